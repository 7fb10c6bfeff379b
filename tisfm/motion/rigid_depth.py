"""Inverse depth under known rigid motions, coarse to fine, with refinement of the motions."""

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np

from tisfm.camera import Camera
from tisfm.kernels.model import MIN_DIVISOR
from tisfm.motion.rigid_level import SAMPLED_PIXELS, RigidLevel
from tisfm.motion.settings import DEPTH
from tisfm.settings import Settings
from tisfm.solver.coarse_to_fine import Records, resize_to_finest
from tisfm.solver.image_pyramid import ImagePyramid
from tisfm.solver.unknowns import Unknowns
from tisfm.visibility.confidence import MIN_RELATIVE_GRADIENT, median

Refinement = Literal["none", "translation", "motion"]


@dataclass(frozen=True, kw_only=True)
class RigidSolution:
    """Motions and inverse depth, estimated from coarse to fine."""

    # (K, 3, 4) float64: R and t of each motion. The length of t makes D px/frame on average.
    motions: np.ndarray
    inverse_depth: np.ndarray  # (H, W) float32: D = f·d, signed
    # (7, h, w) float32: as in `tisfm.kernels.solve.data_precision`, on the last level
    precision: np.ndarray
    level: int  # the last level
    density: float  # sampling density of the last level divided by that of the finest level
    history: Records  # list of (level, warp, Iteration)
    converged: bool
    is_limit_adjustable: bool = True  # whether the settings determine the number of iterations

    def deviation(self) -> np.ndarray:
        """Return the standard deviation of D, (H, W) float32.

        The variance is that of a linear problem with constant coefficients: data of precision A at
        every pixel, smoothed with the weight κ = α b, give (1/4πκ) ln(1 + 4πκ/A). Without
        smoothing, this is 1/A. A is the mean curvature of the data in a window, κ a quarter of the
        weights of a pixel's edges, and the unit is the mean residual in the window.
        """
        window, fields = (DEPTH.deviation_window, DEPTH.deviation_window), self.precision
        precision = cv2.blur(fields[0], window)
        precision += MIN_DIVISOR
        residual = cv2.blur(fields[3], window)
        # Without texture the residual is small, too, so the median residual is its lower bound.
        is_textured = fields[0] > MIN_RELATIVE_GRADIENT * fields[0].max()
        median_residual = median(fields[3][is_textured]) if is_textured.any() else 0.0
        np.maximum(residual, median_residual, out=residual)
        smoothing = fields[4] * np.float32(1 / np.pi)  # 1/(4πκ)
        precision *= smoothing
        np.reciprocal(precision, out=precision)
        np.log1p(precision, out=precision)
        precision *= smoothing
        precision *= residual
        np.sqrt(precision, out=precision)
        precision *= np.float32(DEPTH.deviation_factor)
        deviation = np.maximum(precision, DEPTH.min_deviation, out=precision)
        height, width = self.inverse_depth.shape
        if deviation.shape == (height, width):
            return deviation
        return cv2.resize(deviation, (width, height)) / np.float32(self.density)


