"""Similarity transforms in 3D, and graphs of them."""

from dataclasses import replace

import numpy as np
import pytest

from tisfm.reconstruction.geometry import sim3
from tisfm.reconstruction.geometry.settings import GEOMETRY
from tisfm.reconstruction.geometry.sim3 import (
    fit_sim3,
    fit_sim3_ransac,
    mean_pose,
    refine_sim3,
    sim3_from_vector,
    sim3_scale,
    transform_points,
    transform_pose,
)
from tisfm.reconstruction.geometry.sim3_graph import (
    Edge,
    optimise_sim3_graph,
    solve_sparse,
)

TRUE = sim3_from_vector(np.log(1.7), np.array([0.2, -0.5, 0.1]), np.array([1.0, -2.0, 0.5]))


def cloud(count=60, seed=0):
    return np.random.default_rng(seed).uniform((-2, -2, 3), (2, 2, 7), (count, 3))


def path(count=12):
    turns = [
        sim3_from_vector(0.0, np.array([0, 0.03 * k, 0]), np.array([0.1 * k, 0, 0]))
        for k in range(count)
    ]
    return np.array(turns)


def edge(first, second, similarity, is_certain=True):
    points = cloud()
    return Edge(
        first=first,
        second=second,
        similarity=similarity,
        points=points,
        distances=np.linalg.norm(points, axis=1),
        deviation=0.01,
        weight=60.0,
        is_certain=is_certain,
    )


def test_exact_similarity_is_found():
    found = fit_sim3(transform_points(TRUE, cloud()), cloud(), np.ones(60))
    np.testing.assert_allclose(found, TRUE, atol=1e-12)
    assert sim3_scale(found) == pytest.approx(1.7)


def test_three_points_are_turned_and_never_mirrored():
    """In a plane of points, the SVD does not determine the sign of the third axis."""
    random = np.random.default_rng(3)
    for _ in range(40):
        others = random.uniform(-1, 1, (3, 3))
        found = fit_sim3(transform_points(TRUE, others), others, np.ones(3))
        np.testing.assert_allclose(found, TRUE, atol=1e-6)


def test_mirrored_cloud_gets_a_rotation():
    found = fit_sim3(cloud() * (-1, 1, 1), cloud(), np.ones(60))
    assert np.linalg.det(found[:3, :3]) > 0


def test_weight_of_two_counts_as_a_point_twice():
    random = np.random.default_rng(4)
    others, points = cloud(), transform_points(TRUE, cloud()) + 0.3 * random.normal(size=(60, 3))
    counts = random.integers(0, 5, 60)
    twice = fit_sim3(np.repeat(points, counts, axis=0), np.repeat(others, counts, axis=0),
                   np.ones(counts.sum()))  # fmt: skip
    np.testing.assert_allclose(fit_sim3(points, others, counts.astype(float)), twice, atol=1e-12)
    assert np.abs(twice - fit_sim3(points, others, np.ones(60))).max() > 1e-3


def test_noise_on_both_sides_leaves_the_scale():
    random = np.random.default_rng(1)
    points, others = (one + 0.5 * random.normal(size=(20000, 3)) for one in [cloud(20000)] * 2)
    assert sim3_scale(fit_sim3(points, others, np.ones(20000))) == pytest.approx(1, abs=0.01)


def test_ransac_finds_the_similarity_of_most_points(monkeypatch):
    others, points = cloud(), transform_points(TRUE, cloud())
    points[::3] += 3
    distances = np.linalg.norm(points, axis=1)
    similarity, agree = fit_sim3_ransac(points, others, distances)
    np.testing.assert_allclose(similarity, TRUE, atol=1e-9)
    np.testing.assert_array_equal(agree, np.arange(60) % 3 > 0)
    for changed in ({"min_inliers": 41}, {"min_inlier_share": 0.7}):
        monkeypatch.setattr(sim3, "GEOMETRY", replace(GEOMETRY, **changed))
        assert fit_sim3_ransac(points, others, distances) is None
    monkeypatch.setattr(sim3, "GEOMETRY", replace(GEOMETRY, min_inliers=0, min_inlier_share=0.0))
    assert fit_sim3_ransac(points[:2], others[:2], distances[:2]) is None


def near_and_far():
    """Return 30 near and 30 far points with errors, the true points, and their distances.

    The errors are 0.02 % of the distance for near points, and 2 % for far ones.
    """
    random = np.random.default_rng(5)
    near, far = random.uniform(-1, 1, (30, 3)), 100 * random.uniform(-1, 1, (30, 3))
    others = np.concatenate([near, far]) + np.array([0, 0, 2])
    distances = 1.7 * np.linalg.norm(others, axis=1)
    off = 0.02 * distances[:, None] * random.normal(size=(60, 3)) / np.sqrt(3)
    off[:30] /= 100
    return transform_points(TRUE, others) + off, others, distances


def test_points_count_less_by_the_square_of_their_distance():
    points, others, distances = near_and_far()
    found, agree = fit_sim3_ransac(points, others, distances)
    assert agree.all()
    # Measured: 0.0007; without weights by distance 0.15, with weights 1/distance 0.004.
    assert (
        np.abs(transform_points(found, others[:30]) - transform_points(TRUE, others[:30])).max()
        < 0.002
    )


