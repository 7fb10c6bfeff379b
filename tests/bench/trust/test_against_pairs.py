"""The benchmark that compares a path with pairs of its frames."""

import json
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

import tisfm
from bench.trust import against_pairs
from bench.trust.against_pairs import Recording, compare_with_pairs
from bench.trust.cases import Clip
from tests.reconstruction.films import walk
from tisfm.rigid import pose_matrix

COUNT, GAP = 8, 2  # the last pair is shorter
TURN = np.degrees(0.012)  # of the walk in a frame


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return a folder with the frames of a walk, in ``walk``."""
    found = tmp_path_factory.mktemp("data")
    (found / "walk").mkdir()
    for k, frame in enumerate(walk(count=COUNT).frames):
        cv2.imwrite(str(found / "walk" / f"{k:03d}.png"), frame)
    return found


@pytest.fixture(scope="module")
def recording():
    return Recording(name="walk", source="walk", focal=walk(count=COUNT).camera.focal, gap=GAP)


def test_a_right_path_agrees_with_its_pairs(folder, recording, tmp_path, monkeypatch):
    monkeypatch.setattr(against_pairs, "RECORDINGS", (recording, Recording(name="b", source="b")))
    monkeypatch.setattr(against_pairs, "RESULTS", tmp_path)
    start = against_pairs.runtime.start
    monkeypatch.setattr(against_pairs.runtime, "start", lambda threads=None: start())
    assert against_pairs.main(["--data", str(folder)]) == 0
    (found,) = json.loads((tmp_path / "against_pairs.json").read_text())["found"]
    assert (found["frames"], found["posed"], found["pieces"]) == (COUNT, COUNT, 1)
    assert found["green"] == 1 and 0 < found["with_depth"] < COUNT
    assert found["focal_deviation"] is None  # it was stated
    assert found["forward"] == pytest.approx(np.degrees(np.arctan2(0.12, 0.05)), abs=4)
    pairs = found["agreement"]
    assert pairs["rotation"] == pytest.approx((COUNT - 1) * TURN, abs=0.5)
    assert pairs["usable_pairs"] == pairs["pairs"] == 4
    assert pairs["difference"] < 0.5
    assert pairs["rank"] > 0.9 and pairs["ranked_pairs"] > 0
    text = (tmp_path / "against_pairs.md").read_text(encoding="utf-8")
    assert "| walk | 8 | 8 | 1 |" in text
    assert "b: no b in the folder" in text


def test_a_path_with_another_rotation_and_depth_inside_out_differs_from_its_pairs(
    folder, recording
):
    settings = tisfm.Settings.preset("fast", motion="camera")
    camera = tisfm.Camera(focal=recording.focal)
    result = tisfm.reconstruct(folder / "walk", camera=camera, settings=settings)
    turned = result.poses.copy()
    for k in range(COUNT):  # 1° a frame about the vertical axis
        turned[k] = turned[k] @ pose_matrix((0, 0, 0, 0, np.radians(k), 0))

    class InsideOut:
        """The result with other poses, and depth whose order is reversed."""

        poses, camera, mask, depth_error = turned, result.camera, None, result.depth_error
        picture, inverse_depth_std = result.picture, result.inverse_depth_std
        labels = result.labels

        @staticmethod
        def inverse_depth(frame):
            true = result.inverse_depth(frame)
            return true.max() + true.min() - true

    found = compare_with_pairs(InsideOut, np.arange(COUNT), GAP)
    assert found.difference == pytest.approx(COUNT - 1, abs=0.5)
    assert found.rank < -0.9


def stub(depth, labels=0):
    """Return a result of three frames, of which the first has depth."""
    shape = depth.shape
    return SimpleNamespace(
        poses=np.array([pose_matrix((0, 0, 0, 0, k * np.radians(2), 0)) for k in range(3)]),
        depth_error=np.array([0.02, np.nan, np.nan]),
        shape=shape,
        zoom=None,
        calibration=SimpleNamespace(radial=0.0),
        inverse_depth=lambda frame: 1 / depth,
        inverse_depth_std=lambda frame: np.full(shape, 0.01),
        labels=lambda frame: np.full(shape, labels, np.uint8),
    )


def pair(status, depth, motion=None):
    return SimpleNamespace(
        status=status,
        motions=None if motion is None else [np.array(motion)],
        inverse_depth=1 / depth,
        inverse_depth_std=np.full(depth.shape, 0.01),
    )


DEPTH = np.tile(np.linspace(2, 6, 80), (40, 1))


@pytest.mark.parametrize(
    ("status", "motion", "labels", "usable", "ranked"),
    [
        ("converged", (0, 0, 1, 0, -np.radians(2), 0), 0, 2, 1),
        ("converged", (0, 0, 1, 0, -np.radians(2), 0), 1, 2, 0),
        ("pure_rotation", (0, 0, 0, 0, -np.radians(2), 0), 0, 2, 0),
        ("contradicted", (0, 0, 1, 0, np.radians(9), 0), 0, 0, 0),
        ("too_few_pixels", None, 0, 0, 0),
    ],
)
def test_pairs_are_used_as_far_as_their_status_allows(
    monkeypatch, status, motion, labels, usable, ranked
):
    monkeypatch.setattr(against_pairs, "interpret", lambda *_: pair(status, DEPTH, motion))
    found = compare_with_pairs(stub(DEPTH, labels), np.arange(3), 1)
    assert (found.pairs, found.usable_pairs, found.ranked_pairs) == (2, usable, ranked)
    assert found.rotation == pytest.approx(4)
    assert found.difference == (pytest.approx(0, abs=1e-5) if usable else None)
    assert found.rank == (pytest.approx(1) if ranked else None)


@pytest.mark.parametrize("members", [[], [1]])
def test_a_piece_without_two_frames_is_not_compared(members):
    assert compare_with_pairs(stub(DEPTH), np.array(members, int), 2).rotation is None


def test_the_laser_points_are_scaled_to_the_result(monkeypatch):
    laser = np.full((80, 160), np.nan, np.float32)
    laser[::2, ::2] = np.repeat(np.linspace(4, 12, 80), 40).reshape(80, 40).T  # sparse, in m
    loaded = SimpleNamespace(depth=lambda frame: laser)
    monkeypatch.setattr(against_pairs, "load_clip", lambda *_: loaded)
    clip = Clip(folder="laser")
    assert against_pairs.laser_rank(stub(DEPTH), clip, None) == pytest.approx(1, abs=1e-3)
    assert against_pairs.laser_rank(stub(DEPTH[:, ::-1]), clip, None) == pytest.approx(-1, abs=1e-3)
    assert against_pairs.laser_rank(stub(DEPTH), None, None) is None
    without_lens = stub(DEPTH)
    without_lens.calibration.radial = -0.2
    assert against_pairs.laser_rank(without_lens, clip, None) is None


def test_equal_values_have_no_rank():
    values = np.linspace(0, 1, 2000)
    assert against_pairs.rank_correlation(values, np.ones(2000)) is None
    assert against_pairs.rank_correlation(values[:10], values[:10]) is None
    assert against_pairs.rank_correlation(values, values**3) == pytest.approx(1)


def test_a_camera_that_stands_still_has_no_direction():
    poses = np.tile(np.eye(4), (4, 1, 1))
    assert against_pairs.angle_to_axis(poses) is None
    poses[2:, 2, 3] = 1.0  # one step ahead, beside two without motion
    assert against_pairs.angle_to_axis(poses) == pytest.approx(0)


def test_folders_without_the_sequences_are_refused(tmp_path, capsys, monkeypatch):
    assert against_pairs.main(["--data", str(tmp_path)]) == 2
    assert "has none of these sequences" in capsys.readouterr().err
    monkeypatch.delenv("TISFM_DATA", raising=False)
    assert against_pairs.main([]) == 2
    assert "name a folder" in capsys.readouterr().err