def rigid_depth(
    pyramid: ImagePyramid,
    settings: Settings,
    motions: np.ndarray,  # (K, 3, 4) array: R and t of each motion
    labels: np.ndarray,  # (H, W) int array: index of each pixel's motion
    *,
    last: int = 0,  # the last level, unless `start` begins on a finer level
    # part of the motions that is refined on the finer levels, jointly with depth
    refine: Refinement = "motion",
    # (H, W) bool array: pixels whose data are used, by default all. Depth is continued smoothly
    # to other pixels.
    support: np.ndarray | None = None,
    # (int, (h, w) float32): the first level and the D of this level, for translations scaled by
    # `scaled_translations`; by default the coarsest level, and zero
    start: tuple[int, np.ndarray] | None = None,
    # linearisations on the last level, by default `settings.warps * DEPTH.warps_factor`
    warps: int | None = None,
) -> RigidSolution:
    """Estimate the inverse depth of every pixel, from coarse to fine.

    The data terms are those of a flow field, restricted to epipolar lines. Their weights are
    `settings.depth_brightness`, `settings.gradient` and `settings.depth_normalization`.
    Displacements are computed exactly. The unknown D is in px/frame for every motion, because
    translations are scaled such that D moves a pixel by D px/frame on average. Edges between
    labels have no smoothness.
    """
    motions = scaled_translations(motions, labels, pyramid.cameras[0])
    history: Records = []
    coarse: Unknowns | None = None
    residuals = np.zeros(len(motions))
    coarsest_level, depth = (pyramid.levels - 1, None) if start is None else start
    linearisations = [
        settings.warps * DEPTH.warps_factor if warps is None else warps
    ] + coarsest_level * [settings.coarse_warps if start is None else settings.warps]
    last = min(last, coarsest_level)
    for level in reversed(range(last, coarsest_level + 1)):
        state = RigidLevel(
            pyramid, level, settings, labels, coarse, support=support, count=len(motions)
        )
        if level == coarsest_level and depth is not None:
            state.unknowns.set_images(depth[None])
        for warp in range(linearisations[level - last]):
            state.linearise(motions)
            state.minimiser.set_alpha(
                settings.depth_smoothness * max(1.0, residuals.max() / DEPTH.max_quiet_residual)
            )
            state.minimiser.update()  # depth was despeckled
            iterations, converged = state.minimiser.minimise()
            history += [(level, warp, iteration) for iteration in iterations]
            state.despeckle()
            residuals = state.median_residuals(motions)
            if refine != "none" and (
                level == last or pyramid.scales[level] >= DEPTH.min_refined_scale
            ):
                unknowns = 6 if refine == "motion" else 3
                motions = state.refine_motions(motions, unknowns, residuals)
        coarse = state.unknowns
    state.minimiser.update()  # depth was despeckled
    return RigidSolution(
        motions=motions,
        inverse_depth=resize_to_finest(pyramid, state.unknowns, last)[0],
        precision=state.unknowns.precision(state.minimiser.system),
        level=last,
        density=pyramid.scales[last],
        history=history,
        converged=converged,
    )


def motion_residual(
    pyramid: ImagePyramid,
    settings: Settings,
    motion: np.ndarray,  # (3, 4) array: R and t; the length of t fits `inverse_depth`
    inverse_depth: np.ndarray,  # (H, W) float32: D
) -> tuple[np.ndarray, np.ndarray]:
    """Return the residual of one motion and its depth in the images, and their flow.

    Returns the squared residual, (H, W) float32, px², 0 where the flow leaves the image; and the
    flow, (2, H, W) float32.
    """
    labels = np.zeros(inverse_depth.shape, np.int32)
    state = RigidLevel(pyramid, 0, settings, labels, count=1)
    state.unknowns.set_images(inverse_depth[None])
    state.linearise(motion[None])
    state.minimiser.update()
    residual = state.unknowns.residual(state.minimiser.system)
    return residual, state.unknowns.to_images(state.flow)


def motion_precision(
    pyramid: ImagePyramid,
    settings: Settings,
    # (K, 3, 4) array: R and t of each motion; the lengths of t fit `inverse_depth`
    motions: np.ndarray,
    labels: np.ndarray,  # (H, W) int array
    inverse_depth: np.ndarray,  # (H, W) float32: D
) -> np.ndarray:
    """Return the precision of data and neighbours for given motions and depth, (7, H, W) float32.

    `RigidSolution.precision` is this precision for a solution of `rigid_depth`.
    """
    state = RigidLevel(pyramid, 0, settings, labels, count=len(motions))
    state.unknowns.set_images(inverse_depth[None])
    state.linearise(motions)
    state.minimiser.update()
    state.minimiser.set_alpha(
        settings.depth_smoothness
        * max(1.0, state.median_residuals(motions).max() / DEPTH.max_quiet_residual)
    )
    state.minimiser.update()
    return state.unknowns.precision(state.minimiser.system)


def scaled_translations(motions: np.ndarray, labels: np.ndarray, camera: Camera) -> np.ndarray:
    """Return the motions with translations scaled such that |∂(u, v)/∂D| is 1 on average.

    Each translation is divided by the root mean square of |(t₁ − x̂ t₃, t₂ − ŷ t₃)| over the
    pixels of its label. A translation of zero stays zero.
    """
    height, width = labels.shape
    cx, cy = camera.center_for(height, width)
    stride = max(1, int((height * width / SAMPLED_PIXELS) ** 0.5))
    x = (np.arange(0, width, stride) - cx) / camera.focal
    y = (np.arange(0, height, stride)[:, None] - cy) / camera.focal
    sampled_labels = labels[::stride, ::stride]
    scaled_motions = np.array(motions, np.float64)
    for label, motion in enumerate(scaled_motions):
        t1, t2, t3 = motion[:, 3]
        square = (t1 - x * t3) ** 2 + (t2 - y * t3) ** 2
        is_label = sampled_labels == label
        length = float(np.sqrt(square[is_label].mean() if is_label.any() else square.mean()))
        if length > 0:
            motion[:, 3] /= length
    return scaled_motions
