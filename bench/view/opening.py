"""Time from the start of ``tisfm view`` until its page shows points in a browser.

The browser is a headless Chromium without a GPU, which is already open. The page itself records
when it has drawn points, because screenshots would delay the drawing.
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

from bench.shared.results import process_memory

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
OPTIONS = (
    "--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
)  # fmt: skip
WINDOW = {"width": 1280, "height": 800}
PAGE_TIMEOUT = 120.0  # s to wait for the page
IDLE_TIME = 1.5  # s without data after which a frame counts as complete; set by hand
MIN_PAYLOAD = 10_000  # bytes of a message with points or pictures
# Notes the second picture after the first call that draws 1,000 points or more.
DRAWING_NOTES = """
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
COMMAND = "import sys; from tisfm.cli.command_line import main; sys.exit(main())"


@dataclass(frozen=True, kw_only=True)
class Opening:
    """Times of one start of the command: s since the start, unless stated otherwise."""

    served: float  # until the command prints the address of its page
    first: float  # until the first points are visible
    processor: float  # processor time of the command until the first points are visible
    refined: float  # until all points of the first frame have arrived
    # Since each step of the slider: until the frame is shown, and until all its points are there.
    steps: tuple[tuple[float, float], ...]
    memory: float | None  # of the command after the first picture, MB; None if not reported
    peak: float | None  # MB


def browser_path() -> str | None:
    """Return the Chromium of this machine, or None."""
    return next(filter(None, map(shutil.which, NAMES)), None)


@contextmanager
def browser() -> Iterator[Any]:
    """Start a browser for a block.

    Raise RuntimeError if Chromium or Playwright is not installed.
    """
    path = browser_path()
    if path is None:
        raise RuntimeError("Chromium is not installed: on Debian, install the package chromium")
    try:
        from playwright.sync_api import sync_playwright
    except ImportError as error:
        raise RuntimeError("playwright is not installed: pip install '.[test]'") from error
    with sync_playwright() as playwright:
        chromium_browser = playwright.chromium.launch(executable_path=path, args=list(OPTIONS))
        try:
            yield chromium_browser
        finally:
            chromium_browser.close()


def measure_opening(chromium: Any, folder: Path, steps: Sequence[int]) -> Opening:
    """Start the command on a result, open its page, and step to frames.

    Raise RuntimeError if the command serves no page.
    """
    tab = chromium.new_context(viewport=WINDOW).new_page()
    tab.add_init_script(DRAWING_NOTES)
    arrivals = Arrivals(tab)
    begin, start_clock = time.perf_counter(), time.time()
    command = subprocess.Popen(
        [sys.executable, "-c", COMMAND, "view", str(folder), "--no-browser", "--port", "0"],
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert command.stderr is not None
        address = re.search(r"http://\S+:\d+", command.stderr.readline())
        if address is None:
            raise RuntimeError(f"tisfm view serves no page of {folder}")
        served = time.perf_counter() - begin
        tab.goto(address[0])
        drawing_time = tab.wait_for_function("window.pointsSeen", timeout=1000 * PAGE_TIMEOUT)
        first = drawing_time.json_value() - start_clock
        processor = _processor_time(command.pid)
        refined = arrivals.last_after(begin, tab) - begin
        resident = process_memory("VmRSS", command.pid)
        step_times = tuple(_measure_step(tab, arrivals, number) for number in steps)
        return Opening(
            served=served,
            first=first,
            processor=processor,
            refined=refined,
            steps=step_times,
            memory=_megabytes(resident),
            peak=_megabytes(process_memory("VmHWM", command.pid)),
        )
    finally:
        command.kill()
        command.communicate()
        tab.context.close()


class Arrivals:
    """Times at which data arrived in a tab."""

    def __init__(self, tab: Any) -> None:
        self.times: list[float] = []
        tab.on("websocket", lambda socket: socket.on("framereceived", self._note))

    def _note(self, payload: str | bytes) -> None:
        if len(payload) > MIN_PAYLOAD:
            self.times.append(time.perf_counter())

    def last_after(self, begin: float, tab: Any) -> float:
        """Wait until no more data arrive, and return the time of the last arrival."""
        while True:
            last = max([begin, *self.times])
            idle = time.perf_counter() - last
            if idle > IDLE_TIME:
                return last
            tab.wait_for_timeout(1000 * (IDLE_TIME - idle) + 20)


def _measure_step(tab: Any, arrivals: Arrivals, number: int) -> tuple[float, float]:
    """Step to a frame by the number field of the slider, and return both times."""
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
        timeout=1000 * PAGE_TIMEOUT,
    )
    display_time = time.perf_counter() - begin
    return display_time, arrivals.last_after(begin, tab) - begin


def _processor_time(process: int) -> float:
    """Return the processor time of a process, s; NaN if the system does not report it."""
    path = Path(f"/proc/{process}/stat")
    if not path.exists():
        return float("nan")
    fields = path.read_text(encoding="utf-8").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _megabytes(size: float | None) -> float | None:
    return None if size is None else size / 1e6
