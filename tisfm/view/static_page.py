"""A page that plays a result without Python and without a network."""

from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from tisfm.errors import InputError
from tisfm.results.frame import ResultFrame
from tisfm.results.result_frames import ResultFrames
from tisfm.view.colors import Quantity, Ranges, legend_of_result, object_labels
from tisfm.view.frame_cloud import PointFilter, frame_cloud
from tisfm.view.html_texts import foot_html, legend_html
from tisfm.view.scene import ViewerScene
from tisfm.view.server import start_server, stop_server


@dataclass(frozen=True, kw_only=True)
class StaticPage:
    """A page that plays by itself."""

    text: str  # the HTML file
    frames: int  # frames in it
    unread: tuple[str, ...]  # names of frames that could not be read, each with the reason


def static_page(
    result: ResultFrames,
    *,
    quantity: Quantity,  # gives the colours of the points
    ranges: Ranges,
    points: PointFilter,  # selects the points of a frame
    max_frames: int,  # limit of the frames; a longer result is sampled evenly
    frames_per_second: float,
    size: float = 1.2,  # size of points; 1 if neighbours touch at the median depth
) -> StaticPage:
    """Return an HTML file with points, frusta and paths of frames, which any browser plays.

    Frames that cannot be read are left out; a line at its foot names them.

    Raises ImportError if viser is not installed.

    Raises ValueError if no frame can be read.
    """
    count = len(result.names)
    numbers = np.unique(np.linspace(0, count - 1, min(count, max_frames)).astype(int))
    unread: list[str] = []
    labels: set[int] = set()
    first_frame: ResultFrame | None = None
    server = start_server("127.0.0.1", 0)
    try:
        for number in map(int, numbers):
            try:
                frame = result.read(number)
            except (OSError, ValueError) as error:  # missing or damaged: other frames are shown
                unread.append(f"{result.names[number]}: {' '.join(str(error).split())}")
                continue
            if first_frame is None:
                first_frame, piece = frame, int(result.piece[number])
                scene = ViewerScene(server, result)
                scene.set_depth(frame.median_depth)
                scene.show_path(number, frame, path=True, frusta=True)
            elif result.piece[number] != piece:
                piece = int(result.piece[number])
                scene.show_path(number, frame, path=True, frusta=True)
            labels |= object_labels(frame)
            cloud = frame_cloud(frame, quantity, ranges, points, scene.pose_of(number))
            if frame is first_frame:
                scene.set_first_viewpoint(frame, cloud)
                recording = server.get_scene_serializer()
            scene.show_points(cloud, frame, size=size)
            scene.show_frustum(frame, visible=True)
            scene.show_objects(number, visible=True)
            recording.insert_sleep(1 / frames_per_second)
        if first_frame is None:
            raise InputError(f"{result.folder} has no frame that can be read: {unread[0]}")
        if piece != result.piece[first_frame.number]:  # the page plays in a loop
            scene.show_path(first_frame.number, first_frame, path=True, frusta=True)
        shown_count = len(numbers) - len(unread)
        text = _with_foot(
            recording.as_html(),
            legend_html(legend_of_result(result, quantity, ranges, labels)),
            _caption(result, shown_count, unread),
        )
        return StaticPage(text=text, frames=shown_count, unread=tuple(unread))
    finally:
        stop_server(server)


def _caption(result: ResultFrames, shown_count: int, unread: list[str]) -> str:
    """Return name, number of frames, unread frames, grade, and a note on the focal length."""
    text = f"{result.folder.resolve().name}: {shown_count} of {len(result.names)} frames"
    if unread:
        others = f" and {len(unread) - 1} more" if len(unread) > 1 else ""
        text += f". Left out, as it cannot be read: {unread[0]}{others}"
    if result.names:
        text += f". Grade {result.grade_summary.text}"
        text += f". {result.focal_note}" if result.focal_note else ""
    return text


def _with_foot(page: str, legend: Markup, caption: str) -> str:
    """Return a page, as viser made it, with a legend and a line at its foot."""
    block = foot_html(legend, caption)
    before, end, after = page.rpartition("</body>")
    page_text = f"{before}{block}{end}{after}" if end else f"{page}{block}"
    return page_text.encode("utf-8", "replace").decode()  # names may have lone surrogates
