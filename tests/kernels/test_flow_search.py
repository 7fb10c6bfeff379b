"""Displacements found by the correlation of windows, and carried to where there are none."""

import cv2
import numpy as np
import pytest

from bench import reference

NOISE = 1.5


def texture(height, width, seed=0):
    """Return smooth noise of whole levels, as bytes are."""
    noise = np.random.default_rng(seed).normal(size=(height, width))
    smooth = cv2.GaussianBlur(noise, (0, 0), 1.5)
    return np.rint(np.clip(128 + 45 * smooth / max(smooth.std(), 1e-9), 0, 255)).astype(np.float32)


def search_in(levels0, levels1):
    from tisfm.kernels.rigid.flow_search import FlowSearch

    return FlowSearch(levels0, levels1, noise=NOISE)


def drawn(shape, seed=0, largest=6.0):
    state = np.zeros((*shape, 4), np.float32)
    state[..., :2] = np.random.default_rng(seed).uniform(-largest, largest, (*shape, 2))
    state[..., 3] = 1
    return state


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (12, 1), (13, 17), (24, 31)])
def test_score_is_that_of_the_reference(size):
    from tisfm.kernels.rigid.windows import OUTSIDE_COST, UNTEXTURED

    levels0, levels1 = texture(*size), texture(*size, seed=1)
    state = drawn(size)
    search_in(levels0, levels1).score(state, min_variance=1.8)
    rows, columns = np.mgrid[: size[0], : size[1]]
    place = np.stack([rows + state[..., 1], columns + state[..., 0]])
    limits = np.array(size)[:, None, None] - 0.5
    surely = ((place > -0.49) & (place < limits - 0.01)).all(axis=0)
    outside = ((place < -0.51) | (place > limits + 0.01)).any(axis=0)
    shifted = np.stack([*place[::-1], np.ones(size)])
    east, south = np.eye(3)[:2, :, None, None]
    expected, variance = reference.window_cost(
        levels0, levels1, shifted, east, south, noise=NOISE**2
    )
    cost = state[..., 2]
    seen = cost < UNTEXTURED
    np.testing.assert_array_equal(seen, variance > 1.8 * NOISE**2)
    assert (cost[seen & outside] == OUTSIDE_COST).all()
    compared = seen & surely
    # float32, and a reciprocal
    np.testing.assert_allclose(cost[compared], expected[compared], rtol=0, atol=1e-3)
    assert compared.mean() > 0.2 or min(size) == 1


def test_a_shift_is_found_and_no_cost_rises():
    frame = texture(60, 90)
    search = search_in(frame[:, 12:].copy(), frame[:, :-12].copy())
    state = drawn((60, 78), largest=16.0)
    search.score(state, min_variance=1.8)
    for turn in range(6):
        before = state[..., 2].copy()
        search.improve(state, neighbour_distance=5, draws=7, spans=(16.0, 0.5), seed=turn)
        assert (state[..., 2] <= before).all()
    costs = state.copy()
    search.score(costs, min_variance=1.8)
    np.testing.assert_allclose(costs[..., 2], state[..., 2], atol=1e-6)
    off = np.hypot(state[6:-6, 6:60, 0] - 12, state[6:-6, 6:60, 1])  # beyond, the border repeats
    assert (off < 0.5).mean() > 0.98


def test_the_same_answer_twice_and_another_for_another_seed():
    frame0, frame1 = texture(31, 45), texture(31, 45, seed=1)
    found = []
    for seed in (0, 0, 1):
        search, state = search_in(frame0, frame1), drawn((31, 45))
        search.score(state, min_variance=1.8)
        search.improve(state, neighbour_distance=5, draws=3, spans=(8.0, 1.0), seed=seed)
        found.append(state)
    np.testing.assert_array_equal(found[0], found[1])
    assert (found[0] != found[2]).any()


def test_other_pixels_keep_their_flow():
    frame0, frame1 = texture(31, 45), texture(31, 45, seed=1)
    state = drawn((31, 45))
    state[:, 20:, 3] = 0
    state[..., 2] = 9
    before = state.copy()
    search = search_in(frame0, frame1)
    search.score(state, min_variance=1.8)
    search.improve(state, neighbour_distance=5, draws=3, spans=(8.0, 1.0), seed=0)
    np.testing.assert_array_equal(state[:, 20:], before[:, 20:])
    assert (state[:, :20, 2] < 9).all()


def test_bare_windows_are_not_compared():
    from tisfm.kernels.rigid.windows import RADIUS, UNTEXTURED

    frame = texture(40, 60)
    frame[:, 30:] = 77
    state = drawn(frame.shape)
    search_in(frame, frame).score(state, min_variance=1.8)
    assert (state[:, 30 + RADIUS :, 2] == UNTEXTURED).all()
    assert (state[:, :25, 2] < UNTEXTURED).all()


def nearest_by_steps(guide, known, edge):
    """Return the least distance from a known pixel, by relaxing all steps until none shortens."""
    height, width = guide.shape
    distance = np.where(known, 0.0, np.inf)
    changed = True
    while changed:
        before = distance.copy()
        for row, column in np.ndindex(height, width):
            for other in (
                (row - 1, column),
                (row + 1, column),
                (row, column - 1),
                (row, column + 1),
            ):
                if 0 <= other[0] < height and 0 <= other[1] < width:
                    step = 1 + abs(guide[row, column] - guide[other]) / edge
                    distance[row, column] = min(distance[row, column], distance[other] + step)
        changed = (distance < before).any()
    return distance


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (8, 1), (9, 13)])
def test_displacements_are_propagated_along_the_shortest_path(size):
    from tisfm.kernels.rigid.flow_search import propagate_flow

    guide = texture(*size)
    known = np.zeros(size, bool)
    known.flat[[0, -1]] = True
    state = drawn(size, seed=3)
    state[..., 2] = 5
    given = state.copy()
    distance = np.where(known, 0, 1e6).astype(np.float32)
    for _ in range(8):
        propagate_flow(guide, distance, state, edge=10.0)
    np.testing.assert_allclose(distance, nearest_by_steps(guide, known, 10.0), rtol=1e-5)
    first, last = given.reshape(-1, 4)[[0, -1], :2]
    there = (state[..., :2] == first).all(axis=-1) | (state[..., :2] == last).all(axis=-1)
    assert there.all()
    np.testing.assert_array_equal(state[..., 2:], given[..., 2:])


def test_errors_name_the_argument():
    from tisfm.kernels.rigid.flow_search import FlowSearch, propagate_flow

    frame = texture(9, 11)
    with pytest.raises(ValueError, match="noise is 0"):
        FlowSearch(frame, frame, noise=0)
    with pytest.raises(ValueError, match="grey1"):
        FlowSearch(frame, frame[:-1].copy(), noise=1)
    search = search_in(frame, frame)
    with pytest.raises(ValueError, match="state"):
        search.score(np.zeros((9, 11, 3), np.float32), min_variance=1.8)
    with pytest.raises(ValueError, match="neighbour_distance is 4"):
        search.improve(drawn((9, 11)), neighbour_distance=4, draws=1, spans=(1.0, 1.0), seed=0)
    with pytest.raises(ValueError, match="edge is 0"):
        propagate_flow(frame, frame.copy(), drawn((9, 11)), edge=0)
