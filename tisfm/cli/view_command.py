"""What `tisfm view` does."""

import time
import webbrowser
from pathlib import Path

from tisfm.cli.console import tell
from tisfm.formats import atomic_write
from tisfm.view.cache import FrameCache
from tisfm.view.cloud import Choice
from tisfm.view.opening import NothingYetError, open_result
from tisfm.view.page import Page
from tisfm.view.ranges import ranges_of, sampled
from tisfm.view.result import Result
from tisfm.view.static import static_page

_WAIT = 0.5  # s between looks at a folder that has nothing yet


def view(folder: Path, *, host: str, port: int, browser: bool, frame: int, points: int) -> int:
    """Show a result in the browser until Ctrl-C."""
    if points < 1:
        raise ValueError(f"--points is {points}: expected a positive number")
    result = _opened(folder)
    _require_frame(result, frame)
    page = Page(result, host=host, port=port, number=frame, most_points=points)
    try:
        tell(f"{folder} at {page.url}: Ctrl-C ends it")
        if browser:
            webbrowser.open(page.url)
        while True:  # a wait without an end cannot be interrupted on Windows
            time.sleep(0.5)
    except KeyboardInterrupt:
        return 0
    finally:
        page.stop()
    return 0


def write_static(folder: Path, path: Path, *, frames: int, points: int) -> int:
    """Write a page that plays a result without Python."""
    for name, value in (("--html-frames", frames), ("--html-points", points)):
        if value < 1:
            raise ValueError(f"{name} is {value}: expected a positive number")
    if not path.absolute().parent.is_dir():
        raise FileNotFoundError(f"there is no folder {path.parent} to write {path.name} to")
    result = open_result(folder)
    ranges = ranges_of(sampled(FrameCache(result), len(result.names)))
    text = static_page(
        result,
        quantity="image",
        ranges=ranges,
        choice=Choice(most_points=points),
        most_frames=frames,
        frames_per_second=8,
    )
    with atomic_write(path) as file:
        file.write(text.encode())
    shown = min(frames, len(result.names))
    tell(f"{shown} of {len(result.names)} frames in {path}, {len(text) / 1e6:.1f} MB")
    return 0


def _opened(folder: Path) -> Result:
    """Open a result; wait for the first frame where one is being made."""
    is_told = False
    while True:
        try:
            return open_result(folder)
        except NothingYetError as error:
            if not is_told:
                tell(f"{error}: waiting for it, Ctrl-C ends that")
            is_told = True
            time.sleep(_WAIT)


def _require_frame(result: Result, frame: int) -> None:
    count = len(result.names)
    if not 0 <= frame < count:
        raise ValueError(f"--frame is {frame}: expected 0 to {count - 1}")