def test_points_count_less_by_their_distance_also_beside_poses():
    points, others, distances = near_and_far()
    poses = np.array([transform_pose(TRUE, pose) for pose in path()])
    random = np.random.default_rng(6)
    poses[:, :3, 3] += 0.02 * np.median(distances) * random.normal(size=(len(poses), 3))
    found = refine_sim3(TRUE, (points, others), distances, (poses, path()))
    assert (
        np.abs(transform_points(found, others[:30]) - transform_points(TRUE, others[:30])).max()
        < 0.0008
    )


def test_poses_outweigh_inaccurate_points():
    random = np.random.default_rng(2)
    points = transform_points(TRUE, cloud()) + 0.1 * random.normal(size=(60, 3))
    distances = np.linalg.norm(points, axis=1)
    rough, _ = fit_sim3_ransac(points, cloud(), distances)
    poses = np.array([transform_pose(TRUE, pose) for pose in path()])
    found = refine_sim3(rough, (points, cloud()), distances, (poses, path()))
    assert abs(sim3_scale(rough) / 1.7 - 1) > 1e-4 > abs(sim3_scale(found) / 1.7 - 1)


def test_pose_stays_rigid_and_the_mean_lies_between():
    pose = transform_pose(TRUE, path()[5])
    np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-12)
    mean = mean_pose(path()[[2, 4]], np.array([1.0, 1.0]))
    np.testing.assert_allclose(mean, path()[3], atol=1e-12)


def test_mean_of_poses_is_weighted():
    """For rotations about one axis, the mean angle is that of the mean sine and cosine."""
    few, weights = path()[[2, 4, 9]], np.array([1.0, 3.0, 0.5])
    mean = mean_pose(few, weights)
    angles = np.array([0.06, 0.12, 0.27])
    angle = np.arctan2(weights @ np.sin(angles), weights @ np.cos(angles))
    expected = sim3_from_vector(
        0.0, np.array([0, angle, 0]), np.array([weights @ [0.2, 0.4, 0.9] / 4.5, 0, 0])
    )
    np.testing.assert_allclose(mean, expected, atol=1e-12)


def test_surer_edges_count_more():
    """Two edges of different scale count by their precision."""
    points = cloud()
    centre = points.mean(axis=0)
    scales, worths, deviations = (0.01, -0.02), (60.0, 120.0), (0.01, 0.03)
    edges = []
    for scale, worth, deviation in zip(scales, worths, deviations, strict=True):
        about = sim3_from_vector(scale, np.zeros(3), centre - np.exp(scale) * centre)
        edges.append(replace(edge(0, 1, about), weight=worth, deviation=deviation))
    (place,) = optimise_sim3_graph(2, edges)
    weights = np.array(worths) / np.array(deviations) ** 2
    expected = weights @ scales / weights.sum()
    assert np.log(sim3_scale(place[1])) == pytest.approx(expected, abs=1e-5)


def chain(count=6, drift=0.02):
    """Return drifting edges from each node to the next, the true poses, and the true edge."""
    move = sim3_from_vector(0.0, np.array([0, 2 * np.pi / count, 0]), np.array([1.0, 0, 0]))
    true = [np.linalg.matrix_power(move, k) for k in range(count)]
    off = sim3_from_vector(drift, np.array([0, drift, 0]), np.array([0, drift, 0]))
    return [edge(k, k + 1, off @ move) for k in range(count - 1)], true, move


def test_chain_follows_its_edges():
    edges, true, _ = chain(drift=0.0)
    (place,) = optimise_sim3_graph(6, edges)
    for node, similarity in place.items():
        np.testing.assert_allclose(similarity, true[node], atol=1e-9)


def test_closed_loop_spreads_the_drift():
    edges, _, move = chain(24, drift=0.005)
    (apart,) = optimise_sim3_graph(24, edges)
    (closed,) = optimise_sim3_graph(24, [*edges, edge(23, 0, move, is_certain=False)])
    gap = [np.abs(place[23] @ move - np.eye(4)).max() for place in (apart, closed)]
    assert gap[1] < 0.1 * gap[0]
    growth = [np.log(sim3_scale(place[23])) for place in (apart, closed)]
    assert growth[0] == pytest.approx(0.115) and abs(growth[1]) < 0.01


def test_false_loop_closure_is_rejected():
    edges, true, move = chain(drift=0.0)
    false = edge(
        0, 4, sim3_from_vector(0.7, np.array([1.0, 0, 0]), np.array([3.0, 0, 1])), is_certain=False
    )
    (place,) = optimise_sim3_graph(6, [*edges, edge(5, 0, move, is_certain=False), false])
    for node, similarity in place.items():
        np.testing.assert_allclose(similarity, true[node], atol=0.02)


def test_unconnected_nodes_are_separate():
    edges, _, _ = chain()
    found = optimise_sim3_graph(8, [*edges[:2], edge(6, 7, np.eye(4))])
    assert [list(place) for place in found] == [[0, 1, 2], [3], [4], [5], [6, 7]]


@pytest.mark.parametrize("count", [1, 7, 8, 16])
def test_system_is_solved_as_linalg_does(count):
    random = np.random.default_rng(count)
    matrix, vector = random.normal(size=(count, count)), random.normal(size=count)
    matrix = matrix @ matrix.T + np.eye(count)
    # Some matrices have an empty block.
    matrix[:1, count // 2 :] = matrix[count // 2 :, :1] = count == 1
    matrix += count * np.eye(count)
    kept = matrix.copy(), vector.copy()
    np.testing.assert_allclose(
        solve_sparse(matrix, vector), np.linalg.solve(matrix, vector), rtol=1e-8
    )
    np.testing.assert_array_equal(matrix, kept[0])
    np.testing.assert_array_equal(vector, kept[1])
