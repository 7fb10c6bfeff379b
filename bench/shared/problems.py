"""Input of the kernel timings, a linearised rendered pair, and checks of their answers."""

from functools import cached_property, lru_cache

import cv2
import numpy as np

from bench import reference
from tisfm import scenes
from tisfm.rigid import rigid_motion

ALPHA = 278.0  # the paper's λ = 1e8 at f = 600
CONTRAST = 0.03  # px/frame
SMOOTHNESS = {
    joint: reference.Smoothness(contrast=CONTRAST, joint=joint) for joint in (False, True)
}
RELAXATION = 1.9  # over-relaxation of a sweep
CONSTRAINTS = {"brightness": 0.3, "gradient": 1.0, "normalization": 0.1}  # weights; grey levels
DATA_SCALES = (0.3 * 0.1**2, 0.1**2)  # m ε² of brightness and of gradient
UNIQUENESS = {"density": 1.23, "flow_difference": 0.07}  # pixels per pixel; px/frame
DENSITY_RATIO = 0.7  # coarse over fine sampling density
RHO_NOISE = 0.1  # px/frame, on ρ̂, so that weights of edges lie well between 0 and 1
LINE_STEPS = (0.5, -1.0)  # along two directions; repeated steps neither grow nor vanish
EDGE_RATE = 0.2  # growth of the divisor of edge weights, per grey level
TOLERATED_SQUARE = 0.15**2  # px²
OUTLINE_COSTS = {"best_count": 2, "guess_costs": (0.1, 0.5), "guess_distances": (4.0, 2.0)}
HYPOTHESES = 0.5 + np.arange(16)  # px/frame, of inverse depth; fill whole vectors of lanes
GUESS_TRUNCATION = 4.0  # px/frame
AGGREGATION = {"step": 0.3, "jump": 5.0, "edge": 1.2}  # penalties; brightness units
UNCERTAIN_BORDER = 0.01  # px from the image border, where rounding decides on inside or outside


