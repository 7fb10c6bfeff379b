"""Inverse depth under known rigid motions, coarse to fine, and the motions refined by it."""

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np

from tisfm.camera import Camera
from tisfm.kernels.model.constants import LEAST_DIVISOR
from tisfm.motion.rigid_level import QUIET, REFINED, SAMPLES, RigidLevel
from tisfm.settings import Settings
from tisfm.solver.coarse_to_fine import Records, at_finest
from tisfm.solver.image_pyramid import ImagePyramid
from tisfm.solver.unknowns import Unknowns
from tisfm.visibility.confidence import ROUNDING, median

WARPS = 3  # linearisations on the last level for one of the field's
DEVIATION_WINDOW = 15  # px, over which curvature and residual are averaged for it
# Of the deviation: 68% of the visible pixels of rendered scenes, with noise of 0 to 5 grey levels,
# then lie within one. Neither errors of the motion nor of the model are in it.
CALIBRATION = 0.75
SUREST = np.float32(0.001)  # px: the least deviation


Refinement = Literal["none", "translation", "motion"]


@dataclass(frozen=True, kw_only=True)
class RigidSolution:
    """What coarse to fine leaves.

    Attributes
    ----------
    motions : (K, 3, 4) float64
        R and t of each motion; t of a length such that D is in px/frame, as an average.
    inverse_depth : (H, W) float32
        D = f·d, signed.
    precision : (7, h, w) float32
        Of `tisfm.kernels.solve.data_precision`, on the level that it ended on.
    level : int
        Which that is.
    density : float
        Its sampling density over the finest's.
    history : list of (level, warp, Iteration)
    converged : bool
    adjustable : bool
        Whether the settings say how many iterations there are.
    """

    motions: np.ndarray
    inverse_depth: np.ndarray
    precision: np.ndarray
    level: int
    density: float
    history: Records
    converged: bool
    adjustable: bool = True

    def deviation(self) -> np.ndarray:
        """Return the standard deviation of D, (H, W) float32.

        That of a linear problem with constant coefficients, where data of precision A at every
        pixel are smoothed with the weight κ = α b: (1/4πκ) ln(1 + 4πκ/A), which is 1/A where
        nothing is smoothed. A is the mean curvature of the data in a window, κ a quarter of what a
        pixel's edges weigh, and the unit is the residual there.
        """
        window, known = (DEVIATION_WINDOW, DEVIATION_WINDOW), self.precision
        precision = cv2.blur(known[0], window)
        precision += LEAST_DIVISOR
        residual = cv2.blur(known[3], window)
        # Where nothing is seen, nothing is violated either.
        seen = known[0] > ROUNDING * known[0].max()
        usual = median(known[3][seen]) if seen.any() else 0.0
        np.maximum(residual, usual, out=residual)
        spread = known[4] * np.float32(1 / np.pi)  # 1/(4πκ)
        precision *= spread
        np.reciprocal(precision, out=precision)
        np.log1p(precision, out=precision)
        precision *= spread
        precision *= residual
        np.sqrt(precision, out=precision)
        precision *= np.float32(CALIBRATION)
        deviation = np.maximum(precision, SUREST, out=precision)
        height, width = self.inverse_depth.shape
        if deviation.shape == (height, width):
            return deviation
        return cv2.resize(deviation, (width, height)) / np.float32(self.density)


