"""A page that plays a result without Python and without a network."""

from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from tisfm.errors import InputError
from tisfm.results.frame import ViewFrame
from tisfm.results.result import Result
from tisfm.view.colors import Quantity, Ranges
from tisfm.view.frame_cloud import Choice, cloud
from tisfm.view.html_texts import legend_html, legend_of, things_in
from tisfm.view.scene import SceneView
from tisfm.view.server import start_server, stop_server

_CAPTION = (
    "position:fixed;left:0;bottom:44px;max-width:60%;padding:0.3em 0.7em;font:12px sans-serif;"
    "color:#333;background:rgba(255,255,255,0.8);pointer-events:none"
)


@dataclass(frozen=True, kw_only=True)
class StaticPage:
    """A page that plays by itself.

    Attributes
    ----------
    text : str
        The HTML file.
    frames : int
        Frames in it.
    unread : tuple of str
        Names of frames that could not be read, each with what is wrong.
    """

    text: str
    frames: int
    unread: tuple[str, ...]


def static_page(
    result: Result,
    *,
    quantity: Quantity,
    ranges: Ranges,
    choice: Choice,
    most_frames: int,
    frames_per_second: float,
    size: float = 1.2,
) -> StaticPage:
    """Return one HTML file with points, frusta and paths of frames, which any browser plays.

    Frames that cannot be read are left out; a line at its foot names them.

    Parameters
    ----------
    result : Result
    quantity : str
        What points are coloured by.
    ranges : Ranges
    choice : Choice
        Which points of a frame.
    most_frames : int
        Frames are left out, evenly, until there are so many.
    frames_per_second : float
    size : float
        Of points, over their distance.

    Raises
    ------
    ImportError
        If viser is not installed.
    ValueError
        If no frame can be read.
    """
    count = len(result.names)
    numbers = np.unique(np.linspace(0, count - 1, min(count, most_frames)).astype(int))
    unread: list[str] = []
    things: set[int] = set()
    first: ViewFrame | None = None
    server = start_server("127.0.0.1", 0)
    try:
        for number in map(int, numbers):
            try:
                frame = result.read(number)
            except (OSError, ValueError) as error:  # it is gone, or damaged: the others are shown
                unread.append(f"{result.names[number]}: {' '.join(str(error).split())}")
                continue
            if first is None:
                first, piece = frame, int(result.piece[number])
                scene = SceneView(server, result)
                scene.begin(frame.usual_depth)
                scene.show_path(number, frame, path=True, frusta=True)
            elif result.piece[number] != piece:
                piece = int(result.piece[number])
                scene.show_path(number, frame, path=True, frusta=True)
            things |= things_in(frame)
            points = cloud(frame, quantity, ranges, choice, scene.pose_of(number))
            if frame is first:
                scene.place_browsers(frame, points)
                recording = server.get_scene_serializer()
            scene.show_points(points, frame, size=size)
            scene.show_here(frame, visible=True)
            scene.show_things(number, visible=True)
            recording.insert_sleep(1 / frames_per_second)
        if first is None:
            raise InputError(f"{result.folder} has no frame that can be read: {unread[0]}")
        if piece != result.piece[first.number]:  # it begins anew after its end
            scene.show_path(first.number, first, path=True, frusta=True)
        shown = len(numbers) - len(unread)
        text = _captioned(
            recording.as_html(),
            legend_html(legend_of(result, quantity, ranges, things)),
            _caption(result, shown, unread),
        )
        return StaticPage(text=text, frames=shown, unread=tuple(unread))
    finally:
        stop_server(server)


def _caption(result: Result, shown: int, unread: list[str]) -> str:
    """Return what the page says of itself."""
    said = f"{result.folder.resolve().name}: {shown} of {len(result.names)} frames"
    if unread:
        more = f" and {len(unread) - 1} more" if len(unread) > 1 else ""
        said += f". Left out, as it cannot be read: {unread[0]}{more}"
    return said


def _captioned(page: str, legend: Markup, caption: str) -> str:
    """Return a page, as viser made it, with a legend and a line at its foot."""
    block = Markup('<div style="{}">{}{}</div>').format(_CAPTION, legend, caption)
    before, end, after = page.rpartition("</body>")
    whole = f"{before}{block}{end}{after}" if end else f"{page}{block}"
    return whole.encode("utf-8", "replace").decode()  # names may have lone surrogates
