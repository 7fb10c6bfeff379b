"""Alignment of neighbouring chunks by the frames that both contain."""

from types import SimpleNamespace

import numpy as np
import pytest

import tisfm
from tests.reconstruction.films import along
from tisfm.reconstruction.chunks import overlaps
from tisfm.reconstruction.chunks.overlaps import (
    overlap_sim3,
    scale_from_depth,
    scale_from_positions,
)
from tisfm.reconstruction.chunks.placement import ChunkResult, place_chunks
from tisfm.reconstruction.geometry.sim3 import mean_rotation, sim3_scale, transform_pose
from tisfm.reconstruction.result.folder import write_depth
from tisfm.rigid import pose_matrix

COUNT, SHAPE = 8, (60, 80)
SIMILARITY = pose_matrix((0.3, -0.2, 0.5, 0.1, -0.4, 0.2))
SIMILARITY[:3, :3] *= 1.7


class Chunk(SimpleNamespace):
    """Poses and depth with the interface of a reconstruction."""

    def inverse_depth(self, frame):
        return np.asarray(self.inverse[frame], np.float32)

    def inverse_depth_std(self, frame):
        return np.asarray(self.deviation[frame], np.float32)


def chunk(folder, poses, depth, *, with_depth=range(COUNT), off=0.01):
    (folder / "depth").mkdir(parents=True)
    inverse = 1 / depth
    for frame in with_depth:
        write_depth(folder, frame, np.float32(inverse[frame]), np.float32(off * inverse[frame]))
    return Chunk(
        folder=folder,
        poses=poses,
        inverse=inverse,
        deviation=off * inverse,
        shape=SHAPE,
        camera=tisfm.Camera(focal=80.0),
        has_position=np.ones(COUNT, bool),
    )


@pytest.fixture
def both(tmp_path):
    """Return two chunks of a plane in front of a camera; each has its own coordinates."""
    poses = along(COUNT)
    depth = np.stack([_plane(pose) for pose in poses])
    there = np.array([transform_pose(np.linalg.inv(SIMILARITY), pose) for pose in poses])
    first = chunk(tmp_path / "0", poses, depth)
    second = chunk(tmp_path / "1", there, depth / sim3_scale(SIMILARITY))
    return first, second


def _plane(pose, away=4.0):
    """Return the depth of a plane Z = 4 in a camera."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    rays = np.stack([(x - 39.5) / 80, (y - 29.5) / 80, np.ones(SHAPE)], axis=-1)
    return (away - pose[2, 3]) / (rays @ pose[:3, :3].T)[..., 2]


SHARED = [(k, k) for k in range(COUNT)]


def test_similarity_is_found(both):
    found = overlap_sim3(*both, SHARED)
    np.testing.assert_allclose(found, SIMILARITY, atol=1e-5)


def test_surer_scale_counts_more(both, monkeypatch):
    """The scale from depth and the scale from camera positions count by their precision."""
    monkeypatch.setattr(overlaps, "scale_from_depth", lambda *_: (0.01, 0.01))
    monkeypatch.setattr(overlaps, "scale_from_positions", lambda *_: (0.06, 0.02))
    found = np.log(sim3_scale(overlap_sim3(*both, SHARED)))
    assert found == pytest.approx((0.01 / 0.01**2 + 0.06 / 0.02**2) / (0.01**-2 + 0.02**-2))


def test_depth_of_other_frames_is_enough(both, tmp_path):
    """For example, only keyframes have depth, and both chunks have different keyframes."""
    first, second = both
    one = chunk(tmp_path / "a", first.poses, 1 / first.inverse, with_depth=(1, 5))
    two = chunk(tmp_path / "b", second.poses, 1 / second.inverse, with_depth=(2, 7))
    scale, _ = scale_from_depth(one, two, SHARED)
    assert scale == pytest.approx(np.log(sim3_scale(SIMILARITY)), abs=2e-3)


def test_chunks_of_a_camera_at_rest_are_aligned_by_depth(both):
    first, second = both
    shared = [(3, 3)]
    found = overlap_sim3(first, second, shared)
    np.testing.assert_allclose(found, SIMILARITY, atol=1e-5)


def test_positions_are_enough(both, tmp_path):
    first, second = both
    one = chunk(tmp_path / "a", first.poses, 1 / first.inverse, with_depth=())
    two = chunk(tmp_path / "b", second.poses, 1 / second.inverse, with_depth=())
    assert scale_from_depth(one, two, SHARED) is None
    np.testing.assert_allclose(overlap_sim3(one, two, SHARED), SIMILARITY, atol=1e-9)
    assert overlap_sim3(one, two, SHARED[:3]) is None  # too few frames


def test_third_of_wrong_depth_changes_little(both):
    first, second = both
    second.inverse[:, : SHAPE[0] // 3] *= 2
    found = overlap_sim3(first, second, SHARED)
    np.testing.assert_allclose(found, SIMILARITY, rtol=0.01, atol=0.02)


def test_contradictory_depth_gives_no_scale(both):
    first, second = both
    random = np.random.default_rng(0)
    second.inverse *= np.exp(random.normal(0, 1, second.inverse.shape))
    assert scale_from_depth(first, second, SHARED) is None


def test_uncertain_depth_is_ignored(both):
    first, second = both
    second.deviation = 0.5 * second.inverse
    assert scale_from_depth(first, second, SHARED) is None


def test_joined_result_has_the_unit_of_its_first_keyframe(tmp_path):
    """The first chunk has no keyframe; a unit of the second is 1.7 units of the first."""
    poses = along(12)
    there = np.array([transform_pose(np.linalg.inv(SIMILARITY), pose) for pose in poses[4:]])
    parts = []
    for begin, path, keyframes in ((0, poses[:8], ()), (4, there, (3, 6))):
        result = chunk(tmp_path / str(begin), path, np.empty(0), with_depth=())
        result.piece, result.unit, result.keyframes = np.zeros(8, int), (1.0,), keyframes
        parts.append(ChunkResult(result=result, frames={begin + k: k for k in range(8)}))
    found = place_chunks(parts, has_given_poses=False)
    assert [placement.part for placement in found] == [0] * 6 + [1] * 6
    assert [placement.number for placement in found] == [*range(6), *range(2, 8)]
    expected = np.linalg.inv(poses[0]) @ poses
    expected[:, :3, 3] /= 1.7
    np.testing.assert_allclose([placement.pose for placement in found], expected, atol=1e-9)
    np.testing.assert_allclose([placement.scale for placement in found], [1 / 1.7] * 6 + [1] * 6)


def test_positions_of_different_paths_give_no_scale():
    random = np.random.default_rng(0)
    poses, others = along(COUNT), along(COUNT)
    others[:, :3, 3] = random.normal(0, 1, (COUNT, 3))
    assert scale_from_positions(poses, others, np.eye(3)) is None
    others[:, :3, 3] = 0
    assert scale_from_positions(poses, others, np.eye(3)) is None


def test_rotation_is_the_mean_of_all_frames():
    turn = pose_matrix((0, 0, 0, 0.2, -0.1, 0.4))[:3, :3]
    poses = along(COUNT)
    others = poses.copy()
    others[:, :3, :3] = turn.T @ poses[:, :3, :3]
    np.testing.assert_allclose(mean_rotation(poses, others), turn, atol=1e-12)
