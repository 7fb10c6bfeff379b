"""Films that are longer and larger than in the short tests, with tighter bounds."""

from dataclasses import replace

import numpy as np
import pytest

import tisfm
from tests.reconstruction.films import path_error
from tests.rendered import bodies_film, room_film
from tisfm.rigid import pose_matrix
from tisfm.scenes import bodies_path

pytestmark = pytest.mark.nightly
COUNT, DELAY, READOUT = 24, 16, 0.8  # frames, frames, and intervals between frames


def shaken():
    """Return the poses of a shaken camera that moves to and fro."""
    at = np.arange(COUNT)
    turns = 0.03 * np.sin(0.9 * at), 0.04 * np.cos(0.7 * at) - 0.04, 0.02 * np.sin(1.3 * at)
    centres = 0.9 * np.sin(at / 18), 0.05 * np.sin(at), 0.3 * (1 - np.cos(at / 18))
    return np.array([pose_matrix(twist) for twist in np.stack([*centres, *turns], axis=1)])


def rolling_film(readout):
    return room_film(shaken(), 120, 160, textured=True, samples=2, readout=readout)


def errors(readout):
    """Return the errors of a stream's path, depth and pictures, and its estimated readouts."""
    film, straight = rolling_film(READOUT), rolling_film(0.0).frames
    stream = tisfm.reconstruct_stream(
        film.frames,
        camera=replace(film.camera, readout=readout),
        settings=tisfm.Settings.preset("fast", motion="camera"),
        delay=DELAY,
    )
    poses, depths, changes, readouts = [], [], [], set()
    for frame in stream:
        assert frame.piece == 0
        poses.append(frame.pose)
        readouts.add(frame.calibration.readout)
        ratio = film.depth[frame.index] * frame.inverse_depth
        if np.isfinite(ratio).any():
            depths.append(np.nanmean(np.abs(np.nanmedian(ratio) / ratio - 1)))
        change = np.abs(frame.picture.astype(float) - straight[frame.index])
        changes.append(change[12:-12, 12:-12].mean())
    return (path_error(np.array(poses), film.poses), np.mean(depths), np.mean(changes)), readouts


@pytest.mark.parametrize("readout", [READOUT, None])
def test_stream_with_a_rolling_shutter(readout):
    corrected, readouts = errors(readout)
    ignored, _ = errors(0.0)
    assert len(readouts) == 1
    assert (np.divide(corrected, ignored) < (0.2, 0.6, 0.75)).all()


def test_known_size_scales_an_object_that_was_found():
    film = bodies_film(bodies_path(16), 240, 320)

    def reconstructed(sizes):
        return tisfm.reconstruct(
            film.frames,
            camera=film.camera,
            settings=tisfm.Settings.preset("fast", motion="objects"),
            object_sizes=sizes,
            depth_of="none",
        )

    with_path = [one for one in reconstructed(None).objects if np.isfinite(one.poses).any()]
    number = with_path[0].id
    once, twice = (
        next(one for one in reconstructed({number: size}).objects if one.id == number)
        for size in (1.0, 2.0)
    )
    assert once.scale_from == twice.scale_from == "size"
    np.testing.assert_allclose(twice.extent, 2 * once.extent)
