"""Evaluation of real sequences, and what warms it up."""

import numpy as np
import pytest

import tisfm
from tisfm.datasets import find_pairs
from tisfm.evaluation import pairs
from tisfm.evaluation.pairs import evaluate
from tisfm.focal_guess import GuessedFocalWarning
from tisfm.metrics import pose_errors
from tisfm.motion.egomotion import camera_motion


def test_the_default_preset_on_a_real_pair(shared_data):
    (found,) = evaluate(find_pairs(shared_data / "middlebury" / "RubberWhale")).pairs
    assert found.errors.endpoint < 0.25
    assert found.errors.pixels == pytest.approx(0.984 * 388 * 584, rel=1e-3)


def test_poses_of_a_real_sequence(shared_data):
    """From the flow alone: no order, sign or inverse of the poses is mistaken."""
    for pair in find_pairs(shared_data / "new_tsukuba")[3:40:12]:
        loaded = pair.load()
        result = tisfm.interpret(
            loaded.frame0,
            loaded.frame1,
            camera=loaded.camera,
            settings=tisfm.Settings.preset("fast"),
        )
        motion = camera_motion(result.flow, result.confidence, loaded.camera)
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = motion.rotation, motion.translation
        errors = pose_errors(pose, loaded.pose)
        assert errors.direction < 3 and errors.rotation < 0.05


@pytest.mark.parametrize("channels", [(), (3,)])
def test_warming_up_compiles_all_kernels(monkeypatch, recwarn, channels):
    """A pair without parallax would leave those of depth to be compiled while time is taken."""
    statuses = []
    original = pairs.interpret

    def interpret(*frames, **options):
        result = original(*frames, **options)
        statuses.append(result.status)
        return result

    monkeypatch.setattr(pairs, "interpret", interpret)
    pairs._warm_up(tisfm.Settings(motion="camera"), channels, np.dtype(np.uint8))
    assert statuses == ["converged"]
    assert not [w for w in recwarn if w.category is GuessedFocalWarning]
