"""Whether two frames show the same scene, and whether their flow can be right."""

import cv2
import numpy as np

from tisfm.motion.settings import CHECKS
from tisfm.motion.window_statistics import correlation, mean_in_windows, variance_in_windows, warped
from tisfm.solver.image_pyramid import ImagePyramid
from tisfm.status import Status
from tisfm.visibility.confidence import CONFIDENCE_WINDOW, median

RESAMPLING_BORDER = 4  # px that are repeated where a frame is resampled, which bends stripes


def unrelated_status(
    # frame0, frame1: (H, W) float32, grey levels
    frame0: np.ndarray,
    frame1: np.ndarray,
    flow: np.ndarray,  # (H, W, 2) float32: px/frame
    trust: np.ndarray,  # (H, W) float32: confidence of the flow; not all 0
    *,
    is_free_flow: bool = True,  # whether the flow is free at every pixel
) -> Status | None:
    """Return the status of frames that a flow does not align, None if the flow aligns them.

    Frames are aligned if their correlation in windows is high at the median trusted pixel. A flow
    that is free at every pixel also has to keep neighbours in order nearly everywhere: a flow that
    folds the image can align any two frames.
    """
    if is_free_flow and (share := _folded_share(flow, trust)) > CHECKS.max_folded_share:
        return Status(
            "unrelated",
            f"the frames match only if the flow folds {100 * share:.0f}% of the image over: check "
            "that they show one scene, take frames closer in time, or raise smoothness",
        )
    correlations = correlation(frame0, frame1, flow)
    order = np.argsort(correlations, axis=None)
    total = np.cumsum(trust.ravel()[order], dtype=np.float64)
    median_correlation = float(correlations.ravel()[order[np.searchsorted(total, total[-1] / 2)]])
    if median_correlation >= CHECKS.min_correlation:
        return None
    return Status(
        "unrelated",
        f"no flow aligns the frames (their median correlation is {median_correlation:.2f}): check "
        "that they show one scene, or take frames closer in time or with less noise",
    )


