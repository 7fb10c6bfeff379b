"""Files that a browser can save: a screenshot, a fly-through, a page that plays by itself."""

import io
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tisfm.errors import InputError
from tisfm.view.html_texts import progress_html, set_html
from tisfm.view.scene import pose_behind, quaternion
from tisfm.view.static_page import static_page
from tisfm.view.viewpoint import FOV

if TYPE_CHECKING:
    from viser import ClientHandle

    from tisfm.view.page import ViewerPage

# Set by hand.
_MAX_FILM_FRAMES = 300
FILM_SIZE = (540, 960)  # rows and columns, px
_SWING_ANGLE = 0.15  # rad, to either side, in a film of frames without a common scale
_TIMEOUT = 120.0  # s, for a browser to draw a picture
_MAX_STATIC_FRAMES = 120  # frames of a page that plays by itself
_MAX_STATIC_POINTS = 20_000  # points of each frame of such a page


def save_screenshot(page: "ViewerPage", client: "ClientHandle") -> None:
    """Give a browser its view as a PNG file."""
    from PIL import Image

    height, width = client.camera.image_height, client.camera.image_width
    view = client.get_render(height, width, transport_format="png", timeout=_TIMEOUT)
    picture = Image.fromarray(view).convert("RGBA")
    background = Image.new("RGBA", picture.size, "white")  # the background of the page
    file = io.BytesIO()
    Image.alpha_composite(background, picture).convert("RGB").save(file, "PNG")
    name = f"{page.result.names[max(page.number, 0)]}.png"
    client.send_file_download(name, file.getvalue(), save_immediately=True)


def save_film(page: "ViewerPage", client: "ClientHandle") -> None:
    """Give a browser a film along the path, or around the frames if there is no path.

    The browser draws each picture. Frames that cannot be read are left out, with a note.

    Raises ImportError if PyAV is not installed.

    Raises RuntimeError, TimeoutError if the browser does not answer.

    Raises ValueError if no frame can be read.
    """
    from tisfm.exports.video_file import check_video, video_file  # it takes a while to load

    check_video()
    count = len(page.result.names)
    numbers = np.unique(np.linspace(0, count - 1, min(count, _MAX_FILM_FRAMES)).astype(int))
    current_number, depth, unread_frames = page.number, page.scene.depth, list[str]()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "film.mp4")
        try:
            with video_file(path, page.controls.speed.value) as film:
                for k, number in enumerate(map(int, numbers)):
                    set_html(page.controls.progress, progress_html(k + 1, len(numbers)))
                    if page.show(number) is None:
                        unread_frames.append(f"{page.result.names[number]}: {page.fault}")
                        continue
                    pose = pose_behind(page.scene.pose_of(number), depth)
                    if not page.result.has_one_scale:
                        pose = _swing_pose(
                            pose, depth, _SWING_ANGLE * np.sin(2 * np.pi * k / len(numbers))
                        )
                    film.add(_render_view(client, pose))
                if len(unread_frames) == len(numbers):
                    raise InputError(f"no frame can be read: {unread_frames[0]}")
        finally:
            page.show(max(current_number, 0))
        client.send_file_download("fly-through.mp4", path.read_bytes(), save_immediately=True)
    _note_unread(page, client, "The film is not complete", unread_frames)


def save_static(page: "ViewerPage", client: "ClientHandle") -> None:
    """Give a browser a page that plays without Python, as an HTML file."""
    static = static_page(
        page.result,
        quantity=page.controls.color.value,
        ranges=page.ranges,
        points=page.point_filter(_MAX_STATIC_POINTS),
        max_frames=_MAX_STATIC_FRAMES,
        frames_per_second=page.controls.speed.value,
        size=page.controls.size.value,
    )
    client.send_file_download("view.html", static.text.encode(), save_immediately=True)
    _note_unread(page, client, "The page is not complete", static.unread)


def notify(page: "ViewerPage", client: "ClientHandle", title: str, text: str) -> None:
    """Show a note in a browser, if it is still connected."""
    if client.client_id in page.server.get_clients():
        client.add_notification(title, text)


def _note_unread(
    page: "ViewerPage", client: "ClientHandle", title: str, unread_frames: Sequence[str]
) -> None:
    """Note in a browser which frames were left out."""
    if unread_frames:
        frames = (
            "1 frame cannot" if len(unread_frames) == 1 else f"{len(unread_frames)} frames cannot"
        )
        notify(page, client, title, f"{frames} be read: {unread_frames[0]}")


def _render_view(client: "ClientHandle", pose: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Return the view of a browser from a pose, (H, W, 3) uint8."""
    picture = client.get_render(
        *FILM_SIZE,
        wxyz=quaternion(pose),
        position=pose[:3, 3],
        fov=FOV,
        transport_format="jpeg",
        timeout=_TIMEOUT,
    )
    return np.asarray(picture[..., :3], np.uint8)


def _swing_pose(pose: NDArray[np.float64], depth: float, angle: float) -> NDArray[np.float64]:
    """Return a pose turned about a point ahead of it, by an angle about its Y axis, rad."""
    rotation = np.eye(4)
    rotation[:3, :3] = (
        (np.cos(angle), 0, np.sin(angle)),
        (0, 1, 0),
        (-np.sin(angle), 0, np.cos(angle)),
    )
    forward, backward = np.eye(4), np.eye(4)
    forward[2, 3], backward[2, 3] = depth, -depth
    swung_pose: NDArray[np.float64] = pose @ forward @ rotation @ backward
    return swung_pose
