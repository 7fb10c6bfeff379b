"""The preset "paper" against its minimum, found by a sparse direct solver in double precision."""

from functools import cache

import numpy as np
import pytest
from scipy import sparse
from scipy.sparse.linalg import splu

import tisfm
from bench import reference
from tests.rendered import static_scene
from tisfm.formats import read_image

CAMERA = tisfm.Camera(focal=600.0)


def paper(**changes):
    return tisfm.Settings.preset("paper", **changes)


def constraints(frame0, frame1, settings):
    """Return (I_x, I_y, I_t) as the library has them, (3, H, W) float64."""
    from tisfm.frames import grey_pair
    from tisfm.motion.problems import flow_problem, pyramid_of
    from tisfm.solver.coarse_to_fine import data_term_on, unknowns_on

    pyramid = pyramid_of(*grey_pair(frame0, frame1), CAMERA, settings)
    problem = flow_problem(settings, CAMERA.focal)
    unknowns = unknowns_on(pyramid, 0, problem)
    data_term = data_term_on(pyramid, 0, problem, unknowns)
    data_term.bind_linearise(unknowns.grid.allocate(2))()
    return unknowns.to_images(data_term.constraints).astype(np.float64)


def least(frame0, frame1, settings):
    """Return the ρ̂ of least energy (eq. 20), (n, H, W): a half-quadratic with exact solves."""
    ix, iy, it = constraints(frame0, frame1, settings)
    n, (height, width) = settings.components, ix.shape
    motion = reference.motion_matrix(CAMERA, height, width, n)
    row = (motion[0] * ix + motion[1] * iy).transpose(1, 2, 0).ravel()
    count = height * width
    pixel = np.arange(count).reshape(height, width)
    data = sparse.csr_matrix((row, (np.repeat(np.arange(count), n), np.arange(n * count))))
    one = np.concatenate([pixel[:, :-1].ravel(), pixel[:-1].ravel()])
    other = np.concatenate([pixel[:, 1:].ravel(), pixel[1:].ravel()])
    edge = np.arange(len(one))
    signs = np.repeat([1.0, -1.0], len(one))
    ends = (np.tile(edge, 2), np.concatenate([one, other]))
    step = sparse.kron(
        sparse.csr_matrix((signs, ends), shape=(len(one), count)), sparse.identity(n)
    )
    rho, contrast = np.zeros(n * count), settings.contrast_for(CAMERA.focal)
    for _ in range(40):
        b = 1 / np.sqrt(1 + (step @ rho) ** 2 / contrast**2)
        smooth = settings.alpha * step.T @ sparse.diags(b) @ step
        found = splu((data.T @ data + smooth).tocsc()).solve(-data.T @ it.ravel())
        moved, rho = np.linalg.norm(found - rho), found
        if moved < 1e-5 * np.linalg.norm(rho):
            return rho.reshape(height, width, n).transpose(2, 0, 1)
    raise AssertionError("the exact solve has not converged")


@cache
def solved(name, model, folder):
    """Return a pair and its ρ̂ of least energy."""
    if name == "rendered":
        pair = static_scene("sideways", 30, 42)
        frames = pair.frame0, pair.frame1
    else:
        frames = [read_image(folder / name / f"img0{k}.pgm")[40:72, 70:114] for k in (30, 31)]
    return frames, least(*frames, paper(model=model))


def off(result, exact):
    """Return the errors of ρ̂ and inverse depth (eq. 24), relative to their norms."""
    found = result.rho[: len(exact)].astype(np.float64)
    depths = [np.linalg.norm(rho[:3], axis=0) for rho in (found, exact)]
    return (
        np.linalg.norm(found - exact) / np.linalg.norm(exact),
        np.linalg.norm(depths[0] - depths[1]) / np.linalg.norm(depths[1]),
    )


@pytest.fixture(params=["rendered", "flowergarden"])
def pair(request):
    """Return the name of a pair, and the folder of real sequences for a real one."""
    real = request.param != "rendered"
    return request.param, request.getfixturevalue("shared_data") if real else None


