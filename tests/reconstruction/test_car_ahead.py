"""A car in front of the camera that drives along the camera's path, in a rendered street."""

from functools import cache

import numpy as np
import pytest

import tisfm
from tisfm.reconstruction.objects.sequence_labels import SequenceLabels
from tisfm.scenes import Box, Plane, Scene, Texture

HEIGHT, WIDTH, FRAMES = 160, 400, 10
CAMERA = tisfm.Camera(focal=300.0)
OURS = 0.64  # m a frame, the camera moves straight ahead; the road is 1.6 m below
CAR, PARKED = 4, 5  # indices of the objects


def street(number, speed):
    """Return the street in a frame; the car has moved by a speed, m a frame."""

    def paint(seed, wavelength, mean=128.0):
        return Texture(wavelength=wavelength, detail=3, mean=mean, contrast=90, seed=seed)

    objects = [
        Plane(texture=paint(1, 0.5), point=(0, 1.6, 0), normal=(0, -1, 0)),
        Plane(texture=paint(2, 1.5), point=(-8, 0, 0), normal=(1, 0, 0)),
        Plane(texture=paint(3, 1.5), point=(8, 0, 0), normal=(-1, 0, 0)),
        Plane(texture=paint(4, 12.0), point=(0, 0, 90), normal=(0, 0, -1)),
        Box(texture=paint(5, 0.4, 90), center=(0.3, 0.9, 10 + speed * number), size=(1.8, 1.4, 4)),
        Box(texture=paint(6, 0.4, 90), center=(-3.5, 0.9, 14), size=(1.8, 1.4, 4)),
    ]
    return Scene(objects=objects, camera=CAMERA, height=HEIGHT, width=WIDTH)


@cache
def labelled(speed):
    """Return estimated and true labels, (N, H, W) each."""
    finder, poses, true = SequenceLabels(CAMERA), [], []
    for number in range(FRAMES):
        pose = np.eye(4)
        pose[2, 3] = OURS * number
        frame, _, labels = street(number, speed).render_view_with_labels(pose, samples=1)
        finder.add(np.rint(frame).astype(np.uint8))
        poses.append(pose)
        true.append(labels)
    list(finder.labels())
    return np.stack(list(finder.labels(poses, CAMERA))), np.stack(true)


# tests/motion/test_floating_parts.py has a pair, and test_objects.py other objects.
@pytest.mark.nightly
@pytest.mark.parametrize("speed", [0.4, 0.56])
def test_moving_car_ahead_is_labelled_and_a_parked_one_is_not(speed):
    found, true = labelled(speed)
    car = found[true == CAR]
    own = np.bincount(car[car > 0]).argmax()
    assert own > 0
    shares = [(f[t == CAR] == own).mean() for f, t in zip(found, true, strict=True)]
    assert np.mean(shares) > 0.4  # measured: 0.48
    assert (found[true == PARKED] > 0).mean() < 0.05
    assert (found[true < CAR] > 0).mean() < 0.05


@pytest.mark.nightly  # the parked car of the test above stands as well
def test_standing_car_ahead_is_not_labelled():
    found, true = labelled(0.0)
    assert (found[true >= CAR] > 0).mean() < 0.1
    assert (found > 0).mean() < 0.02
