"""Where points of a frame are in another: by what the images show, wherever depth leads."""

import numpy as np
import pytest

from tests.exports.exported import predicted, true_places
from tisfm.exports.guided_matching import (
    PosedCamera,
    measure_points,
    points_in_world,
    smooth_pixels,
)
from tisfm.reconstruction.tracks.tracker import choose_new_points


@pytest.fixture(scope="module")
def begun(film):
    points = choose_new_points(film.frames[3], np.empty((0, 2)), ~smooth_pixels(inverse(film)), 24)
    assert len(points) > 150
    return points


def sought(film, points, inverse_depth, other, frame=3):
    poses = [PosedCamera(camera=film.camera, matrix=film.poses[k]) for k in (frame, other)]
    return measure_points(film.frames[frame], film.frames[other], points, inverse_depth, *poses)


def inverse(film, frame=3):
    return (1 / film.depth[frame]).astype(np.float32)


@pytest.mark.parametrize("other", [2, 4, 6])
def test_measured_positions_are_exact_to_a_fraction_of_a_pixel(film, begun, other):
    found = sought(film, begun, inverse(film), other)
    true = true_places(film, begun, 3, [other])[:, 0]
    error = np.linalg.norm(found - true, axis=1)
    assert np.isfinite(error).mean() > 0.2
    assert np.nanmedian(error) < 0.15 and np.nanpercentile(error, 90) < 0.8


def test_no_motion_is_found_to_be_none(film, begun):
    found = sought(film, begun, inverse(film), 3)
    assert np.isfinite(found).all()
    np.testing.assert_allclose(found, begun, atol=1e-4)


@pytest.mark.parametrize("factor", [0.9, 1.1])
def test_a_wrong_depth_does_not_move_the_measured_positions(film, begun, factor):
    """It would fail if positions were projected from the depth."""
    other, right = 5, inverse(film)
    found = sought(film, begun, right, other)
    again = sought(film, begun, right * np.float32(factor), other)
    both = np.isfinite(found[:, 0]) & np.isfinite(again[:, 0])
    assert both.mean() > 0.2
    pose, shape = PosedCamera(camera=film.camera, matrix=film.poses[3]), film.frames[0].shape
    column, row = begun.astype(int).T
    led = [
        predicted(
            points_in_world(begun, depth[row, column].astype(float), pose, shape),
            PosedCamera(camera=film.camera, matrix=film.poses[other]),
            shape,
        )
        for depth in (right, right * factor)
    ]
    moved = np.linalg.norm(led[1] - led[0], axis=1)[both]
    assert np.median(moved) > 0.6
    assert np.median(np.linalg.norm(again - found, axis=1)[both]) < 0.15
    true = true_places(film, begun, 3, [other])[:, 0]
    assert np.nanmedian(np.linalg.norm(again - true, axis=1)) < 0.2


def test_another_exposure_changes_little(film, begun):
    frame = film.frames[5].astype(float)
    brighter = np.clip(0.8 * frame + 30, 0, 255).astype(np.uint8)
    poses = [PosedCamera(camera=film.camera, matrix=film.poses[k]) for k in (3, 5)]
    found, again = (
        measure_points(film.frames[3], other, begun, inverse(film), *poses)
        for other in (film.frames[5], brighter)
    )
    apart = np.linalg.norm(found - again, axis=1)
    assert np.isfinite(apart).sum() > 0.6 * np.isfinite(found[:, 0]).sum()
    assert np.nanmedian(apart) < 0.25


def test_unrelated_frames_share_no_points(film, begun):
    noise = np.random.default_rng(0).integers(0, 256, film.frames[0].shape).astype(np.uint8)
    poses = [PosedCamera(camera=film.camera, matrix=film.poses[k]) for k in (3, 4)]
    found = measure_points(film.frames[3], noise, begun, inverse(film), *poses)
    assert np.isfinite(found[:, 0]).sum() <= 1


def test_points_behind_the_camera_have_no_position(film, begun):
    turned = film.poses[3] @ np.diag([-1.0, 1, -1, 1])
    poses = [PosedCamera(camera=film.camera, matrix=matrix) for matrix in (film.poses[3], turned)]
    found = measure_points(film.frames[3], film.frames[4], begun, inverse(film), *poses)
    assert np.isnan(found).all()
    nothing = measure_points(film.frames[3], film.frames[4], begun[:0], inverse(film), *poses)
    assert nothing.shape == (0, 2)


def test_frames_without_depth_predict_infinite_depth(film, begun):
    found = sought(film, begun, np.full(film.depth[3].shape, np.nan, np.float32), 3)
    np.testing.assert_allclose(found, begun, atol=1e-4)
