"""Initial inverse depth for one rigid motion: triangulated, or found by a plane sweep."""

from functools import cached_property

import cv2
import numpy as np

from tisfm.camera import Camera
from tisfm.kernels.layout.lanes import aligned_empty, aligned_zeros
from tisfm.kernels.model import MIN_DEPTH_RATIO
from tisfm.kernels.rigid.plane_sweep import matching_cost
from tisfm.kernels.rigid.semi_global import UNUSED_COST, aggregate, best_hypothesis
from tisfm.motion.settings import DEPTH
from tisfm.runtime import lanes
from tisfm.solver.image_pyramid import ImagePyramid
from tisfm.solver.smoothness import mean_step

# Largest number of costs (pixels times hypotheses) of a sweep, which decides its level. If every
# level has more, as for long and narrow frames, the largest parallaxes are left out.
MAX_COSTS = 2**25
MIN_MEAN_STEP = 0.01  # grey levels: smallest mean difference of neighbours


class PlaneSweep:
    """A plane sweep on any level of a pyramid, guided by the depth of a flow field."""

    def __init__(
        self,
        pyramid: ImagePyramid,
        # (3, 4) array: R and t, as from `tisfm.motion.rigid_depth.scaled_translations`
        motion: np.ndarray,
        level: int,  # level of the flow field
        flow: np.ndarray,  # (h, w, 2) float32: flow field, px/frame of its level
        trust: np.ndarray,  # (h, w) float32: confidence of the flow
        *,
        # whether the motion was given: the sweep then runs on the finest possible level
        is_motion_known: bool = False,
    ) -> None:
        self._pyramid, self._motion = pyramid, motion
        self._min_level = 0 if is_motion_known else pyramid.last
        self._flow_level, self._trust = level, trust
        self._guess = triangulated_depth(flow, motion, pyramid.cameras[level])

    @cached_property
    def depth_range(self) -> tuple[float, float]:
        """Smallest and largest common D (`range_percentiles`), px/frame of the finest level."""
        frames = self._pyramid.frames0
        level = next(
            (k for k, frame in enumerate(frames) if frame.size <= DEPTH.max_range_pixels),
            len(frames) - 1,
        )
        max_guess = (
            np.percentile(self._guess, DEPTH.range_percentiles[1])
            / self._pyramid.scales[self._flow_level]
        )
        side = max(frames[0].shape)
        depth = self._run(
            level,
            0.0,
            min(max(DEPTH.max_range_parallax * side, (1 + DEPTH.range_margin) * max_guess), side),
        )
        low, high = np.percentile(depth, DEPTH.range_percentiles) / self._pyramid.scales[level]
        return low, high

    def initial_depth(self) -> tuple[int, np.ndarray]:
        """Return a level of the pyramid and its initial inverse depth.

        With little parallax, this depth is the triangulated flow field, which is near the truth.
        With much parallax, it is the result of a sweep that uses the flow field as a guess. Only a
        sweep for a known motion may be finer than the last level of the pyramid.

        Returns the level of the flow field, or a finer level; and the inverse depth D, (H, W)
        float32, px/frame of that level.
        """
        if not self.is_needed:
            return self._flow_level, self._guess
        level = min(max(self.finest_level, self._min_level), self._flow_level)
        return level, self._run(level, *self._search_range)

    @property
    def is_needed(self) -> bool:
        """Whether parallax is too large for an estimate from coarse to fine."""
        low, high = self.depth_range
        return high - low >= DEPTH.min_sweep_range

    @property
    def finest_level(self) -> int:
        """Finest level whose sweep has at most `MAX_COSTS` costs: depth can be refined there."""
        low, high = self._search_range
        frames, scales = self._pyramid.frames0, self._pyramid.scales
        levels = range(self._flow_level)
        return next(
            (k for k in levels if (high - low) * scales[k] * frames[k].size <= MAX_COSTS),
            self._flow_level,
        )

    @property
    def _search_range(self) -> tuple[float, float]:
        """Smallest and largest D of the sweep, px of the finest level."""
        low, high = self.depth_range
        return max((1 - DEPTH.range_margin) * low, 0), (1 + DEPTH.range_margin) * high

    def _run(self, level: int, low: float, high: float) -> np.ndarray:
        """Return D of a level, (h, w) float32, swept between bounds in px of the finest level."""
        pyramid = self._pyramid
        frame0, frame1 = pyramid.frames0[level], pyramid.frames1[level]
        scale, width_height = pyramid.scales[level], frame0.shape[::-1]
        guess = cv2.resize(self._guess, width_height) * np.float32(
            scale / pyramid.scales[self._flow_level]
        )
        hypotheses = np.arange(low * scale, high * scale + 1)
        hypotheses = hypotheses[: max(2, MAX_COSTS // frame0.size)]
        return sweep_depth(
            frame0,
            frame1,
            self._motion,
            pyramid.cameras[level],
            hypotheses,
            guess,
            cv2.resize(self._trust, width_height),
            valid=pyramid.valid_on(level),
        )


def triangulated_depth(
    flow: np.ndarray,  # (H, W, 2) float32: px/frame
    motion: np.ndarray,  # (3, 4) array: R and t
    camera: Camera,  # camera of the flow's level
) -> np.ndarray:  # (H, W) float32: D = f·d, px/frame
    """Return the inverse depth of every pixel whose target is nearest to the target of a flow.

    Near the epipole, where depth hardly moves a pixel, the surroundings decide.
    """
    height, width = flow.shape[:2]
    flow = np.nan_to_num(flow.astype(np.float32), nan=0, posinf=0, neginf=0)  # flow may diverge
    x, y = _rays(height, width, camera)
    rotation, translation = motion[:, :3].astype(np.float32), motion[:, 3].astype(np.float32)
    p1, p2, p3 = (row[0] * x + row[1] * y + row[2] for row in rotation)
    x = x + flow[..., 0] / np.float32(camera.focal)
    y = y + flow[..., 1] / np.float32(camera.focal)
    # x p₃ = p₁ and y p₃ = p₂, p = R x̂ + d t, are linear in d.
    slope_x, slope_y = translation[0] - x * translation[2], translation[1] - y * translation[2]
    numerator = (x * p3 - p1) * slope_x + (y * p3 - p2) * slope_y
    square = slope_x**2 + slope_y**2
    window = (DEPTH.neighbour_window, DEPTH.neighbour_window)
    numerator += DEPTH.neighbour_weight * cv2.blur(numerator, window)
    square += DEPTH.neighbour_weight * cv2.blur(square, window) + np.float32(1e-9)
    return cv2.medianBlur(
        np.float32(camera.focal) * (numerator / square), DEPTH.sweep_median_window
    )


def sweep_depth(
    # frame0, frame1: (H, W) float32, grey levels
    frame0: np.ndarray,
    frame1: np.ndarray,
    motion: np.ndarray,  # (3, 4) array: R and t
    camera: Camera,  # camera of the frames' level
    hypotheses: np.ndarray,  # (N,) array: D, px/frame, evenly spaced and positive; at least 2
    # guess, trust: (H, W) float32, likely inverse depth, and its trust in [0, 1]
    guess: np.ndarray,
    trust: np.ndarray,
    *,
    # tuple of two (H, W) bool: used pixels of each frame, by default all. Other pixels have the
    # weight of hidden pixels.
    valid: tuple[np.ndarray, np.ndarray] | None = None,
) -> np.ndarray:  # (H, W) float32: D, interpolated between the hypotheses
    """Return the best inverse depth of every pixel among hypotheses, by semi-global matching.

    References
    ----------
    Collins, "A space-sweep approach to true multi-image matching", CVPR 1996; Hirschmüller,
    "Stereo processing by semiglobal matching and mutual information", PAMI 2008,
    doi 10.1109/TPAMI.2007.1166.
    """
    height, width = frame0.shape
    unit = max(mean_step(frame0, None if valid is None else valid[0]), MIN_MEAN_STEP)
    lane_count = lanes()
    vectors = -(-len(hypotheses) // lane_count)
    padded_shape = (height, width, vectors * lane_count)
    cost = aligned_empty((height, width, vectors, lane_count) if lane_count > 1 else padded_shape)
    matching_cost(
        _scaled_features(frame0, unit),
        _scaled_features(frame1, unit),
        guess,
        DEPTH.guess_cost + DEPTH.guess_cost_of_trust * trust,
        motion.astype(np.float32),
        cost,
        center=camera.center_for(height, width),
        focal=camera.focal,
        first=float(hypotheses[0]),
        step=float(hypotheses[1] - hypotheses[0]),
        guess_distance=DEPTH.guess_distance,
    )
    cost.reshape(padded_shape)[..., len(hypotheses) :] = UNUSED_COST
    if valid is not None:
        cost[~valid[0]] *= DEPTH.hidden_cost_weight
    depth = _best_depth(cost, frame0 / np.float32(unit), hypotheses)
    hidden = _is_hidden(depth, motion, camera, None if valid is None else valid[1])
    if valid is not None:
        hidden &= valid[0]  # pixels outside `valid` have this weight already
    cost[hidden] *= DEPTH.hidden_cost_weight
    depth = _best_depth(cost, frame0 / np.float32(unit), hypotheses)
    return cv2.medianBlur(depth, DEPTH.sweep_median_window)


def _best_depth(cost: np.ndarray, guide: np.ndarray, hypotheses: np.ndarray) -> np.ndarray:
    height, width = guide.shape
    total = aligned_empty(cost.shape)
    aggregate(cost, guide, total, step=DEPTH.step_cost, jump=DEPTH.jump_cost, edge=DEPTH.edge_steps)
    best = np.empty((height, width), np.float32)
    best_hypothesis(total.reshape(height, width, -1), best, count=len(hypotheses))
    spacing = hypotheses[1] - hypotheses[0]
    return np.float32(hypotheses[0]) + np.float32(spacing) * best


def _is_hidden(
    depth: np.ndarray, motion: np.ndarray, camera: Camera, valid1: np.ndarray | None
) -> np.ndarray:
    """Return the pixels that leave the image or are occluded in frame 1, (H, W) bool.

    Pixels that move to a pixel outside `valid1`, (H, W) bool, are included.
    """
    height, width = depth.shape
    x, y = _rays(height, width, camera)
    points = np.stack(np.broadcast_arrays(x, y, np.float32(1)))
    points = np.einsum("ij,jhw->ihw", motion[:, :3].astype(np.float32), points)
    points += depth * (motion[:, 3] / camera.focal).astype(np.float32)[:, None, None]
    cx, cy = camera.center_for(height, width)
    nearness = 1 / np.maximum(points[2], np.float32(MIN_DEPTH_RATIO))
    columns = np.rint(cx + camera.focal * points[0] * nearness)
    rows = np.rint(cy + camera.focal * points[1] * nearness)
    is_inside = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
    columns, rows = columns[is_inside].astype(np.int32), rows[is_inside].astype(np.int32)
    depth1 = depth * nearness  # D of frame 1
    max_depth1: np.ndarray = np.full(depth.shape, -np.inf, np.float32)
    np.maximum.at(max_depth1, (rows, columns), depth1[is_inside])
    # Rounding leaves gaps in a stretched surface.
    front_depth1 = cv2.dilate(max_depth1, np.ones((3, 3), np.uint8))
    hidden: np.ndarray = ~is_inside
    hidden[is_inside] = front_depth1[rows, columns] > depth1[is_inside] + DEPTH.hidden_distance
    if valid1 is not None:
        hidden[is_inside] |= ~valid1[rows, columns]
    return hidden


def _scaled_features(frame: np.ndarray, unit: float) -> np.ndarray:
    """Return brightness and four times its derivatives, as multiples of the largest cost."""
    features = aligned_zeros((*frame.shape, 4))
    max_difference = DEPTH.max_brightness_difference * unit
    features[..., 0] = frame / np.float32(max_difference)
    for k, order in enumerate(((1, 0), (0, 1))):
        features[..., 1 + k] = cv2.Sobel(frame, cv2.CV_32F, *order, scale=4 / 8 / max_difference)
    return features


def _rays(height: int, width: int, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Return x̂, (W,), and ŷ, (H, 1), float32."""
    cx, cy = camera.center_for(height, width)
    x = (np.arange(width) - cx) / camera.focal
    y = (np.arange(height)[:, None] - cy) / camera.focal
    return x.astype(np.float32), y.astype(np.float32)
