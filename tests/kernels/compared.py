"""Sizes, models and lanes that kernels are tested with, and how they are compared."""

import numpy as np
import pytest

from bench import reference
from tests.lanes import LANES
from tests.pairwise import pairwise

# One pixel per lane, one lane wide, odd, non-square, exactly full strips, wider than high.
SIZES = [(5, 1), (4, 8), (7, 9), (13, 37), (6, 64), (21, 5)]
MODELS = [6, 3, 2, 1]
each_size = pytest.mark.parametrize("size", SIZES, ids=lambda s: f"{s[0]}x{s[1]}")
each_model = pytest.mark.parametrize("components", MODELS)
each_lanes = pytest.mark.parametrize("lanes", LANES)
of_each = pairwise(size=SIZES, components=MODELS, lanes=LANES)
KINDS = ["paper", "separate", "joint"]  # of weights: without g and s_k, of each component, one


def close(actual, expected, scale=1.0):
    """Equal up to a few dozen float32 roundings of the values' own magnitude."""
    magnitude = max(float(np.abs(expected).max(initial=0.0)), scale)
    np.testing.assert_allclose(actual, expected, rtol=2e-5, atol=4e-6 * magnitude)


def padding(problem, array):
    """Return everything of a lane array that is not a pixel or a copy of one."""
    kept = problem.to_lanes(np.ones((1, problem.grid.height, problem.grid.width)))[0] == 0
    return array[:, kept]


def smoothness_of(problem, contrast, kind):
    """Return the reference's smoothness, s_k, and g in lanes."""
    if kind == "paper":
        return reference.Smoothness(contrast=contrast), 1.0, problem.unknowns.edges
    n, height, width = problem.rho.shape
    g = np.random.default_rng(8).uniform(0.1, 2, size=(2, height, width))
    g[0, :, -1] = g[1, -1] = 0
    g = g.astype(np.float32)
    stiffness = (1.0, 0.5, 0.1, 10.0, 3.0, 0.2)[:n]
    smoothness = reference.Smoothness(
        contrast=contrast,
        edges=g.astype(float),
        stiffness=np.array(stiffness),
        joint=kind == "joint",
    )
    return smoothness, stiffness, problem.to_lanes(g)


def kernel_weights(problem, rho, smoothness):
    """Return g·b as kernels take it: without s_k, and once where it is joint."""
    n = len(rho)
    weights = reference.edge_weights(rho, smoothness).reshape(2, n, *rho.shape[1:])
    weights = weights / smoothness.stiffnesses(n)
    return weights[:, : 1 if smoothness.joint else n].reshape(-1, *rho.shape[1:])
