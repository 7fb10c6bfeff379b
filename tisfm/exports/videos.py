"""Videos of depth, of image motion, and for one's eyes to see depth."""

import math
import os
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from tisfm.exports.clock import frame_rate
from tisfm.exports.depths import frames_with_depth
from tisfm.exports.pieces import chosen_frames
from tisfm.exports.ranges import inverse_depth_ranges, speed_range
from tisfm.exports.result_frames import ResultFrames
from tisfm.exports.stereo import anaglyph_of, inner_part, nearness, view_beside, without_holes
from tisfm.exports.video_file import check_video, video_file
from tisfm.show import flow_radius, flow_to_color

VideoKind = Literal["depth", "flow", "side-by-side", "anaglyph", "wiggle"]
Picture = NDArray[np.uint8]
DISPARITY = {"anaglyph": 0.03, "wiggle": 0.015}  # of the width
_WIDEST = 0.2
_SCREEN = 0.5  # of the range of inverse depth: what is so near stays in place
_SWING = 1.2  # s, there and back


def write_video(
    frames: ResultFrames,
    path: str | os.PathLike[str],
    kind: VideoKind,
    *,
    chosen: Iterable[int] | None = None,
    frames_per_second: float | None = None,
    disparity: float | None = None,
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
        swinging camera. Half as near as the nearest stays in place.
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
    taken = chosen_frames(chosen, len(frames))
    if kind != "flow":
        taken = frames_with_depth(frames, taken)
    rate = frame_rate(frames.times, taken, frames_per_second)
    if kind == "wiggle" and len(taken) == 1:  # a still swings once there and back
        taken = taken * max(2, round(_SWING * rate))
    draw = _drawing(frames, taken, kind, rate=rate, disparity=disparity)
    with video_file(path, rate) as video:
        for done, frame in enumerate(taken):
            video.add(draw(done, frame))
            if progress is not None:
                progress(done + 1, len(taken))
    return Path(path)


def check_disparity(disparity: float) -> None:
    """Raise ValueError if a disparity is no share of the width that eyes could follow."""
    if not 0 < disparity <= _WIDEST:
        raise ValueError(
            f"disparity is {disparity}: expected a share of the width, above 0, up to {_WIDEST}"
        )


def _drawing(
    frames: ResultFrames,
    taken: list[int],
    kind: VideoKind,
    *,
    rate: float,
    disparity: float | None,
) -> Callable[[int, int], Picture]:
    """Return what draws a frame, by how many came before and by its number."""
    if kind == "flow":
        fastest = speed_range(frames, taken)
        return lambda done, frame: flow_colors(frames.flow(frame), fastest)
    ranges = inverse_depth_ranges(frames, taken)

    def near(frame: int, *, filled: bool = False) -> NDArray[np.float32]:
        group, scale = frames.scale(frame)
        inverse_depth = frames.inverse_depth(frame)
        if filled:
            inverse_depth = without_holes(inverse_depth)
        return nearness(inverse_depth, ranges[group] * scale)

    if kind == "depth":
        return lambda done, frame: depth_colors(near(frame))
    if kind == "side-by-side":
        return lambda done, frame: np.hstack(
            [_in_color(frames.picture(frame)), depth_colors(near(frame))]
        )
    shift = frames.shape[1] * (DISPARITY[kind] if disparity is None else disparity)
    if kind == "anaglyph":
        return lambda done, frame: anaglyph_of(
            frames.picture(frame), near(frame, filled=True), disparity=shift, screen=_SCREEN
        )
    return lambda done, frame: _swung(
        _in_color(frames.picture(frame)),
        near(frame, filled=True),
        shift=shift,
        phase=2 * math.pi * done / (_SWING * rate),
    )


def flow_colors(flow: NDArray[np.float32], fastest: float) -> Picture:
    """Return image motion as colours, (H, W, 3): what is faster looks as if it were as fast."""
    radius = flow_radius(flow)
    share = np.ones_like(radius)
    np.divide(fastest, radius, out=share, where=radius > fastest)
    return flow_to_color(flow * share[..., None], limit=fastest)


def depth_colors(near: NDArray[np.float32]) -> Picture:
    """Return shares of the nearest inverse depth as colours, (H, W, 3): near is bright."""
    grey = np.rint(near * 255).astype(np.uint8)
    return np.asarray(cv2.cvtColor(cv2.applyColorMap(grey, cv2.COLORMAP_MAGMA), cv2.COLOR_BGR2RGB))


def _swung(picture: Picture, near: NDArray[np.float32], *, shift: float, phase: float) -> Picture:
    """Return what a camera sees that swings about the one of a picture, without a border."""
    seen = view_beside(picture, near, disparity=shift * math.sin(phase), screen=_SCREEN)
    return inner_part(seen, disparity=shift, screen=_SCREEN)


def _in_color(picture: Picture) -> Picture:
    return picture if picture.ndim == 3 else np.repeat(picture[..., None], 3, axis=2)
