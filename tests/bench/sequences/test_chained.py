"""Pairs one after another, in one scale."""

from types import SimpleNamespace

import numpy as np
import pytest

from bench.sequences.worker import chain
from tests.evaluation.reconstructed import CENTER, DEPTHS, FOCAL, PATH, H, N, W
from tisfm.metrics import absolute_errors
from tisfm.rigid import rigid_twist


def interpretation(first, second, *, status="converged"):
    """What a pair would say that is exact: its translation has the length 1."""
    motion = np.linalg.inv(PATH[second]) @ PATH[first]
    twist = rigid_twist(motion[:3, :3], motion[:3, 3])
    length = np.linalg.norm(twist[:3])
    twist[:3] /= length
    return SimpleNamespace(
        motions=twist[None],
        inverse_depth=(length / DEPTHS[first]).astype(np.float32),
        status=status,
    )


def chained(interpret):
    kept = {}
    found = chain(N, interpret, kept.__setitem__, focal=FOCAL, center=CENTER)
    return found, kept


def test_exact_pairs_make_the_path_and_one_scale():
    found, kept = chained(interpretation)
    errors = absolute_errors(np.array(found.poses), PATH)
    # Pixels are rounded where depth is compared: a wall's depth changes little between two.
    assert errors.similarity < 2e-4
    assert found.piece == [0] * N and found.status == ["converged"] * N
    assert sorted(kept) == list(range(N))
    for k in range(N):  # in the scale of the first pair, its depth is the true one
        depth = found.units[k] / kept[k].inverse_depth
        np.testing.assert_allclose(depth * errors.scale, DEPTHS[k], rtol=5e-3)


def test_a_pair_without_depth_turns_and_carries_the_scale_over():
    def interpret(first, second):
        turned = (first, second) == (2, 3)
        return interpretation(first, second, status="pure_rotation" if turned else "converged")

    found, kept = chained(interpret)
    assert sorted(kept) == [0, 1, 3, 4, 5] and found.piece == [0] * N
    np.testing.assert_allclose(found.poses[3][:3, 3], found.poses[2][:3, 3], atol=1e-12)
    scale = found.units[0] / kept[0].inverse_depth / DEPTHS[0]
    after = found.units[4] / kept[4].inverse_depth / DEPTHS[4]
    assert np.median(after) == pytest.approx(np.median(scale), rel=0.05)  # it did move a little


def test_a_scale_that_is_lost_begins_a_piece():
    def interpret(first, second):
        result = interpretation(first, second)
        if first == 3:
            result.inverse_depth = np.full((H, W), -1, np.float32)
        return result

    found, kept = chained(interpret)
    assert found.piece[:3] == [0] * 3 and found.piece[3] == 1
    np.testing.assert_array_equal(found.poses[3], np.eye(4))
    assert found.units[3] == 1 and len(kept) == N


def test_a_pair_without_a_motion_does_not_move_the_camera():
    def interpret(first, second):
        result = interpretation(first, second)
        if first == 1:
            result.motions = None
        return result

    found, kept = chained(interpret)
    np.testing.assert_array_equal(found.poses[2], found.poses[1])
    assert 1 not in kept
