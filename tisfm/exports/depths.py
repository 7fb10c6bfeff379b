"""Depth of every frame in the files that other programs read."""

import os
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tisfm.errors import InputError
from tisfm.exports.float_images import check_exr, write_exr, write_pfm, write_tiff
from tisfm.exports.pieces import chosen_frames
from tisfm.exports.result_frames import ResultFrames
from tisfm.exports.value_ranges import some_of, thinned
from tisfm.formats import write_depth_png, write_dpt

DepthKind = Literal["tum", "kitti", "exr", "tiff", "pfm", "dpt"]
Progress = Callable[[int, int], None]
VALUES_PER_UNIT = {"tum": 5000.0, "kitti": 256.0}
LARGEST = 65535  # of a 16-bit file
_MOST_BEYOND = 0.5  # of the pixels with depth: where more are beyond, another file is needed
SUFFIXES = {"tum": ".png", "kitti": ".png", "exr": ".exr", "tiff": ".tiff", "pfm": ".pfm",
            "dpt": ".dpt"}  # fmt: skip


def write_depths(
    frames: ResultFrames,
    folder: str | os.PathLike[str],
    kind: DepthKind,
    *,
    chosen: Iterable[int] | None = None,
    progress: Progress | None = None,
) -> list[Path]:
    """Write a file with the depth of every frame that has some.

    Depth is Z, along the optical axis, in the unit of the result.

    Parameters
    ----------
    frames : ResultFrames
    folder : path
        It has to exist. Files are called like the frames.
    kind : {"tum", "kitti", "exr", "tiff", "pfm", "dpt"}
        16-bit PNG of 5000 (TUM) or 256 (KITTI) values per unit, 0 where there is no depth, or where
        it is beyond the largest value; EXR of float32, channel Z, with 0 for no depth; TIFF of
        float32, with NaN; PFM, with infinity, as Middlebury has it; Sintel's ``.dpt``, with NaN.
    chosen : iterable of int, optional
        Numbers of frames; by default all.
    progress : callable, optional
        Called with the number of frames that are done, and of all.

    Returns
    -------
    list of Path
        What was written.

    Raises
    ------
    ValueError
        If no frame has depth, or half of it does not fit into 16 bits.
    ImportError
        If EXR files cannot be written.
    OSError
        If a file cannot be written.

    Examples
    --------
    >>> import tisfm
    >>> from tisfm.exports import SequenceFrames, write_depths
    >>> frames = SequenceFrames(tisfm.Reconstruction.load("walk"))
    >>> len(write_depths(frames, ".", "tum"))  # a 16-bit PNG for each frame
    9
    """
    if kind == "exr":
        check_exr()
    with_depth = frames_with_depth(frames, chosen)
    if kind in VALUES_PER_UNIT:
        check_fits(frames, with_depth, kind)
    written = []
    for done, frame in enumerate(with_depth, 1):
        file = Path(folder) / f"{frames.names[frame]}{SUFFIXES[kind]}"
        _write(file, kind, depth_of(frames.inverse_depth(frame)))
        written.append(file)
        if progress is not None:
            progress(done, len(with_depth))
    return written


def frames_with_depth(frames: ResultFrames, chosen: Iterable[int] | None = None) -> list[int]:
    """Return the frames that have depth, or raise ValueError if none has."""
    found = [frame for frame in chosen_frames(chosen, len(frames)) if frames.has_depth(frame)]
    if not found:
        raise InputError(f"no frame of {frames.folder} has depth: {frames.advice}")
    return found


def check_fits(frames: ResultFrames, chosen: list[int], kind: DepthKind) -> float:
    """Return the share of the depth that is beyond what 16 bits hold, from some of the frames.

    Raises
    ------
    ValueError
        If it is more than half, or if half of the depth is below 10 values, and steps of it.
    """
    scale = VALUES_PER_UNIT[kind]
    depth = [depth_of(thinned(frames.inverse_depth(frame))) for frame in some_of(chosen)]
    values = np.concatenate([one[np.isfinite(one)] for one in depth])
    if not len(values):
        return 0.0
    beyond = float((values * scale > LARGEST + 0.5).mean())
    middle = float(np.median(values))
    held = f"a file of {scale:g} values per unit holds {10 / scale:g} to {LARGEST / scale:.4g}"
    advice = f"{frames.unit_advice}, or take depth-exr, depth-tiff, depth-pfm or depth-dpt"
    if beyond > _MOST_BEYOND:
        raise InputError(
            f"depth in {frames.folder} is {middle:.4g} in the median, and {100 * beyond:.3g} % of "
            f"it is beyond {LARGEST / scale:.4g}, but {held}: {advice}"
        )
    if middle * scale < 10:
        raise InputError(
            f"depth in {frames.folder} is {middle:.3g} in the median, but {held}: {advice}"
        )
    return beyond


def depth_of(inverse_depth: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return depth, (H, W) float32; NaN where there is none."""
    depth = np.full_like(inverse_depth, np.nan)
    with np.errstate(over="ignore"):
        np.divide(1, inverse_depth, out=depth, where=inverse_depth > 0)
    depth[~np.isfinite(depth) | (depth <= 0)] = np.nan
    return depth


def _write(file: Path, kind: DepthKind, depth: NDArray[np.float32]) -> None:
    none = np.isnan(depth)
    if kind in VALUES_PER_UNIT:
        scale = VALUES_PER_UNIT[kind]
        write_depth_png(file, np.where(depth * scale > LARGEST + 0.5, np.nan, depth), scale=scale)
    elif kind == "exr":
        write_exr(file, {"Z": np.where(none, np.float32(0), depth)})
    elif kind == "tiff":
        write_tiff(file, depth)
    elif kind == "pfm":
        write_pfm(file, np.where(none, np.float32(np.inf), depth))
    else:
        write_dpt(file, depth)
