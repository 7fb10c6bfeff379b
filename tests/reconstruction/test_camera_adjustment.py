"""The adjustment of poses, points and a camera whose focal length may change."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from tests.reconstruction.bundles import FOCAL, bundle
from tisfm.reconstruction.calibration.bundle_residuals import BundleState, linearise
from tisfm.reconstruction.calibration.camera_adjustment import (
    adjust_camera,
    measure_cost,
    solve_equations,
)
from tisfm.reconstruction.calibration.normal_equations import reduce_equations


@pytest.mark.parametrize("zoom", [0.02 * np.arange(8), np.r_[0, 0, 0, 0, 0.02 * np.arange(1, 5)]])
def test_zoom_of_every_frame_is_found(zoom):
    found = adjust_camera(bundle(zoom), FOCAL, has_zoom=True)
    assert np.abs(found.zoom - zoom).max() < 5 * found.zoom_deviation.max() < 0.03
    assert found.zoom[0] == found.zoom_deviation[0] == 0
    assert found.residual == pytest.approx(0.1, rel=0.2)
    constant = adjust_camera(bundle(zoom), FOCAL, ("focal", "k1"))
    assert found.cost < 0.8 * constant.cost


def test_focal_length_and_coefficients_are_found():
    lens = (-0.2, 0.05, 0.004, -0.006)
    free = ("focal", "k1", "k2", "p1", "p2")
    found = adjust_camera(bundle(np.zeros(8), lens), 1.1 * FOCAL, free)
    error = np.abs(found.common - [np.log(FOCAL), *lens])
    assert (error < 5 * found.common_deviation).all()
    assert (found.common_deviation < 0.05).all()
    fixed = adjust_camera(bundle(np.zeros(8), lens), FOCAL, ("k1",))
    assert fixed.focal == pytest.approx(FOCAL)
    assert (fixed.common_deviation == 0).tolist() == [True, False, True, True, True]


def test_outliers_do_not_matter():
    tracks = bundle(np.zeros(8))
    positions = tracks.positions.copy()
    positions[::20] += 15.0
    found = adjust_camera(replace(tracks, positions=positions), FOCAL, ("focal",), has_zoom=True)
    assert found.focal == pytest.approx(FOCAL, rel=0.02)
    assert np.abs(found.zoom).max() < 0.01


def test_prior_of_the_zoom_is_part_of_the_cost():
    """The derivative of the cost is the gradient of the normal equations."""
    tracks = bundle(np.zeros(8))
    zoom = 1e-3 * np.array([0, 1, -1, 2, 0.5, 3, -2, 1])
    state = BundleState(
        poses=tracks.poses, points=tracks.points, common=np.r_[np.log(FOCAL), np.zeros(4)],
        zoom=zoom, removed_zoom=2e-3 * np.arange(8) ** 2,
    )  # fmt: skip
    deviation = linearise(tracks, state).weighting_deviation

    def cost(zoom):
        moved = replace(state, zoom=zoom)
        linear = linearise(tracks, moved)
        return measure_cost(tracks, moved, linear, 3.0, deviation)

    step = 1e-6
    slopes = [(cost(zoom + step * e) - cost(zoom - step * e)) / (2 * step) for e in np.eye(8)]
    linear = linearise(tracks, state)
    is_free = np.zeros(7 * 8 + 5, bool)
    is_free[48:56] = True
    reduced = reduce_equations(tracks, state, linear, is_free, 3.0)
    eliminated = reduced.coupling @ reduced.inverse_points @ reduced.point_gradient
    np.testing.assert_allclose(
        slopes, 2 * deviation**2 * (reduced.gradient + eliminated), rtol=1e-4, atol=1e-2
    )


def test_deviations_do_not_depend_on_the_origin_of_the_world():
    tracks = bundle(0.01 * np.arange(8))
    shift, turn = np.array([5.0, -3.0, 2.0]), cv2.Rodrigues(np.array([0.3, -0.5, 0.2]))[0]
    poses = tracks.poses.copy()
    poses[:, :, :3] = tracks.poses[:, :, :3] @ turn.T
    poses[:, :, 3] -= poses[:, :, :3] @ shift
    moved = replace(tracks, poses=poses, points=tracks.points @ turn.T + shift)
    first, second = (
        adjust_camera(one, FOCAL, ("focal",), has_zoom=True) for one in (tracks, moved)
    )
    for name in ("zoom", "zoom_deviation", "common_deviation"):
        np.testing.assert_allclose(
            getattr(first, name), getattr(second, name), rtol=0.02, atol=2e-5
        )


@pytest.mark.filterwarnings("ignore:.*encountered:RuntimeWarning")
def test_camera_with_numbers_that_are_too_large_stays():
    tracks = bundle(np.zeros(8))
    points = tracks.points.copy()
    points[0] = 1e100, 0, 0  # its direction has no finite derivative
    found = adjust_camera(replace(tracks, points=points), FOCAL, ("focal", "k1", "k2"))
    assert found.focal == pytest.approx(FOCAL)
    assert np.isinf(found.common_deviation[0])


def test_equations_of_unknowns_with_very_different_units_are_solved():
    random = np.random.default_rng(0)
    units = 10.0 ** np.arange(-6, 6)
    root = random.normal(size=(12, 12))
    matrix, true = np.outer(units, units) * (root @ root.T + np.eye(12)), 1 / units
    assert solve_equations(matrix, matrix @ true) == pytest.approx(true, rel=1e-12, abs=0)


def test_singular_equations_have_a_solution():
    without_effect = np.diag([1.0, 1.0, 0.0])
    assert solve_equations(without_effect, np.array([1, 2, 0])) == pytest.approx([1, 2, 0])
    random = np.random.default_rng(1)
    for _ in range(50):  # of these, rounding leaves many positive definite
        root = random.normal(size=(20, 19))
        matrix = root @ root.T
        vector = matrix @ random.normal(size=20)
        solution = solve_equations(matrix, vector)
        assert np.linalg.norm(solution) < 1e3
        assert matrix @ solution == pytest.approx(vector, rel=1e-9, abs=1e-9)


def test_equations_that_are_not_positive_definite_are_solved():
    matrix = np.array([[1.0, 2.0], [2.0, 1.0]])
    assert solve_equations(matrix, np.array([5, 4])) == pytest.approx([1, 2])
    matrix = np.array([[1.0, 2.0], [2.0, -1.0]])
    assert solve_equations(matrix, np.array([5, 0])) == pytest.approx([1, 2])
