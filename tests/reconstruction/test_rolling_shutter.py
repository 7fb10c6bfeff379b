"""Sequences from a shaken camera with a rolling shutter."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import tisfm
from tests.one_thread import bits_on_one_thread, several_threads
from tests.reconstruction.films import path_error
from tests.rendered import room_film
from tisfm.camera_file import read_camera
from tisfm.reconstruction.path.path_solver import find_path
from tisfm.reconstruction.rolling_shutter.correction import _is_seen
from tisfm.reconstruction.rolling_shutter.readout import ReadoutEstimate
from tisfm.rigid import pose_matrix
from tisfm.settings import Settings
from tisfm.sources import FrameSource

COUNT, READOUT = 16, 0.8


def shaken(count=COUNT):
    """Return the poses of a shaken camera."""
    at = np.arange(count)
    turns = 0.03 * np.sin(0.9 * at), 0.04 * np.cos(0.7 * at) - 0.04, 0.02 * np.sin(1.3 * at)
    twists = np.stack([0.04 * at, 0.01 * np.sin(at), 0.02 * at, *turns], axis=1)
    return np.array([pose_matrix(twist) for twist in twists])


@cache
def film(readout=READOUT):
    return room_film(shaken(), 120, 160, textured=True, samples=2, readout=readout)


def reconstructed(readout, of=READOUT, **options):
    options = {"depth_of": "none"} | options
    return tisfm.reconstruct(
        film(of).frames,
        camera=replace(film(of).camera, readout=readout),
        settings=Settings.preset("fast", motion="camera"),
        **options,
    )


@cache
def with_depth(readout):
    """Return the reconstruction of the film with a readout time of the camera; None if unknown."""
    return reconstructed(readout, depth_of="keyframes")


def bits():
    path = find_path(((frame, None, None) for frame in film().frames), film().camera)
    assert path.rolling is not None
    return b"".join(pose.tobytes() for pose in path.pieces[0].poses.values()).hex()


@pytest.mark.slow
def test_the_readout_is_found_and_undone():
    ignored, found = with_depth(0.0), with_depth(None)
    assert (found.piece == 0).all()
    assert path_error(found.poses, shaken()) < 0.2 * path_error(ignored.poses, shaken())
    about = found.calibration
    assert abs(about.readout - READOUT) < 0.08 and 0 < about.readout_std < 0.06
    assert about.origin == "given"  # origin of the focal length
    assert found.camera.readout == 0.0  # frames of the result have no readout time
    again = tisfm.Reconstruction.load(found.folder)
    assert again.calibration == about and again.camera == found.camera
    assert read_camera(found.folder).readout == about.readout


@pytest.mark.slow
def test_depth_is_that_of_middle_rows():
    off = []
    for readout in (0.0, READOUT):
        result = with_depth(readout)
        errors = []
        for key in result.keyframes:
            ratio = film().depth[key] * result.inverse_depth(key)
            errors.append(np.nanmean(np.abs(np.nanmedian(ratio) / ratio - 1)))
        off.append(np.mean(errors))
    assert off[1] < 0.6 * off[0]


@pytest.mark.slow
def test_a_readout_that_is_given_is_undone():
    result = with_depth(READOUT)
    assert path_error(result.poses, shaken()) < 0.01
    assert result.calibration.readout == 0  # nothing was estimated
    assert result.camera.readout == 0


@pytest.mark.slow
def test_rows_that_are_read_at_once_leave_everything_as_it_is():
    found, given = (reconstructed(readout, of=0.0) for readout in (None, 0.0))
    assert found.calibration.readout == 0
    np.testing.assert_array_equal(found.poses, given.poses)
    assert found.camera.readout is None  # unknown


@pytest.mark.slow
def test_known_poses_are_those_of_middle_rows():
    poses = shaken()
    errors = []
    for readout in (None, READOUT):
        result = reconstructed(readout, poses=poses, depth_of="keyframes")
        key = result.keyframes[0]
        errors.append(np.nanmean(np.abs(result.depth(key) / film().depth[key] - 1)))
    assert errors[1] < 0.7 * errors[0]


@pytest.mark.slow
def test_what_is_said_of_cropped_frames_is_of_whole_ones(tmp_path):
    result = reconstructed(None, crop=(0, 6, 160, 108), folder=tmp_path / "cropped")
    assert abs(result.calibration.readout - READOUT) < 0.1
    assert read_camera(tmp_path / "cropped").readout == result.calibration.readout
    whole = with_depth(None).calibration
    assert 0.5 < result.calibration.readout_std / whole.readout_std < 2


def test_cropped_rows_take_their_share_of_the_time():
    source = FrameSource(np.zeros((2, 120, 160), np.uint8), crop=(0, 30, 160, 60), size=80)
    camera = tisfm.Camera(focal=96.0, readout=0.8)
    assert source.camera_after(camera, (120, 160)).readout == pytest.approx(0.4)
    assert source.camera_after(tisfm.Camera(focal=96.0), (120, 160)).readout is None


@pytest.mark.slow
@several_threads
def test_one_thread_gives_the_same_bits():
    assert bits_on_one_thread("tests.reconstruction.test_rolling_shutter") == bits()


@pytest.mark.parametrize(
    ("readout", "deviation", "seen"),
    [(0.8, 0.1, True), (-0.8, 0.1, True), (0.3, 0.1, False), (1.3, 0.1, True), (1.5, 0.1, False),
     (-2.1, 0.49, False)],  # with this deviation, no possible readout time differs from 0
)  # fmt: skip
def test_a_readout_is_taken_where_it_differs_from_none_and_a_camera_may_have_it(
    readout, deviation, seen
):
    assert _is_seen(ReadoutEstimate(readout=readout, deviation=deviation)) is seen
