"""Pairs from a camera with a rolling shutter."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import tisfm
from tests.draws import nightly_except
from tests.motion.one_motion import FAST
from tests.rendered import room_film
from tisfm.metrics import pose_errors
from tisfm.motion import rolling_shutter
from tisfm.motion.camera import camera_estimate
from tisfm.motion.rolling_shutter import _depth_of_frame1
from tisfm.rigid import pose_matrix, rigid_motion
from tisfm.shutter import GlobalShutterMap, interpolation_nodes
from tisfm.status import Status

READOUT = 0.8
MOTIONS = {
    "turning": (0.1, 0.02, 0.02, 0.03, -0.03, 0.02),
    "forward": (0.02, 0.02, 0.15, 0.01, 0.0, 0.02),
    "nodding": (0.1, 0.0, 0.0, 0.05, 0.0, 0.0),
}


@cache
def film(motion="turning", readout=READOUT, count=2, step=1, size=(120, 160)):
    poses = [pose_matrix(k / step * np.array(MOTIONS[motion])) for k in range(count)]
    return room_film(poses, *size, textured=True, samples=2, readout=readout)


def interpreted(of, readout, settings=FAST, **options):
    camera = replace(of.camera, readout=readout)
    return tisfm.interpret(*of.frames[:2], camera=camera, settings=settings, **options)


def off(result, of):
    """Return the mean relative error of depth, and the angle of the rotation, degrees."""
    seen = result.confidence > 0
    ratio = of.depth[0] * result.inverse_depth
    error = np.abs(np.median(ratio[seen]) / ratio - 1)[seen].clip(max=1).mean()
    true = np.linalg.inv(of.poses[1]) @ of.poses[0]
    return error, pose_errors(pose_matrix(result.motions[0]), true).rotation


@pytest.mark.parametrize("motion", nightly_except("turning", of=MOTIONS))
def test_depth_and_motion_are_those_of_middle_rows(motion):
    depth, turn = zip(
        off(interpreted(film(motion, readout=0.0), 0.0), film(motion, readout=0.0)),
        off(interpreted(film(motion), READOUT), film(motion)),
        off(interpreted(film(motion), 0.0), film(motion)),
        strict=True,
    )
    assert depth[1] < 1.05 * depth[0] and depth[2] > 1.12 * depth[0]  # rows: undone, and ignored
    assert turn[1] < 0.7 * turn[2]


def test_the_result_belongs_to_its_frame():
    result = interpreted(film(), READOUT)
    assert result.camera == replace(film().camera, readout=0.0)
    true, read = (film(readout=readout).frames[0].astype(float) for readout in (0.0, READOUT))
    inside = np.s_[10:-10, 10:-10]
    left = np.abs(result.frame - true)[inside].mean()
    assert left < 0.5 * np.abs(read - true)[inside].mean()


def test_rows_are_corrected_if_their_skew_contradicts_the_camera(monkeypatch):
    usual = interpreted(film(), READOUT)

    def contradicted(*arguments):
        return replace(camera_estimate(*arguments), status=Status("contradicted", "a zoom"))

    monkeypatch.setattr(rolling_shutter, "camera_estimate", contradicted)
    result = interpreted(film(), READOUT)
    np.testing.assert_array_equal(result.frame, usual.frame)
    assert result.camera.readout == 0 and result.status == usual.status


def test_no_readout_changes_nothing():
    plain, zero = interpreted(film(), None), interpreted(film(), 0.0)
    for name in ("rho", "inverse_depth", "inverse_depth_std", "confidence", "motions", "frame"):
        np.testing.assert_array_equal(getattr(zero, name), getattr(plain, name))
    assert plain.camera.readout is None and zero.camera.readout == 0
    np.testing.assert_array_equal(zero.frame, film().frames[0])


@pytest.mark.parametrize("motion", nightly_except("field", of=["field", "objects"]))
def test_other_motions_ignore_the_readout_time(motion):
    settings = tisfm.Settings.preset("fast", motion=motion)
    plain, stated = (interpreted(film(), readout, settings) for readout in (None, READOUT))
    np.testing.assert_array_equal(stated.flow, plain.flow)
    assert stated.camera.readout == READOUT


def test_a_pose_is_that_of_middle_rows():
    of = film("nodding")
    pose = np.linalg.inv(of.poses[1]) @ of.poses[0]
    errors = []
    for known in (pose, pose[:3, :3]):
        undone, ignored = (interpreted(of, r, pose=known) for r in (READOUT, None))
        errors.append((off(undone, of)[0], off(ignored, of)[0]))
        assert undone.camera.readout == 0
        if known is pose:  # depth is in the unit of the pose
            ratio = undone.depth / of.depth[0]
            assert np.nanmedian(ratio) == pytest.approx(1, abs=0.01)
    assert all(one < 0.8 * other for one, other in errors)


def test_identical_frames_stay_as_they_are():
    frame = film().frames[0]
    camera = replace(film().camera, readout=READOUT)
    result = tisfm.interpret(frame, frame, camera=camera, settings=FAST)
    assert result.status == "no_motion"
    assert not result.flow.any() and result.camera.readout == READOUT
    np.testing.assert_array_equal(result.frame, frame)


def test_pixels_that_frames_do_not_show_are_occluded():
    settings = tisfm.Settings.preset("fast", motion="camera")
    result = interpreted(film("nodding"), READOUT, settings, mask=_left_out())
    assert (result.confidence[result.occlusion] == 0).all()
    assert np.isinf(result.inverse_depth_std[result.occlusion]).all()
    # Masked pixels are occluded at their new positions.
    assert result.occlusion[50:60, 50:60].all()


def _left_out():
    mask = np.ones((120, 160), bool)
    mask[45:65, 45:65] = False
    return mask


def test_distortion_is_removed_too():
    lens = replace(film().camera, distortion=(-0.05, 0.0, 0.0, 0.0), readout=READOUT)
    result = tisfm.interpret(*film().frames, camera=lens, settings=FAST)
    assert result.camera.is_pinhole and result.camera.readout == 0
    bare = tisfm.interpret(*film().frames, camera=replace(lens, readout=0.0), settings=FAST)
    assert np.abs(result.flow - bare.flow).max() > 0.5


def test_skipped_frames_reduce_the_share_of_the_readout():
    of = film(count=4, step=3, size=(60, 80))
    apart = film(readout=READOUT / 3, size=(60, 80))
    np.testing.assert_allclose(of.poses[3], apart.poses[1])
    camera = replace(of.camera, readout=READOUT)
    options = {"settings": FAST, "step": 3}
    (pair,) = tisfm.interpret_sequence(of.frames, camera=camera, **options)
    frames = of.frames[0], of.frames[3]
    expected = tisfm.interpret(*frames, camera=replace(camera, readout=READOUT / 3), settings=FAST)
    np.testing.assert_array_equal(pair.flow, expected.flow)


def test_depth_of_the_next_frame_is_that_of_its_points():
    camera, shape = tisfm.Camera(focal=120.0), (121, 160)
    nodes = interpolation_nodes(shape)
    plane = np.full(shape, 0.25, np.float32)
    ahead = _depth_of_frame1(plane, np.array((0.0, 0.0, -0.8, 0.0, 0.0, 0.0)), camera)
    np.testing.assert_allclose(ahead, 1 / (4 - 0.8), rtol=1e-6)
    # Inverse depth of the plane n·P = 1 is n·(x̂, ŷ, 1). After a motion it is another plane.
    normal, twist = np.array((0.05, -0.03, 0.25)), np.array((0.2, 0.1, 0.3, 0.02, -0.03, 0.04))
    rows, columns = np.indices(shape)
    pixels = np.stack([columns, rows], axis=-1)

    def rays(places):
        flat = (places - camera.center_for(*shape)) / camera.focal
        return np.concatenate([flat, np.ones((*flat.shape[:-1], 1))], axis=-1)

    rotation, translation = rigid_motion(twist)
    turned = rotation @ normal
    expected = rays(nodes) @ turned / (1 + turned @ translation)
    found = _depth_of_frame1((rays(pixels) @ normal).astype(np.float32), twist, camera)
    inside = np.s_[5:-5, 5:-5]  # pixels that frame 0 shows
    np.testing.assert_allclose(found[inside], expected[inside], rtol=2e-3)


def test_one_depth_at_all_nodes_is_one_depth():
    camera, shape = tisfm.Camera(focal=120.0), (121, 160)
    twist = np.array((0.2, 0.1, 0.3, 0.02, -0.03, 0.04))
    nodes = np.full(interpolation_nodes(shape).shape[:2], 0.25)
    image = np.random.default_rng(0).uniform(0, 255, shape).astype(np.float32)
    one, other = (
        GlobalShutterMap(camera, 0.7, twist, depth, shape).apply(image) for depth in (0.25, nodes)
    )
    np.testing.assert_array_equal(one, other)
