"""Depth and masks of every frame as files of other programs, and common ranges of their values."""

import os
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tisfm.errors import InputError
from tisfm.exports.export_request import select_frames
from tisfm.exports.float_images import check_exr, write_exr, write_pfm, write_tiff
from tisfm.folders.result_folder import make_subfolder
from tisfm.formats import write_depth_png, write_dpt, write_png
from tisfm.results.result_frames import ResultFrames, file_names
from tisfm.show import flow_radius
from tisfm.show.palette import DEPTH_PERCENTILE, FLOW_PERCENTILE

# A sample of frames and pixels gives the ranges of all values; set by hand.
SAMPLED_FRAMES = 48  # at most
SAMPLED_PIXELS = 20_000  # of each frame, about


def sample_frames(frames: Sequence[int], count: int = SAMPLED_FRAMES) -> list[int]:
    """Return at most `count` of the frames, evenly spread."""
    if len(frames) <= count:
        return list(frames)
    return [frames[k] for k in np.linspace(0, len(frames) - 1, count).round().astype(int)]


def inverse_depth_ranges(
    frames: ResultFrames, chosen: Sequence[int], percentile: float = DEPTH_PERCENTILE
) -> dict[int, float]:
    """Return a percentile of inverse depth for each group of frames with one scale.

    It is in multiples of the scale of `ResultFrames.scale`; 0 for a group without depth. The
    default percentile is that of the nearest colour.
    """
    groups: dict[int, list[int]] = {}
    for frame in chosen:
        groups.setdefault(frames.scale(frame)[0], []).append(frame)
    ranges = {}
    for group, members in groups.items():
        samples = [_positive_samples(frames, frame) for frame in sample_frames(members)]
        values = np.concatenate(samples)
        ranges[group] = float(np.percentile(values, percentile)) if len(values) else 0.0
    return ranges


def speed_range(frames: ResultFrames, chosen: Sequence[int]) -> float:
    """Return the length of image motion, px, that 98 % of the sample stay below."""
    samples = []
    for frame in sample_frames(chosen):
        radius = flow_radius(subsample_pixels(frames.flow(frame))).ravel()
        samples.append(radius[np.isfinite(radius)])
    values = np.concatenate(samples)
    return float(np.percentile(values, FLOW_PERCENTILE)) if len(values) else 0.0


