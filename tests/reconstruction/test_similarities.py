"""Similarities in space, and graphs of them."""

import numpy as np
import pytest

from tisfm.reconstruction.similarities import (
    agreed,
    fitted,
    mean_pose,
    moved,
    moved_pose,
    refined,
    scale_of,
    step,
)
from tisfm.reconstruction.similarity_graph import BLOCK, Edge, placed, solved

TRUE = step(np.log(1.7), np.array([0.2, -0.5, 0.1]), np.array([1.0, -2.0, 0.5]))


def cloud(count=60, seed=0):
    return np.random.default_rng(seed).uniform((-2, -2, 3), (2, 2, 7), (count, 3))


def path(count=12):
    turns = [step(0.0, np.array([0, 0.03 * k, 0]), np.array([0.1 * k, 0, 0])) for k in range(count)]
    return np.array(turns)


def edge(first, second, similarity, certain=True):
    points = cloud()
    return Edge(
        first=first,
        second=second,
        similarity=similarity,
        points=points,
        distances=np.linalg.norm(points, axis=1),
        deviation=0.01,
        worth=60.0,
        certain=certain,
    )


def test_an_exact_similarity_is_found():
    found = fitted(moved(TRUE, cloud()), cloud(), np.ones(60))
    np.testing.assert_allclose(found, TRUE, atol=1e-12)
    assert scale_of(found) == pytest.approx(1.7)


def test_noise_on_both_sides_leaves_the_scale():
    random = np.random.default_rng(1)
    points, others = (one + 0.5 * random.normal(size=(20000, 3)) for one in [cloud(20000)] * 2)
    assert scale_of(fitted(points, others, np.ones(20000))) == pytest.approx(1, abs=0.01)


def test_what_most_points_agree_on_is_found():
    others, points = cloud(), moved(TRUE, cloud())
    points[::3] += 3
    distances = np.linalg.norm(points, axis=1)
    similarity, agree = agreed(points, others, distances, fewest=20, share=0.5)
    np.testing.assert_allclose(similarity, TRUE, atol=1e-9)
    np.testing.assert_array_equal(agree, np.arange(60) % 3 > 0)
    assert agreed(points, others, distances, fewest=41, share=0.5) is None
    assert agreed(points, others, distances, fewest=20, share=0.7) is None
    assert agreed(points[:2], others[:2], distances[:2], fewest=0, share=0.0) is None


def test_poses_say_more_than_points_that_are_rough():
    random = np.random.default_rng(2)
    points = moved(TRUE, cloud()) + 0.1 * random.normal(size=(60, 3))
    distances = np.linalg.norm(points, axis=1)
    rough, _ = agreed(points, cloud(), distances, fewest=20, share=0.5)
    poses = np.array([moved_pose(TRUE, pose) for pose in path()])
    found = refined(rough, (points, cloud()), distances, (poses, path()))
    assert abs(scale_of(rough) / 1.7 - 1) > 1e-4 > abs(scale_of(found) / 1.7 - 1)


def test_a_pose_stays_rigid_and_the_mean_lies_between():
    pose = moved_pose(TRUE, path()[5])
    np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-12)
    mean = mean_pose(path()[[2, 4]], np.array([1.0, 1.0]))
    np.testing.assert_allclose(mean, path()[3], atol=1e-12)


def chain(count=6, drift=0.02):
    """Return edges from each node to the next, which are off, and the true places of nodes."""
    move = step(0.0, np.array([0, 2 * np.pi / count, 0]), np.array([1.0, 0, 0]))
    true = [np.linalg.matrix_power(move, k) for k in range(count)]
    off = step(drift, np.array([0, drift, 0]), np.array([0, drift, 0]))
    return [edge(k, k + 1, off @ move) for k in range(count - 1)], true, move


def test_a_chain_is_placed_along_its_edges():
    edges, true, _ = chain(drift=0.0)
    (place,) = placed(6, edges)
    for node, similarity in place.items():
        np.testing.assert_allclose(similarity, true[node], atol=1e-9)


def test_a_closed_loop_spreads_the_drift():
    edges, _, move = chain(24, drift=0.005)
    (apart,) = placed(24, edges)
    (closed,) = placed(24, [*edges, edge(23, 0, move, certain=False)])
    gap = [np.abs(place[23] @ move - np.eye(4)).max() for place in (apart, closed)]
    assert gap[1] < 0.1 * gap[0]
    growth = [np.log(scale_of(place[23])) for place in (apart, closed)]
    assert growth[0] == pytest.approx(0.115) and abs(growth[1]) < 0.01


def test_a_loop_that_is_false_is_not_believed():
    edges, true, move = chain(drift=0.0)
    false = edge(0, 4, step(0.7, np.array([1.0, 0, 0]), np.array([3.0, 0, 1])), certain=False)
    (place,) = placed(6, [*edges, edge(5, 0, move, certain=False), false])
    for node, similarity in place.items():
        np.testing.assert_allclose(similarity, true[node], atol=0.02)


def test_nodes_that_nothing_connects_are_apart():
    edges, _, _ = chain()
    found = placed(8, [*edges[:2], edge(6, 7, np.eye(4))])
    assert [list(place) for place in found] == [[0, 1, 2], [3], [4], [5], [6, 7]]


@pytest.mark.parametrize("count", [1, BLOCK, BLOCK + 1, 3 * BLOCK - 5])
def test_a_system_is_solved_as_linalg_does(count):
    random = np.random.default_rng(count)
    matrix, vector = random.normal(size=(count, count)), random.normal(size=count)
    matrix = matrix @ matrix.T + np.eye(count)
    matrix[:1, count // 2 :] = matrix[count // 2 :, :1] = count == 1  # some of it is empty
    matrix += count * np.eye(count)
    kept = matrix.copy(), vector.copy()
    np.testing.assert_allclose(solved(matrix, vector), np.linalg.solve(matrix, vector), rtol=1e-8)
    np.testing.assert_array_equal(matrix, kept[0])
    np.testing.assert_array_equal(vector, kept[1])
