"""``tisfm view`` as somebody at a browser meets it: how long until there is something to see.

The browser is a headless Chromium that draws without a GPU. It has been started before. Its page
notes when it has drawn points: looking at pictures of the window would keep it from drawing.
"""

import os
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
OPTIONS = (
    "--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
)  # fmt: skip
WINDOW = {"width": 1280, "height": 800}
PATIENCE = 120.0  # s
_REST = 1.5  # s without data, after which all of a frame is there
# The first call that draws many points is noted when the browser comes to the next picture but one.
_NOTES = """
const draw = WebGL2RenderingContext.prototype.drawArrays;
WebGL2RenderingContext.prototype.drawArrays = function (mode, first, count) {
  draw.call(this, mode, first, count);
  if (mode === this.POINTS && count >= 1000 && !window.asked) {
    window.asked = true;
    const note = () => { window.pointsSeen = Date.now() / 1000; };
    requestAnimationFrame(() => requestAnimationFrame(note));
  }
};
"""
_STARTS = "import sys; from tisfm.cli.command_line import main; sys.exit(main())"


@dataclass(frozen=True, kw_only=True)
class Opening:
    """What was measured of one start of the command; s from then on, unless said otherwise.

    Attributes
    ----------
    served : float
        Until the command says where its page is.
    first : float
        Until points are seen.
    processor : float
        Of the processor, spent by the command until then.
    refined : float
        Until all points of the first frame have come.
    steps : tuple of (float, float)
        From a step of the slider on: until the frame is shown, and until all its points have come.
    memory, peak : float or None
        MB of the command after the first picture, and the most until its end; None where the system
        does not say so.
    """

    served: float
    first: float
    processor: float
    refined: float
    steps: tuple[tuple[float, float], ...]
    memory: float | None
    peak: float | None


def browser_path() -> str | None:
    """Return the Chromium of this machine, None if it has none."""
    return next(filter(None, map(shutil.which, NAMES)), None)


@contextmanager
def browser() -> Iterator[Any]:
    """Start a browser for a block.

    Raises
    ------
    RuntimeError
        If there is none, or no Playwright to drive it.
    """
    path = browser_path()
    if path is None:
        raise RuntimeError("there is no Chromium: Debian has it as the package chromium")
    try:
        from playwright.sync_api import sync_playwright
    except ImportError as error:
        raise RuntimeError("there is no playwright: pip install '.[test]'") from error
    with sync_playwright() as playwright:
        started = playwright.chromium.launch(executable_path=path, args=list(OPTIONS))
        try:
            yield started
        finally:
            started.close()


def opened(chromium: Any, folder: Path, steps: Sequence[int]) -> Opening:
    """Start the command on a result, look at its page, and go to frames.

    Raises
    ------
    RuntimeError
        If the command ends, or nothing is seen.
    """
    tab = chromium.new_context(viewport=WINDOW).new_page()
    tab.add_init_script(_NOTES)
    came = Arrivals(tab)
    begin, began = time.perf_counter(), time.time()
    command = subprocess.Popen(
        [sys.executable, "-c", _STARTS, "view", str(folder), "--no-browser", "--port", "0"],
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert command.stderr is not None
        found = re.search(r"http://\S+:\d+", command.stderr.readline())
        if found is None:
            raise RuntimeError(f"tisfm view does not serve {folder}")
        served = time.perf_counter() - begin
        tab.goto(found[0])
        seen = tab.wait_for_function("window.pointsSeen", timeout=1000 * PATIENCE)
        first = seen.json_value() - began
        processor = _processor_time(command.pid)
        refined = came.last_after(begin, tab) - begin
        memory = _memory(command.pid, "VmRSS")
        taken = tuple(_stepped(tab, came, number) for number in steps)
        return Opening(
            served=served,
            first=first,
            processor=processor,
            refined=refined,
            steps=taken,
            memory=memory,
            peak=_memory(command.pid, "VmHWM"),
        )
    finally:
        command.kill()
        command.communicate()
        tab.context.close()


class Arrivals:
    """When data came to a tab."""

    def __init__(self, tab: Any) -> None:
        self.times: list[float] = []
        tab.on("websocket", lambda socket: socket.on("framereceived", self._note))

    def _note(self, payload: str | bytes) -> None:
        if len(payload) > 10_000:  # points and pictures
            self.times.append(time.perf_counter())

    def last_after(self, begin: float, tab: Any) -> float:
        """Wait until nothing more comes, and return when the last of it came."""
        while True:
            last = max([begin, *self.times])
            rest = time.perf_counter() - last
            if rest > _REST:
                return last
            tab.wait_for_timeout(1000 * (_REST - rest) + 20)


def _stepped(tab: Any, came: Arrivals, number: int) -> tuple[float, float]:
    """Go to a frame by the slider's number, and return how long it took."""
    field = (
        tab.get_by_text("Frame", exact=True)
        .locator("xpath=../../..")
        .locator("input:not([type=hidden])")
        .last
    )
    field.fill(str(number))
    begin = time.perf_counter()
    field.press("Enter")
    tab.wait_for_function(
        "want => document.querySelector('[data-testid=status]')?.innerText.includes(want)",
        arg=f", {number + 1} of ",
        timeout=1000 * PATIENCE,
    )
    shown = time.perf_counter() - begin
    return shown, came.last_after(begin, tab) - begin


def _processor_time(process: int) -> float:
    """Return the time of the processor that a process has spent, s; NaN where it is not told."""
    path = Path(f"/proc/{process}/stat")
    if not path.exists():
        return float("nan")
    fields = path.read_text(encoding="utf-8").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _memory(process: int, name: str) -> float | None:
    """Return a size that the system tells of a process, MB."""
    path = Path(f"/proc/{process}/status")
    found = path.exists() and re.search(rf"{name}:\s+(\d+) kB", path.read_text(encoding="utf-8"))
    return int(found[1]) * 1024 / 1e6 if found else None