def replaced_status(
    # frame0, frame1, flow: as for `unrelated_status`
    frame0: np.ndarray,
    frame1: np.ndarray,
    flow: np.ndarray,
    # (H, W) bool: pixels that are not visible in frame 1; they do not count. By default all pixels
    # count.
    hidden: np.ndarray | None = None,
) -> Status | None:
    """Return the status of frames with one layout and different contents, None for others.

    The parts that such frames share are at rest, and many textured windows differ. A large object
    that moves far also gives windows that differ, but most of them are found elsewhere in the other
    frame.
    """
    while (
        frame0.size >= 4 * CHECKS.min_judged_pixels and min(frame0.shape) > 4 * RESAMPLING_BORDER
    ):  # noise is less on coarse levels
        frame0, frame1, flow = (
            cv2.resize(array, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
            for array in (frame0, frame1, flow * np.float32(0.5))
        )
        if hidden is not None:
            hidden_share = cv2.resize(
                hidden.astype(np.float32), None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA
            )
            hidden = hidden_share > 0
    with np.errstate(over="ignore", invalid="ignore"):  # frames may be far too bright
        unit = np.float32(frame0.std(dtype=float))
        warped1 = warped(frame1, flow)
        difference, variance0, variance1 = (
            variance_in_windows(image, mean_in_windows(image))
            for image in (warped1 - frame0, frame0, warped1)
        )
        noise_variance = float(np.percentile(difference, CHECKS.noise_percentile))
        noise = max(noise_variance / 2, (CHECKS.faint_share * float(unit)) ** 2)
        is_textured = np.maximum(variance0, variance1) > np.float32(
            CHECKS.min_textured_variance * noise
        )
    if hidden is not None:
        is_textured &= ~hidden
    if np.count_nonzero(is_textured) < CHECKS.min_textured_share * is_textured.size:
        return None
    is_different = is_textured & (correlation(frame0, frame1, flow) < CHECKS.min_correlation)
    share = np.count_nonzero(is_different) / np.count_nonzero(is_textured)
    if (
        share <= CHECKS.max_replaced_share
        or _common_motion_share(frame0, frame1, is_different) >= CHECKS.min_common_share
    ):
        return None
    return Status(
        "unrelated",
        f"parts of the frames are equal and at rest, but {100 * share:.0f}% of the texture differs "
        "in the second frame: check that they show one scene, or mask parts that are fixed to the "
        "image",
    )


def _common_motion_share(frame0: np.ndarray, frame1: np.ndarray, is_different: np.ndarray) -> float:
    """Return the largest share of lost squares that one displacement finds in the other frame.

    Squares around lost pixels are searched in the whole other frame. Chance matches rarely share
    one displacement.
    """
    half = CHECKS.square // 2
    squares = np.argwhere(
        is_different[half : -half : CHECKS.square_step, half : -half : CHECKS.square_step]
    )
    # Displacements from frame 0 to frame 1, found in both directions.
    displacements = np.full((2, len(squares), 2), np.nan)
    for k, (frame, other) in enumerate(((frame0, frame1), (frame1, frame0))):
        for number, (top, left) in enumerate(squares * CHECKS.square_step):
            square = frame[top : top + CHECKS.square, left : left + CHECKS.square]
            correlations = cv2.matchTemplate(other, square, cv2.TM_CCOEFF_NORMED)
            _, best, _, (column, row) = cv2.minMaxLoc(correlations)
            if best >= CHECKS.min_square_correlation:
                displacements[k, number] = (1 - 2 * k) * np.array([column - left, row - top])
    is_found = np.isfinite(displacements[..., 0])
    support = [
        (np.abs(displacements - displacement).max(axis=-1) <= 1).any(axis=0).sum()
        for displacement in displacements[is_found]
    ]
    return max(support, default=0) / max(len(squares), 1)


def _folded_share(flow: np.ndarray, trust: np.ndarray) -> float:
    """Return the share of the trust at pixels where the flow turns the image over."""
    with np.errstate(over="ignore", invalid="ignore"):  # where the flow diverged
        across = np.diff(flow[:-1], axis=1)
        down = np.diff(flow[:, :-1], axis=0)
        area = (1 + across[..., 0]) * (1 + down[..., 1]) - across[..., 1] * down[..., 0]
        weight = trust[:-1, :-1]
        total = float(weight.sum())
        return float(weight[area <= 0].sum()) / total if total > 0 else 0.0


def field_status(
    pyramid: ImagePyramid,
    flow: np.ndarray,  # (2, H, W) float32: px/frame
    trust: np.ndarray,  # (H, W) float32: confidence of the flow
) -> Status | None:
    """Return the status of a wrong flow field of the finest level, None for others.

    The flow is judged on a coarser level, since motion that is free at every pixel can align fine
    detail of any two frames.
    """
    level = _judged_level(pyramid)
    frame0, frame1 = pyramid.frames0[level], pyramid.frames1[level]
    stripes = aperture_status(frame0)
    size, area = frame0.shape[::-1], cv2.INTER_AREA
    trust = cv2.resize(trust, size, interpolation=area)
    if stripes is not None or not trust.any():
        return stripes
    coarse = cv2.merge([cv2.resize(part, size, interpolation=area) for part in flow])
    return unrelated_status(frame0, frame1, coarse * np.float32(pyramid.scales[level]), trust)


def _judged_level(pyramid: ImagePyramid) -> int:
    """Return the level that a flow field is judged on."""
    return max(
        (k for k, frame in enumerate(pyramid.frames0) if frame.size >= CHECKS.min_judged_pixels),
        default=0,
    )


def confirms_large_motion(
    pyramid: ImagePyramid,
    flow: np.ndarray,  # (2, H, W) float32: px/frame of the finest level
    # (H, W) bool: pixels that leave the image or are occluded; they are not judged
    hidden: np.ndarray,
) -> bool:
    """Return whether the images confirm that most of their common part moved far.

    A repetitive texture confirms no motion, since it matches at every period.
    """
    if hidden.all() or not np.isfinite(flow[:, ~hidden]).all():
        return False
    min_motion = np.float32(CHECKS.min_large_motion * max(flow.shape[1:]))
    if median(np.hypot(*flow[:, ~hidden])) < min_motion:
        return False
    level = _judged_level(pyramid)
    frame0, frame1 = pyramid.frames0[level], pyramid.frames1[level]
    if not frame0.std():
        return False
    size, area = frame0.shape[::-1], cv2.INTER_AREA
    visible = (cv2.resize(hidden.astype(np.float32), size, interpolation=area) == 0).astype(
        np.float32
    )
    visible_flow = np.where(hidden, 0, flow) * np.float32(pyramid.scales[level])
    coarse = cv2.merge([cv2.resize(part, size, interpolation=area) for part in visible_flow])
    if not visible.any() or _folded_share(coarse, visible) > CHECKS.max_folded_share:
        return False
    if (
        median(correlation(frame0, frame1, coarse)[visible > 0])
        < CHECKS.min_large_motion_correlation
    ):
        return False
    return not _is_repetitive(frame0, visible > 0)


def _is_repetitive(frame: np.ndarray, visible: np.ndarray) -> bool:
    """Return whether the middle of the visible part matches elsewhere in the same frame."""
    left, top, width, height = cv2.boundingRect(visible.astype(np.uint8))
    left, top = left + width // 4, top + height // 4
    width, height = max(width // 2, 1), max(height // 2, 1)
    part = frame[top : top + height, left : left + width]
    if not part.std():
        return True  # without texture it matches everywhere
    is_similar = (
        cv2.matchTemplate(frame, part, cv2.TM_CCOEFF_NORMED) >= CHECKS.min_large_motion_correlation
    )
    _, areas = cv2.connectedComponents(is_similar.astype(np.uint8), connectivity=8)
    return bool((is_similar & (areas != areas[top, left])).any())


def aperture_status(
    frame: np.ndarray,  # (H, W) float32: grey levels
) -> Status | None:
    """Return the status of a frame that varies along one direction only, None for others.

    Its motion along the stripes cannot be seen: the aperture problem.

    References
    ----------
    Jähne, "Digital Image Processing", chapter on simple neighbourhoods (structure tensor); Marr
    and Ullman, "Directional selectivity and its use in early visual processing", Proc. R. Soc.
    Lond. B 211 (1981), doi 10.1098/rspb.1981.0001 (aperture problem).
    """
    while frame.size >= 4 * CHECKS.min_judged_pixels and min(frame.shape) > 4 * RESAMPLING_BORDER:
        frame = cv2.resize(frame, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    if min(frame.shape) < 2 * RESAMPLING_BORDER + CONFIDENCE_WINDOW:  # too few windows
        return None
    inner = np.s_[RESAMPLING_BORDER:-RESAMPLING_BORDER, RESAMPLING_BORDER:-RESAMPLING_BORDER]
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
    faint_variation = np.float32(CHECKS.faint_share * variation.sum())
    if (
        along > CHECKS.max_stripe_variation * (along + across + faint_variation)
    ).mean() > CHECKS.max_stripe_exceptions:
        return None
    return Status(
        "aperture",
        "the frames vary along one direction only, so motion along their stripes is invisible "
        "(the aperture problem): take frames that show corners, or give the pose",
    )


def diverged_status(
    flow: np.ndarray,  # (2, H, W) float32: (u, v), px/frame
    leaves: np.ndarray,  # (H, W) bool: where the flow leaves the image
    *,
    # whether matched points, a pose or the images confirm a large motion (`confirms_large_motion`):
    # pixels that leave the image may then go far
    is_confirmed: bool = False,
) -> Status | None:
    """Return the status of a flow that is too long for any pair of frames, None for others."""
    max_flow, max_leaving = CHECKS.max_flow, CHECKS.max_leaving_share
    if is_confirmed:
        max_flow, max_leaving = CHECKS.max_confirmed_flow, CHECKS.max_confirmed_leaving_share
        flow = np.where(leaves & np.isfinite(flow), 0, flow)
    # A point that moves by half the image is rarely visible twice; NaN fails the comparisons, too.
    limit = max_flow * max(flow.shape[1:])
    is_short = max(flow.max(), -flow.min()) <= limit / np.sqrt(2)
    if not is_short and not np.sqrt(np.einsum("khw,khw->hw", flow, flow).max()) <= limit:
        return Status(
            "diverged",
            f"image motion grew beyond {100 * max_flow:g}% of the image's longer side: bring the "
            "frames to the 8-bit scale, give data_contrast a value, raise smoothness or contrast, "
            "take frames closer in time, and check the camera's focal length and centre",
        )
    leaving_share = float(leaves.mean())
    if leaving_share > max_leaving:
        return Status(
            "diverged",
            f"{100 * leaving_share:.0f}% of the pixels leave the image, so few can be compared: "
            "take frames closer in time, check that they show one scene, or raise smoothness",
        )
    return None
