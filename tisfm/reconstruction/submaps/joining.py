"""The path of a long sequence from overlapping submaps, in bounded memory.

Each submap is mapped by itself. The views of a submap are divided into groups. A graph of
similarities then moves each group, so that shared points coincide: points of neighbouring groups,
of consecutive submaps, and of loops. This graph also corrects the drift of scale along a submap.
"""

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np

from tisfm.camera import Camera
from tisfm.reconstruction.calibration.self_calibration import find_models_and_focal
from tisfm.reconstruction.geometry.sim3 import (
    fit_sim3_ransac,
    mean_pose,
    refine_sim3,
    relative_errors,
    transform_pose,
)
from tisfm.reconstruction.geometry.sim3_graph import Edge, optimise_sim3_graph
from tisfm.reconstruction.mapping.models import Model
from tisfm.reconstruction.mapping.settings import MAPPING
from tisfm.reconstruction.mapping.solution import FocalEstimate
from tisfm.reconstruction.result.calibration import Calibrate
from tisfm.reconstruction.submaps.settings import SUBMAPS
from tisfm.reconstruction.submaps.submap import Matches, Submap, SubmapBuilder
from tisfm.reconstruction.tracks.tracker import Observations
from tisfm.reconstruction.tracks.triangulation import triangulate_tracks
from tisfm.reconstruction.tracks.views import View


