"""Videos of depth, of image motion, and stereoscopic videos."""

import math
import os
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tisfm.errors import InputError
from tisfm.exports.export_request import frame_rate, select_frames
from tisfm.exports.frame_maps import frames_with_depth, inverse_depth_ranges, speed_range
from tisfm.exports.video_file import check_video, video_file
from tisfm.results.result_frames import ResultFrames
from tisfm.show import anaglyph, depth_to_color, flow_to_color, stereo_view
from tisfm.show.arrays import as_rgb
from tisfm.show.stereo import DISPARITY, check_disparity, check_screen

VideoKind = Literal["depth", "flow", "side-by-side", "anaglyph", "wiggle"]
Picture = NDArray[np.uint8]
_SWING_PERIOD = 1.2  # s, of the swinging camera; set by hand


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
    """Write a video, H.264 in MP4, with one range of colours for all frames.

    Parameters
    ----------
    frames : ResultFrames
        Frames without depth are left out, except for flow.
    path : path
        The file. No suffix is added; ``.mp4`` is usual.
    kind : {"depth", "flow", "side-by-side", "anaglyph", "wiggle"}
        Inverse depth in colours, near is bright; image motion with direction as hue; frame and
        depth side by side; an anaglyph for red-cyan glasses; or a camera that swings from side to
        side, also around a single frame.
    chosen : iterable of int, optional
        Frame numbers; by default all.
    frames_per_second : float, optional
        By default from the times of the frames, or 25.
    disparity : float, optional
        Disparity between the nearest point and infinity from one view to the other, as a share of
        the width, at most 0.2. By default 0.03 for an anaglyph, and 0.015 to either side for the
        swinging camera.
    screen : float, optional
        The plane of the screen, without disparity, as a quantile of the depth of all frames with
        one scale: 0 for the farthest, 1 for the nearest point. By default its inverse depth is half
        of the nearest.
    screen_depth : float, optional
        The plane of the screen as a depth, in the unit of the frames.
    progress : callable, optional
        Called with the number of finished frames and of all frames.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    ValueError
        If there is no depth or no flow, or an option is out of range.
    ImportError
        If PyAV is not installed.
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
    if screen_depth is not None and not frames.has_one_scale:
        raise InputError(
            "screen_depth is a depth, and each pair has a unit of its own: give screen, a quantile"
        )
    numbers = select_frames(chosen, len(frames))
    if kind != "flow":
        numbers = frames_with_depth(frames, numbers)
    rate = frame_rate(frames.times, numbers, frames_per_second)
    if kind == "wiggle" and len(numbers) == 1:  # one period around a single frame
        numbers = numbers * max(2, round(_SWING_PERIOD * rate))
    draw = _draw_function(
        frames,
        numbers,
        kind,
        rate=rate,
        disparity=disparity,
        screen=screen,
        screen_depth=screen_depth,
    )
    with video_file(path, rate) as video:
        for position, frame in enumerate(numbers):
            video.add(draw(position, frame))
            if progress is not None:
                progress(position + 1, len(numbers))
    return Path(path)


def _draw_function(
    frames: ResultFrames,
    numbers: list[int],
    kind: VideoKind,
    *,
    rate: float,
    disparity: float | None,
    screen: float | None,
    screen_depth: float | None,
) -> Callable[[int, int], Picture]:
    """Return a function that draws a frame by its position in the video and its number."""
    if kind == "flow":
        flow_limit = speed_range(frames, numbers)
        return lambda position, frame: flow_to_color(
            frames.flow(frame), limit=flow_limit, beyond="same"
        )
    ranges = inverse_depth_ranges(frames, numbers)

    def draw_depth(frame: int) -> Picture:
        group, scale = frames.scale(frame)
        return depth_to_color(frames.inverse_depth(frame), limit=ranges[group] * scale)

    if kind == "depth":
        return lambda position, frame: draw_depth(frame)
    if kind == "side-by-side":
        return lambda position, frame: np.hstack([as_rgb(frames.picture(frame)), draw_depth(frame)])
    screen_ranges = {} if screen is None else inverse_depth_ranges(frames, numbers, 100 * screen)

    def planes_of(frame: int) -> tuple[float, float | None]:
        """Return the inverse depth of the nearest point, and the depth of the screen."""
        group, scale = frames.scale(frame)
        nearest = ranges[group] * scale
        if screen is None:
            return nearest, screen_depth
        plane = screen_ranges[group] * scale
        return nearest, 1 / plane if plane > 0 else math.inf

    def draw_anaglyph(frame: int) -> Picture:
        nearest, plane = planes_of(frame)
        return anaglyph(
            frames.picture(frame),
            frames.inverse_depth(frame),
            disparity=DISPARITY if disparity is None else disparity,
            screen_depth=plane,
            limit=nearest,
        )

    def draw_swing(position: int, frame: int) -> Picture:
        nearest, plane = planes_of(frame)
        view = stereo_view(
            frames.picture(frame),
            frames.inverse_depth(frame),
            eye=math.sin(2 * math.pi * position / (_SWING_PERIOD * rate)),
            disparity=DISPARITY / 2 if disparity is None else disparity,
            screen_depth=plane,
            limit=nearest,
        )
        return as_rgb(view)

    return draw_swing if kind == "wiggle" else lambda position, frame: draw_anaglyph(frame)
