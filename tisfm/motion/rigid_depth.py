"""Inverse depth under known rigid motions, coarse to fine, and the motions refined by it."""

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from tisfm.camera import Camera
from tisfm.kernels.layout.images import image_to_lanes, multiply
from tisfm.kernels.layout.lanes import LaneData, on_host
from tisfm.kernels.layout.launch import in_turn
from tisfm.kernels.model.constants import LEAST_DIVISOR
from tisfm.kernels.rigid.epipolar import along, displacement
from tisfm.kernels.rigid.motion_system import motion_system
from tisfm.motion.epipolar_fit import hold_scale, spin_prior
from tisfm.motion.problems import depth_problem
from tisfm.settings import Settings
from tisfm.solver.coarse_to_fine import Records, at_finest, data_term_on, unknowns_on
from tisfm.solver.half_quadratic import HalfQuadratic
from tisfm.solver.image_pyramid import ImagePyramid
from tisfm.solver.unknowns import Unknowns
from tisfm.visibility.confidence import ROUNDING, median

REFINED = 0.45  # of the finest level's sampling density: coarser levels do not refine motions
HELD = 1e-4  # times α: how little neighbours hold a pixel's depth while the motion changes
MEDIAN = 5  # px, a window for depth after each linearisation
QUIET = 0.15  # px: median residual beyond which smoothness grows in proportion
WARPS = 3  # linearisations on the last level for one of the field's
OUTLYING = 1.5  # median residuals: what is further off hardly counts for the motion
DEVIATION_WINDOW = 15  # px, over which curvature and residual are averaged for it
# Of the deviation: 68% of the visible pixels of rendered scenes, with noise of 0 to 5 grey levels,
# then lie within one. Neither errors of the motion nor of the model are in it.
CALIBRATION = 0.75
SUREST = np.float32(0.001)  # px: the least deviation
SAMPLES = 20_000  # pixels, about, that medians and means over the image are taken of

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
        state = _Level(
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


def residual_under(
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
    state = _Level(pyramid, 0, settings, labels, count=1)
    state.unknowns.set_images(inverse_depth[None])
    state.linearise(motion[None])
    state.minimiser.update()
    residual = state.unknowns.residual(state.minimiser.system)
    return residual, state.unknowns.to_images(state.flow)


def precision_under(
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
    state = _Level(pyramid, 0, settings, labels, count=len(motions))
    state.unknowns.set_images(inverse_depth[None])
    state.linearise(motions)
    state.minimiser.update()
    state.minimiser.set_alpha(
        settings.depth_smoothness * max(1.0, state.noise(motions).max() / QUIET)
    )
    state.minimiser.update()
    return state.unknowns.precision(state.minimiser.system)


class _Level:
    """One level of the pyramid: depth, labels and data."""

    def __init__(
        self,
        pyramid: ImagePyramid,
        level: int,
        settings: Settings,
        labels: np.ndarray,
        coarse: Unknowns | None = None,
        *,
        support: np.ndarray | None = None,
        count: int,
    ) -> None:
        self._focal = pyramid.cameras[level].focal
        problem = depth_problem(settings, self._focal)
        self.unknowns = unknowns = unknowns_on(pyramid, level, problem, coarse)
        grid = unknowns.grid
        size = (grid.width, grid.height)
        resized = cv2.resize(labels.astype(np.float32), size, interpolation=cv2.INTER_NEAREST)
        self._labels = grid.allocate(1)
        if count > 1:
            image_to_lanes(grid, resized, self._labels)
        self._label_image = resized
        self._rows = slice(1, -1, max(1, grid.height * grid.width // SAMPLES))
        inside = _inside(unknowns, pyramid.counted0(level))[0, self._rows, 1:-1]
        sample = np.where(inside > 0, on_host(self._labels)[0, self._rows, 1:-1], -1)
        self._samples = [np.flatnonzero(sample == label) for label in range(count)]
        if labels.any():
            multiply(grid, _within(unknowns, resized), unknowns.edges)
        counted: np.ndarray | None = None
        if support is not None:
            counted = cv2.resize(support.astype(np.float32), size, interpolation=cv2.INTER_AREA)
        elif labels.any() and pyramid.scales[level] >= REFINED:
            # Stencils that reach over a boundary see two motions.
            counted = (~_mixed(resized)).astype(np.float32)
        data_term = data_term_on(pyramid, level, problem, unknowns)
        self._constraints, self._scales = data_term.constraints, data_term.scales
        restricted = grid.allocate(self._constraints.shape[0])
        self.minimiser = HalfQuadratic(
            unknowns,
            restricted,
            scales=self._scales,
            smoothness=problem.smoothness,
            effort=problem.effort,
        )
        self.flow, direction = (grid.allocate(2, zeros=False) for _ in range(2))
        self._motions = np.zeros((count, 3, 4), np.float32)
        steps = [
            displacement.bind(
                grid,
                unknowns.rho,
                self._labels,
                unknowns.x_hat,
                unknowns.y_hat,
                self.flow,
                direction,
                motions=self._motions,
                focal=self._focal,
            ),
            data_term.bind_linearise(self.flow),
            along.bind(grid, self._constraints, self.flow, direction, unknowns.rho, restricted),
        ]
        if counted is not None:
            weight = grid.allocate(1)
            image_to_lanes(grid, np.sqrt(counted), weight)  # of what is squared
            steps.append(multiply.bind(grid, weight, restricted))
        self._linearise = in_turn(*steps)

    def linearise(self, motions: np.ndarray) -> None:
        """Find the data about the current depth, and restrict them to epipolar lines."""
        self._motions[...] = motions
        self._linearise()

    def despeckle(self) -> None:
        """Replace depth by its median over a small window: single pixels go their own way."""
        depth = self.unknowns.images()[0]
        alone = len(self._motions) == 1
        medians = (
            cv2.medianBlur(depth, MEDIAN) if alone else median_within(depth, self._label_image)
        )
        image_to_lanes(self.unknowns.grid, medians, self.unknowns.rho)

    def noise(self, motions: np.ndarray) -> np.ndarray:
        """Return the median residual of each motion's pixels, (K,); 0 for one that shows none.

        Of a sample of rows, and with the weights that the last iteration solved for.
        """
        depth = on_host(self.unknowns.rho)[0, self._rows, 1:-1]
        tensor = on_host(self.minimiser.system.tensor)[:, self._rows, 1:-1]
        residual = (tensor[0] * depth + 2 * tensor[3]) * depth + tensor[5]
        noise = np.zeros(len(motions))
        for label, motion in enumerate(motions):
            mine = residual.ravel()[self._samples[label]]
            if mine.size and motion[:, 3].any():
                noise[label] = np.sqrt(max(median(mine), 0))
        return noise

    def refined(self, motions: np.ndarray, unknowns: int, noise: np.ndarray) -> np.ndarray:
        """Return the motions after a step of Gauss–Newton on the last linearisation."""
        system = self.minimiser.system
        motions = motions.copy()
        current = motions.astype(np.float32)
        for label, motion in enumerate(motions):
            matrix, vector = motion_system(
                system,
                self._constraints,
                self.unknowns.rho,
                self._labels,
                motions=current,
                label=label,
                focal=self._focal,
                scales=self._scales,
                held=HELD * system.alpha,
                tolerated=(OUTLYING * float(noise[label])) ** 2 + LEAST_DIVISOR,
            )
            if label > 0:  # objects hardly spin relative to the background
                stiffness, offset = spin_prior(motion[:, :3], motions[0, :, :3], noise[label])
                matrix[3:, 3:] += stiffness * np.eye(3)
                vector[3:] -= stiffness * offset
            motions[label] = _stepped(motion, matrix, vector, unknowns)
        return motions


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


def median_within(values: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """Return the median of a window around every pixel, of the pixels of its own label only.

    Parameters
    ----------
    values : (H, W) float32
    labels : (H, W) float32

    Returns
    -------
    (H, W) float32
    """
    medians = cv2.medianBlur(values, MEDIAN)
    mixed = _mixed(labels)
    if mixed.any():
        own, around = (
            sliding_window_view(np.pad(image, MEDIAN // 2, mode="edge"), (MEDIAN, MEDIAN))[mixed]
            for image in (labels, values)
        )
        alike = own == labels[mixed][:, None, None]
        around = np.where(alike, around, np.nan).reshape(len(around), -1)
        medians[mixed] = np.nanmedian(around, axis=1)
    return medians


def _mixed(labels: np.ndarray) -> np.ndarray:
    """Return where a window around a pixel holds more than one label, (H, W) bool."""
    window = np.ones((MEDIAN, MEDIAN), np.uint8)
    return cv2.erode(labels, window) != cv2.dilate(labels, window)


def _stepped(
    motion: np.ndarray, matrix: np.ndarray, vector: np.ndarray, unknowns: int
) -> np.ndarray:
    """Return a motion after the step that its normal equations ask for, ‖t‖ kept."""
    translation = motion[:, 3]
    length = np.linalg.norm(translation)
    if not (length > 0 and np.isfinite(matrix).all() and np.isfinite(vector).all()):
        return motion
    matrix = hold_scale(matrix, translation / length)
    step = np.zeros(6)
    step[:unknowns] = -np.linalg.solve(matrix[:unknowns, :unknowns], vector[:unknowns])
    turn = cv2.Rodrigues(step[3:])[0]
    moved = turn @ translation + step[:3]
    return np.column_stack([turn @ motion[:, :3], moved * (length / np.linalg.norm(moved))])


def _inside(unknowns: Unknowns, counted: np.ndarray | None) -> np.ndarray:
    """Return 1 on the pixels of the image that count, else 0, as a lane array; not placed."""
    inside = unknowns.grid.inside()
    if counted is None:
        return inside
    weight = unknowns.grid.allocate(1)
    image_to_lanes(unknowns.grid, counted.astype(np.float32), weight)
    return inside * on_host(weight)


def _within(unknowns: Unknowns, labels: np.ndarray) -> LaneData:
    """Return a lane array that is 1 for the edges between pixels of one label, else 0."""
    grid = unknowns.grid
    same = np.zeros((2, *labels.shape), np.float32)
    same[0, :, :-1] = labels[:, 1:] == labels[:, :-1]
    same[1, :-1] = labels[1:] == labels[:-1]
    out = grid.allocate(2)
    for component, edges in enumerate(same):
        image_to_lanes(grid, edges, out, component=component)
    return out
