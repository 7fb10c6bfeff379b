"""Streams from a shaken camera with a rolling shutter."""

import warnings
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import tisfm
from tests.reconstruction.films import path_error
from tests.rendered import room_film
from tisfm import Settings
from tisfm.reconstruction.streaming.stream import Stream
from tisfm.rigid import pose_matrix
from tisfm.sources import FrameSource

FAST = Settings.preset("fast", motion="camera")
COUNT, DELAY, READOUT = 24, 16, 0.8


@cache
def film(readout=READOUT):
    """Return a small film of a shaken camera that moves to and fro."""
    at = np.arange(COUNT)
    turns = 0.03 * np.sin(0.9 * at), 0.04 * np.cos(0.7 * at) - 0.04, 0.02 * np.sin(1.3 * at)
    way = 0.9 * np.sin(at / 18), 0.05 * np.sin(at), 0.3 * (1 - np.cos(at / 18))
    poses = np.array([pose_matrix(twist) for twist in np.stack([*way, *turns], axis=1)])
    return room_film(poses, 120, 160, textured=True, samples=2, readout=readout)


@cache
def streamed(readout, of=READOUT, count=COUNT):
    camera, frames = replace(film(of).camera, readout=readout), film(of).frames[:count]
    frames = tisfm.reconstruct_stream(frames, camera=camera, settings=FAST, delay=DELAY)
    return list(frames)


def error(found):
    return path_error(np.array([frame.pose for frame in found]), film().poses)


def depth_error(found):
    errors = []
    for frame in found:
        ratio = film().depth[frame.index] * frame.inverse_depth
        if np.isfinite(ratio).any():
            errors.append(np.nanmean(np.abs(np.nanmedian(ratio) / ratio - 1)))
    return np.mean(errors)


@pytest.mark.slow
@pytest.mark.parametrize("readout", [READOUT, None])
def test_poses_and_depth_are_those_of_middle_rows(readout):
    found, ignored = streamed(readout), streamed(0.0)
    assert [frame.index for frame in found] == list(range(COUNT))
    assert all(frame.piece == 0 for frame in found)
    assert error(found) < 0.2 * error(ignored)
    assert depth_error(found) < 0.6 * depth_error(ignored)
    assert all(frame.camera.readout == 0 for frame in found)  # undone in the frames of the stream


@pytest.mark.slow
def test_it_is_found_with_the_first_path_and_stays():
    about = {frame.calibration for frame in streamed(None)}
    assert len(about) == 1
    (found,) = about
    assert abs(found.readout - READOUT) < 3 * found.readout_std < 0.4
    # The given value: nothing is estimated.
    assert {frame.calibration.readout for frame in streamed(READOUT)} == {0}


@pytest.mark.slow
def test_pictures_are_what_the_middle_rows_saw():
    straight = film(readout=0.0).frames
    inside = np.s_[12:-12, 12:-12]
    off = []
    for of in (streamed(READOUT), streamed(0.0)):
        changes = [np.abs(f.picture.astype(float) - straight[f.index])[inside].mean() for f in of]
        off.append(np.mean(changes))
    assert off[0] < 0.75 * off[1]  # part of the rest is noise, part is from JPEG


@pytest.mark.slow
def test_rows_that_are_read_at_once_leave_everything_as_it_is():
    found, given = (streamed(readout, of=0.0, count=DELAY + 2) for readout in (None, 0.0))
    for one, other in zip(found, given, strict=True):
        np.testing.assert_array_equal(one.pose, other.pose)
        np.testing.assert_array_equal(one.inverse_depth, other.inverse_depth)
        assert one.calibration.readout == 0 and one.camera.readout is None


@pytest.mark.slow
def test_what_was_said_of_a_frame_stays_and_nothing_piles_up(monkeypatch):
    held = []

    def watched(stream, real=Stream._drop_old):
        real(stream)
        names = [path.name for path in stream._folder.rglob("*.*")]
        held.append((stream._path.last_fixed, stream._frames.provisional_frames(), names))

    monkeypatch.setattr(Stream, "_drop_old", watched)
    camera = replace(film().camera, readout=READOUT)
    source = FrameSource(film().frames)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = list(Stream(source, camera, "nothing", FAST, DELAY).frames())
    for one, other in zip(found, streamed(READOUT), strict=True):
        np.testing.assert_array_equal(one.pose, other.pose)
    for settled, as_read, names in held:
        assert all(frame > settled for frame in as_read)
        assert {int(name[:6]) for name in names if "_read" in name} == set(as_read)
