"""Depth interpolated across surfaces without texture."""

from dataclasses import replace

import numpy as np
import pytest

import tisfm
from tests.draws import nightly_except
from tests.motion.one_motion import CAMERA, errors, interpreted, shared
from tests.rendered import room, static_scene, three_blocks
from tisfm.motion.settings import DEPTH
from tisfm.rigid import pose_matrix


@pytest.fixture(scope="module")
def bare_room():
    return room(360, 480, seed=5)


@pytest.fixture(scope="module")
def with_pose(bare_room):
    """Return the interpretation of the bare room under its true pose."""
    return shared(bare_room, pose=pose_matrix(bare_room.motions[0]))


def relative_errors(result, scene):
    """Return |s·Z − true|/true of every pixel; s is the median of the ratio true/Z."""
    depth = 1 / np.maximum(result.inverse_depth, 1e-9)
    scaled = depth * np.median(scene.depth / depth)
    return np.abs(scaled - scene.depth) / scene.depth


@pytest.mark.parametrize("preset", nightly_except("balanced", of=["fast", "balanced", "accurate"]))
def test_a_bare_room_with_its_pose(bare_room, preset):
    settings = tisfm.Settings.preset(preset, motion="camera")
    pose = pose_matrix(bare_room.motions[0])
    result = shared(bare_room, settings, pose=pose)
    assert result.status == "converged"
    depth = np.where(result.inverse_depth > 0, result.depth, np.nan)
    off = np.abs(depth / bare_room.depth - 1)  # in the unit of the pose
    assert np.nanmean(off) < (0.06 if preset == "fast" else 0.04)
    assert np.isfinite(off).all()


def test_a_bare_room_without_a_pose(bare_room):
    result = interpreted(bare_room)
    assert result.status == "converged"
    assert relative_errors(result, bare_room).mean() < 0.07
    assert errors(result, bare_room).rotation < 0.5
    assert errors(result, bare_room).direction < 6
    flow = np.linalg.norm(result.flow - bare_room.flow, axis=-1)[bare_room.visible]
    assert np.median(flow) < 1


@pytest.mark.nightly
def test_a_bare_room_in_twelve_bits_of_sixteen(bare_room, with_pose):
    """The threshold of noise is in proportion to the range of the grey levels."""
    twelve = [frame.astype(np.uint16) * 16 for frame in (bare_room.frame0, bare_room.frame1)]
    pose = pose_matrix(bare_room.motions[0])
    narrow = tisfm.interpret(*twelve, camera=bare_room.camera, settings=CAMERA, pose=pose)
    off = [relative_errors(result, bare_room).mean() for result in (narrow, with_pose)]
    assert off[0] < 1.3 * off[1]


def test_motion_of_a_mostly_textured_scene_is_refined_with_depth(monkeypatch):
    """Up to 15 % without texture, jointly with depth; above, from a finer flow field."""
    import tisfm.motion.camera

    still = np.zeros((3, 6))
    scene = three_blocks(120, 160, camera_motion=(0.5, 0, 0, 0, 0.02, 0), block_motions=still)

    def motions(bare):
        monkeypatch.setattr(tisfm.motion.camera, "textureless_share", lambda *_: bare)
        return interpreted(scene).motions

    joint = motions(0.0)  # depth is not interpolated
    np.testing.assert_array_equal(motions(0.1), joint)
    assert np.abs(motions(0.2) - joint).max() > 1e-6


def test_first_order_smoothness_does_not_interpolate(bare_room, monkeypatch):
    import tisfm.motion.camera

    # No share is above 2: depth is never interpolated.
    monkeypatch.setattr(tisfm.motion.camera, "DEPTH", replace(DEPTH, min_textureless_share=2.0))
    pose = pose_matrix(bare_room.motions[0])
    result = interpreted(bare_room, pose=pose)
    assert relative_errors(result, bare_room).mean() > 0.045


def test_deviation_and_confidence_of_interpolated_depth(bare_room, with_pose):
    result = with_pose
    off = np.abs(result.inverse_depth - 1 / bare_room.depth)
    within = (off <= result.inverse_depth_std).mean()
    assert 0.5 < within < 0.97
    relative = result.inverse_depth_std / result.inverse_depth
    surest = relative <= np.quantile(relative, 0.4)
    wrong = np.abs(result.depth / bare_room.depth - 1)
    assert wrong[surest].mean() < 0.6 * wrong.mean()
    assert (result.confidence >= 0).all() and (result.confidence <= 1).all()
    confident = result.confidence > 0.5
    assert 0.1 < confident.mean() < 0.9
    assert wrong[confident].mean() < wrong.mean()


def test_depth_does_not_exceed_matched_depth_much(bare_room, with_pose):
    assert (with_pose.inverse_depth > 0).all()
    assert with_pose.depth.max() < 4 * bare_room.depth.max()


def test_depth_of_textured_scenes_is_not_interpolated(monkeypatch):
    import tisfm.motion.camera

    def never(*_):
        raise AssertionError("depth is interpolated")

    monkeypatch.setattr(tisfm.motion.camera, "textureless_depth", never)
    scene = static_scene("sideways", 120, 160)
    assert interpreted(scene).status == "converged"


@pytest.mark.nightly
def test_too_few_matches_are_not_interpolated(bare_room, monkeypatch):
    import tisfm.motion.textureless_depth

    monkeypatch.setattr(
        tisfm.motion.textureless_depth, "DEPTH", replace(DEPTH, min_matched_share=1.1)
    )
    result = interpreted(bare_room, pose=pose_matrix(bare_room.motions[0]))
    assert result.inverse_depth.any()


def test_the_limit_of_iterations_is_reported(bare_room):
    settings = tisfm.Settings.preset("fast", motion="camera", tolerance=0)
    result = interpreted(bare_room, settings, pose=pose_matrix(bare_room.motions[0]))
    assert result.status == "iteration_limit"
    assert "accept a higher tolerance" in result.status.message
    assert "outer_iterations" not in result.status.message


def test_large_single_levels_are_left_to_the_sweep(bare_room, monkeypatch):
    import tisfm.motion.textureless_depth

    monkeypatch.setattr(
        tisfm.motion.textureless_depth, "DEPTH", replace(DEPTH, max_plane_pixels=10)
    )
    result = interpreted(bare_room, pose=pose_matrix(bare_room.motions[0]))
    assert result.inverse_depth.any()


def test_bare_share():
    from tisfm.motion.textureless_depth import textureless_share

    rng = np.random.default_rng(0)
    frame = rng.uniform(0, 255, (120, 160)).astype(np.float32)
    assert textureless_share(frame) == 0
    frame[:, 80:] = 50
    assert textureless_share(frame) == pytest.approx(0.5, abs=0.06)
    noisy = 90 + rng.normal(0, 3, (120, 160)).astype(np.float32)
    assert textureless_share(noisy) > 0.95
    assert textureless_share(np.full((1, 1), 7, np.float32)) == 1
    assert 0 <= textureless_share(1e30 * frame) <= 1  # and raises no warning
