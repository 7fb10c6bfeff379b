"""What a browser can save: a screenshot, a fly-through, a page that plays by itself."""

import io
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tisfm.view.scene import START_FOV, behind, quaternion
from tisfm.view.static import static_page

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
    shown = client.get_render(height, width, transport_format="jpeg", timeout=_TIMEOUT)
    file = io.BytesIO()
    Image.fromarray(shown).save(file, "PNG")
    name = f"{page.result.names[max(page.number, 0)]}.png"
    client.send_file_download(name, file.getvalue(), save_immediately=True)


def save_film(page: "Page", client: "ClientHandle") -> None:
    """Give a browser a fly-through: along the path, or around where there is none.

    The browser draws each picture.

    Raises
    ------
    ImportError
        If PyAV is not installed.
    RuntimeError, TimeoutError
        If the browser does not draw.
    """
    require_video()
    count = len(page.result.names)
    numbers = np.unique(np.linspace(0, count - 1, min(count, MOST_FRAMES)).astype(int))
    before = page.number
    pictures = []
    try:
        for k, number in enumerate(numbers):
            page.controls.progress.content = f"<div>picture {k + 1} of {len(numbers)}</div>"
            page.show(int(number))
            pose = behind(page.scene.pose_of(int(number)), page.scene.depth)
            if not page.result.has_one_scale:
                pose = _swung(pose, page.scene.depth, 0.15 * np.sin(2 * np.pi * k / len(numbers)))
            pictures.append(
                client.get_render(
                    *FILM_SIZE,
                    wxyz=quaternion(pose),
                    position=pose[:3, 3],
                    fov=START_FOV,
                    transport_format="jpeg",
                    timeout=_TIMEOUT,
                )
            )
    finally:
        page.show(max(before, 0))
    film = encoded_film(pictures, frames_per_second=int(page.controls.speed.value))
    client.send_file_download("fly-through.mp4", film, save_immediately=True)


def save_static(page: "Page", client: "ClientHandle") -> None:
    """Give a browser a page that plays without Python, as HTML."""
    text = static_page(
        page.result,
        quantity=page.controls.color.value,
        ranges=page.ranges,
        choice=page.choice(_STATIC_POINTS),
        most_frames=_STATIC_FRAMES,
        frames_per_second=page.controls.speed.value,
        size=page.controls.size.value,
    )
    client.send_file_download("view.html", text.encode(), save_immediately=True)


def require_video() -> None:
    """Raise ImportError if there is no PyAV."""
    try:
        import av  # noqa: F401
    except ImportError as error:
        raise ImportError(
            "a film needs PyAV, which is not installed: pip install 'tisfm[video]'"
        ) from error


def encoded_film(pictures: list[NDArray[np.uint8]], *, frames_per_second: int) -> bytes:
    """Return pictures, (H, W, 3) uint8 of one size, as an MP4 file of H.264."""
    import av

    height, width = (side - side % 2 for side in pictures[0].shape[:2])  # as its colours need
    file = io.BytesIO()
    with av.open(file, "w", format="mp4") as container:
        stream: Any = container.add_stream("libx264", rate=Fraction(frames_per_second))
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        stream.options = {"crf": "20"}
        for picture in pictures:
            shown = np.ascontiguousarray(picture[:height, :width, :3])
            container.mux(stream.encode(av.VideoFrame.from_ndarray(shown, format="rgb24")))
        container.mux(stream.encode(None))
    return file.getvalue()


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
