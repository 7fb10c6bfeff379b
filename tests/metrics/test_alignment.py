"""The similarity that brings points nearest to others."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.trajectory.paths import PATIENT, random_path
from tisfm.metrics import align
from tisfm.rigid import rigid_motion

SCALES = st.floats(-3, 3).map(lambda power: 10**power)
SPINS = st.tuples(*[st.floats(-1.7, 1.7)] * 3)


@PATIENT
@given(seed=st.integers(0, 999), count=st.integers(3, 30), scale=SCALES, spin=SPINS)
def test_a_similarity_is_recovered(seed, count, scale, spin):
    rng = np.random.default_rng(seed)
    points, offset = rng.normal(size=(count, 3)), rng.normal(size=3)
    rotation = rigid_motion([0, 0, 0, *spin])[0]
    found = align(points, scale * points @ rotation.T + offset)
    # Three points may all but lie on a line: the rotation is then as uncertain as they are thin.
    thin = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)[1]
    assert found.scale == pytest.approx(scale, rel=1e-9)
    np.testing.assert_allclose(found.rotation, rotation, atol=1e-12 / min(1, thin) ** 2)
    target = scale * points @ rotation.T + offset
    np.testing.assert_allclose(found.apply(points), target, atol=1e-9 * max(1, scale))


@PATIENT
@given(seed=st.integers(0, 999), with_scale=st.booleans())
def test_no_other_similarity_is_nearer(seed, with_scale):
    rng = np.random.default_rng(seed)
    points, truth = rng.normal(size=(8, 3)), rng.normal(size=(8, 3))
    best = align(points, truth, with_scale=with_scale)
    assert np.linalg.det(best.rotation) == pytest.approx(1)  # a mirror would be nearer
    error = np.square(best.apply(points) - truth).sum()
    for _ in range(10):
        turned = rigid_motion([0, 0, 0, *rng.normal(0, 1e-3, 3)])[0] @ best.rotation
        scale = best.scale * (1 + rng.normal(0, 1e-3) * with_scale)
        moved = scale * points @ turned.T
        moved += (truth - moved).mean(axis=0)
        assert np.square(moved - truth).sum() >= error * (1 - 1e-12)
    assert with_scale or best.scale == 1


def test_points_on_a_line_in_a_plane_and_at_one_position():
    line = np.outer(np.arange(5.0), [1, 2, 3])
    found = align(line, 2 * line[:, ::-1] + 1)
    np.testing.assert_allclose(found.apply(line), 2 * line[:, ::-1] + 1, atol=1e-12)
    assert found.scale == pytest.approx(2)
    plane = np.random.default_rng(0).normal(size=(6, 3)) * (1, 1, 0)
    mirrored = plane * (1, -1, 1)  # which a turn does as well
    np.testing.assert_allclose(align(plane, mirrored).apply(plane), mirrored, atol=1e-12)
    still = np.full((5, 3), 7.3)
    found = align(still, line)
    assert found.scale == 1
    np.testing.assert_allclose(found.apply(still), np.broadcast_to(line.mean(axis=0), (5, 3)))
    assert align(line, still).scale == pytest.approx(0, abs=1e-12)
    one = align([[1.0, 2, 3]], [[4.0, 5, 6]])
    np.testing.assert_allclose(one.apply([[1.0, 2, 3]]), [[4, 5, 6]])


def test_wrong_points_are_refused():
    path = random_path(np.random.default_rng(0), 5)[:, :3, 3]
    for points, words in (
        (path[:3], "points are .3, 3. and truth is .5, 3."),
        (path[:, :2], "points are .5, 2."),
        (np.where(path == 0, np.nan, path), "points have values that are NaN"),
    ):
        with pytest.raises(ValueError, match=words):
            align(points, path)
    with pytest.raises(ValueError, match="at least 1"):
        align(np.empty((0, 3)), np.empty((0, 3)))
