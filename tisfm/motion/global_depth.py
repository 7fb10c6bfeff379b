"""Depth of frames far apart under a known motion: a global search along all epipolar lines.

An estimate from coarse to fine loses things that are smaller than their motion. Here, census
transforms are compared for all inverse depths up to half of the image, in both directions, with
semi-global aggregation. Pixels whose matches disagree get the depth of the farther side. Region by
region, the frames choose between this depth and the estimate (`tisfm.motion.better_regions`).
"""

import cv2
import numpy as np

from tisfm.camera import Camera
from tisfm.kernels.layout.lanes import aligned_empty
from tisfm.kernels.rigid.census import BITS, WORDS, census_cost
from tisfm.kernels.rigid.semi_global import UNUSED_COST, aggregate, best_hypothesis
from tisfm.motion.better_regions import better_regions
from tisfm.motion.estimate import deviation_factor
from tisfm.motion.joined_depth import join_solutions, rescale
from tisfm.motion.moved_pixels import move_pixels
from tisfm.motion.plane_sweep import MAX_COSTS, MIN_MEAN_STEP
from tisfm.motion.rigid_depth import RigidSolution, rigid_depth, scaled_translations
from tisfm.motion.settings import GLOBAL
from tisfm.motion.sparse_start import depth_flow
from tisfm.runtime import lanes
from tisfm.settings import Settings
from tisfm.solver.image_pyramid import ImagePyramid
from tisfm.solver.smoothness import mean_step

REGION_UNITS = 16  # units per px of D for cv2.filterSpeckles, which takes integers


