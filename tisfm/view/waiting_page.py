"""A page that shows the progress of a result without a complete frame."""

import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tisfm.reconstruction.result.folder import PICTURES, read_picture
from tisfm.results.opening import NotReadyError, describe_progress, open_result
from tisfm.results.result_frames import ResultFrames, as_rgb
from tisfm.view.html_texts import NOTHING, set_html, waiting_html

if TYPE_CHECKING:
    from viser import ViserServer

# Set by hand.
_FOLDER_CHECK_INTERVAL = 0.5  # s between checks of the folder
_PICTURE_PERIOD = 2.0  # s between pictures
_LAST_MESSAGE_TIME = 0.3  # s for browsers to receive the last message


class WaitingPage:
    """Shows browsers the progress of a command that writes a result."""

    def __init__(
        self,
        server: "ViserServer",  # `ViewerPage` takes it over, and removes the texts of this page
        folder: Path,
    ) -> None:
        self._folder, self._server = folder, server
        gui = server.gui
        gui.configure_theme(show_logo=False, show_share_button=False, control_width="large")
        self._text = gui.add_html("")
        self._shown_text = NOTHING
        self._image: Any = None
        self._add_image = gui.add_image
        self._picture_time = -np.inf

    def wait(self) -> ResultFrames:
        """Return the result as soon as it has a complete frame.

        Raises OSError, ValueError if the command has ended without a result, or a file is damaged.
        """
        while True:
            try:
                return open_result(self._folder)
            except NotReadyError as error:
                self._show(str(error))
            except (OSError, ValueError) as error:
                reason = " ".join(str(error).split())
                set_html(self._text, waiting_html(reason, is_running=False))
                self._server.flush()
                time.sleep(_LAST_MESSAGE_TIME)
                raise
            time.sleep(_FOLDER_CHECK_INTERVAL)

    def _show(self, reason: str) -> None:
        """Show the reason of waiting, the progress, and the latest frame."""
        text = waiting_html(reason, describe_progress(self._folder))
        if text != self._shown_text:
            self._shown_text = text
            set_html(self._text, text)
        now = time.monotonic()
        if now - self._picture_time < _PICTURE_PERIOD:
            return
        self._picture_time = now
        picture = _newest_picture(self._folder)
        if picture is None:
            return
        if self._image is None:
            self._image = self._add_image(picture, label="latest frame", jpeg_quality=80)
        else:
            self._image.image = picture


def _newest_picture(folder: Path) -> NDArray[np.uint8] | None:
    """Return the latest frame of a running reconstruction; None without a frame."""
    names = sorted(path.stem for path in (folder / PICTURES).glob("*.jpg"))
    if not names or not names[-1].isdigit():
        return None
    try:
        return as_rgb(read_picture(folder, int(names[-1])))
    except (OSError, ValueError):  # the file is being replaced
        return None
