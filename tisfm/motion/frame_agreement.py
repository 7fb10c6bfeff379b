"""Whether two frames show the same scene, and whether their flow can be right."""

import cv2
import numpy as np

from tisfm.motion.settings import CHECKS
from tisfm.motion.window_statistics import (
    correlation,
    mean_in_windows,
    variance_in_windows,
    warp_image,
)
from tisfm.solver.image_pyramid import ImagePyramid
from tisfm.status import Status
from tisfm.visibility.confidence import CONFIDENCE_WINDOW, median

RESAMPLING_BORDER = 4  # px: resampling repeats pixels in this border, which bends stripes


def unrelated_status(
    # frame0, frame1: (H, W) float32, grey levels
    frame0: np.ndarray,
    frame1: np.ndarray,
    flow: np.ndarray,  # (H, W, 2) float32: px/frame
    trust: np.ndarray,  # (H, W) float32: confidence of the flow; not all 0
    *,
    is_unrestricted: bool = True,  # whether no motion model restricts the flow of a pixel
) -> Status | None:
    """Return the status of frames that a flow does not align, None for others.

    Frames are aligned if their correlation in windows is high at the median trusted pixel. A flow
    that is free at every pixel also has to keep neighbours in order nearly everywhere: a flow that
    folds the image can align any two frames.
    """
    if is_unrestricted and (share := _folded_share(flow, trust)) > CHECKS.max_folded_share:
        return Status(
            "unrelated",
            f"the frames match only if the flow folds {100 * share:.0f}% of the image over: check "
            "that they show one scene, take frames closer in time, or raise smoothness",
        )
    correlations = correlation(frame0, frame1, flow)
    order = np.argsort(correlations, axis=None)
    trust_sums = np.cumsum(trust.ravel()[order], dtype=np.float64)
    median_correlation = float(
        correlations.ravel()[order[np.searchsorted(trust_sums, trust_sums[-1] / 2)]]
    )
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
    # (H, W) bool: pixels that are not visible in frame 1, which are ignored; by default none
    hidden: np.ndarray | None = None,
) -> Status | None:
    """Return the status of frames with one layout and different contents, None for others.

    The common parts of such frames are at rest, and many textured windows differ. With a large
    object that moves far, many windows differ, too, but most match elsewhere in the other frame.
    """
    # Coarse levels have less noise.
    while frame0.size >= 4 * CHECKS.min_judged_pixels and min(frame0.shape) > 4 * RESAMPLING_BORDER:
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
        warped1 = warp_image(frame1, flow)
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
    """Return the largest share of squares with differences that match at one displacement.

    Squares around different pixels are searched in the whole other frame. Chance matches rarely
    share one displacement.
    """
    margin = CHECKS.square_side // 2
    squares = np.argwhere(
        is_different[margin : -margin : CHECKS.square_step, margin : -margin : CHECKS.square_step]
    )
    # Displacements from frame 0 to frame 1, from searches in both directions.
    displacements = np.full((2, len(squares), 2), np.nan)
    for k, (frame, other_frame) in enumerate(((frame0, frame1), (frame1, frame0))):
        for number, (top, left) in enumerate(squares * CHECKS.square_step):
            square = frame[top : top + CHECKS.square_side, left : left + CHECKS.square_side]
            correlations = cv2.matchTemplate(other_frame, square, cv2.TM_CCOEFF_NORMED)
            _, max_correlation, _, (column, row) = cv2.minMaxLoc(correlations)
            if max_correlation >= CHECKS.min_square_correlation:
                displacements[k, number] = (1 - 2 * k) * np.array([column - left, row - top])
    is_found = np.isfinite(displacements[..., 0])
    support = [
        (np.abs(displacements - displacement).max(axis=-1) <= 1).any(axis=0).sum()
        for displacement in displacements[is_found]
    ]
    return max(support, default=0) / max(len(squares), 1)


def _folded_share(flow: np.ndarray, trust: np.ndarray) -> float:
    """Return the share of the trust at pixels where the flow folds the image."""
    with np.errstate(over="ignore", invalid="ignore"):  # where the flow diverged
        slope_x = np.diff(flow[:-1], axis=1)
        slope_y = np.diff(flow[:, :-1], axis=0)
        area = (1 + slope_x[..., 0]) * (1 + slope_y[..., 1]) - slope_x[..., 1] * slope_y[..., 0]
        weight = trust[:-1, :-1]
        total = float(weight.sum())
        return float(weight[area <= 0].sum()) / total if total > 0 else 0.0