def global_depth(
    pyramid: ImagePyramid,
    settings: Settings,
    solution: RigidSolution,  # of one motion, whose depth was found without this search
    *,
    flow_residual: float,  # px: as in `make_estimate`, for the deviation of the new depth alone
) -> RigidSolution | None:
    """Return a solution with depth from a global search in the regions where the frames prefer it.

    Returns None without a translation, or if the frames are not far apart, hardly match, or prefer
    the depth that was found everywhere.
    """
    frames = pyramid.frames0
    labels = np.zeros(pyramid.shape, np.int32)
    # A refined motion has another direction, and so another length of a translation in px.
    motion = scaled_translations(solution.motions, labels, pyramid.cameras[0])[0]
    unit = float(np.linalg.norm(motion[:, 3]))
    if not unit:
        return None
    found = rescale(solution, float(np.linalg.norm(solution.motions[0, :, 3])) / unit)
    coarse = next(
        (k for k, frame in enumerate(frames) if frame.size <= GLOBAL.range_pixels), len(frames) - 1
    )
    reach = GLOBAL.max_parallax * max(frames[coarse].shape)
    depth, is_matched = _match(pyramid, coarse, motion, reach)
    if is_matched.mean() < GLOBAL.min_matched_share:
        return None
    high = float(np.percentile(depth[is_matched], GLOBAL.range_percentile)) / pyramid.scales[coarse]
    if high < GLOBAL.min_parallax * max(pyramid.shape):
        return None
    high = min((1 + GLOBAL.range_margin) * high, GLOBAL.max_parallax * max(pyramid.shape))
    level = next(
        k
        for k, frame in enumerate(frames)
        if k >= coarse or (high * pyramid.scales[k] + 2) * frame.size <= MAX_COSTS
    )
    if level < coarse:
        depth, is_matched = _match(pyramid, level, motion, high * pyramid.scales[level])
    depth = _fill(depth, is_matched, motion, pyramid.cameras[level])
    last = min(pyramid.last, solution.level)
    size = frames[last].shape[::-1]
    ratio = np.float32(pyramid.scales[last] / pyramid.scales[level])
    start = cv2.resize(depth, size, interpolation=cv2.INTER_NEAREST) * ratio
    height, width = pyramid.shape
    support = (
        cv2.resize(is_matched.astype(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST)
        > 0
    )
    candidate = rigid_depth(
        pyramid,
        settings,
        motion[None],
        labels,
        last=last,
        refine="none",
        support=support,
        start=(last, start),
    )
    is_better = better_regions(
        pyramid, motion, found.inverse_depth, candidate.inverse_depth, support
    )
    if not is_better.any():
        return None
    deviation = candidate.deviation()
    return join_solutions(
        found,
        candidate,
        is_better,
        motions=motion[None],
        other_deviation=deviation * np.float32(deviation_factor(deviation, flow_residual)),
        status_from_other=found.converged,
    )


def _match(
    pyramid: ImagePyramid,
    level: int,
    motion: np.ndarray,  # (3, 4): R and t
    high: float,  # px of the level: largest D
) -> tuple[np.ndarray, np.ndarray]:
    """Return D of every pixel of frame 0, (h, w) float32, and whether both directions agree."""
    frames = pyramid.frames0[level], pyramid.frames1[level]
    camera = pyramid.cameras[level]
    inverse = np.column_stack([motion[:, :3].T, -motion[:, :3].T @ motion[:, 3]])
    code0, code1 = (_census(frame) for frame in frames)
    count = max(2, min(int(np.ceil(high)) + 1, MAX_COSTS // frames[0].size))
    depth0 = _sweep(frames[0], code0, code1, motion, camera, count)
    depth1 = _sweep(frames[1], code1, code0, inverse, camera, count)
    agrees = _agrees(depth0, depth1, motion, camera)
    valid = pyramid.valid_on(level)
    if valid is not None:
        agrees &= valid[0]
    units = np.where(agrees, REGION_UNITS * (depth0 + 1), 0).clip(0, np.iinfo(np.int16).max)
    units = units.astype(np.int16)
    cv2.filterSpeckles(units, 0, GLOBAL.min_region, int(GLOBAL.region_step * REGION_UNITS))
    return depth0, units > 0


def _census(frame: np.ndarray) -> np.ndarray:
    """Return the census transform of the 7×7 window around every pixel, (H, W, 2) int32."""
    height, width = frame.shape
    side = round((WORDS * BITS + 1) ** 0.5)
    padded = cv2.copyMakeBorder(frame, *(side // 2,) * 4, cv2.BORDER_REPLICATE)
    codes = np.zeros((height, width, WORDS), np.int32)
    shifts = [(dy, dx) for dy in range(side) for dx in range(side) if (dy, dx) != (side // 2,) * 2]
    for n, (dy, dx) in enumerate(shifts):
        is_darker = padded[dy : dy + height, dx : dx + width] < frame
        codes[..., n // BITS] |= is_darker.astype(np.int32) << (n % BITS)
    return codes


def _sweep(
    guide: np.ndarray,  # (h, w) float32: grey levels
    # census0, census1: (h, w, 2) int32
    census0: np.ndarray,
    census1: np.ndarray,
    motion: np.ndarray,  # (3, 4): R and t
    camera: Camera,
    count: int,  # hypotheses 0, 1, … px
) -> np.ndarray:  # (h, w) float32: D, px of the level
    height, width = guide.shape
    lane_count = lanes()
    vectors = -(-count // lane_count)
    plain_shape = (height, width, vectors * lane_count)
    cost = aligned_empty((height, width, vectors, lane_count) if lane_count > 1 else plain_shape)
    census_cost(
        census0,
        census1,
        np.ascontiguousarray(motion, np.float32),
        cost,
        center=camera.center_for(height, width),
        focal=camera.focal,
        first=0.0,
        step=1.0,
    )
    cost *= np.float32(GLOBAL.cost_factor)
    cost.reshape(plain_shape)[..., count:] = UNUSED_COST
    total = aligned_empty(cost.shape)
    unit = max(mean_step(guide, None), MIN_MEAN_STEP)
    aggregate(
        cost,
        np.ascontiguousarray(guide / np.float32(unit)),
        total,
        step=GLOBAL.step_cost,
        jump=GLOBAL.jump_cost,
        edge=GLOBAL.edge_steps,
    )
    best = np.empty((height, width), np.float32)
    best_hypothesis(total.reshape(plain_shape), best, count=count)
    return best


def _agrees(
    depth0: np.ndarray, depth1: np.ndarray, motion: np.ndarray, camera: Camera
) -> np.ndarray:
    """Return whether D of frame 0 and of frame 1, (h, w), show the same points, (h, w) bool."""
    moved = move_pixels(depth0, motion, camera)
    difference = np.abs(depth1[moved.rows, moved.columns] - moved.depth)
    agrees: np.ndarray = moved.is_inside & (difference <= GLOBAL.max_disagreement)
    return agrees


def _fill(
    depth: np.ndarray,  # (h, w) float32
    is_matched: np.ndarray,  # (h, w) bool
    motion: np.ndarray,
    camera: Camera,
) -> np.ndarray:
    """Return D with other pixels filled from the farther one of the matches on both sides.

    The sides are those along the epipolar line, to the nearest axis of the image: a thing hides
    what is beside it along this line, and what is hidden is farther.
    """
    known = np.where(is_matched, depth, np.nan).astype(np.float32)
    along_rows = np.fmin(_carry(known), _carry(known[:, ::-1])[:, ::-1])
    along_columns = np.fmin(_carry(known.T).T, _carry(known.T[:, ::-1])[:, ::-1].T)
    near, far = (
        depth_flow(np.full_like(depth, value), motion, camera) for value in (0.0, GLOBAL.line_step)
    )
    u, v = np.abs(np.moveaxis(far - near, -1, 0))
    first, second = (
        np.where(u >= v, *pair)
        for pair in ((along_rows, along_columns), (along_columns, along_rows))
    )
    filled = np.where(np.isnan(first), second, first)
    filled = np.nan_to_num(filled, nan=float(np.median(depth[is_matched])))
    result: np.ndarray = cv2.medianBlur(filled.astype(np.float32), GLOBAL.median_window)
    return result


def _carry(values: np.ndarray) -> np.ndarray:
    """Return an array whose NaN have the last value to their left in the row, (h, w)."""
    columns = np.where(np.isnan(values), 0, np.arange(values.shape[1]))
    np.maximum.accumulate(columns, axis=1, out=columns)
    return np.take_along_axis(values, columns, axis=1)
