"""Pairs that were given a status that says something else than what they show."""

import cv2
import numpy as np
import pytest

import tisfm
from tests.cases.inputs import FOCAL, HEIGHT, WIDTH, room


def grain(seed, height=HEIGHT, width=WIDTH):
    """Return a picture of grains of some px, (height, width) float64."""
    noise = np.random.default_rng(seed).normal(size=(height, width))
    grains = cv2.GaussianBlur(noise, (0, 0), 2)
    return 128 + 45 * grains / grains.std()


def layout(seed, margin):
    """Return a picture whose margin, px, is that of every other and whose middle is its own."""
    picture = grain(99)
    inner = np.s_[margin:-margin, margin:-margin]
    picture[inner] = grain(seed, *picture[inner].shape)
    return picture


def interpreted(frame0, frame1, motion):
    frames = (np.clip(np.rint(frame), 0, 255).astype(np.uint8) for frame in (frame0, frame1))
    settings = tisfm.Settings.preset("fast", motion=motion)
    return tisfm.interpret(*frames, camera=tisfm.Camera(focal=FOCAL), settings=settings)


@pytest.mark.parametrize("motion", ["camera", "objects"])
@pytest.mark.parametrize("margin", [50, 60, 70])
def test_a_cut_between_pictures_of_one_layout(motion, margin):
    status = interpreted(layout(0, margin), layout(1, margin), motion).status
    assert status == "unrelated" and "something else in the second" in status.message


@pytest.mark.parametrize("motion", ["camera", "objects"])
@pytest.mark.parametrize("noise", [0, 3, 8])
def test_a_camera_at_rest_is_no_cut(motion, noise):
    rng = np.random.default_rng(0)
    frames = [room(1)[0] + rng.normal(0, noise, (HEIGHT, WIDTH)) for _ in range(2)]
    assert interpreted(*frames, motion).status == "no_motion"


@pytest.mark.parametrize("motion", ["camera", "objects"])
def test_a_thing_that_moves_before_a_camera_at_rest_is_no_cut(motion):
    frames = []
    for moved in (0, 8):
        frame = room(1)[0].astype(float)
        frame[90:150, 90 + moved : 230 + moved] = grain(7, 60, 140)
        frames.append(frame)
    assert interpreted(*frames, motion).status != "unrelated"