class Problem:
    """A pair of frames linearised about a flow near the true one.

    Every array is float64 but holds float32 numbers, so that reference and kernels have the same
    input. `expected` keeps the answers of the reference.
    """

    def __init__(self, height: int, width: int) -> None:
        pair = scenes.two_blocks(height, width, samples=1)
        self.height, self.width, self.camera = height, width, pair.camera
        self.frames = [in_single_precision(pair.frame0), in_single_precision(pair.frame1)]
        self.expected: dict[tuple, np.ndarray] = {}
        rng = np.random.default_rng(0)
        truth = pair.camera.focal * np.concatenate([pair.tau, pair.omega])
        self.rho = in_single_precision(truth + RHO_NOISE * rng.normal(size=truth.shape))
        self.previous = in_single_precision(self.rho + RHO_NOISE * rng.normal(size=truth.shape))
        shape = (6, round(DENSITY_RATIO * height), round(DENSITY_RATIO * width))
        self.coarse = in_single_precision(rng.normal(size=shape))
        self.parents = in_single_precision(rng.normal(size=(6, -(-height // 2), -(-width // 2))))
        self.step = in_single_precision(
            self.rho - self.previous + RHO_NOISE * rng.normal(size=truth.shape)
        )
        self.motion = reference.motion_matrix(self.camera, height, width, 6)
        self.flow = in_single_precision(reference.flow(self.motion, self.rho))
        # Lengths in units of the background's step: D is then in px/frame.
        unit = np.linalg.norm(pair.motions[0, :3])
        poses = [np.column_stack(rigid_motion(twist)) for twist in pair.motions]
        self.motions = in_single_precision(np.array(poses) / [1, 1, 1, unit])
        self.inverse_depth = in_single_precision(unit * pair.camera.focal / pair.depth)[None]
        self.labels = in_single_precision(pair.labels)
        self._weights: dict[tuple[int, bool], np.ndarray] = {}

    def weights(self, components: int, *, joint: bool = False) -> np.ndarray:
        """Return the edge weights of the first components of ρ̂, one for each even if joint."""
        if (components, joint) not in self._weights:
            weights = reference.edge_weights(self.rho[:components], SMOOTHNESS[joint])
            self._weights[components, joint] = in_single_precision(weights)
        return self._weights[components, joint]

    @cached_property
    def gradients(self) -> np.ndarray:
        """(I_x, I_y, I_t) of frame 0 and frame 1 warped, with a border of 2 px, (3, H+4, W+4)."""
        warped, _ = reference.warp(self.frames[1], self.flow)
        return in_single_precision(
            np.array(reference.derivatives(self.frames[0], warped, "five_tap", halo=2))
        )

    @cached_property
    def mask(self) -> np.ndarray:
        """1 where the flow ends inside the image, (H, W)."""
        return reference.warp(self.frames[1], self.flow)[1]

    @cached_property
    def residual(self) -> np.ndarray:
        """Residual of the constraints of each pixel, grey levels; random, (H, W)."""
        return in_single_precision(
            np.random.default_rng(1).uniform(0, 5, (self.height, self.width))
        )

    @cached_property
    def tensor(self) -> np.ndarray:
        """Motion tensor, (6, H, W)."""
        inner = tuple(self.gradients[:, 2:-2, 2:-2])
        return in_single_precision(reference.brightness_tensor(inner, self.flow, self.mask))

    @cached_property
    def constraints(self) -> np.ndarray:
        """Constraints of brightness and gradient constancy, normalised, (9, H, W)."""
        gradients = tuple(self.gradients)
        terms = reference.constancy_constraints(gradients, self.flow, self.mask, **CONSTRAINTS)
        return in_single_precision(np.concatenate(terms).reshape(9, self.height, self.width))

    @cached_property
    def terms(self) -> list[np.ndarray]:
        """Motion tensors, (6, H, W), of brightness and of its gradient."""
        constraints = self.constraints.reshape(3, 3, self.height, self.width)
        return reference.tensors_of([constraints[:1], constraints[1:]])

    @cached_property
    def precision(self) -> np.ndarray:
        """J of windows, squared residual and M, random, (7, H, W): data precision."""
        a, b = np.random.default_rng(2).normal(size=(2, 2, self.height, self.width))
        covariance = np.stack([a[0] ** 2, a[0] * a[1], a[1] ** 2])
        covariance += np.stack([b[0] ** 2, b[0] * b[1], b[1] ** 2])
        curvature = [cv2.boxFilter(entry, -1, (15, 15)) for entry in self.tensor[:3]]
        return in_single_precision(np.stack([*curvature, self.residual, *covariance]))

    @cached_property
    def signs(self) -> np.ndarray:
        """1 or -1, (1, H, W)."""
        return np.sign(self.residual - 2.5)[None]

    @cached_property
    def features(self) -> np.ndarray:
        """Brightness and its derivatives of both frames, as multiples of a unit, (2, 3, H, W)."""
        unit = 2.4 * np.abs(np.diff(self.frames[0])).mean()
        frames = np.array(self.frames) / unit
        slopes = np.gradient(frames, axis=(2, 1))
        return in_single_precision(np.stack([frames, *(4 * slope for slope in slopes)], axis=1))

    @cached_property
    def guess(self) -> np.ndarray:
        """A prior inverse depth, px/frame, (H, W)."""
        return in_single_precision(self.inverse_depth[0] + self.residual)

    @cached_property
    def trust(self) -> np.ndarray:
        """Weight of the prior inverse depth, (H, W)."""
        return in_single_precision(self.residual / 10)

    @cached_property
    def twists(self) -> np.ndarray:
        """T and f·ω of every motion; random, (K, 6)."""
        return in_single_precision(np.random.default_rng(4).normal(size=(len(self.motions), 6)))

    @cached_property
    def cost(self) -> np.ndarray:
        """Costs of all hypotheses; random, (H, W, N)."""
        shape = (self.height, self.width, len(HYPOTHESES))
        return in_single_precision(np.random.default_rng(3).uniform(0, 2, shape))

    @cached_property
    def census(self) -> np.ndarray:
        """Census transforms of both frames; random bits, (2, H, W, 2) int32."""
        shape = (2, self.height, self.width, 2)
        return np.random.default_rng(5).integers(0, 2**24, shape, dtype=np.int32)

    @cached_property
    def outline_codes(self) -> np.ndarray:
        """Census transforms of a keyframe and three frames; random bits, (4, H, W) int32."""
        shape = (4, self.height, self.width)
        return np.random.default_rng(6).integers(-1, 2**24, shape, dtype=np.int32)

    @cached_property
    def rounds_clearly(self) -> np.ndarray:
        """Whether the target of a hypothesis is clearly nearest to one pixel, (H, W, N)."""
        rows, columns = np.mgrid[: self.height, : self.width]
        rotation, translation = self.motions[0, :, :3], self.motions[0, :, 3]
        is_clear = []
        for hypothesis in HYPOTHESES:
            depth = np.full(rows.shape, hypothesis)
            u, v = reference.displacement(depth, self.camera, rotation, translation)
            fractions = np.stack([columns + u, rows + v]) % 1
            is_clear.append((np.abs(fractions - 0.5) > UNCERTAIN_BORDER).all(axis=0))
        return np.stack(is_clear, axis=-1)

    @cached_property
    def certain(self) -> np.ndarray:
        """Whether the target of a hypothesis is clearly inside or outside the image, (H, W, N)."""
        rows, columns = np.mgrid[: self.height, : self.width]
        rotation, translation = self.motions[0, :, :3], self.motions[0, :, 3]
        certain = []
        for hypothesis in HYPOTHESES:
            depth = np.full(rows.shape, hypothesis)
            u, v = reference.displacement(depth, self.camera, rotation, translation)
            x, y = columns + u, rows + v
            away = [x, x - self.width + 1, y, y - self.height + 1]
            certain.append((np.abs(away) > UNCERTAIN_BORDER).all(axis=0))
        return np.stack(certain, axis=-1)


def in_single_precision(values: np.ndarray) -> np.ndarray:
    """Return the values rounded to float32, as float64."""
    return np.asarray(values, np.float32).astype(np.float64)


@lru_cache(maxsize=2)
def problem_at(height: int, width: int) -> Problem:
    """Return the problem of a size; the last two sizes are kept."""
    return Problem(height, width)


def disagreement(actual: np.ndarray, expected: np.ndarray) -> float:
    """Return the largest deviation of (k, …) arrays, relative to the largest value of each of k."""
    if actual.shape != expected.shape:
        raise ValueError(f"the answer is {actual.shape} but the reference's is {expected.shape}")
    k = len(expected)
    deviation = np.abs(actual - expected).reshape(k, -1).max(axis=1)
    largest = np.abs(expected).reshape(k, -1).max(axis=1)
    return float((deviation / np.maximum(largest, np.finfo(np.float32).tiny)).max())


def check(actual: np.ndarray, expected: np.ndarray, tolerance: float) -> float:
    """Return the disagreement, or raise an AssertionError if it is above the tolerance."""
    error = disagreement(actual, expected)
    if not error <= tolerance:  # NaN included
        raise AssertionError(
            f"the answer differs from the reference's by {error:.1e} of the largest value: "
            f"expected at most {tolerance:.1e}"
        )
    return error


def check_quantile(distance: np.ndarray, share: float, tolerance: float) -> float:
    """Return the quantile of the distance at a share of the pixels, or raise as `check` does."""
    error = float(np.quantile(distance, share))
    if not error <= tolerance:
        raise AssertionError(
            f"{share:.0%} of the pixels agree with the reference to {error:.1e} px/frame: "
            f"expected {tolerance:.1e}"
        )
    return error
