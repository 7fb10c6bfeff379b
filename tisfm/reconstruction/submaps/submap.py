"""Submaps of a long sequence, with the points that are needed to join them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tisfm.camera import Camera
from tisfm.reconstruction.mapping.models import ViewGraph
from tisfm.reconstruction.mapping.settings import MAPPING
from tisfm.reconstruction.tracks.triangulation import TrackPoints
from tisfm.reconstruction.tracks.views import View

Matches = Mapping[tuple[int, int], np.ndarray]


@dataclass(frozen=True, kw_only=True, eq=False)
class Submap:
    """Views of a span in one coordinate system."""

    span: tuple[int, int]  # the first view of the span, and the view after its last
    # by view, in order: (4, 4) float64, camera to world
    poses: dict[int, np.ndarray]
    groups: list[list[int]]  # the views, divided into consecutive groups
    points: np.ndarray  # (P, 3) float64: the points that were adjusted together with the poses
    visibility: np.ndarray  # (G, P) bool: the points that the views of each group show
    tracks: TrackPoints  # points of the tracks in views that also belong to other spans
    # by view: numbers, (N,) int64, and positions, (N, 3) float64, of its detected points that match
    # views of other spans
    detected: dict[int, tuple[np.ndarray, np.ndarray]]

    def group_of(self, view: int) -> int:
        """Return the number of the group that contains a view."""
        return next(k for k, views in enumerate(self.groups) if views[0] <= view <= views[-1])

    def view_poses(self, views: Sequence[int]) -> np.ndarray:
        """Return the poses of views, (N, 4, 4)."""
        return np.array([self.poses[view] for view in views])

    def distances(self, group: int, points: np.ndarray) -> np.ndarray:
        """Return the distances of points, (N, 3), from the mean position of a group, (N,)."""
        middle = self.view_poses(self.groups[group])[:, :3, 3].mean(axis=0)
        return np.asarray(np.linalg.norm(points - middle, axis=1))

    def detected_at(self, view: int, numbers: np.ndarray) -> np.ndarray:
        """Return the positions of detected points of a view, (N, 3); NaN for unknown positions."""
        numbers_with_position, positions = self.detected[view]
        result = np.full((len(numbers), 3), np.nan)
        if len(numbers_with_position):
            indices = np.searchsorted(numbers_with_position, numbers).clip(
                0, len(numbers_with_position) - 1
            )
            has_position = numbers_with_position[indices] == numbers
            result[has_position] = positions[indices[has_position]]
        return result


class SubmapBuilder:
    """Maps the spans of a sequence one by one."""

    def __init__(
        self,
        # views, matches, camera, shape, is_focal_known: as for
        # `tisfm.reconstruction.mapping.models.find_models`
        views: Sequence[View],
        matches: Matches,
        camera: Camera,
        shape: tuple[int, int],
        # the first view of each submap, and the view after its last
        spans: Sequence[tuple[int, int]],
        group_size: int,  # approximate number of views of a group
        *,
        is_focal_known: bool = True,
    ) -> None:
        self._views, self._matches, self._spans = views, matches, spans
        self._camera, self._shape, self._group_size = camera, shape, group_size
        self._is_focal_known = is_focal_known
        self._cross_span_numbers = _find_cross_span_points(matches, spans)

    def build_submaps(self) -> list[Submap]:
        """Return all submaps. One span may have several submaps."""
        submaps = [self._map_views(list(range(*span))) for span in self._spans]
        # Remaining views of a span are added to a submap of the previous or the next span.
        count = len(submaps)
        for k in range(1, count):
            submaps[k] += self._continue_submap(self._spans[k], submaps[k], submaps[k - 1])
        for k in reversed(range(count - 1)):
            submaps[k] += self._continue_submap(self._spans[k], submaps[k], submaps[k + 1])
        return [submap for span_submaps in submaps for submap in span_submaps]

    def _continue_submap(
        self,
        span: tuple[int, int],
        span_submaps: Sequence[Submap],
        neighbour_submaps: Sequence[Submap],
    ) -> list[Submap]:
        """Return submaps of the remaining views of a span, continued from a neighbour submap."""
        remaining = set(range(*span)).difference(*(submap.poses for submap in span_submaps))
        if len(remaining) < MAPPING.min_views:
            return []
        for other in sorted(neighbour_submaps, key=lambda submap: -len(submap.poses)):
            poses = {view: pose for view, pose in other.poses.items() if span[0] <= view < span[1]}
            if len(poses) < 2:
                continue
            submaps = self._map_views(sorted(remaining.union(poses)), poses)
            if any(not remaining.isdisjoint(submap.poses) for submap in submaps):
                return submaps
        return []

    def _map_views(
        self, numbers: Sequence[int], poses: Mapping[int, np.ndarray] | None = None
    ) -> list[Submap]:
        """Return submaps of some views, mapped alone, or continued from known poses by view."""
        views = [self._views[k] for k in numbers]
        index_of = {view: k for k, view in enumerate(numbers)}
        matches = {
            (index_of[earlier], index_of[later]): indices
            for (earlier, later), indices in self._matches.items()
            if earlier in index_of and later in index_of
        }
        graph = ViewGraph.from_views(
            views, matches, self._shape, is_focal_known=self._is_focal_known
        )
        if poses is None:
            reconstructions = graph.grow_models(self._camera)
        else:
            frame_poses = {views[index_of[view]].frame: pose for view, pose in poses.items()}
            reconstructions = [graph.continue_model(self._camera, frame_poses)]
        return [
            self._make_submap(graph, reconstruction, views, numbers)
            for reconstruction in reconstructions
            if reconstruction.num_reg_images() >= MAPPING.min_views
        ]

    def _make_submap(
        self, graph: ViewGraph, reconstruction: Any, views: Sequence[View], numbers: Sequence[int]
    ) -> Submap:
        model = graph.make_model(reconstruction)
        mapped_views = [k for k, view in enumerate(views) if view.frame in model.poses]
        groups = np.array_split(
            np.array(mapped_views), max(1, round(len(mapped_views) / self._group_size))
        )
        points, observations = _observed_points(reconstruction)
        shared_tracks = [
            views[k].observations.tracks
            for k in mapped_views
            if sum(begin <= numbers[k] < end for begin, end in self._spans) > 1
        ]
        return Submap(
            span=(numbers[0], numbers[-1] + 1),
            poses={numbers[k]: model.poses[views[k].frame] for k in mapped_views},
            groups=[[numbers[k] for k in group] for group in groups],
            points=points,
            visibility=_group_visibility(observations, [k[-1] for k in groups], len(points)),
            tracks=model.points.select(np.concatenate([np.empty(0, np.int64), *shared_tracks])),
            detected=_detected_points(
                graph, points, observations, numbers, self._cross_span_numbers
            ),
        )


def _find_cross_span_points(
    matches: Matches, spans: Sequence[tuple[int, int]]
) -> dict[int, np.ndarray]:
    """Return, by view, the numbers of detected points that match a view with no common span."""
    points: dict[int, list[np.ndarray]] = {}
    for (earlier, later), indices in matches.items():
        if not any(begin <= earlier and later < end for begin, end in spans):
            for view, side in ((earlier, 0), (later, 1)):
                points.setdefault(view, []).append(indices[:, side])
    return {view: np.unique(np.concatenate(parts)) for view, parts in points.items()}


def _observed_points(reconstruction: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return the points of pycolmap's reconstruction, (P, 3), and their observations, (N, 3) int64.

    Each observation has three numbers from 0: of the point, of the view, and of the point within
    the view.
    """
    points, observations = [], []
    for number, (_, point) in enumerate(sorted(reconstruction.points3D.items())):
        points.append(np.array(point.xyz))
        observations += [
            (number, element.image_id - 1, element.point2D_idx) for element in point.track.elements
        ]
    return np.array(points).reshape(-1, 3), np.array(observations, np.int64).reshape(-1, 3)


def _group_visibility(observations: np.ndarray, ends: Sequence[int], count: int) -> np.ndarray:
    """Return whether groups show points, (G, P) bool; `ends` has the last view of each group."""
    visibility = np.zeros((len(ends), count), bool)
    visibility[np.searchsorted(ends, observations[:, 1]), observations[:, 0]] = True
    return visibility


def _detected_points(
    graph: ViewGraph,
    points: np.ndarray,
    observations: np.ndarray,
    numbers: Sequence[int],
    points_of_views: Mapping[int, np.ndarray],
) -> dict[int, tuple[np.ndarray, np.ndarray]]:
    """Return, by view, the numbers and positions of those detected points that are mapped.

    `points_of_views` has the numbers of the requested points of each view.
    """
    mapped_points = {}
    for k in np.unique(observations[:, 1]).tolist():
        view = numbers[k]
        if view not in points_of_views:
            continue
        view_observations = observations[observations[:, 1] == k]
        detected = view_observations[:, 2] - len(graph.views[k].observations.tracks)
        is_requested = np.isin(detected, points_of_views[view])
        order = np.argsort(detected[is_requested])
        mapped_points[view] = (
            detected[is_requested][order],
            points[view_observations[is_requested, 0][order]],
        )
    return mapped_points