@pytest.mark.parametrize("model", ["rigid", "translation"])
@pytest.mark.parametrize(
    "changes",
    [{}, {"tolerance": 1e-3}, {"cycles": 0, "outer_iterations": 1000}],
    ids=["cycles", "closer", "sweeps"],
)
def test_a_converged_solution_is_at_the_minimum(pair, model, changes):
    name, folder = pair
    frames, exact = solved(name, model, folder)
    settings = paper(model=model, **changes)
    result = tisfm.interpret(*frames, camera=CAMERA, settings=settings)
    assert result.status == "converged"
    assert f"{settings.tolerance:g}" in result.status.message
    assert max(off(result, exact)) <= settings.tolerance
    assert len(result.history.change) < (30 if settings.cycles else 1000)


@pytest.mark.parametrize(
    ("changes", "advice"),
    [
        ({"outer_iterations": 4}, "raise outer_iterations, or accept"),
        ({"cycles": 0, "outer_iterations": 11}, "set cycles to 1"),
    ],
)
def test_a_solution_that_has_not_converged_says_so(changes, advice):
    frames, exact = solved("rendered", "rigid", None)
    result = tisfm.interpret(*frames, camera=CAMERA, settings=paper(**changes))
    assert max(off(result, exact)) > paper().tolerance
    assert result.status == "iteration_limit" and advice in result.status.message


@pytest.mark.parametrize(
    ("model", "thorough", "expected"),
    [("translation", False, 0.059), ("rigid", False, 1.0), ("rigid", True, 0.0195)],
)
def test_the_last_change_says_too_little(shared_data, model, thorough, expected):
    """The reference stops by it, with and without a solve for motions without image motion."""
    frames, exact = solved("flowergarden", model, shared_data)
    settings = paper(model=model)
    rho = np.zeros_like(exact)
    run = reference.minimise(
        reference.tensors_of([constraints(*frames, settings)[None]]),
        reference.motion_matrix(CAMERA, *rho.shape[1:], len(rho)),
        rho,
        alpha=settings.alpha,
        smoothness=reference.Smoothness(contrast=settings.contrast_for(CAMERA.focal)),
        outer_iterations=settings.outer_iterations,
        sweeps=settings.sweeps,
        relaxation=settings.relaxation,
        tolerance=settings.tolerance,
        thorough=thorough,
    )
    assert run.converged and run.changes[-1] <= settings.tolerance
    off = np.linalg.norm(rho - exact) / np.linalg.norm(exact)
    assert off == pytest.approx(expected, rel=0.05)


@pytest.mark.parametrize(
    ("cycles", "limit", "status"),
    [(1, 2, "iteration_limit"), (1, 3, "converged"), (0, 3, "iteration_limit")],
)
def test_the_fewest_iterations_that_can_converge(cycles, limit, status):
    """Any error is tolerated, so only the rule itself asks for more iterations."""
    pair = static_scene("sideways", 30, 42)
    settings = paper(cycles=cycles, outer_iterations=limit, tolerance=1e6)
    result = tisfm.interpret(pair.frame0, pair.frame1, camera=CAMERA, settings=settings)
    assert len(result.history.change) == limit and result.status == status


def test_error_left_of_changes_that_shrink():
    from tisfm.solver.half_quadratic import remaining_error

    changes = [0.9**k for k in range(5)]
    assert remaining_error(changes) == pytest.approx(sum(0.9**k for k in range(5, 500)))
    assert remaining_error([1.0, 1e-3]) == pytest.approx(
        2e-3
    )  # one fall is no reason to expect another
    assert remaining_error([1.0, 0.8, 0.08]) == pytest.approx(4 * 0.08)
    assert remaining_error([1e-3, 1e-3]) == remaining_error([0.1]) == remaining_error([]) == np.inf
    assert remaining_error([0.1, 0.0]) == 0
