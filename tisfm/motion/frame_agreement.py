"""Whether two frames show the same scene, and whether their flow can be right."""

import cv2
import numpy as np

from tisfm.motion.window_statistics import (
    correlation,
    mean_in_windows,
    variance_in_windows,
    warped,
)
from tisfm.solver.image_pyramid import ImagePyramid
from tisfm.status import Status
from tisfm.visibility.confidence import CONFIDENCE_WINDOW, median

# Median correlation of frames that show the same: 0.97 and more on benchmarks, 0.65 under noise of
# 40 grey levels. Of unrelated scenes and of noise it is below 0.4.
CORRELATED = 0.5
# The images confirm a motion of half the image or more if their common part has a median motion of
# a quarter of the longer side or more, and this median correlation.
BORNE_OUT, FAR = 0.9, 0.25
# Share of the trusted pixels that a flow folds over: at most 0.08 between real frames, of which it
# misses much then, and under "paper" 0.17 and more between unrelated ones.
FOLDED = 0.12
JUDGED = 2**12  # pixels, at least, of the level that a flow field is judged on
# Share of the windows with structure in which two frames at rest are not alike. Noise, and an
# object that moves before a camera at rest, give 0.00; a picture with 37 % replaced in its middle
# 0.21, and with 52 % 0.48.
REPLACED = 0.15
# Share of the squares that are not alike which one displacement finds in the other frame, and the
# least correlation there. An object that moves and fills a sixth to a third of the frame gives 0.52
# and more; a picture whose middle is replaced gives 0.28 at most.
MOVED, FOUND = 0.4, 0.8
SQUARE, SQUARE_STEP = 15, 5  # px
STRUCTURE = 16.0  # least variance of a window with structure, over the variance of the noise
QUIETEST = 10  # percentile of the variances of differences that is taken for noise
FEWEST_SEEN = 0.05  # of all windows: if fewer have structure, frames are not judged
# Stripes: in all but this share of the windows, no more than this share of the variation is along
# them. Noise of 20 grey levels on stripes of 40 makes it 0.17; in real frames it is above a half.
VARIED, ALONG = 0.01, 0.25
FAINT = 0.01  # of the usual variation: windows with less do not count
BORDER = 4  # px that are repeated where a frame is resampled, which bends stripes


def unrelated(
    frame0: np.ndarray,
    frame1: np.ndarray,
    flow: np.ndarray,
    trust: np.ndarray,
    *,
    free: bool = True,
) -> Status | None:
    """Return the status of frames that a flow does not make alike, None if it does.

    That is judged by their correlation in windows, at the median of what is trusted. Where motion
    is free, it also has to leave neighbours in their order nearly everywhere: a flow that folds the
    image makes any two frames alike.

    Parameters
    ----------
    frame0, frame1 : (H, W) float32
        Grey levels.
    flow : (H, W, 2) float32
        px/frame.
    trust : (H, W) float32
        Its confidence; not all 0.
    free : bool
        Whether the flow is free at every pixel.
    """
    if free and (share := _folded(flow, trust)) > FOLDED:
        return Status(
            "unrelated",
            f"the frames are alike only where the flow folds {100 * share:.0f}% of the image over: "
            "check that they are of one scene, take them closer in time, or raise smoothness",
        )
    alike = correlation(frame0, frame1, flow)
    order = np.argsort(alike, axis=None)
    total = np.cumsum(trust.ravel()[order], dtype=np.float64)
    middle = float(alike.ravel()[order[np.searchsorted(total, total[-1] / 2)]])
    if middle >= CORRELATED:
        return None
    return Status(
        "unrelated",
        f"the frames have little in common wherever their parts are moved to (correlation "
        f"{middle:.2f}): check that they are of one scene, take them closer in time, or with less "
        "noise",
    )