def field_status(
    pyramid: ImagePyramid,
    flow: np.ndarray,  # (2, H, W) float32: px/frame
    trust: np.ndarray,  # (H, W) float32: confidence of the flow
) -> Status | None:
    """Return the status of a wrong flow field of the finest level, None for others.

    The flow is evaluated on a coarser level, since motion that is free at every pixel can align
    fine detail of any two frames.
    """
    level = _judged_level(pyramid)
    frame0, frame1 = pyramid.frames0[level], pyramid.frames1[level]
    stripe_status = aperture_status(frame0)
    size, mode = frame0.shape[::-1], cv2.INTER_AREA
    trust = cv2.resize(trust, size, interpolation=mode)
    if stripe_status is not None or not trust.any():
        return stripe_status
    coarse_flow = cv2.merge([cv2.resize(part, size, interpolation=mode) for part in flow])
    return unrelated_status(frame0, frame1, coarse_flow * np.float32(pyramid.scales[level]), trust)


def _judged_level(pyramid: ImagePyramid) -> int:
    """Return the level on which a flow field is evaluated."""
    return max(
        (k for k, frame in enumerate(pyramid.frames0) if frame.size >= CHECKS.min_judged_pixels),
        default=0,
    )


def confirms_large_motion(
    pyramid: ImagePyramid,
    flow: np.ndarray,  # (2, H, W) float32: px/frame of the finest level
    # (H, W) bool: pixels that leave the image or are occluded; they are not evaluated
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
    size, mode = frame0.shape[::-1], cv2.INTER_AREA
    visible = (cv2.resize(hidden.astype(np.float32), size, interpolation=mode) == 0).astype(
        np.float32
    )
    visible_flow = np.where(hidden, 0, flow) * np.float32(pyramid.scales[level])
    coarse_flow = cv2.merge([cv2.resize(part, size, interpolation=mode) for part in visible_flow])
    if not visible.any() or _folded_share(coarse_flow, visible) > CHECKS.max_folded_share:
        return False
    if (
        median(correlation(frame0, frame1, coarse_flow)[visible > 0])
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
        return True  # a part without texture matches everywhere
    is_similar = (
        cv2.matchTemplate(frame, part, cv2.TM_CCOEFF_NORMED) >= CHECKS.min_large_motion_correlation
    )
    _, areas = cv2.connectedComponents(is_similar.astype(np.uint8), connectivity=8)
    return bool((is_similar & (areas != areas[top, left])).any())


def aperture_status(
    frame: np.ndarray,  # (H, W) float32: grey levels
) -> Status | None:
    """Return the status of a frame that varies along one direction only, None for others.

    Motion along its stripes is invisible (the aperture problem).

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
    interior = np.s_[RESAMPLING_BORDER:-RESAMPLING_BORDER, RESAMPLING_BORDER:-RESAMPLING_BORDER]
    with np.errstate(over="ignore", invalid="ignore"):  # frames may be far too bright
        grey = (frame - frame.mean()) / frame.std()
        slope_x, slope_y = (
            cv2.Sobel(grey, cv2.CV_32F, *order, scale=1 / 8)[interior] for order in ((1, 0), (0, 1))
        )
        derivatives = np.stack([slope_x.ravel(), slope_y.ravel()])
        tensor = derivatives @ derivatives.T / slope_x.size
    if not np.isfinite(tensor).all():
        return None
    variations, directions = np.linalg.eigh(tensor)
    variation_along, variation_across = (
        mean_in_windows((np.float32(x) * slope_x + np.float32(y) * slope_y) ** 2)
        for x, y in directions.T
    )
    faint_variation = np.float32(CHECKS.faint_share * variations.sum())
    if (
        variation_along
        > CHECKS.max_stripe_variation * (variation_along + variation_across + faint_variation)
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
    # whether matched points, a pose or the images (`confirms_large_motion`) confirm a large motion;
    # pixels that leave the image may then move far
    is_confirmed: bool = False,
) -> Status | None:
    """Return the status of a flow that is too long for any pair of frames, None for others."""
    max_flow, max_leaving = CHECKS.max_flow, CHECKS.max_leaving_share
    if is_confirmed:
        max_flow, max_leaving = CHECKS.max_confirmed_flow, CHECKS.max_confirmed_leaving_share
        flow = np.where(leaves & np.isfinite(flow), 0, flow)
    # A point that moves by half the image is rarely visible in both frames. NaN counts as too long.
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
