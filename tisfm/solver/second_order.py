"""Inverse depth with second-order smoothness: planes of any slant have no cost.

D is inverse depth, px/frame, and v₁ and v₂ are its slopes. Anchors are measurements D* with weights
w, and ρ are the unknowns (D, v₁, v₂) of a pixel. `tisfm.kernels.solve.second_order` defines the
energy. On a level of spacing h, contrasts are multiplied by h, and the data of the finer pixels are
added up. The energy of a field is then the same on every level, up to discretisation.

A lane array holds an image as vertical strips (`tisfm.kernels.layout.lanes`).
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from tisfm.errors import InputError, InputTypeError
from tisfm.kernels.layout.images import image_to_lanes, lanes_to_images, multiply
from tisfm.kernels.layout.lanes import LaneData, LaneGrid, aligned_empty
from tisfm.kernels.solve.second_order.stencil import COMPONENTS, WEIGHTS
from tisfm.kernels.solve.second_order.system import SecondOrderSystem
from tisfm.kernels.solve.weight_update import Sums
from tisfm.runtime import lane_grid
from tisfm.solver.half_quadratic import Iteration
from tisfm.solver.sampling import enlarge, shrink
from tisfm.solver.second_order_multigrid import Interpolation, SecondOrderMultigrid
from tisfm.solver.smoothness import image_driven_factor

MAX_COARSEST_SIDE = 40  # px: largest longer side of the coarsest level
QUADRATIC_ITERATIONS = 12  # with quadratic costs, on the coarsest level, before robust costs
ITERATIONS = 3  # half-quadratic iterations on the finest level
COARSE_ITERATIONS = 2  # additional iterations on each coarser level


@dataclass(frozen=True, kw_only=True)
class SecondOrderSettings:
    """Weights of the smoothness of inverse depth, and the scale of robust anchors.

    Raises ValueError if a value is out of its range.
    """

    # alpha, beta, gamma: weights of r (ΔD minus the slopes), Δv and ΔD, relative to an anchor of
    # weight 1 at a pixel. If anchors are farther apart than √(β/α) px, slopes continue unchanged
    # between them. γ > 0 limits how far D continues along a slope; it may be 0.
    alpha: float = 6.0
    beta: float = 3072.0
    gamma: float = 0.02
    # contrasts of r (px), of Δv (px per px) and of ΔD (px): a larger value counts as a crease or a
    # jump; infinite for neither creases nor jumps
    slope_contrast: float = 0.15
    crease_contrast: float = 0.0005
    jump_contrast: float = 0.1
    # σ, px: anchors with a larger residual have less weight. Infinite for full weight.
    anchor_scale: float = 0.5
    image_edges: float = 5.0  # κ of the image-driven factor (`tisfm.solver.smoothness`)

    def quadratic(self) -> "SecondOrderSettings":
        """Return these settings with quadratic costs, whose energy has a single minimum."""
        return replace(
            self,
            slope_contrast=math.inf,
            crease_contrast=math.inf,
            jump_contrast=math.inf,
            anchor_scale=math.inf,
        )

    def __post_init__(self) -> None:
        for name in ("alpha", "beta"):
            value = getattr(self, name)
            if not 0 < value < math.inf:
                raise InputError(f"{name} is {value}: expected a positive number")
        for name in ("gamma", "image_edges"):
            value = getattr(self, name)
            if not 0 <= value < math.inf:
                raise InputError(f"{name} is {value}: expected a number of at least 0")
        for name in ("slope_contrast", "crease_contrast", "jump_contrast", "anchor_scale"):
            value = getattr(self, name)
            if not value > 0:
                raise InputError(f"{name} is {value}: expected a positive value, in px")


class SecondOrderMinimiser:
    """Alternates the weights and the unknowns, D with its slopes, on one level.

    If other code changes ρ, anchors or constraints, call `update` before `minimise`. `minimise`
    itself keeps the weights up to date.
    """

    def __init__(
        self,
        grid: LaneGrid,
        anchors: LaneData,  # lane array, 2 components: w and D*, used without a copy; 0 in padding
        edges: LaneData,  # lane array, 2 components: factor g of smoothness; 0 across the border
        settings: SecondOrderSettings,
        *,
        spacing: float = 1.0,  # h, px of the finest level
        # lane array, 3 components for each of 1 to 3 constraints: (p, 0, c) of p D + c = 0, used
        # without a copy; 0 in padding
        constraints: LaneData | None = None,
        scales: Sequence[float] = (),  # scales of the terms (`tisfm.kernels.model.robust`)
        cycles: int = 1,  # multigrid cycles in each iteration
    ) -> None:
        if cycles < 1:
            raise InputError(f"cycles is {cycles}: expected at least 1")
        self.grid, self._spacing, self._cycles = grid, spacing, cycles
        # lane array, 3 components: D, px/frame of the finest level, and its slopes v₁ and v₂,
        # px/frame per px of the finest level. Zero at first; `minimise` modifies it in place.
        self.rho = grid.allocate(COMPONENTS)
        self.system = SecondOrderSystem(
            grid=grid,
            tensor=grid.allocate(COMPONENTS),
            weights=grid.allocate(WEIGHTS),
            alpha=settings.alpha,
            beta=settings.beta,
            gamma=settings.gamma,
            spacing=spacing,
        )
        self._multigrid = SecondOrderMultigrid(self.system, self.rho)
        contrasts = (settings.slope_contrast, settings.crease_contrast, settings.jump_contrast)
        self._update: Callable[[], Sums] = self.system.bind_weight_update(
            self.rho,
            grid.allocate(1),
            anchors,
            edges,
            constraints,
            contrasts=[spacing * contrast for contrast in contrasts],
            anchor_scale=settings.anchor_scale,
            scales=scales,
        )

    def start_from(self, coarse: "SecondOrderMinimiser") -> None:
        """Interpolate ρ from the level of half the density; ρ must be zero before."""
        Interpolation(self.grid, coarse.rho, self.rho, self._spacing)()

    def update(self) -> Sums:
        """Compute the weights for the current ρ, anchors and constraints."""
        return self._update()

    def minimise(
        self,
        iterations: int,  # largest number of iterations
        *,
        tolerance: float = 0.0,  # bound of ‖change of D‖ / ‖D‖
    ) -> tuple[list[Iteration], bool]:
        """Iterate until D hardly changes or the iterations run out.

        Returns the records of the iterations, and whether the last relative change was within the
        tolerance.
        """
        records: list[Iteration] = []
        self._multigrid.restart()
        for _ in range(iterations):
            self._multigrid.coarsen()
            for _ in range(self._cycles):
                self._multigrid.descend()
            sums = self._update()
            records.append(
                Iteration(
                    energy=sums.energy,
                    half_quadratic=sums.half_quadratic,
                    change=sums.change / sums.size if sums.size > 0 else 0.0,
                )
            )
            if sums.change <= tolerance * sums.size:
                return records, True
        return records, False

    def images(self) -> np.ndarray:
        """Return D, v₁ and v₂, (3, H, W) float32."""
        out = aligned_empty((COMPONENTS, self.grid.height, self.grid.width))
        lanes_to_images(self.grid, self.rho, out)
        return out


def extend_depth(
    target: np.ndarray,  # (H, W) float32: measurements D*, px/frame; any value where `weight` is 0
    # (H, W) float32, weights of the measurements: 0 without a measurement, 1 for a single good
    # measurement
    weight: np.ndarray,
    frame: np.ndarray,  # (H, W) float32: grey levels; depth may jump or bend at their edges
    settings: SecondOrderSettings | None = None,
    *,
    # half-quadratic iterations on the finest level; coarser levels, which are cheap, have more
    iterations: int = ITERATIONS,
    # halvings of the density at which the extension ends; the result is then interpolated
    last_level: int = 0,
) -> tuple[np.ndarray, np.ndarray]:
    """Extend inverse depth from pixels with a measurement to the whole frame.

    Returns D, (H, W) float32, px/frame, 0 everywhere without a measurement; and the slopes v₁ and
    v₂, (2, H, W) float32, px/frame per px.

    Raises TypeError, ValueError if the arrays are not float32 of one size, if a weight is negative
    or not finite, if a target of weight above 0 is not finite, if `iterations` is below 1, or if
    `last_level` is negative.
    """
    if iterations < 1:
        raise InputError(f"iterations is {iterations}: expected at least 1")
    if last_level < 0:
        raise InputError(f"last_level is {last_level}: expected at least 0")
    settings = settings or SecondOrderSettings()
    anchors = _check_measurements(target, weight, frame)
    weight_sum = anchors[0].sum(dtype=np.float64)
    if not weight_sum:
        return np.zeros(frame.shape, np.float32), np.zeros((2, *frame.shape), np.float32)
    levels = [(anchors, np.ascontiguousarray(frame))]
    while max(levels[-1][1].shape) > MAX_COARSEST_SIDE:
        levels.append(_coarsen(*levels[-1]))
    coarse: SecondOrderMinimiser | None = None
    last_level = min(last_level, len(levels) - 1)
    for level in reversed(range(last_level, len(levels))):
        anchors, image = levels[level]
        grid = lane_grid(*image.shape)
        level_arrays = (
            grid,
            anchors_in_lanes(grid, anchors),
            image_driven_factor(grid, image, settings.image_edges),
        )
        minimiser = SecondOrderMinimiser(*level_arrays, settings, spacing=2.0**level)
        if coarse is None:
            start = SecondOrderMinimiser(*level_arrays, settings.quadratic(), spacing=2.0**level)
            mean = (anchors[0] * anchors[1]).sum(dtype=np.float64) / weight_sum
            image_to_lanes(grid, np.full(image.shape, mean, np.float32), start.rho)
            start.update()
            start.minimise(QUADRATIC_ITERATIONS)
            grid.copy(start.rho, minimiser.rho)
        else:
            minimiser.start_from(coarse)
        minimiser.update()
        minimiser.minimise(iterations + COARSE_ITERATIONS * level)
        coarse = minimiser
    images = minimiser.images()
    if last_level:
        images = enlarge(images, 2**last_level, *frame.shape)
    return images[0], images[1:]


def anchors_in_lanes(grid: LaneGrid, anchors: np.ndarray) -> LaneData:
    """Return w and D*, (2, H, W) float32, as a lane array with 0 in padding."""
    out = grid.allocate(2)
    for component, values in enumerate(anchors):
        image_to_lanes(grid, np.ascontiguousarray(values), out, component=component)
    multiply(grid, grid.place(grid.image_mask()), out)
    return out


def _coarsen(anchors: np.ndarray, frame: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return anchors and frame for the level of half the density.

    A coarse weight is the sum of the finer weights, so that the data energy of a field stays the
    same. A coarse target is the weighted mean of the finer targets.
    """
    height, width = (-(-side // 2) for side in frame.shape)
    weight, target = anchors
    padded = cv2.copyMakeBorder(
        np.dstack([weight, weight * target]),
        0,
        2 * height - frame.shape[0],
        0,
        2 * width - frame.shape[1],
        cv2.BORDER_CONSTANT,
    )
    sums = 4 * cv2.resize(padded, (width, height), interpolation=cv2.INTER_AREA)
    weights = sums[..., 0]
    targets = np.divide(sums[..., 1], weights, out=np.zeros_like(weights), where=weights > 0)
    return np.stack([weights, targets]), shrink(frame[None], 2, height, width)[0]


def _check_measurements(target: np.ndarray, weight: np.ndarray, frame: np.ndarray) -> np.ndarray:
    """Return weight and target, (2, H, W), with target 0 where the weight is 0; raise if wrong."""
    for name, array in (("target", target), ("weight", weight), ("frame", frame)):
        if not isinstance(array, np.ndarray) or array.dtype != np.float32:
            kind = getattr(array, "dtype", type(array).__name__)
            raise InputTypeError(f"{name} is {kind}: expected a NumPy array of float32")
        if array.shape != frame.shape or array.ndim != 2:
            raise InputError(
                f"{name} is {array.shape} but frame is {frame.shape}: expected one size, (H, W)"
            )
    if not (np.isfinite(weight).all() and (weight >= 0).all()):
        raise InputError("weight has values below 0 or not finite: expected numbers of at least 0")
    target = np.where(weight > 0, target, np.float32(0))
    if not np.isfinite(target).all():
        raise InputError("target is not finite where weight is above 0: expected finite numbers")
    return np.stack([weight, target])
