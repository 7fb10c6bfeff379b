"""What a browser can save: a screenshot, a fly-through, a page that plays by itself."""

import io
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tisfm.errors import InputError
from tisfm.view.html_texts import progress_html, set_html
from tisfm.view.scene import behind, quaternion
from tisfm.view.static_page import static_page
from tisfm.view.viewpoint import FOV

if TYPE_CHECKING:
    from viser import ClientHandle

    from tisfm.view.page import Page

MOST_FRAMES = 300  # of a fly-through
FILM_SIZE = (540, 960)  # rows and columns, px
_TIMEOUT = 120.0  # s, for a browser to draw a picture
_STATIC_FRAMES, _STATIC_POINTS = 120, 20_000


def save_screenshot(page: "Page", client: "ClientHandle") -> None:
    """Give a browser what it shows, as a PNG file."""
    from PIL import Image

    height, width = client.camera.image_height, client.camera.image_width
    shown = client.get_render(height, width, transport_format="png", timeout=_TIMEOUT)
    picture = Image.fromarray(shown).convert("RGBA")
    ground = Image.new("RGBA", picture.size, "white")  # as of the page
    file = io.BytesIO()
    Image.alpha_composite(ground, picture).convert("RGB").save(file, "PNG")
    name = f"{page.result.names[max(page.number, 0)]}.png"
    client.send_file_download(name, file.getvalue(), save_immediately=True)


def save_film(page: "Page", client: "ClientHandle") -> None:
    """Give a browser a fly-through: along the path, or around where there is none.

    The browser draws each picture. Frames that cannot be read are left out, and told.

    Raises
    ------
    ImportError
        If PyAV is not installed.
    RuntimeError, TimeoutError
        If the browser does not draw.
    ValueError
        If no frame can be read.
    """
    from tisfm.exports.video_file import check_video, video_file  # it takes a while to load

    check_video()
    count = len(page.result.names)
    numbers = np.unique(np.linspace(0, count - 1, min(count, MOST_FRAMES)).astype(int))
    before, depth, unread = page.number, page.scene.depth, list[str]()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "film.mp4")
        try:
            with video_file(path, page.controls.speed.value) as film:
                for k, number in enumerate(map(int, numbers)):
                    set_html(page.controls.progress, progress_html(k + 1, len(numbers)))
                    if page.show(number) is None:
                        unread.append(f"{page.result.names[number]}: {page.fault}")
                        continue
                    pose = behind(page.scene.pose_of(number), depth)
                    if not page.result.has_one_scale:
                        pose = _swung(pose, depth, 0.15 * np.sin(2 * np.pi * k / len(numbers)))
                    film.add(_drawn(client, pose))
                if len(unread) == len(numbers):
                    raise InputError(f"no frame can be read: {unread[0]}")
        finally:
            page.show(max(before, 0))
        client.send_file_download("fly-through.mp4", path.read_bytes(), save_immediately=True)
    _tell_unread(page, client, "The film is not complete", unread)


def save_static(page: "Page", client: "ClientHandle") -> None:
    """Give a browser a page that plays without Python, as HTML."""
    made = static_page(
        page.result,
        quantity=page.controls.color.value,
        ranges=page.ranges,
        choice=page.choice(_STATIC_POINTS),
        most_frames=_STATIC_FRAMES,
        frames_per_second=page.controls.speed.value,
        size=page.controls.size.value,
    )
    client.send_file_download("view.html", made.text.encode(), save_immediately=True)
    _tell_unread(page, client, "The page is not complete", made.unread)


def tell_browser(page: "Page", client: "ClientHandle", title: str, text: str) -> None:
    """Show a note in a browser, if it is still there."""
    if client.client_id in page.server.get_clients():
        client.add_notification(title, text)


def _tell_unread(page: "Page", client: "ClientHandle", title: str, unread: Sequence[str]) -> None:
    """Say in a browser which frames are left out, if any are."""
    if unread:
        frames = "1 frame cannot" if len(unread) == 1 else f"{len(unread)} frames cannot"
        tell_browser(page, client, title, f"{frames} be read: {unread[0]}")


def _drawn(client: "ClientHandle", pose: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Return what a browser draws as seen from a pose, (H, W, 3) uint8."""
    picture = client.get_render(
        *FILM_SIZE,
        wxyz=quaternion(pose),
        position=pose[:3, 3],
        fov=FOV,
        transport_format="jpeg",
        timeout=_TIMEOUT,
    )
    return np.asarray(picture[..., :3], np.uint8)


def _swung(pose: NDArray[np.float64], depth: float, angle: float) -> NDArray[np.float64]:
    """Return a pose turned about what it looks at, by an angle about its Y axis, rad."""
    turn = np.eye(4)
    turn[:3, :3] = (
        (np.cos(angle), 0, np.sin(angle)),
        (0, 1, 0),
        (-np.sin(angle), 0, np.cos(angle)),
    )
    there, back = np.eye(4), np.eye(4)
    there[2, 3], back[2, 3] = depth, -depth
    swung: NDArray[np.float64] = pose @ there @ turn @ back
    return swung
