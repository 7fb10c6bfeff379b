"""Camera paths through a rendered room, against exact poses."""

import hashlib

import numpy as np
import pytest

from tests.one_thread import bits_on_one_thread, several_threads
from tests.reconstruction.films import mirrored, path_error, there_and_back, walk
from tisfm.reconstruction.path.path_solver import find_path


def path_of(images):
    return find_path(((image, None, None) for image in images), walk().camera)


def bits():
    film = walk(6, 120, 160)
    path = find_path(((image, None, None) for image in film.frames), film.camera)
    poses = [pose.tobytes() for piece in path.pieces for pose in piece.poses.values()]
    return hashlib.sha256(b"".join(poses)).hexdigest()


def test_round_trip_closes_around_blank_frames():
    film = walk()
    images = there_and_back(film)
    images[4] = images[5] = np.zeros_like(images[0])
    path = path_of(images)
    (piece,) = path.pieces
    assert path.missing == {4: "no_texture", 5: "no_texture"} and "dark" in path.missing[4].message
    seen = sorted(piece.poses)
    assert seen == [k for k in range(18) if k not in (4, 5)]
    found = np.array([piece.poses[k] for k in seen])
    true = np.concatenate([film.poses, film.poses[::-1]])[seen]
    length = np.linalg.norm(np.diff(found[:, :3, 3], axis=0), axis=1).sum()
    assert np.linalg.norm(found[0, :3, 3] - found[-1, :3, 3]) < 0.003 * length
    assert path_error(found, true) < 0.005


@pytest.mark.nightly
def test_two_scenes_are_two_pieces():
    path = path_of([*walk().frames, *mirrored(walk(seed=5))])
    assert [list(piece.poses) for piece in path.pieces] == [list(range(9)), list(range(9, 18))]


def test_camera_at_rest_has_no_path():
    path = path_of([walk().frames[0]] * 3)
    assert path.pieces == ()
    assert path.missing == dict.fromkeys(range(3), "no_motion")


def test_two_different_frames_are_too_few():
    first, second = walk().frames[[0, 5]]
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


def test_no_frame_has_no_path():
    path = find_path([], walk().camera)
    assert (path.pieces, path.missing, len(path.observations)) == ((), {}, 0)


@pytest.mark.nightly  # the next test compares the bits with another process
def test_same_bits_twice():
    assert bits() == bits()


@several_threads
def test_same_bits_on_one_thread():
    assert bits_on_one_thread(__name__) == bits()
