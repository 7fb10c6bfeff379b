"""Coarse to fine: the energy never rises, and all of it agrees with the reference."""

import numpy as np
import pytest

import tisfm
from bench import reference
from tests.draws import examples, long_draw_too
from tests.pairwise import pairwise
from tests.rendered import two_blocks
from tisfm.motion.problems import flow_problem, pyramid_of
from tisfm.solver.coarse_to_fine import coarse_to_fine
from tisfm.solver.image_pyramid import gaussian_pyramid, level_count, smooth


@pytest.fixture(scope="module")
def blocks():
    return two_blocks(60, 82, seed=1)


def solve(frame0, frame1, settings, camera):
    pyramid = pyramid_of(frame0.astype(np.float32), frame1.astype(np.float32), camera, settings)
    problem = flow_problem(settings, camera.focal)
    return coarse_to_fine(pyramid, problem)


@pairwise(
    preset=["paper", "balanced", "accurate"],
    relaxation=[1.0, 1.9, 1.98],
    model=["rigid", "translation"],
    solver=["cholesky", "closed_form"],
    frames=["random", "image"],
    contrast=["preset's", 1e-3],  # the least that settings accept
    cycles=[0, 1],
    short=True,
)
@long_draw_too
def test_energy_never_rises_within_a_warp(
    preset, relaxation, model, solver, frames, contrast, cycles, blocks
):
    """But by rounding: some units of float32 (1.2e-7) of its value."""
    if frames == "random":
        rng = np.random.default_rng(0)
        pair = rng.uniform(0, 255, (2, 45, 61)).astype(np.float32)
    else:
        pair = blocks.frame0, blocks.frame1
    settings = tisfm.Settings.preset(
        preset,
        model=model,
        solver=solver,
        relaxation=relaxation,
        tolerance=0.0,
        outer_iterations=examples(6, 12),
        sweeps=3,
        cycles=cycles,
        **({"contrast": contrast} if contrast == 1e-3 else {}),
    )
    history = tisfm.interpret(*pair, camera=blocks.camera, settings=settings).history
    # The step of a cycle is a sum of three fields, each rounded: seen to lift the energy by 1.4e-6.
    rounding = 3e-6 if cycles else 1e-6
    for level in np.unique(history.level):
        for warp in np.unique(history.warp[history.level == level]):
            within = (history.level == level) & (history.warp == warp)
            energy, majorant = history.energy[within], history.half_quadratic[within]
            assert len(energy) == settings.outer_iterations
            assert np.all(np.diff(energy) <= rounding * energy[:-1])
            assert np.all(energy <= majorant * (1 + 1e-6))
            assert np.all(majorant[1:] <= energy[:-1] * (1 + rounding))


def test_recorded_energy_is_the_references(blocks):
    settings = tisfm.Settings.preset("paper", outer_iterations=5, tolerance=0.0)
    solution = solve(blocks.frame0, blocks.frame1, settings, blocks.camera)
    frames = [f.astype(np.float64) for f in (blocks.frame0, blocks.frame1)]
    shape = frames[0].shape
    motion = reference.motion_matrix(blocks.camera, *shape, 6)
    zero = np.zeros((2, *shape))
    tensor = reference.brightness_tensor(
        reference.derivatives(*frames, "cube"), zero, np.ones(shape)
    )
    rho = solution.unknowns.images().astype(np.float64)
    smoothness = reference.Smoothness(contrast=blocks.camera.focal)
    expected = reference.energy(tensor, motion, rho, settings.alpha, smoothness)
    assert solution.history[-1][2].energy == pytest.approx(expected, rel=2e-6)


@pairwise(
    preset=["paper", "fast", "balanced"],
    model=["rigid", "translation"],
    solver=["cholesky", "closed_form"],
    short=True,
)
def test_the_whole_pair_agrees_with_the_reference(model, preset, solver):
    """Same iterations on both sides; the flow, because ρ̂ itself is ambiguous in the data."""
    pair = two_blocks(50, 67, seed=2)
    settings = tisfm.Settings.preset(
        preset, model=model, solver=solver, tolerance=0.0, outer_iterations=3, sweeps=5, cycles=0
    )
    flow = np.moveaxis(
        tisfm.interpret(pair.frame0, pair.frame1, camera=pair.camera, settings=settings).flow, -1, 0
    )
    factor = settings.pyramid_factor
    levels = level_count(50, 67, factor, settings.pyramid_levels)
    pyramids = [
        gaussian_pyramid(smooth(f.astype(np.float32), settings.presmoothing), factor, levels)
        for f in (pair.frame0, pair.frame1)
    ]
    rho = reference.coarse_to_fine(*pyramids, pair.camera, settings)
    motion = reference.motion_matrix(pair.camera, 50, 67, settings.components)
    expected = reference.flow(motion, rho)
    difference = np.abs(flow - expected)
    if settings.warps == 1:
        assert difference.max() < 1e-3
    # Between warps rounding may tip a pixel over the image's border or an edge; no more than a few.
    assert np.quantile(difference, 0.999) < 2e-3
    assert np.abs(expected).max() > 0.5
