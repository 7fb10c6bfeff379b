"""Errors of the path of a camera."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.trajectory.paths import PATIENT, random_path, similar
from tisfm.metrics import absolute_errors, drift, path_length, relative_errors
from tisfm.rigid import pose_matrix, rigid_motion

TURN = rigid_motion([0, 0, 0, 0.4, -1.0, 2.0])[0]


def straight(count, *, length=1.0):
    """A path along Z."""
    path = np.tile(np.eye(4), (count, 1, 1))
    path[:, 2, 3] = length * np.arange(count)
    return path


def shaken(path, rng, size=0.05):
    """A path whose poses are each off by a little."""
    return np.array([pose @ pose_matrix(rng.normal(0, size, 6)) for pose in path])


@PATIENT
@given(seed=st.integers(0, 999), scale=st.floats(0.01, 100), gaps=st.sets(st.integers(0, 11)))
def test_a_path_in_another_world_has_no_error(seed, scale, gaps):
    rng = np.random.default_rng(seed)
    truth = random_path(rng, 20)
    found = similar(truth, 1 / scale, TURN, [5, -2, 1])
    found[list(gaps)] = np.nan
    errors = absolute_errors(found, truth)
    assert errors.poses == 20 - len(gaps)
    assert errors.scale == pytest.approx(scale)
    assert errors.similarity < 1e-12 * 100
    for step in (1, 7):
        relative = relative_errors(found, truth, step=step, scale=errors.scale)
        known = np.isfinite(found[:, 0, 0])
        assert relative.pairs == (known[:-step] & known[step:]).sum()
        assert relative.translation < 1e-11 and relative.rotation < 1e-11


def test_the_scale_is_an_error_of_the_rigid_alignment_alone():
    truth = straight(11)
    found = similar(truth, 0.9, TURN, [1, 1, 1])
    errors = absolute_errors(found, truth)
    assert errors.similarity == pytest.approx(0, abs=1e-12)
    # Off by a tenth of the distance from the centre of the path, -5 … 5.
    assert errors.rigid == pytest.approx(0.1 * np.sqrt(10), rel=1e-9)
    relative = relative_errors(found, truth)
    assert relative.translation == pytest.approx(0.1) and relative.pairs == 10
    assert drift(found, truth).translation == pytest.approx(0.1)
    assert path_length(truth) == 10


def test_errors_of_one_pose_are_the_added_ones():
    truth = random_path(np.random.default_rng(3), 10)
    found = truth.copy()
    found[6] = found[6] @ pose_matrix([0.3, 0, 0.4, 0, 0, 0])
    relative = relative_errors(found, truth)
    # Two of nine motions are off by 0.5.
    assert relative.translation == pytest.approx(0.5 * np.sqrt(2 / 9))
    found[6] = truth[6] @ pose_matrix([0, 0, 0, 0, np.radians(3), 0])
    # One motion turns wrongly, and the next back; it is also off by what 3° make of its length.
    assert relative_errors(found, truth).rotation == pytest.approx(3 * np.sqrt(2 / 9))
    assert relative_errors(found[5:7], truth[5:7]).translation == pytest.approx(0, abs=1e-12)


def test_standstill_one_pose_and_none():
    still = np.tile(np.eye(4), (6, 1, 1))
    moving = straight(6)
    assert path_length(still) == 0 and path_length(np.full((3, 4, 4), np.nan)) == 0
    assert absolute_errors(still, moving).similarity == pytest.approx(np.sqrt(35 / 12))
    assert absolute_errors(still, moving).scale == 1
    assert absolute_errors(moving, still).similarity == pytest.approx(0, abs=1e-12)
    assert drift(moving, still) is None
    one = moving.copy()
    one[1:] = np.nan
    assert absolute_errors(one, moving).similarity == 0 and absolute_errors(one, moving).poses == 1
    assert relative_errors(one, moving) is None and drift(one, moving) is None
    assert relative_errors(moving, moving, step=6) is None
    with pytest.raises(
        ValueError, match="no frame has both an estimated and a true pose: of 6 frames, 0 have"
    ):
        absolute_errors(np.full_like(moving, np.nan), moving)
    with pytest.raises(ValueError, match=r"poses are \(5, 4, 4\) and truth is \(6, 4, 4\)"):
        absolute_errors(moving[1:], moving)
    with pytest.raises(ValueError, match="step is 0"):
        relative_errors(moving, moving, step=0)
    for options in ({"lengths": [0.0]}, {"lengths": [np.nan]}, {"every": 0}):
        with pytest.raises(ValueError, match="expected"):
            drift(moving, moving, **options)


def devkit(found, truth, lengths, every, *, measured=False):
    """The benchmark's program, loop by loop; or per length as it is."""
    travelled = [0.0]
    for before, after in pairwise(truth):
        travelled.append(travelled[-1] + np.linalg.norm(after[:3, 3] - before[:3, 3]))
    translations, rotations = [], []
    for first in range(0, len(truth), every):
        for length in lengths:
            last = next(
                (i for i in range(first, len(truth)) if travelled[i] > travelled[first] + length),
                -1,
            )
            if last == -1:
                continue
            true = np.linalg.inv(truth[first]) @ truth[last]
            motion = np.linalg.inv(found[first]) @ found[last]
            error = np.linalg.inv(motion) @ true
            cosine = 0.5 * (np.trace(error[:3, :3]) - 1)
            divisor = travelled[last] - travelled[first] if measured else length
            rotations.append(np.arccos(max(min(cosine, 1), -1)) / divisor)
            translations.append(np.linalg.norm(error[:3, 3]) / divisor)
    return np.mean(translations), np.degrees(np.mean(rotations)), len(rotations)


def test_drift_is_that_of_the_benchmark():
    rng = np.random.default_rng(1)
    truth = random_path(rng, 200, length=2.0, turn=0.05)
    found = shaken(truth, rng)
    assert path_length(truth) > 500
    errors = drift(found, truth)
    assert errors.lengths == (100, 200, 300, 400, 500, 600, 700, 800)
    translation, rotation, segments = devkit(found, truth, errors.lengths, 10)
    assert errors.segments == segments > 50
    assert errors.translation == pytest.approx(translation, rel=1e-9)
    assert errors.rotation == pytest.approx(rotation, rel=1e-6)  # an arc cosine rounds
    short = drift(found[:20], truth[:20])
    length = path_length(truth[:20])
    assert length < 100
    np.testing.assert_allclose(short.lengths, length * np.arange(1, 9) / 10)
    translation, rotation, segments = devkit(
        found[:20], truth[:20], short.lengths, 1, measured=True
    )
    assert short.segments == segments > 30
    assert short.translation == pytest.approx(translation, rel=1e-9)
    assert short.rotation == pytest.approx(rotation, rel=1e-6)


def test_drift_excludes_unknown_poses():
    rng = np.random.default_rng(2)
    truth = random_path(rng, 30)
    found = shaken(truth, rng)
    whole = drift(found, truth, lengths=[5.0], every=1)
    found[12] = np.nan
    assert 0 < whole.segments - drift(found, truth, lengths=[5.0], every=1).segments <= 30
