"""Inverse depth of a partly textureless frame: matched at texture, and carried across planes.

Textureless surfaces show only noise, which tells nothing about their depth. Planes are matched
forward and backward (`tisfm.motion.matched_planes`). Second-order smoothness carries the matched
depth to the other pixels (`tisfm.solver.second_order`). Then the constraints of the images refine
depth where windows vary by more than noise.
"""

from dataclasses import replace

import cv2
import numpy as np

from tisfm.kernels.layout.images import image_to_lanes, lanes_to_images, multiply
from tisfm.kernels.layout.launch import join_launches
from tisfm.kernels.rigid.epipolar import displacement, restrict_to_line
from tisfm.motion.joined_depth import SolutionWithDeviation
from tisfm.motion.matched_planes import MatchedPlanes, matched_planes, noise_deviation
from tisfm.motion.problems import depth_problem
from tisfm.motion.settings import DEPTH
from tisfm.motion.window_statistics import window_variance
from tisfm.settings import Settings
from tisfm.solver.coarse_to_fine import Records, data_term_on, resize_to_finest, unknowns_on
from tisfm.solver.half_quadratic import Iteration
from tisfm.solver.image_pyramid import ImagePyramid
from tisfm.solver.second_order import (
    SecondOrderMinimiser,
    SecondOrderSettings,
    anchors_in_lanes,
    extend_depth,
)
from tisfm.solver.smoothness import image_driven_factor

SECOND_ORDER = SecondOrderSettings(
    alpha=48.0, beta=196608.0, slope_contrast=0.1, crease_contrast=0.003, image_edges=5.0
)


def textureless_share(frame: np.ndarray, valid: np.ndarray | None = None) -> float:
    """Return the share of a frame's windows, (H, W) float32, that show only noise.

    The share is over the windows around the pixels of `valid`, (H, W) bool, by default all.
    """
    noise = noise_deviation(frame, valid=valid)
    is_textureless = (
        window_variance(frame, DEPTH.texture_window) <= DEPTH.min_texture_variance * noise**2
    )
    if valid is not None:
        is_textureless = is_textureless[valid]
    return float(is_textureless.mean()) if is_textureless.size else 0.0