def subsample_pixels(values: np.ndarray) -> np.ndarray:
    """Return about `SAMPLED_PIXELS` pixels of a map on a regular grid, (h, w) or (h, w, 2)."""
    step = max(1, int(np.sqrt(values.shape[0] * values.shape[1] / SAMPLED_PIXELS)))
    return values[step // 2 :: step, step // 2 :: step]


def _positive_samples(frames: ResultFrames, frame: int) -> np.ndarray:
    values = subsample_pixels(frames.inverse_depth(frame)).ravel() / frames.scale(frame)[1]
    return np.asarray(values[np.isfinite(values) & (values > 0)])


DepthKind = Literal["tum", "kitti", "exr", "tiff", "pfm", "dpt"]
Progress = Callable[[int, int], None]
VALUES_PER_UNIT = {"tum": 5000.0, "kitti": 256.0}  # as the datasets of these names define
MAX_VALUE = 65535  # largest value in a 16-bit file
_MAX_SHARE_OUT_OF_RANGE = 0.5  # of depth; a larger share is an error; set by hand
_MIN_MEDIAN_VALUE = 10  # median value below which steps of depth are too coarse; set by hand
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
    """Write a file for every frame with depth.

    Depth is Z, along the optical axis, in the unit of the result.

    Parameters
    ----------
    frames : ResultFrames
    folder : path
        It has to exist. Files have the names of the frames.
    kind : {"tum", "kitti", "exr", "tiff", "pfm", "dpt"}
        16-bit PNG of 5000 (TUM) or 256 (KITTI) values per unit, 0 for no depth and for depth beyond
        the largest value; EXR of float32, channel Z, with 0 for no depth; TIFF of float32, with
        NaN; PFM, with infinity, as in Middlebury; ``.dpt`` of Sintel, with NaN.
    chosen : iterable of int, optional
        Frame numbers; by default all.
    progress : callable, optional
        Called with the number of finished frames and of all frames.

    Returns
    -------
    list of Path
        The files.

    Raises
    ------
    ValueError
        If no frame has depth, or half of the depth does not fit into 16 bits.
    ImportError
        If OpenEXR is not installed for EXR files.
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
    numbers = frames_with_depth(frames, chosen)
    if kind in VALUES_PER_UNIT:
        check_depth_range(frames, numbers, kind)
    names, written = file_names(frames.names), []
    for done, frame in enumerate(numbers, 1):
        file = Path(folder) / f"{names[frame]}{SUFFIXES[kind]}"
        _write(file, kind, depth_from_inverse(frames.inverse_depth(frame)))
        written.append(file)
        if progress is not None:
            progress(done, len(numbers))
    return written


def frames_with_depth(frames: ResultFrames, chosen: Iterable[int] | None = None) -> list[int]:
    """Return the frames with depth; raise ValueError if there is none."""
    with_depth = [frame for frame in select_frames(chosen, len(frames)) if frames.has_depth(frame)]
    if not with_depth:
        raise InputError(f"no frame of {frames.folder} has depth: {frames.depth_advice}")
    return with_depth


def check_depth_range(frames: ResultFrames, chosen: list[int], kind: DepthKind) -> float:
    """Return the share of depth that 16 bits cannot hold, estimated from some of the frames.

    Raises ValueError if it is more than half, or if the median depth has a value below 10, so that
    steps are coarse.
    """
    scale = VALUES_PER_UNIT[kind]
    depth = [
        depth_from_inverse(subsample_pixels(frames.inverse_depth(frame)))
        for frame in sample_frames(chosen)
    ]
    values = np.concatenate([part[np.isfinite(part)] for part in depth])
    if not len(values):
        return 0.0
    share_out_of_range = float((values * scale > MAX_VALUE + 0.5).mean())
    median = float(np.median(values))
    advice = f"{frames.unit_advice}, or take depth-exr, depth-tiff, depth-pfm or depth-dpt"
    if share_out_of_range > _MAX_SHARE_OUT_OF_RANGE:
        raise InputError(
            f"{100 * share_out_of_range:.3g} % of the depth in {frames.folder} is beyond "
            f"{MAX_VALUE / scale:.4g}, the largest depth that this 16-bit format can hold (the "
            f"median depth is {median:.4g}): {advice}"
        )
    if median * scale < _MIN_MEDIAN_VALUE:
        raise InputError(
            f"the median depth in {frames.folder} is {median:.3g}, too small for this 16-bit "
            f"format with its steps of {1 / scale:g} (expected at least "
            f"{_MIN_MEDIAN_VALUE / scale:g}): {advice}"
        )
    return share_out_of_range


def depth_from_inverse(inverse_depth: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return depth, (H, W) float32; NaN for no depth."""
    depth = np.full_like(inverse_depth, np.nan)
    with np.errstate(over="ignore"):
        np.divide(1, inverse_depth, out=depth, where=inverse_depth > 0)
    depth[~np.isfinite(depth) | (depth <= 0)] = np.nan
    return depth


def _write(file: Path, kind: DepthKind, depth: NDArray[np.float32]) -> None:
    no_depth = np.isnan(depth)
    if kind in VALUES_PER_UNIT:
        scale = VALUES_PER_UNIT[kind]
        write_depth_png(file, np.where(depth * scale > MAX_VALUE + 0.5, np.nan, depth), scale=scale)
    elif kind == "exr":
        write_exr(file, {"Z": np.where(no_depth, np.float32(0), depth)})
    elif kind == "tiff":
        write_tiff(file, depth)
    elif kind == "pfm":
        write_pfm(file, np.where(no_depth, np.float32(np.inf), depth))
    else:
        write_dpt(file, depth)


def write_masks(
    frames: ResultFrames,
    folder: str | os.PathLike[str],
    *,
    chosen: Iterable[int] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> list[Path]:
    """Write black and white masks of every frame, a folder for each kind of mask.

    Parameters
    ----------
    frames : ResultFrames
        For a reconstruction with ``motion="objects"``: ``at-rest`` has the static scene in white,
        ``object-1`` and so on the moving object of this id. For one with masked pixels that move:
        ``at-rest``. For pairs: ``visible`` has the pixels
        in white that are visible in the next frame; with ``motion="objects"``, ``motion-0`` and so
        on the pixels with this motion, whose numbers have no meaning in other pairs.
    folder : path
        It has to exist. Folders have the names of the masks, files the names of the frames.
    chosen : iterable of int, optional
        Frame numbers; by default all.
    progress : callable, optional
        Called with the number of finished frames and of all frames.

    Returns
    -------
    list of Path
        The files.

    Raises
    ------
    ValueError
        If the result has no labels and no masked pixels that move.
    OSError
        If a file cannot be written.

    Examples
    --------
    >>> import tisfm
    >>> from tisfm.exports import SequenceFrames, write_masks
    >>> frames = SequenceFrames(tisfm.Reconstruction.load("bodies"))  # of ``motion="objects"``
    >>> written = write_masks(frames, ".", chosen=[0])
    >>> written[0].parent.name
    'at-rest'
    """
    numbers, names, written = select_frames(chosen, len(frames)), file_names(frames.names), []
    for done, frame in enumerate(numbers, 1):
        for name, mask in frames.masks(frame).items():
            subfolder = make_subfolder(Path(folder) / name)
            file = subfolder / f"{names[frame]}.png"
            write_png(file, np.where(mask, np.uint8(255), np.uint8(0)))
            written.append(file)
        if progress is not None:
            progress(done, len(numbers))
    return written
