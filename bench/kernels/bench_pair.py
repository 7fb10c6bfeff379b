"""Times of whole pairs, coarse to fine, with the same number of iterations on both sides.

The reference starts from pyramids; the driver builds them, and its time includes that. Without a
tolerance, neither side stops early. Outer iterations are limited to 5 and 3, with the same work per
iteration. With the preset "paper", an iteration is a sweep.
"""

from dataclasses import dataclass, replace

import numpy as np
import pytest
import taichi as ti

from bench import reference
from bench.shared.problems import Problem, check_quantile, problem_at
from tisfm import runtime
from tisfm.kernels.layout.lanes import LaneGrid
from tisfm.motion.problems import flow_problem, pyramid_of
from tisfm.settings import Settings
from tisfm.solver import coarse_to_fine, image_pyramid

REFERENCE_SIZE = (240, 320)  # px: the reference takes minutes for larger pairs


@dataclass(frozen=True)
class Pair:
    """Settings of a pair, the share of its pixels that must agree, and the tolerance, px/frame.

    Within one linearisation, float32 and float64 agree. After a warp they differ at isolated pixels
    with outlying flow. So do two runs of the reference if their frames differ by 1e-5 grey levels.
    """

    settings: Settings
    share: float
    tolerance: float


PAIRS = {
    # Iterations are sweeps, as in the reference.
    "paper": Pair(Settings.preset("paper", outer_iterations=5, cycles=0, tolerance=0.0), 1.0, 1e-4),
    "balanced": Pair(Settings.preset("balanced", outer_iterations=3, tolerance=0.0), 0.9, 1e-2),
}

each_preset = pytest.mark.parametrize("preset", PAIRS)
each_model = pytest.mark.parametrize("model", ["rigid", "translation"])
each_solver = pytest.mark.parametrize("solver", ["cholesky", "closed_form"])


def reference_run(problem: Problem, settings: Settings):
    """Return the call of the reference, which returns ρ̂, (components, H, W)."""
    size = (problem.height, problem.width)
    factor = settings.pyramid_factor
    levels = image_pyramid.level_count(*size, factor, settings.pyramid_levels)
    pyramids = [
        image_pyramid.gaussian_pyramid(
            image_pyramid.smooth(frame.astype(np.float32), settings.presmoothing), factor, levels
        )
        for frame in problem.frames
    ]
    return lambda: reference.coarse_to_fine(*pyramids, problem.camera, settings)


def taichi_run(problem: Problem, settings: Settings):
    """Return the call of the driver, which returns the `Unknowns`."""
    frames = [frame.astype(np.float32) for frame in problem.frames]
    task = flow_problem(settings, problem.camera.focal)

    def run():
        pyramid = pyramid_of(*frames, problem.camera, settings)
        solution = coarse_to_fine.coarse_to_fine(pyramid, task)
        ti.sync()
        return solution.unknowns

    return run


def expected_rho(problem: Problem, preset: str, model: str) -> np.ndarray:
    """Return the answer of the reference, which is computed once."""
    key = ("pair", preset, model)
    if key not in problem.expected:
        problem.expected[key] = reference_run(
            problem, replace(PAIRS[preset].settings, model=model)
        )()
    return problem.expected[key]


def label(problem, preset, model) -> dict:
    return {"kernel": f"pair {preset}", "size": [problem.height, problem.width], "model": model}


@each_preset
@each_model
def bench_pair_numpy(problem, preset, model, measure, full_reference):
    if not full_reference and problem.height * problem.width > np.prod(REFERENCE_SIZE):
        pytest.skip("the reference takes minutes at this size: --full-reference runs it")
    settings = replace(PAIRS[preset].settings, model=model)
    rho = measure(
        reference_run(problem, settings),
        warm=False,
        implementation="numpy",
        **label(problem, preset, model),
    )
    problem.expected["pair", preset, model] = rho


@each_preset
@each_model
@each_solver
def bench_pair_taichi(problem, preset, model, solver, lanes, measure, monkeypatch):
    on_device = runtime.runs_on_gpu()
    monkeypatch.setattr(
        coarse_to_fine, "lane_grid", lambda *size: LaneGrid(*size, lanes, on_device=on_device)
    )
    pair = PAIRS[preset]
    settings = replace(pair.settings, model=model, solver=solver)
    is_known = ("pair", preset, model) in problem.expected
    is_small = problem.height * problem.width <= np.prod(REFERENCE_SIZE)
    # If the reference was not run, a smaller image of the same scene is checked.
    checked_problem = problem if is_known or is_small else problem_at(*REFERENCE_SIZE)
    motion = reference.motion_matrix(
        checked_problem.camera, checked_problem.height, checked_problem.width, settings.components
    )
    actual, expected = (
        reference.flow(motion, rho)
        for rho in (
            taichi_run(checked_problem, settings)().images(),
            expected_rho(checked_problem, preset, model),
        )
    )
    distance = np.hypot(*(actual - expected))
    error = check_quantile(distance, pair.share, pair.tolerance)
    measure(
        taichi_run(problem, settings),
        implementation="taichi",
        lanes=lanes,
        solver=solver,
        disagreement=error,
        checked_at=[checked_problem.height, checked_problem.width],
        **label(problem, preset, model),
    )