def rigid_depth(
    pyramid: ImagePyramid,
    settings: Settings,
    motions: np.ndarray,
    labels: np.ndarray,
    *,
    last: int = 0,
    refine: Refinement = "motion",
    support: np.ndarray | None = None,
    start: tuple[int, np.ndarray] | None = None,
    warps: int | None = None,
) -> RigidSolution:
    """Estimate the inverse depth of every pixel, from coarse to fine.

    The data are those of a flow field, weighted as `settings.depth_brightness`,
    `settings.gradient` and `settings.depth_normalization` say and seen along epipolar lines only;
    displacements are exact. The unknown is in px/frame, whatever the motion, because translations
    are given a length by which D moves a pixel, on average, by D px/frame. An edge between two
    labels carries no smoothness.

    Parameters
    ----------
    pyramid : ImagePyramid
    settings : Settings
    motions : (K, 3, 4) array
        R and t of each motion.
    labels : (H, W) int array
        Which motion a pixel has.
    last : int
        The level to end on, unless `start` begins on a finer one.
    refine : {"none", "translation", "motion"}
        What of the motions is refined on the finer levels, jointly with depth.
    support : (H, W) bool array, optional
        Where the data count, by default everywhere; elsewhere depth is continued smoothly.
    start : (int, (h, w) float32), optional
        The level to start on and D there, for motions of the length that `scaled_translations`
        gives them; by default the coarsest level, and zero.
    warps : int, optional
        Linearisations on the last level, by default `WARPS` for one of the field's.
    """
    motions = scaled_translations(motions, labels, pyramid.cameras[0])
    history: Records = []
    coarse: Unknowns | None = None
    noise = np.zeros(len(motions))
    coarsest, depth = (pyramid.levels - 1, None) if start is None else start
    linearisations = [settings.warps * WARPS if warps is None else warps] + coarsest * [
        settings.coarse_warps if start is None else settings.warps
    ]
    last = min(last, coarsest)
    for level in reversed(range(last, coarsest + 1)):
        state = RigidLevel(
            pyramid, level, settings, labels, coarse, support=support, count=len(motions)
        )
        if level == coarsest and depth is not None:
            state.unknowns.set_images(depth[None])
        for warp in range(linearisations[level - last]):
            state.linearise(motions)
            state.minimiser.set_alpha(settings.depth_smoothness * max(1.0, noise.max() / QUIET))
            state.minimiser.update()  # depth was despeckled
            iterations, converged = state.minimiser.minimise()
            history += [(level, warp, iteration) for iteration in iterations]
            state.despeckle()
            noise = state.noise(motions)
            if refine != "none" and (level == last or pyramid.scales[level] >= REFINED):
                unknowns = 6 if refine == "motion" else 3
                motions = state.refined(motions, unknowns, noise)
        coarse = state.unknowns
    state.minimiser.update()  # depth was despeckled
    return RigidSolution(
        motions=motions,
        inverse_depth=at_finest(pyramid, state.unknowns, last)[0],
        precision=state.unknowns.precision(state.minimiser.system),
        level=last,
        density=pyramid.scales[last],
        history=history,
        converged=converged,
    )


def motion_residual(
    pyramid: ImagePyramid, settings: Settings, motion: np.ndarray, inverse_depth: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return how badly one motion and depth meet the images, and their flow.

    Parameters
    ----------
    pyramid : ImagePyramid
    settings : Settings
    motion : (3, 4) array
        R and t, of the length that `inverse_depth` is for.
    inverse_depth : (H, W) float32
        D.

    Returns
    -------
    residual : (H, W) float32
        Squared, px²; 0 where the flow leaves the image.
    flow : (2, H, W) float32
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
    motions: np.ndarray,
    labels: np.ndarray,
    inverse_depth: np.ndarray,
) -> np.ndarray:
    """Return what data and neighbours say of given motions and depth, (7, H, W) float32.

    It is what `rigid_depth` says of its own, as `RigidSolution.precision`.

    Parameters
    ----------
    pyramid : ImagePyramid
    settings : Settings
    motions : (K, 3, 4) array
        R and t of each, of the length that `inverse_depth` is for.
    labels : (H, W) int array
    inverse_depth : (H, W) float32
        D.
    """
    state = RigidLevel(pyramid, 0, settings, labels, count=len(motions))
    state.unknowns.set_images(inverse_depth[None])
    state.linearise(motions)
    state.minimiser.update()
    state.minimiser.set_alpha(
        settings.depth_smoothness * max(1.0, state.noise(motions).max() / QUIET)
    )
    state.minimiser.update()
    return state.unknowns.precision(state.minimiser.system)


def scaled_translations(motions: np.ndarray, labels: np.ndarray, camera: Camera) -> np.ndarray:
    """Return the motions with translations of a length that makes |∂(u, v)/∂D| 1 on average.

    That is the root mean square of |(t₁ − x̂ t₃, t₂ − ŷ t₃)| over the pixels of each label. A
    translation of zero stays.
    """
    height, width = labels.shape
    cx, cy = camera.center_for(height, width)
    stride = max(1, int((height * width / SAMPLES) ** 0.5))
    x = (np.arange(0, width, stride) - cx) / camera.focal
    y = (np.arange(0, height, stride)[:, None] - cy) / camera.focal
    seen = labels[::stride, ::stride]
    scaled = np.array(motions, np.float64)
    for label, motion in enumerate(scaled):
        t1, t2, t3 = motion[:, 3]
        square = (t1 - x * t3) ** 2 + (t2 - y * t3) ** 2
        mine = seen == label
        length = float(np.sqrt(square[mine].mean() if mine.any() else square.mean()))
        if length > 0:
            motion[:, 3] /= length
    return scaled
