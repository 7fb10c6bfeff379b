"""Camera paths through a rendered room, against exact poses."""

import hashlib

import numpy as np
import pytest

from tests.one_thread import bits_on_one_thread, several_threads
from tests.reconstruction.walks import CAMERA, centres, frames, residual
from tisfm.reconstruction.path.path_solver import find_path

WALK = [(0.02 * k, 0.04 * k, 0.01 * k) for k in range(24)]


def path_of(images):
    return find_path(((image, None, None) for image in images), CAMERA)


def bits():
    path = path_of(frames(WALK[:10]))
    poses = [pose.tobytes() for piece in path.pieces for pose in piece.poses.values()]
    return hashlib.sha256(b"".join(poses)).hexdigest()


@pytest.mark.slow
def test_a_round_trip_closes():
    there = frames(WALK)
    back = frames(WALK[::-1], noise=1.1)
    (piece,) = path_of(there + back).pieces
    found = np.array([piece.poses[k][:3, 3] for k in range(48)])
    length = np.linalg.norm(np.diff(found, axis=0), axis=1).sum()
    assert np.linalg.norm(found[0] - found[-1]) < 0.003 * length
    assert residual(found, centres(WALK + WALK[::-1])) < 0.005


@pytest.mark.slow
def test_frames_after_blanked_ones_are_in_the_same_piece():
    images = frames(WALK)
    for k in range(10, 15):
        images[k] = np.zeros_like(images[k])
    path = path_of(images)
    (piece,) = path.pieces
    assert sorted(path.missing) == list(range(10, 15))
    assert set(path.missing.values()) == {"no_texture"}
    assert "dark" in path.missing[10].message
    seen = sorted(piece.poses)
    found = np.array([piece.poses[k][:3, 3] for k in seen])
    assert residual(found, centres(WALK)[seen]) < 0.01


@pytest.mark.slow
def test_two_scenes_are_two_pieces():
    mirrored = [np.ascontiguousarray(image[:, ::-1]) for image in frames(WALK[:14], seed=5)]
    path = path_of(frames(WALK[:14]) + mirrored)
    assert [list(piece.poses) for piece in path.pieces] == [list(range(14)), list(range(14, 28))]


@pytest.mark.slow
def test_a_camera_that_only_turns_has_no_path():
    path = path_of(frames([(0, 0, 0.03 * k) for k in range(12)]))
    assert path.pieces == ()
    assert set(path.missing.values()) == {"little_parallax"}
    assert sorted(path.missing) == list(range(12))


def test_a_camera_at_rest_has_no_path():
    path = path_of(frames([WALK[0]] * 6))
    assert path.pieces == ()
    assert set(path.missing.values()) == {"no_motion"}


def test_two_frames_that_differ_are_told_to_be_too_few():
    first, second = frames([WALK[0], WALK[12]])
    for images in ([first, second], [first, first, second]):
        path = path_of(images)
        assert path.pieces == ()
        assert set(path.missing.values()) == {"little_parallax"}
        assert {status.message[:22] for status in path.missing.values()} == {
            "only 2 frames differ, "
        }


def test_black_frames_have_no_path():
    path = path_of([np.zeros((120, 160), np.uint8)] * 3)
    assert path.pieces == ()
    assert list(path.missing.values()) == ["no_texture"] * 3


def test_no_frame_at_all():
    path = find_path([], CAMERA)
    assert (path.pieces, path.missing, len(path.observations)) == ((), {}, 0)


@pytest.mark.slow
def test_the_same_bits_twice():
    first = bits()
    assert bits() == first


@several_threads
@pytest.mark.slow
def test_the_same_bits_on_one_thread():
    assert bits_on_one_thread("tests.reconstruction.test_path") == bits()