def replaced(
    frame0: np.ndarray, frame1: np.ndarray, flow: np.ndarray, unseen: np.ndarray | None = None
) -> Status | None:
    """Return the status of frames with one layout and different contents, None for others.

    The parts that such frames share do not move. In contrast to frames of a scene at rest, many
    windows with structure are not alike. A large object that moves far gives such windows too, but
    most of these are found elsewhere in the other frame.

    Parameters
    ----------
    frame0, frame1, flow
        As for `unrelated`.
    unseen : (H, W) bool, optional
        Pixels that frame 1 cannot show; they do not count. By default all do.
    """
    while frame0.size >= 4 * JUDGED and min(frame0.shape) > 4 * BORDER:  # where noise is less
        frame0, frame1, flow = (
            cv2.resize(array, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
            for array in (frame0, frame1, flow * np.float32(0.5))
        )
        if unseen is not None:
            part = cv2.resize(
                unseen.astype(np.float32), None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA
            )
            unseen = part > 0
    with np.errstate(over="ignore", invalid="ignore"):  # frames may be far too bright
        unit = np.float32(frame0.std(dtype=float))
        moved = warped(frame1, flow)
        difference, first, second = (
            variance_in_windows(image, mean_in_windows(image))
            for image in (moved - frame0, frame0, moved)
        )
        quiet = float(np.percentile(difference, QUIETEST))
        noise = max(quiet / 2, (FAINT * float(unit)) ** 2)
        seen = np.maximum(first, second) > np.float32(STRUCTURE * noise)
    if unseen is not None:
        seen &= ~unseen
    if np.count_nonzero(seen) < FEWEST_SEEN * seen.size:
        return None
    lost = seen & (correlation(frame0, frame1, flow) < CORRELATED)
    share = np.count_nonzero(lost) / np.count_nonzero(seen)
    if share <= REPLACED or _moved_together(frame0, frame1, lost) >= MOVED:
        return None
    return Status(
        "unrelated",
        f"parts of the frames are alike and do not move, but {100 * share:.0f}% of their texture "
        "differs in the second: check that they show one scene, or mask the parts that are fixed "
        "to the image",
    )


def _moved_together(frame0: np.ndarray, frame1: np.ndarray, lost: np.ndarray) -> float:
    """Return the largest share of lost squares that one displacement finds in the other frame.

    Squares around lost pixels are sought in all of the other frame. Some are found by chance, but
    hardly at one displacement.
    """
    half = SQUARE // 2
    squares = np.argwhere(lost[half:-half:SQUARE_STEP, half:-half:SQUARE_STEP])
    ways = np.full((2, len(squares), 2), np.nan)  # from frame 0 to frame 1, both ways round
    for k, (here, there) in enumerate(((frame0, frame1), (frame1, frame0))):
        for number, (top, left) in enumerate(squares * SQUARE_STEP):
            square = here[top : top + SQUARE, left : left + SQUARE]
            alike = cv2.matchTemplate(there, square, cv2.TM_CCOEFF_NORMED)
            _, best, _, (column, row) = cv2.minMaxLoc(alike)
            if best >= FOUND:
                ways[k, number] = (1 - 2 * k) * np.array([column - left, row - top])
    known = np.isfinite(ways[..., 0])
    together = [(np.abs(ways - way).max(axis=-1) <= 1).any(axis=0).sum() for way in ways[known]]
    return max(together, default=0) / max(len(squares), 1)


def _folded(flow: np.ndarray, trust: np.ndarray) -> float:
    """Return the share of what is trusted whose neighbours to the right and below change sides."""
    with np.errstate(over="ignore", invalid="ignore"):  # where it diverged
        across = np.diff(flow[:-1], axis=1)
        down = np.diff(flow[:, :-1], axis=0)
        area = (1 + across[..., 0]) * (1 + down[..., 1]) - across[..., 1] * down[..., 0]
        weight = trust[:-1, :-1]
        total = float(weight.sum())
        return float(weight[area <= 0].sum()) / total if total > 0 else 0.0


def field_status(pyramid: ImagePyramid, flow: np.ndarray, trust: np.ndarray) -> Status | None:
    """Return why a flow field of the finest level is wrong, None where nothing is against it.

    That is judged on a coarser level.
    Motion that is free at every pixel makes fine detail alike in any two frames.

    Parameters
    ----------
    pyramid : ImagePyramid
    flow : (2, H, W) float32
        px/frame.
    trust : (H, W) float32
        Its confidence.
    """
    level = _judged_level(pyramid)
    frame0, frame1 = pyramid.frames0[level], pyramid.frames1[level]
    stripes = aperture_status(frame0)
    size, area = frame0.shape[::-1], cv2.INTER_AREA
    trust = cv2.resize(trust, size, interpolation=area)
    if stripes is not None or not trust.any():
        return stripes
    coarse = cv2.merge([cv2.resize(part, size, interpolation=area) for part in flow])
    return unrelated(frame0, frame1, coarse * np.float32(pyramid.scales[level]), trust)


def _judged_level(pyramid: ImagePyramid) -> int:
    """Return the level that a flow field is judged on."""
    return max((k for k, frame in enumerate(pyramid.frames0) if frame.size >= JUDGED), default=0)


def confirms_large_motion(pyramid: ImagePyramid, flow: np.ndarray, unseen: np.ndarray) -> bool:
    """Return whether the images confirm that most of their common part has moved far.

    A texture that repeats confirms no motion: it looks alike at every period.

    Parameters
    ----------
    pyramid : ImagePyramid
    flow : (2, H, W) float32
        px/frame of the finest level.
    unseen : (H, W) bool
        Pixels that leave the image or are hidden; they are not judged.
    """
    if unseen.all() or not np.isfinite(flow[:, ~unseen]).all():
        return False
    far = np.float32(FAR * max(flow.shape[1:]))
    if median(np.hypot(*flow[:, ~unseen])) < far:
        return False
    level = _judged_level(pyramid)
    frame0, frame1 = pyramid.frames0[level], pyramid.frames1[level]
    if not frame0.std():
        return False
    size, area = frame0.shape[::-1], cv2.INTER_AREA
    seen = (cv2.resize(unseen.astype(np.float32), size, interpolation=area) == 0).astype(np.float32)
    known = np.where(unseen, 0, flow) * np.float32(pyramid.scales[level])
    coarse = cv2.merge([cv2.resize(part, size, interpolation=area) for part in known])
    if not seen.any() or _folded(coarse, seen) > FOLDED:
        return False
    if median(correlation(frame0, frame1, coarse)[seen > 0]) < BORNE_OUT:
        return False
    return not _repeats(frame0, seen > 0)


def _repeats(frame: np.ndarray, seen: np.ndarray) -> bool:
    """Return whether the middle of the visible part looks alike elsewhere in the same frame."""
    left, top, width, height = cv2.boundingRect(seen.astype(np.uint8))
    left, top = left + width // 4, top + height // 4
    width, height = max(width // 2, 1), max(height // 2, 1)
    part = frame[top : top + height, left : left + width]
    if not part.std():
        return True  # without texture it looks alike everywhere
    alike = cv2.matchTemplate(frame, part, cv2.TM_CCOEFF_NORMED) >= BORNE_OUT
    _, places = cv2.connectedComponents(alike.astype(np.uint8), connectivity=8)
    return bool((alike & (places != places[top, left])).any())


def aperture_status(frame: np.ndarray) -> Status | None:
    """Return the status of a frame that varies along one direction only, None for others.

    How far it moves along its stripes cannot be seen: the aperture problem.

    Parameters
    ----------
    frame : (H, W) float32
        Grey levels.

    References
    ----------
    Jähne, "Digital Image Processing", chapter on simple neighbourhoods (structure tensor); Marr
    and Ullman, "Directional selectivity and its use in early visual processing", Proc. R. Soc.
    Lond. B 211 (1981), doi 10.1098/rspb.1981.0001 (aperture problem).
    """
    while frame.size >= 4 * JUDGED and min(frame.shape) > 4 * BORDER:
        frame = cv2.resize(frame, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    if min(frame.shape) < 2 * BORDER + CONFIDENCE_WINDOW:  # too few windows to tell
        return None
    inner = np.s_[BORDER:-BORDER, BORDER:-BORDER]
    with np.errstate(over="ignore", invalid="ignore"):  # frames may be far too bright
        grey = (frame - frame.mean()) / frame.std()
        right, down = (
            cv2.Sobel(grey, cv2.CV_32F, *order, scale=1 / 8)[inner] for order in ((1, 0), (0, 1))
        )
        derivatives = np.stack([right.ravel(), down.ravel()])
        tensor = derivatives @ derivatives.T / right.size
    if not np.isfinite(tensor).all():
        return None
    variation, directions = np.linalg.eigh(tensor)
    along, across = (
        mean_in_windows((np.float32(x) * right + np.float32(y) * down) ** 2)
        for x, y in directions.T
    )
    faint = np.float32(FAINT * variation.sum())
    if (along > ALONG * (along + across + faint)).mean() > VARIED:
        return None
    return Status(
        "aperture",
        "the frames vary along one direction only, so that motion along their stripes cannot be "
        "seen (the aperture problem): take frames that show corners, or give the pose",
    )
