"""Pairs that were given a wrong status."""

import cv2
import numpy as np
import pytest

import tisfm
from tests.cases.inputs import FOCAL, HEIGHT, WIDTH, room
from tests.pairwise import pairwise


def grain(seed, height=HEIGHT, width=WIDTH):
    """Return a picture of grains of a few px, (height, width) float64."""
    noise = np.random.default_rng(seed).normal(size=(height, width))
    grains = cv2.GaussianBlur(noise, (0, 0), 2)
    return 128 + 45 * grains / grains.std()


def layout(seed, margin):
    """Return a picture with the same margin, px, as all others and a middle of its own."""
    picture = grain(99)
    inner = np.s_[margin:-margin, margin:-margin]
    picture[inner] = grain(seed, *picture[inner].shape)
    return picture


def interpreted(frame0, frame1, motion):
    frames = (np.clip(np.rint(frame), 0, 255).astype(np.uint8) for frame in (frame0, frame1))
    settings = tisfm.Settings.preset("fast", motion=motion)
    return tisfm.interpret(*frames, camera=tisfm.Camera(focal=FOCAL), settings=settings)


@pairwise(motion=["camera", "objects"], margin=[50, 60, 70], short=True)
def test_cut_between_pictures_of_one_layout(motion, margin):
    status = interpreted(layout(0, margin), layout(1, margin), motion).status
    assert status == "unrelated" and "differs in the second frame" in status.message


@pairwise(motion=["camera", "objects"], noise=[0, 3, 8], short=True)
def test_camera_at_rest_is_not_a_cut(motion, noise):
    rng = np.random.default_rng(0)
    frames = [room(1)[0] + rng.normal(0, noise, (HEIGHT, WIDTH)) for _ in range(2)]
    assert interpreted(*frames, motion).status == "no_motion"


def with_thing(height, width, move):
    """Return two frames of a room at rest with an object that moves to the right, float64."""
    top, left = (HEIGHT - height) // 2, (WIDTH - width - move) // 2
    frames = []
    for moved in (0, move):
        frame = room(1)[0].astype(float)
        frame[top : top + height, left + moved : left + moved + width] = grain(7, height, width)
        frames.append(frame)
    return frames


@pairwise(motion=["objects", "camera"], size_and_move=[(60, 140, 8), (120, 160, 60)], short=True)
def test_object_that_moves_before_a_camera_at_rest_is_not_a_cut(size_and_move, motion):
    height, width, move = size_and_move
    assert interpreted(*with_thing(height, width, move), motion).status != "unrelated"


@pytest.mark.parametrize("move", [20, 30, 45, 90])
@pytest.mark.parametrize(("height", "width"), [(90, 130), (120, 160), (150, 200)])
def test_large_fast_object_is_not_a_cut_even_if_flow_misses_it(height, width, move):
    from tisfm.motion.frame_agreement import replaced_status

    frames = (frame.astype(np.float32) for frame in with_thing(height, width, move))
    assert replaced_status(*frames, np.zeros((HEIGHT, WIDTH, 2), np.float32)) is None


@pytest.mark.parametrize("margin", [40, 50])
@pytest.mark.parametrize("pictures", ["grains", "mirrored", "upside down", "smooth"])
def test_another_middle_is_a_cut(pictures, margin):
    from tisfm.motion.frame_agreement import replaced_status

    frame0 = room(1)[0].astype(np.float32)
    other = {
        "grains": grain(1).astype(np.float32),
        "mirrored": frame0[:, ::-1],
        "upside down": frame0[::-1],
        "smooth": cv2.GaussianBlur(grain(2), (0, 0), 8).astype(np.float32) * 8 - 7 * 128,
    }[pictures]
    inner = np.s_[margin:-margin, margin:-margin]
    frame1 = frame0.copy()
    frame1[inner] = other[inner]
    status = replaced_status(frame0, frame1, np.zeros((HEIGHT, WIDTH, 2), np.float32))
    assert status == "unrelated"