def textureless_depth(
    pyramid: ImagePyramid,
    settings: Settings,
    # (3, 4) array: R and t, as from `tisfm.motion.rigid_depth.scaled_translations`
    motion: np.ndarray,
    *,
    # (H, W) bool array: pixels whose matches and constraints are used, by default all. Depth is
    # carried to the other pixels.
    support: np.ndarray | None = None,
) -> SolutionWithDeviation | None:
    """Estimate the inverse depth of every pixel under a known motion.

    Returns None if too few pixels could be matched, or if no level is small enough.
    """
    if pyramid.frames0[-1].size > DEPTH.max_plane_pixels:
        return None
    planes = matched_planes(pyramid, motion)
    valid_pixels = pyramid.valid0(planes.level)
    valid = np.ones(planes.is_reliable.shape, bool) if valid_pixels is None else valid_pixels
    if support is not None:
        size = valid.shape[::-1]
        is_supported = (
            cv2.resize(support.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
        )
        valid = valid & is_supported
        planes = replace(planes, is_reliable=planes.is_reliable & valid)
    if planes.is_reliable.sum() < max(1, DEPTH.min_matched_share * valid.sum()):
        return None
    level = planes.level
    state = _Level(pyramid, settings, motion, planes, valid)
    history: Records = []
    converged = False
    for warp in range(DEPTH.carried_warps):
        iterations, converged = state.minimise(settings.tolerance)
        history += [(level, warp, iteration) for iteration in iterations]
    state.limit_depth(planes)
    unknowns = state.unknowns
    return SolutionWithDeviation(
        motions=motion[None],
        inverse_depth=resize_to_finest(pyramid, unknowns, level)[0],
        precision=state.precision(),
        level=level,
        density=pyramid.scales[level],
        history=history,
        converged=converged,
        is_limit_adjustable=False,
        known_deviation=_deviation(planes, unknowns.images()[0], pyramid),
    )


class _Level:
    """Depth, its slopes and the data on the level of the matched planes."""

    def __init__(
        self,
        pyramid: ImagePyramid,
        settings: Settings,
        motion: np.ndarray,  # (3, 4): R and t
        planes: MatchedPlanes,
        valid: np.ndarray,  # (h, w) bool: pixels whose constraints are used
    ) -> None:
        level, matched_depth = planes.level, planes.inverse_depth
        frame, focal = pyramid.frames0[level], pyramid.cameras[level].focal
        problem = depth_problem(settings, focal)
        self.unknowns = unknowns = unknowns_on(pyramid, level, problem)
        self._grid = grid = unknowns.grid
        reliability = planes.is_reliable.astype(np.float32)
        depth, slopes = extend_depth(matched_depth, reliability, frame, SECOND_ORDER)
        data_term = data_term_on(pyramid, level, problem, unknowns)
        line_constraints = grid.allocate(data_term.constraints.shape[0])
        self._minimiser = minimiser = SecondOrderMinimiser(
            grid,
            anchors_in_lanes(grid, np.stack([reliability, reliability * matched_depth])),
            image_driven_factor(grid, frame, SECOND_ORDER.image_edges, pyramid.valid0(level)),
            SECOND_ORDER,
            constraints=line_constraints,
            scales=[DEPTH.constraint_weight * scale for scale in data_term.scales],
        )
        for component, values in enumerate((depth, *slopes)):
            image_to_lanes(grid, np.ascontiguousarray(values), minimiser.rho, component=component)
        labels, weight = grid.allocate(1), grid.allocate(1)
        flow, direction = grid.allocate(2, zeros=False), grid.allocate(2, zeros=False)
        texture_weights = texture_weight(frame, valid=pyramid.valid0(level))
        # factor of a constraint before squaring
        factor = np.float32(DEPTH.constraint_weight**0.5) * texture_weights * valid
        image_to_lanes(grid, factor, weight)
        motions = np.ascontiguousarray(motion[None], np.float32)
        inverse_depth = minimiser.rho[:1]
        self._linearise = join_launches(
            displacement.bind(
                grid,
                inverse_depth,
                labels,
                unknowns.x_hat,
                unknowns.y_hat,
                flow,
                direction,
                motions=motions,
                focal=focal,
            ),
            data_term.bind_linearise(flow),
            restrict_to_line.bind(
                grid, data_term.constraints, flow, direction, inverse_depth, line_constraints
            ),
            multiply.bind(grid, weight, line_constraints),
        )

    def minimise(self, tolerance: float) -> tuple[list[Iteration], bool]:
        """Linearise once and minimise."""
        self._linearise()
        self._minimiser.update()
        return self._minimiser.minimise(DEPTH.carried_iterations, tolerance=tolerance)

    def limit_depth(self, planes: MatchedPlanes) -> None:
        """Set the unknowns to the minimiser's D, bounded from below."""
        min_depth = (
            np.quantile(planes.inverse_depth[planes.is_reliable], DEPTH.ignored_far_share)
            / DEPTH.max_carried_ratio
        )
        self.unknowns.set_images(np.maximum(self._minimiser.images()[:1], np.float32(min_depth)))

    def precision(self) -> np.ndarray:
        """Return the precision of data and carried depth (`tisfm.kernels.solve.data_precision`)."""
        tensor = np.empty((3, self._grid.height, self._grid.width), np.float32)
        lanes_to_images(self._grid, self._minimiser.system.tensor, tensor)
        depth = self._minimiser.images()[0]
        precision = np.zeros((7, *depth.shape), np.float32)
        # Constraints of textureless windows are noise: they are neither data nor usual residuals.
        precision[0] = np.where(tensor[0] > DEPTH.min_precision, tensor[0], 0)
        residual = (tensor[0] * depth + 2 * tensor[1]) * depth + tensor[2]
        precision[3] = np.maximum(residual, 0)
        precision[4] = DEPTH.carried_variance
        return precision


def _deviation(planes: MatchedPlanes, depth: np.ndarray, pyramid: ImagePyramid) -> np.ndarray:
    """Return the standard deviation of D, (H, W) float32, px/frame of the finest level.

    It combines the error of matching, an error that grows with the distance from matched pixels,
    and the change of matched pixels nearby by the refinement. `depth`, (h, w) float32, is the
    refined D on the level of the planes.
    """
    reliability = planes.is_reliable.astype(np.float32)
    distance = cv2.distanceTransform((~planes.is_reliable).astype(np.uint8), cv2.DIST_L2, 5)
    window = (DEPTH.refinement_window, DEPTH.refinement_window)
    refinement = cv2.blur(reliability * np.abs(depth - planes.inverse_depth), window)
    refinement /= np.maximum(
        cv2.blur(reliability, window), np.float32(1 / DEPTH.refinement_window**2)
    )
    deviation = np.sqrt(
        DEPTH.match_deviation**2 + (DEPTH.carried_deviation * distance) ** 2 + refinement**2
    )
    height, width = pyramid.shape
    return cv2.resize(deviation, (width, height)) / np.float32(pyramid.scales[planes.level])


def texture_weight(
    frame: np.ndarray,
    *,
    half_variance: float = DEPTH.half_weight_variance,
    valid: np.ndarray | None = None,
) -> np.ndarray:
    """Return the weight of the texture in each window against noise, (H, W) float32, from 0 to 1.

    The weight is ½ if the variance of a window is `half_variance` variances of the noise. The noise
    is measured on the pixels of `valid`, (H, W) bool, by default all.
    """
    noise = noise_deviation(frame, valid=valid)
    variance = window_variance(frame, DEPTH.texture_window)
    return variance / (variance + np.float32(half_variance * noise**2))
