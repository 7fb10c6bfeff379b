"""``tisfm view``: its arguments."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg


@dataclass(kw_only=True)
class View:
    """Look at a result in the browser: points, the camera's path, pictures, numbers at a pixel.

    DIR is what `tisfm run` or `tisfm reconstruct` wrote, or is writing: pairs appear as they are
    finished, a reconstruction at its end. Frames are read when they are looked at. Only this
    computer can open the page, unless --host says otherwise: whoever can reach it sees the result.
    It needs pip install 'tisfm[view]'. Ctrl-C ends it.
    """

    folder: Annotated[Positional[Path], arg(metavar="DIR")]
    """The folder of a result."""
    host: str = "127.0.0.1"
    """Address that the page is served at; 0.0.0.0 lets all of the network see it."""
    port: int = 8080
    """Port, or the next one that is free."""
    browser: bool = True
    """Open the page in the browser of this computer."""
    frame: int = 0
    """Frame that is shown first, from 0."""
    points: int = 200_000
    """Points of a frame, at most, at first; a slider changes it."""
    html: Annotated[Path | None, arg(metavar="FILE")] = None
    """Write a page that plays without Python and without a network, and end."""
    html_frames: int = 120
    """Frames in it, at most: others are left out, evenly."""
    html_points: int = 20_000
    """Points of each frame in it, at most."""

    def __call__(self) -> int:
        """Run the command and return the exit code."""
        from tisfm.cli.view_command import view, write_static

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
