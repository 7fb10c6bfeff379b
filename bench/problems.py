"""What is timed: a rendered pair, linearised."""

from functools import cached_property, lru_cache

import numpy as np

from tisfm import reference, scenes

ALPHA = 278.0  # the paper's λ = 1e8 at f = 600
CONTRAST = 0.03  # px/frame
SMOOTHNESS = {
    joint: reference.Smoothness(contrast=CONTRAST, joint=joint) for joint in (False, True)
}
RELAXATION = 1.9
CONSTRAINTS = {"brightness": 0.3, "gradient": 1.0, "normalization": 0.1}
SCALES = (0.3 * 0.1**2, 0.1**2)  # m ε² of both
UNIQUENESS = {"density": 1.23, "apart": 0.07}  # pixels per pixel; px/frame
RATIO = 0.7  # coarse over fine sampling density
NOISE = 0.1  # px/frame, on ρ̂: no weight of an edge is all but 0 or 1


class Problem:
    """A pair of frames linearised about a flow near the true one.

    Every array is float64 but holds float32 numbers, so that the reference and the kernels start
    from the same. `expected` keeps what the reference made of them.
    """

    def __init__(self, height: int, width: int) -> None:
        pair = scenes.two_blocks(height, width, samples=1)
        self.height, self.width, self.camera = height, width, pair.camera
        self.frames = [single(pair.frame0), single(pair.frame1)]
        self.expected: dict[tuple, np.ndarray] = {}
        rng = np.random.default_rng(0)
        truth = pair.camera.focal * np.concatenate([pair.tau, pair.omega])
        self.rho = single(truth + NOISE * rng.normal(size=truth.shape))
        self.previous = single(self.rho + NOISE * rng.normal(size=truth.shape))
        shape = (6, round(RATIO * height), round(RATIO * width))
        self.coarse = single(rng.normal(size=shape))
        self.motion = reference.motion_matrix(self.camera, height, width, 6)
        self.flow = single(reference.flow(self.motion, self.rho))
        self._weights: dict[tuple[int, bool], np.ndarray] = {}

    def weights(self, components: int, *, joint: bool = False) -> np.ndarray:
        """Return the edge weights of the first components of ρ̂, one for each even if joint."""
        if (components, joint) not in self._weights:
            weights = reference.edge_weights(self.rho[:components], SMOOTHNESS[joint])
            self._weights[components, joint] = single(weights)
        return self._weights[components, joint]

    @cached_property
    def gradients(self) -> np.ndarray:
        """(I_x, I_y, I_t) of frame 0 and frame 1 warped, with a border of 2 px, (3, H+4, W+4)."""
        warped, _ = reference.warp(self.frames[1], self.flow)
        return single(np.array(reference.derivatives(self.frames[0], warped, "five_tap", halo=2)))

    @cached_property
    def mask(self) -> np.ndarray:
        """1 where the flow stays inside the image, (H, W)."""
        return reference.warp(self.frames[1], self.flow)[1]

    @cached_property
    def residual(self) -> np.ndarray:
        """How badly each pixel's constraints are met, in grey levels; random, (H, W)."""
        return single(np.random.default_rng(1).uniform(0, 5, (self.height, self.width)))

    @cached_property
    def tensor(self) -> np.ndarray:
        """Motion tensor, (6, H, W)."""
        inner = tuple(self.gradients[:, 2:-2, 2:-2])
        return single(reference.brightness_tensor(inner, self.flow, self.mask))

    @cached_property
    def constraints(self) -> np.ndarray:
        """Constraints of brightness and gradient constancy, normalised, (9, H, W)."""
        gradients = tuple(self.gradients)
        terms = reference.constancy_constraints(gradients, self.flow, self.mask, **CONSTRAINTS)
        return single(np.concatenate(terms).reshape(9, self.height, self.width))

    @cached_property
    def terms(self) -> list[np.ndarray]:
        """Motion tensors, (6, H, W), of brightness and of its gradient."""
        constraints = self.constraints.reshape(3, 3, self.height, self.width)
        return reference.tensors_of([constraints[:1], constraints[1:]])


def single(values: np.ndarray) -> np.ndarray:
    """Return the values rounded to float32, as float64."""
    return np.asarray(values, np.float32).astype(np.float64)


@lru_cache(maxsize=2)
def problem_at(height: int, width: int) -> Problem:
    """Return the problem of a size; the last two sizes are kept."""
    return Problem(height, width)
