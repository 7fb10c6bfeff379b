"""A page that says how far a result is, while there is nothing of it to look at."""

import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from tisfm.reconstruction.result.folder import PICTURES, read_picture
from tisfm.results.opening import NothingYetError, how_far, open_result
from tisfm.results.result import Result, as_rgb
from tisfm.view.html_texts import set_html, waiting_html

if TYPE_CHECKING:
    from viser import ViserServer

_LOOK = 0.5  # s between looks at a folder
_RENEWED = 2.0  # s between pictures
_SENT = 0.3  # s for browsers to be told the last


class WaitingPage:
    """Shows browsers what is known of a result that is being made.

    Parameters
    ----------
    server : ViserServer
        Whoever shows the result takes it over, and removes what is shown here.
    folder : Path
    """

    def __init__(self, server: "ViserServer", folder: Path) -> None:
        self._folder, self._server = folder, server
        gui = server.gui
        gui.configure_theme(show_logo=False, show_share_button=False, control_width="large")
        self._text = gui.add_html("")
        self._told = Markup()
        self._image: Any = None
        self._add_image = gui.add_image
        self._pictured_at = -np.inf

    def wait(self) -> Result:
        """Return the result as soon as it can be looked at.

        Raises
        ------
        OSError, ValueError
            If nobody goes on making it, or a file is damaged.
        """
        while True:
            try:
                return open_result(self._folder)
            except NothingYetError as error:
                self._show(str(error))
            except (OSError, ValueError) as error:
                reason = " ".join(str(error).split())
                set_html(self._text, waiting_html(reason, is_going_on=False))
                self._server.flush()
                time.sleep(_SENT)
                raise
            time.sleep(_LOOK)

    def _show(self, reason: str) -> None:
        """Show why there is nothing, how far it is, and the frame that was read last."""
        text = waiting_html(reason, how_far(self._folder))
        if text != self._told:
            self._told = text
            set_html(self._text, text)
        now = time.monotonic()
        if now - self._pictured_at < _RENEWED:
            return
        self._pictured_at = now
        picture = _newest_picture(self._folder)
        if picture is None:
            return
        if self._image is None:
            self._image = self._add_image(picture, label="the frame read last", jpeg_quality=80)
        else:
            self._image.image = picture


def _newest_picture(folder: Path) -> NDArray[np.uint8] | None:
    """Return the last frame of a reconstruction that is being made, None if there is none."""
    names = sorted(path.stem for path in (folder / PICTURES).glob("*.jpg"))
    if not names or not names[-1].isdigit():
        return None
    try:
        return as_rgb(read_picture(folder, int(names[-1])))
    except (OSError, ValueError):  # it is just being replaced
        return None
