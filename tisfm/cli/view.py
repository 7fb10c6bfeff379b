"""``tisfm view``."""

import time
import webbrowser
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, arg

from tisfm.cli.console import tell
from tisfm.errors import InputError
from tisfm.formats import atomic_write
from tisfm.results.opening import NotReadyError, open_result
from tisfm.results.result_frames import FrameCache, ResultFrames
from tisfm.view.colors import ranges_of, sample_frames
from tisfm.view.frame_cloud import PointFilter
from tisfm.view.page import ViewerPage
from tisfm.view.server import start_server, stop_server, url_of
from tisfm.view.static_page import static_page
from tisfm.view.waiting_page import WaitingPage

if TYPE_CHECKING:
    from viser import ViserServer


@dataclass(kw_only=True)
class View:
    """Show a result in the browser: points, the path of the camera, pictures, values at a pixel.

    DIR is the folder that tisfm run or tisfm reconstruct wrote, or is writing. Pairs appear when
    they are finished, a reconstruction when it is complete. By default only this computer can open
    the page; with --host, everyone who can reach this computer sees the result. The command needs
    pip install 'tisfm[view]'. Ctrl-C ends it.
    """

    folder: Annotated[Positional[Path], arg(metavar="DIR")]
    """The folder of a result."""
    host: str = "127.0.0.1"
    """Address of the server; 0.0.0.0 makes the page visible to the whole network."""
    port: int = 8080
    """Port of the server. If it is in use, the next free port is taken."""
    browser: bool = True
    """Open the page in the browser of this computer."""
    frame: int = 0
    """Number of the frame that is shown first, from 0."""
    points: int = 200_000
    """Maximum number of points of a frame; a slider on the page changes it."""
    html: Annotated[Path | None, arg(metavar="FILE")] = None
    """Write an HTML file instead, which plays the result without Python and without a network."""
    html_frames: int = 120
    """Maximum number of frames in the file of --html; they are evenly spaced."""
    html_points: int = 20_000
    """Maximum number of points of each frame in the file of --html."""

    def __call__(self) -> int:
        """Run the command and return the exit code."""
        if self.html is not None:
            return write_static(
                self.folder, self.html, frames=self.html_frames, points=self.html_points
            )
        return view(
            self.folder,
            host=self.host,
            port=self.port,
            browser=self.browser,
            frame=self.frame,
            points=self.points,
        )


_FIRST_BROWSER_WAIT = (
    10.0  # s: wait for a browser before more than the first coarse picture is drawn
)


def view(folder: Path, *, host: str, port: int, browser: bool, frame: int, points: int) -> int:
    """Show a result in the browser until Ctrl-C."""
    if points < 1:
        raise InputError(f"--points is {points}: expected a positive number")
    result, server = _open_or_wait(folder, frame, host=host, port=port, browser=browser)
    page = ViewerPage(
        result,
        host=host,
        port=port,
        number=frame,
        max_points=points,
        browser_wait=_FIRST_BROWSER_WAIT,
        server=server,
    )
    try:
        tell(f"{folder} is shown at {page.url}; Ctrl-C ends the command")
        if browser and server is None:
            webbrowser.open(page.url)
        while True:  # a wait without an end cannot be interrupted on Windows
            time.sleep(0.5)
    except KeyboardInterrupt:
        return 0
    finally:
        page.stop()


def write_static(folder: Path, path: Path, *, frames: int, points: int) -> int:
    """Write a page that plays a result without Python."""
    for name, value in (("--html-frames", frames), ("--html-points", points)):
        if value < 1:
            raise InputError(f"{name} is {value}: expected a positive number")
    if not path.absolute().parent.is_dir():
        raise FileNotFoundError(f"there is no folder {path.parent} to write {path.name} to")
    result = open_result(folder)
    ranges = ranges_of(sample_frames(FrameCache(result), len(result.names)))
    page = static_page(
        result,
        quantity="image",
        ranges=ranges,
        points=PointFilter(max_points=points),
        max_frames=frames,
        frames_per_second=8,
    )
    with atomic_write(path) as file:
        file.write(page.text.encode())
    size = len(page.text) / 1e6
    tell(f"{page.frames} of {len(result.names)} frames in {path}, {size:.1f} MB")
    for unread in page.unread:
        tell(f"left out, because it cannot be read: {unread}")
    return 0


def _open_or_wait(
    folder: Path, frame: int, *, host: str, port: int, browser: bool
) -> "tuple[ResultFrames, ViserServer | None]":
    """Open a result. If it has no frame yet, show a waiting page until its first frame.

    Returns the result, and the server of the waiting page, None without such a page.
    """
    try:
        result = open_result(folder)
        _require_frame(result, frame)
        return result, None
    except NotReadyError as error:
        server = start_server(host, port)
        tell(f"{error}: {url_of(server)} waits for it; Ctrl-C ends the command")
    try:
        if browser:
            webbrowser.open(url_of(server))
        result = WaitingPage(server, folder).wait()
        _require_frame(result, frame)
    except BaseException:
        stop_server(server)
        raise
    return result, server


def _require_frame(result: ResultFrames, frame: int) -> None:
    count = len(result.names)
    if not 0 <= frame < count:
        raise InputError(f"--frame is {frame}: expected 0 to {count - 1}")