def submap_spans(count: int) -> list[tuple[int, int]]:
    """Return the first view of each submap, and the view after its last."""
    if count <= SUBMAPS.max_views:
        return [(0, count)]
    parts = -(-(count - SUBMAPS.overlap_views) // (SUBMAPS.max_views - SUBMAPS.overlap_views))
    begins = [k * (count - SUBMAPS.overlap_views) // parts for k in range(parts + 1)]
    return [(begin, end + SUBMAPS.overlap_views) for begin, end in pairwise(begins)]


def focal_from_submaps(
    views: Sequence[View],
    matches: Matches,
    camera: Camera,
    shape: tuple[int, int],
    calibrate: Calibrate,
    *,
    max_deviation: float,
) -> FocalEstimate | None:
    """Return the focal length of the first submap that shows it well, or the best estimate.

    The best estimate has the smallest relative standard deviation. Arguments are as for
    `find_models_and_focal`. None is returned if no submap has a path.
    """
    best_estimate = None
    for begin, end in submap_spans(len(views)):
        span_matches = {
            (earlier - begin, later - begin): indices
            for (earlier, later), indices in matches.items()
            if begin <= earlier and later < end
        }
        span_views = [views[k] for k in range(begin, end)]
        _, estimate = find_models_and_focal(
            span_views, span_matches, camera, shape, calibrate, max_deviation=max_deviation
        )
        if estimate is None:
            continue
        if (
            best_estimate is None
            or estimate.deviation * best_estimate.focal < best_estimate.deviation * estimate.focal
        ):
            best_estimate = estimate
        if best_estimate.is_certain:
            break
    return best_estimate


def models_from_submaps(
    # views, matches, camera, shape, is_focal_known: as for
    # `tisfm.reconstruction.mapping.models.find_models`
    views: Sequence[View],
    matches: Matches,
    camera: Camera,
    shape: tuple[int, int],
    observations: Sequence[Observations],  # tracks in every frame
    *,
    is_focal_known: bool = True,
) -> list[Model]:  # The largest model first. Each view is in at most one model.
    """Find poses of views and points of tracks, as `find_models` does, in bounded memory."""
    group_size = max(SUBMAPS.min_group_views, len(views) // SUBMAPS.group_count)
    spans = submap_spans(len(views))
    builder = SubmapBuilder(
        views, matches, camera, shape, spans, group_size, is_focal_known=is_focal_known
    )
    submaps = builder.build_submaps()
    # Nodes of the graph are groups of views: the first node of each submap, and the number of nodes
    first_nodes = np.cumsum([0, *(len(submap.groups) for submap in submaps)]).tolist()
    edges = [
        *_edges_within_submaps(submaps, first_nodes),
        *_edges_of_overlaps(submaps, first_nodes, views),
    ]
    edges += sorted(_edges_of_loops(submaps, first_nodes, matches), key=lambda edge: -edge.weight)
    paths = []
    for similarities in optimise_sim3_graph(first_nodes[-1], edges):
        submap_numbers = [
            number
            for number, first_node in enumerate(first_nodes[:-1])
            if first_node in similarities
        ]
        poses = _merge_poses(
            [submaps[k] for k in submap_numbers],
            [
                [similarities[node] for node in range(*first_nodes[k : k + 2])]
                for k in submap_numbers
            ],
        )
        paths.append({views[view].frame: pose for view, pose in sorted(poses.items())})
    models, used_frames = [], set[int]()
    # If two submaps cannot be joined, both have the views of their overlap: the larger model keeps
    # these views.
    for path in sorted(paths, key=lambda path: (-len(path), min(path))):
        poses = {frame: pose for frame, pose in path.items() if frame not in used_frames}
        if len(poses) >= MAPPING.min_views:
            used_frames.update(poses)
            points = triangulate_tracks(observations, poses, camera, shape)
            models.append(Model(poses=poses, points=points))
    return sorted(models, key=lambda model: (-len(model.poses), min(model.poses)))


def _edges_within_submaps(submaps: Sequence[Submap], first_nodes: Sequence[int]) -> Iterator[Edge]:
    """Yield edges between groups of one submap: the coordinates of the groups already agree."""
    for submap, first_node in zip(submaps, first_nodes[:-1], strict=True):
        visibility = submap.visibility
        for first in range(len(submap.groups)):
            for second in range(first + 1, len(submap.groups)):
                is_shared = visibility[first] & visibility[second]
                if is_shared.sum() < SUBMAPS.min_shared_points:
                    if second > first + 1:
                        continue
                    # Neighbouring groups are always connected, if need be by all their points.
                    is_shared = visibility[first] | visibility[second]
                points = submap.points[is_shared]
                distances = submap.distances(first, points)
                yield _make_edge(
                    first_node + first, first_node + second, np.eye(4), points, distances
                )


def _edges_of_overlaps(
    submaps: Sequence[Submap], first_nodes: Sequence[int], views: Sequence[View]
) -> Iterator[Edge]:
    """Yield edges between groups of submaps with common views, from the tracks of these views."""
    for k, submap in enumerate(submaps):
        for n, other in enumerate(submaps[k + 1 :], start=k + 1):
            shared_views = sorted(set(submap.poses) & set(other.poses))
            if len(shared_views) < 2:
                continue
            tracks, indices, other_indices = np.intersect1d(
                submap.tracks.tracks, other.tracks.tracks, assume_unique=True, return_indices=True
            )
            points = submap.tracks.positions[indices]
            others = other.tracks.positions[other_indices]
            centre = submap.view_poses(shared_views)[:, :3, 3].mean(axis=0)
            distances = np.linalg.norm(points - centre, axis=1)
            fit = fit_sim3_ransac(points, others, distances)
            if fit is None:
                continue
            similarity, is_inlier = fit
            similarity = refine_sim3(
                similarity,
                (points[is_inlier], others[is_inlier]),
                distances[is_inlier],
                (submap.view_poses(shared_views), other.view_poses(shared_views)),
            )
            for first, second, common_views in _group_pairs(submap, other, shared_views):
                visible_tracks = [views[view].observations.tracks for view in common_views]
                is_shared = is_inlier & np.isin(tracks, np.unique(np.concatenate(visible_tracks)))
                if is_shared.sum() >= SUBMAPS.min_shared_points:
                    yield _make_edge(
                        first_nodes[k] + first, first_nodes[n] + second, similarity,
                        points[is_shared], distances[is_shared],
                    )  # fmt: skip


def _group_pairs(
    submap: Submap, other: Submap, shared_views: Sequence[int]
) -> Iterator[tuple[int, int, list[int]]]:
    """Yield pairs of groups of two submaps, with their common views."""
    for first, views in enumerate(submap.groups):
        for second, others in enumerate(other.groups):
            common_views = sorted(set(shared_views).intersection(views, others))
            if common_views:
                yield first, second, common_views


def _edges_of_loops(
    submaps: Sequence[Submap], first_nodes: Sequence[int], matches: Matches
) -> Iterator[Edge]:
    """Yield edges between groups of different submaps that show the same scene (loops)."""
    parts_of_edges: dict[tuple[int, int], list[tuple[np.ndarray, ...]]] = {}
    submaps_of_view: dict[int, list[int]] = {}
    for number, submap in enumerate(submaps):
        for view in submap.detected:
            submaps_of_view.setdefault(view, []).append(number)
    for (earlier, later), indices in sorted(matches.items()):
        for k in submaps_of_view.get(earlier, ()):
            for n in submaps_of_view.get(later, ()):
                submap, other = submaps[k], submaps[n]
                if submap.span == other.span:
                    continue
                points = submap.detected_at(earlier, indices[:, 0])
                others = other.detected_at(later, indices[:, 1])
                has_positions = np.isfinite(points[:, 0]) & np.isfinite(others[:, 0])
                if not has_positions.any():
                    continue
                first, second = submap.group_of(earlier), other.group_of(later)
                distances = submap.distances(first, points[has_positions])
                parts_of_edges.setdefault(
                    (first_nodes[k] + first, first_nodes[n] + second), []
                ).append((points[has_positions], others[has_positions], distances))
    for (first, second), parts in sorted(parts_of_edges.items()):
        points, others, distances = map(np.concatenate, zip(*parts, strict=True))
        _, unique_indices = np.unique(np.hstack([points, others]), axis=0, return_index=True)
        points, others, distances = (
            points[unique_indices],
            others[unique_indices],
            distances[unique_indices],
        )
        fit = fit_sim3_ransac(points, others, distances)
        if fit is not None:
            similarity, is_inlier = fit
            points, others, distances = (
                values[is_inlier] for values in (points, others, distances)
            )
            deviation = float(np.median(relative_errors(similarity, points, others, distances)))
            yield _make_edge(
                first, second, similarity, points, distances, deviation, is_certain=False
            )


def _make_edge(
    first: int,
    second: int,
    similarity: np.ndarray,
    points: np.ndarray,
    distances: np.ndarray,
    deviation: float = 0.0,
    *,
    is_certain: bool = True,
) -> Edge:
    sample = np.linspace(0, len(points) - 1, min(len(points), SUBMAPS.max_edge_points)).astype(int)
    return Edge(
        first=first,
        second=second,
        similarity=similarity,
        points=points[sample],
        distances=distances[sample],
        deviation=max(deviation, SUBMAPS.min_point_error),
        weight=float(len(points)),
        is_certain=is_certain,
    )


def _merge_poses(
    submaps: Sequence[Submap], similarities: Sequence[Sequence[np.ndarray]]
) -> dict[int, np.ndarray]:
    """Return the poses of views in common coordinates.

    The pose of a view is a weighted mean. Weights change linearly from the middle of a group to the
    middle of the next group, and decrease towards both ends of a submap.
    """
    weighted_poses: dict[int, list[tuple[np.ndarray, float]]] = {}
    for submap, group_similarities in zip(submaps, similarities, strict=True):
        middles = [float(np.mean(views)) for views in submap.groups]
        begin, end = submap.span
        for view, pose in submap.poses.items():
            end_weight = min(view - begin + 1, end - view)  # small near both ends of the submap
            position = float(np.interp(view, middles, np.arange(len(middles))))
            lower_group = min(int(position), len(middles) - 1)
            upper_group = min(lower_group + 1, len(middles) - 1)
            for group, weight in (
                (lower_group, 1 - position + lower_group),
                (upper_group, position - lower_group),
            ):
                if weight > 0:
                    weighted_poses.setdefault(view, []).append(
                        (transform_pose(group_similarities[group], pose), weight * end_weight)
                    )
    return {
        view: mean_pose(*map(np.array, zip(*poses, strict=True)))
        for view, poses in weighted_poses.items()
    }
