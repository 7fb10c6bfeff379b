"""Labels of moving and parked cars of a street, compared with boxes drawn by hand."""

from functools import cache

import numpy as np
import pytest

import tisfm
from tests.reconstruction.cars import CARS, FRAMES, NEAR
from tisfm.datasets import find_sequences

pytestmark = pytest.mark.nightly  # test_car_ahead.py tests a rendered street

MEASURED = (0, 8, 16)  # frames in which moving cars must be labelled
# Moving cars count if they are near and at least half visible; parked cars at any distance.
MOVING = [car for car in CARS if car.moves and not car.hidden and car.distance <= NEAR]
STANDING = [car for car in CARS if not car.moves]


@cache
def labels_in(folder):
    """Return the labels of every frame, (N, H, W)."""
    (sequence,) = find_sequences(folder)
    loaded = sequence.load()
    found = tisfm.reconstruct(
        loaded.frames,
        camera=loaded.camera,
        settings=tisfm.Settings.preset("fast", motion="objects"),
        depth_of="none",
    )
    return np.stack([found.labels(k) for k in range(len(found))])


@pytest.fixture
def labels(shared_data):
    """Return the labels of every frame, (N, H, W)."""
    folder = shared_data / "kitti_cars"
    if not folder.is_dir():
        pytest.skip(f"{folder} is not there")
    found = labels_in(folder)
    assert len(found) == FRAMES
    return found


def identity(car, labels):
    """Return the label with most pixels in a car's boxes; 0 if there is none."""
    inside = np.concatenate([labels[k][car.box(k)].ravel() for k in range(FRAMES)])
    counts = np.bincount(inside[inside > 0])
    return int(counts.argmax()) if len(counts) else 0


def shares(car, labels, frames, label):
    """Return the share of a car's box with a label, for each of some frames."""
    return np.array([(labels[k][car.box(k)] == label).mean() for k in frames])


def test_tanker_has_one_label(labels):
    (tanker,) = (car for car in MOVING if car.name == "tanker")
    own = identity(tanker, labels)
    assert own > 0
    assert (shares(tanker, labels, range(FRAMES), own) >= 0.5).all()
    for other in CARS:
        if other is not tanker:
            assert (shares(other, labels, range(FRAMES), own) < 0.5).all()


@pytest.mark.parametrize("car", STANDING, ids=lambda car: car.name)
def test_cars_that_stand_are_not_labelled(labels, car):
    labelled = np.array([(labels[k][car.box(k)] > 0).mean() >= 0.5 for k in range(FRAMES)])
    assert labelled.mean() <= 0.1


def test_cars_that_move_are_labelled(labels):
    found = []
    for car in MOVING:
        own = identity(car, labels)
        found.append((own > 0) & (shares(car, labels, MEASURED, own) >= 0.5))
    assert np.mean(found) >= 0.8
