"""Drives along straight roads: the path goes forward, and not sideways with depth inside out."""

import numpy as np
import pytest

import tisfm

pytestmark = [pytest.mark.filterwarnings("ignore::tisfm.focal_guess.GuessedFocalWarning")]


def path_of(source, *, status, **options):
    found = tisfm.reconstruct(
        source, settings=tisfm.Settings.preset("fast", motion="camera"), depth_of="none", **options
    )
    assert (found.piece == 0).all() and set(found.status) == {status}
    return np.asarray(found.poses)


def assert_forward(poses):
    """Check that a camera goes along its own axis, and turns by less than 2° in all."""
    steps = np.einsum("nji,nj->ni", poses[:-1, :3, :3], np.diff(poses[:, :3, 3], axis=0))
    steps /= np.linalg.norm(steps, axis=1, keepdims=True)
    assert np.median(steps[:, 2]) > 0.99
    turn = poses[0, :3, :3].T @ poses[-1, :3, :3]
    assert np.degrees(np.arccos(min((np.trace(turn) - 1) / 2, 1))) < 2


@pytest.fixture
def folder(shared_data, request):
    found = shared_data / request.param
    if not found.exists():
        pytest.skip(f"{found} is not there")
    return found


# Lorries and a car drive along: the pixels that move are masked, as in the shorter
# tests/reconstruction/test_moving_pixels.py.
@pytest.mark.nightly
@pytest.mark.parametrize("folder", ["kitti_cars/images"], indirect=True)
@pytest.mark.parametrize(
    ("size", "focal"),
    [
        pytest.param(640, None, id="640, focal unknown"),
        pytest.param(640, 721.5, id="640"),
        pytest.param(800, None, id="800, focal unknown"),
        pytest.param(None, 721.5, id="full size"),
    ],
)
def test_street_with_cars(folder, size, focal):
    camera = None if focal is None else tisfm.Camera(focal=focal)
    assert_forward(path_of(folder, size=size, camera=camera, status="converged"))


@pytest.mark.nightly
@pytest.mark.parametrize("folder", ["clips/carnd_solidWhiteRight.mp4"], indirect=True)
def test_motorway(folder):
    assert_forward(path_of(folder, start=120, stop=161, step=2, status="converged"))
