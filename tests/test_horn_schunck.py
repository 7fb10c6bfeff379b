"""Horn and Schunck's flow: its own equations, and what it refuses."""

import numpy as np
import pytest

import tisfm
from bench import reference
from tests.rendered import static_scene, two_blocks
from tisfm.horn_schunck import horn_schunck


@pytest.fixture(scope="module")
def blocks():
    return two_blocks(90, 122, seed=1)


def test_horn_schunck_solves_its_own_equations():
    """α²Δu = I_x(I_x u + I_y v + I_t) with the 4-neighbour Laplacian, at convergence."""
    pair = static_scene("sideways", 60, 80, seed=0)
    settings = tisfm.Settings.preset("paper", outer_iterations=300, tolerance=1e-7, relaxation=1.8)
    flow = horn_schunck(pair.frame0, pair.frame1, smoothness=100.0, settings=settings)
    u, v = np.moveaxis(flow.astype(np.float64), -1, 0)
    frames = (pair.frame0.astype(float), pair.frame1.astype(float))
    ix, iy, it = reference.derivatives(*frames, "cube")

    def laplacian(field):
        padded = np.pad(field, 1, mode="edge")
        around = padded[:-2, 1:-1] + padded[2:, 1:-1] + padded[1:-1, :-2] + padded[1:-1, 2:]
        return around - 4 * field

    constraint = ix * u + iy * v + it
    assert np.abs(100 * laplacian(u) - ix * constraint).max() < 0.05
    assert np.abs(100 * laplacian(v) - iy * constraint).max() < 0.05
    assert np.abs(ix * it).max() > 50


@pytest.mark.parametrize("smoothness", [0.0, -1.0, np.nan, np.inf])
def test_horn_schunck_refuses_bad_smoothness(smoothness, blocks):
    with pytest.raises(ValueError, match="smoothness"):
        horn_schunck(blocks.frame0, blocks.frame1, smoothness=smoothness)
