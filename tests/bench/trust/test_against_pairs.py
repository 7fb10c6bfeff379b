"""The benchmark that compares a path with pairs of its frames."""

import cv2
import numpy as np
import pytest

import tisfm
from bench.trust import against_pairs
from bench.trust.against_pairs import Recording
from tests.reconstruction.films import walk
from tisfm.rigid import pose_matrix

COUNT, GAP = 7, 2


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return a folder with the frames of a walk, in ``walk``."""
    found = tmp_path_factory.mktemp("data")
    (found / "walk").mkdir()
    for k, frame in enumerate(walk(count=COUNT).frames):
        cv2.imwrite(str(found / "walk" / f"{k:03d}.png"), frame)
    return found


@pytest.fixture(scope="module")
def focal():
    return walk(count=COUNT).camera.focal


def test_a_right_path_agrees_with_its_pairs(folder, focal):
    recording = Recording(name="walk", source="walk", focal=focal, gap=GAP)
    found = against_pairs.compare(recording, folder)
    assert (found.frames, found.posed, found.pieces, found.green) == (COUNT, COUNT, 1, 1.0)
    assert 0 < found.with_depth < COUNT
    assert found.turn == pytest.approx(np.degrees((COUNT - 1) * 0.012), abs=0.2)
    assert found.turn_error < 0.2 and found.pairs == 1
    assert found.rank > 0.9
    assert found.forward == pytest.approx(np.degrees(np.arctan2(0.12, 0.05)), abs=4)
    assert found.laser_rank is None and found.message == ""


def test_a_path_with_another_turn_and_depth_inside_out_differs_from_its_pairs(folder, focal):
    settings = tisfm.Settings.preset("fast", motion="camera")
    camera = tisfm.Camera(focal=focal)
    result = tisfm.reconstruct(folder / "walk", camera=camera, settings=settings)
    turned = result.poses.copy()
    for k in range(COUNT):  # 1° a frame about the vertical axis
        turned[k] = turned[k] @ pose_matrix((0, 0, 0, 0, np.radians(k), 0))

    class InsideOut:
        """The result with other poses, and depth whose order is reversed."""

        poses, objects, camera, depth_error = turned, (), result.camera, result.depth_error
        picture, inverse_depth_std = result.picture, result.inverse_depth_std

        @staticmethod
        def inverse_depth(frame):
            true = result.inverse_depth(frame)
            return true.max() + true.min() - true

    _, error, share, ranks = against_pairs.compare_with_pairs(InsideOut, np.arange(0, COUNT, GAP))
    assert error == pytest.approx(COUNT - 1, abs=0.2) and share == 1
    assert np.median(ranks) < -0.9


def test_words_choose_recordings():
    names = [recording.name for recording in against_pairs.choose(["motorway"])]
    assert names == ["motorway, 0–80", "motorway, 120–160", "motorway, whole"]
    assert len(list(against_pairs.choose(None))) == len(against_pairs.RECORDINGS)


def test_a_folder_without_the_sequences_is_refused(tmp_path, capsys):
    assert against_pairs.main(["--data", str(tmp_path)]) == 2
    assert "no such sequences" in capsys.readouterr().err
