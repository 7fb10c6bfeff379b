"""Which distortions are tried for a path whose tracks fit a richer camera better."""

from types import SimpleNamespace

import pytest

import tisfm
from tisfm.reconstruction.path import lens_revision
from tisfm.reconstruction.path.settings import REVISION

SHAPE = (180, 240)
SOLVER = SimpleNamespace(
    camera=tisfm.Camera(focal=200.0),
    tracks=SimpleNamespace(shape=SHAPE),
)
CORNER = (119.5**2 + 89.5**2) ** 0.5


@pytest.fixture
def tried(monkeypatch):
    """Return a function: displacements that are tried, for the cost of each over that of none."""

    def search(costs):
        starts = []

        def solve(radial, *_):
            start = round(radial * (CORNER / 200.0) ** 2, 3)
            starts.append(start)
            cost = costs[start]
            path = SimpleNamespace(camera=SOLVER.camera)
            if cost is None:
                return None
            return SimpleNamespace(adjusted=cost, radial=radial, path=path)

        monkeypatch.setattr(lens_revision, "_solve_with", solve)
        monkeypatch.setattr(lens_revision, "compare_costs", lambda one, other: one / other)
        found = lens_revision._solve_lens(1.0, SOLVER, None, ())
        return starts, found and round(found.radial * (CORNER / 200.0) ** 2, 3)

    return search


def test_no_strong_distortion_is_tried_if_no_weak_one_fits_better(tried):
    starts, found = tried({-0.1: 0.99, 0.1: 0.97, -0.25: 0.1})
    assert starts == list(REVISION.weak_lens_starts)
    assert found is None


def test_a_strong_distortion_is_tried_if_the_weak_ones_have_no_path(tried):
    starts, found = tried({-0.1: None, 0.1: None, -0.25: 0.5})
    assert starts[:3] == [*REVISION.weak_lens_starts, *REVISION.strong_lens_starts]
    assert found == -0.25


def test_no_path_ends_the_search(tried):
    starts, found = tried({-0.1: None, 0.1: None, -0.25: None})
    assert starts == [-0.1, 0.1, -0.25]
    assert found is None


def test_a_strong_distortion_that_fits_worse_is_not_taken(tried):
    starts, found = tried({-0.1: 0.6, 0.1: 0.9, -0.25: 0.7})
    assert starts == [-0.1, 0.1, -0.25, -0.1]
    assert found == -0.1


def test_the_best_distortion_is_refined(tried):
    starts, found = tried({-0.1: 0.7, 0.1: 0.9, -0.25: 0.5})
    assert starts == [-0.1, 0.1, -0.25, -0.25]
    assert found == -0.25
