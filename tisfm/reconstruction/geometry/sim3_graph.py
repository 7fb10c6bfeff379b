"""A graph of coordinate systems with measured similarities between them.

Each node is a coordinate system. Its unknown is the similarity to a common system, with seven
parameters. Each edge has a measured similarity between two nodes, from points that belong to both
nodes.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import splu
from scipy.spatial.transform import Rotation

from tisfm.reconstruction.geometry.rays import cross_matrices
from tisfm.reconstruction.geometry.settings import GEOMETRY
from tisfm.reconstruction.geometry.sim3 import sim3_from_vector, sim3_scale, transform_points


@dataclass(frozen=True, kw_only=True)
class Edge:
    """A measured similarity between two nodes."""

    # first, second: the nodes
    first: int
    second: int
    # (4, 4) float64: from the second node's coordinates to the first node's coordinates
    similarity: np.ndarray
    # (N, 3) float64: points that belong to both nodes, in the first node's coordinates
    points: np.ndarray
    distances: np.ndarray  # (N,) float64: distances of these points from the camera
    deviation: float  # error of a point, as a share of its distance
    weight: float  # weight of the edge: the number of shared points, of which `points` is a sample
    # Whether the edge is surely right. An uncertain edge gets less weight if it does not fit.
    is_certain: bool

    @property
    def ends(self) -> tuple[int, int]:
        """The two nodes."""
        return self.first, self.second


class Link(Protocol):
    """A similarity between two nodes: the part of `Edge` that `chain_sim3` needs."""

    @property
    def first(self) -> int:
        """The node of the target coordinates of `similarity`."""

    @property
    def second(self) -> int:
        """The other node."""

    @property
    def similarity(self) -> np.ndarray:
        """From the second node's coordinates to the first node's, (4, 4) float64."""


def optimise_sim3_graph(
    count: int,  # number of nodes
    # edges in the order in which they connect nodes for the start values: the most reliable first
    edges: Sequence[Edge],
) -> list[dict[int, np.ndarray]]:
    """Find the similarity of each node to common coordinates.

    Returns a dict for each connected group of nodes, in the order of first nodes: the similarity of
    each node, (4, 4) float64, to the coordinates of the first node of the group.

    References
    ----------
    Strasdat, Montiel and Davison, "Scale drift-aware large scale monocular SLAM", RSS 2010,
    doi 10.15607/RSS.2010.VI.010.
    """
    return [
        _optimise(start, [edge for edge in edges if edge.first in start])
        for start in chain_sim3(count, edges)
    ]


def chain_sim3(count: int, edges: Sequence[Link]) -> list[dict[int, np.ndarray]]:
    """Return the groups of connected nodes; similarities are chained along the first edges.

    Arguments and result are as for `optimise_sim3_graph`.
    """
    group = {node: [node] for node in range(count)}
    similarities = {node: np.eye(4) for node in range(count)}
    for edge in edges:
        if group[edge.first] is group[edge.second]:
            continue
        # All nodes of the second node's group move together.
        motion = (
            similarities[edge.first] @ edge.similarity @ np.linalg.inv(similarities[edge.second])
        )
        merged_group = group[edge.first] + group[edge.second]
        for node in group[edge.second]:
            similarities[node] = motion @ similarities[node]
        for node in merged_group:
            group[node] = merged_group
    groups = []
    for node in range(count):
        nodes = sorted(group[node])
        if nodes[0] == node:
            to_first_node = np.linalg.inv(similarities[node])
            groups.append(
                {other_node: to_first_node @ similarities[other_node] for other_node in nodes}
            )
    return groups


def _optimise(start: dict[int, np.ndarray], edges: Sequence[Edge]) -> dict[int, np.ndarray]:
    """Return the similarities that fit the edges best; the first node stays fixed."""
    nodes, similarities = list(start), dict(start)
    index_of = {node: k for k, node in enumerate(nodes)}
    outlier_error = GEOMETRY.first_outlier_error
    last_outlier_error = GEOMETRY.last_outlier_error
    for _ in range(GEOMETRY.max_rounds if len(nodes) > 1 else 0):
        matrix, vector = np.zeros((7 * len(nodes),) * 2), np.zeros(7 * len(nodes))
        for edge in edges:
            residual, jacobian, weight = _residual(edge, similarities)
            if not edge.is_certain:
                weight = weight / (1 + float(residual @ weight @ residual) / outlier_error**2) ** 2
            weight *= edge.weight / edge.deviation**2
            first, second = (slice(7 * index_of[k], 7 * index_of[k] + 7) for k in edge.ends)
            block, gradient = jacobian.T @ weight @ jacobian, jacobian.T @ weight @ residual
            matrix[first, first] += block
            matrix[second, second] += block
            matrix[first, second] -= block
            matrix[second, first] -= block
            vector[first] += gradient
            vector[second] -= gradient
        change = np.zeros(7 * len(nodes))
        change[7:] = -solve_sparse(matrix[7:, 7:], vector[7:])
        for node in nodes[1:]:
            scale, *vectors = change[7 * index_of[node] : 7 * index_of[node] + 7]
            similarities[node] = (
                sim3_from_vector(scale, np.array(vectors[:3]), np.array(vectors[3:]))
                @ similarities[node]
            )
        if outlier_error == last_outlier_error and np.abs(change).max() < GEOMETRY.min_step:
            break
        outlier_error = max(GEOMETRY.outlier_error_factor * outlier_error, last_outlier_error)
    return similarities


def solve_sparse(matrix: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """Return the solution of a symmetric, positive definite system of which most is zero.

    SuperLU gives the same bits with any number of threads; LAPACK does not.
    """
    factors = splu(
        csc_matrix(matrix),
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )
    return np.asarray(factors.solve(vector))


def _residual(
    edge: Edge, similarities: dict[int, np.ndarray]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return an edge's residual at the centre of its points, (7,), its Jacobian, and its weight.

    The residual is the similarity between the positions of the points in the two nodes: the
    logarithm of its scale, its rotation vector and its translation. With the weight, its square is
    the mean square error of the points, as a share of their distances.
    """
    first, second = similarities[edge.first], similarities[edge.second]
    points, scale_of_first = transform_points(first, edge.points), sim3_scale(first)
    centre = points.mean(axis=0)
    difference = first @ edge.similarity @ np.linalg.inv(second)
    scale = sim3_scale(difference)
    residual = np.concatenate(
        [
            [np.log(scale)],
            Rotation.from_matrix(difference[:3, :3] / scale).as_rotvec(),
            transform_points(difference, centre[None])[0] - centre,
        ]
    )
    jacobian = np.eye(7)
    jacobian[4:, 0], jacobian[4:, 1:4] = centre, -cross_matrices(centre[None])[0]
    point_jacobian = np.zeros((len(points), 3, 7))
    offsets = points - centre
    point_jacobian[:, :, 0], point_jacobian[:, :, 1:4] = offsets, -cross_matrices(offsets)
    point_jacobian[:, :, 4:] = np.eye(3)
    point_jacobian /= (scale_of_first * edge.distances)[:, None, None]
    weight = np.einsum("nij,nik->jk", point_jacobian, point_jacobian) / len(points)
    return residual, jacobian, weight
