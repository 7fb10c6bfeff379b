"""A page that plays a result without Python and without a network."""

import contextlib
import io

import numpy as np

from tisfm.view.cloud import Choice, cloud
from tisfm.view.colors import Quantity, Ranges
from tisfm.view.result import Result
from tisfm.view.scene import SceneView
from tisfm.view.server import start_server


def static_page(
    result: Result,
    *,
    quantity: Quantity,
    ranges: Ranges,
    choice: Choice,
    most_frames: int,
    frames_per_second: float,
    size: float = 1.2,
) -> str:
    """Return one HTML file with points, frusta and paths of frames, which any browser plays.

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
    server = start_server("127.0.0.1", 0)
    try:
        scene = None
        for number in map(int, numbers):
            try:
                frame = result.read(number)
            except (OSError, ValueError):  # it is gone, or damaged: the others are shown
                continue
            if scene is None:
                scene = SceneView(server, result, frame.usual_depth)
                scene.place_browsers(number)
                scene.show_path(number, frame, path=True, frusta=True)
                recording = server.get_scene_serializer()
            points = cloud(frame, quantity, ranges, choice, scene.pose_of(number))
            scene.show_points(points, frame, size=size)
            scene.show_here(frame, visible=True)
            scene.show_things(number, visible=True)
            recording.insert_sleep(1 / frames_per_second)
        if scene is None:
            raise ValueError(f"{result.folder} has no frame that can be read")
        return recording.as_html()
    finally:
        with contextlib.redirect_stdout(io.StringIO()):
            server.stop()
