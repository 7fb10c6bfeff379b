"""Videos of depth, of image motion, and for one's eyes to see depth."""

import math
import os
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tisfm.errors import InputError
from tisfm.exports.clock import frame_rate
from tisfm.exports.depths import frames_with_depth
from tisfm.exports.pieces import chosen_frames
from tisfm.exports.result_frames import ResultFrames
from tisfm.exports.value_ranges import inverse_depth_ranges, speed_range
from tisfm.exports.video_file import check_video, video_file
from tisfm.show import anaglyph, depth_to_color, flow_to_color, stereo_view
from tisfm.show.arrays import as_rgb
from tisfm.show.stereo import DISPARITY, check_disparity, check_screen

VideoKind = Literal["depth", "flow", "side-by-side", "anaglyph", "wiggle"]
Picture = NDArray[np.uint8]
_SWING = 1.2  # s, there and back


def write_video(
    frames: ResultFrames,
    path: str | os.PathLike[str],
    kind: VideoKind,
    *,
    chosen: Iterable[int] | None = None,
    frames_per_second: float | None = None,
    disparity: float | None = None,
    screen: float | None = None,
    screen_depth: float | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Path:
    """Write a video, H.264 in MP4, with one range of colours from its beginning to its end.

    Parameters
    ----------
    frames : ResultFrames
        Those without depth are left out, but for flow.
    path : path
        The file; ``.mp4`` is the customary suffix, and none is added.
    kind : {"depth", "flow", "side-by-side", "anaglyph", "wiggle"}
        Inverse depth in colours, near is bright; image motion, its direction as hue; the frame, and
        depth beside it; for red-cyan glasses; or a camera that swings from side to side, about a
        single frame too.
    chosen : iterable of int, optional
        Numbers of frames; by default all.
    frames_per_second : float, optional
        By default what the times of the frames say, or 25.
    disparity : float, optional
        How far the nearest moves against what is infinitely far from one view to the other, as a
        share of the width, at most 0.2: 0.03 for an anaglyph and 0.015 to either side for the
        swinging camera.
    screen : float, optional
        The plane of the screen, which stays in place, as a quantile of the depth of all frames with
        one scale: 0 for the farthest, 1 for the nearest. By default it is half as near as the
        nearest.
    screen_depth : float, optional
        The same as a depth, in the unit of the frames.
    progress : callable, optional
        Called with the number of frames that are done, and of all.

    Returns
    -------
    Path
        What was written.

    Raises
    ------
    ValueError
        If there is no depth, or no flow; if an option is impossible.
    ImportError
        If PyAV is not there.
    OSError
        If the file cannot be written.

    Examples
    --------
    >>> import tisfm
    >>> from tisfm.exports import SequenceFrames, write_video
    >>> frames = SequenceFrames(tisfm.Reconstruction.load("walk"))
    >>> write_video(frames, "depth.mp4", "depth", frames_per_second=25).name
    'depth.mp4'
    """
    check_video()
    if disparity is not None:
        check_disparity(disparity)
    check_screen(screen, screen_depth)
    if screen_depth is not None and not frames.is_posed:
        raise InputError(
            "screen_depth is a depth, and each pair has a unit of its own: give screen, a quantile"
        )
    taken = chosen_frames(chosen, len(frames))
    if kind != "flow":
        taken = frames_with_depth(frames, taken)
    rate = frame_rate(frames.times, taken, frames_per_second)
    if kind == "wiggle" and len(taken) == 1:  # a still swings once there and back
        taken = taken * max(2, round(_SWING * rate))
    draw = _drawing(
        frames,
        taken,
        kind,
        rate=rate,
        disparity=disparity,
        screen=screen,
        screen_depth=screen_depth,
    )
    with video_file(path, rate) as video:
        for done, frame in enumerate(taken):
            video.add(draw(done, frame))
            if progress is not None:
                progress(done + 1, len(taken))
    return Path(path)


def _drawing(
    frames: ResultFrames,
    taken: list[int],
    kind: VideoKind,
    *,
    rate: float,
    disparity: float | None,
    screen: float | None,
    screen_depth: float | None,
) -> Callable[[int, int], Picture]:
    """Return what draws a frame, by how many came before and by its number."""
    if kind == "flow":
        fastest = speed_range(frames, taken)
        return lambda done, frame: flow_to_color(frames.flow(frame), limit=fastest, beyond="same")
    ranges = inverse_depth_ranges(frames, taken)

    def colors(frame: int) -> Picture:
        group, scale = frames.scale(frame)
        return depth_to_color(frames.inverse_depth(frame), limit=ranges[group] * scale)

    if kind == "depth":
        return lambda done, frame: colors(frame)
    if kind == "side-by-side":
        return lambda done, frame: np.hstack([as_rgb(frames.picture(frame)), colors(frame)])
    planes = {} if screen is None else inverse_depth_ranges(frames, taken, 100 * screen)

    def planes_of(frame: int) -> tuple[float, float | None]:
        """Return what counts as nearest, as inverse depth, and the depth of the screen."""
        group, scale = frames.scale(frame)
        nearest = ranges[group] * scale
        if screen is None:
            return nearest, screen_depth
        plane = planes[group] * scale
        return nearest, 1 / plane if plane > 0 else math.inf

    def red_cyan(frame: int) -> Picture:
        nearest, plane = planes_of(frame)
        return anaglyph(
            frames.picture(frame),
            frames.inverse_depth(frame),
            disparity=DISPARITY if disparity is None else disparity,
            screen_depth=plane,
            limit=nearest,
        )

    def swung(done: int, frame: int) -> Picture:
        nearest, plane = planes_of(frame)
        view = stereo_view(
            frames.picture(frame),
            frames.inverse_depth(frame),
            eye=math.sin(2 * math.pi * done / (_SWING * rate)),
            disparity=DISPARITY / 2 if disparity is None else disparity,
            screen_depth=plane,
            limit=nearest,
        )
        return as_rgb(view)

    return swung if kind == "wiggle" else lambda done, frame: red_cyan(frame)
