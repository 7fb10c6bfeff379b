"""Submaps of a long sequence, with the points that are needed to join them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tisfm.camera import Camera
from tisfm.reconstruction.mapping.incremental import MIN_VIEWS
from tisfm.reconstruction.mapping.models import ViewGraph
from tisfm.reconstruction.tracks.triangulation import TrackPoints
from tisfm.reconstruction.tracks.views import View

Matches = Mapping[tuple[int, int], np.ndarray]


@dataclass(frozen=True, kw_only=True, eq=False)
class Submap:
    """Views of a span in one coordinate system."""

    span: tuple[int, int]  # the first view of the span, and the view after its last
    # dict of int to (4, 4) float64: camera to world, by view, in order
    poses: dict[int, np.ndarray]
    groups: list[list[int]]  # the views, divided into consecutive groups
    points: np.ndarray  # (P, 3) float64: the points that were adjusted together with the poses
    shows: np.ndarray  # (G, P) bool: the points that the views of each group show
    tracks: TrackPoints  # points of the tracks in views that are also in other spans
    # dict of int to ((N,) int64, (N, 3) float64): by view: numbers and positions of detected points
    # that match views of other spans
    detected: dict[int, tuple[np.ndarray, np.ndarray]]

    def group_of(self, view: int) -> int:
        """Return the number of the group that contains a view."""
        return next(k for k, views in enumerate(self.groups) if views[0] <= view <= views[-1])

    def posed(self, views: Sequence[int]) -> np.ndarray:
        """Return the poses of views, (N, 4, 4)."""
        return np.array([self.poses[view] for view in views])

    def distances(self, group: int, points: np.ndarray) -> np.ndarray:
        """Return the distances of points, (N, 3), from the mean position of a group, (N,)."""
        middle = self.posed(self.groups[group])[:, :3, 3].mean(axis=0)
        return np.asarray(np.linalg.norm(points - middle, axis=1))

    def detected_at(self, view: int, numbers: np.ndarray) -> np.ndarray:
        """Return the positions of detected points of a view, (N, 3); NaN for unknown ones."""
        known, positions = self.detected[view]
        there = np.full((len(numbers), 3), np.nan)
        if len(known):
            place = np.searchsorted(known, numbers).clip(0, len(known) - 1)
            same = known[place] == numbers
            there[same] = positions[place[same]]
        return there


class SubmapBuilder:
    """Maps the spans of a sequence one by one."""

    def __init__(
        self,
        # views, matches, camera, shape, focal_known: as for
        # `tisfm.reconstruction.mapping.models.find_models`
        views: Sequence[View],
        matches: Matches,
        camera: Camera,
        shape: tuple[int, int],
        # sequence of (int, int): the first view of each submap, and the view after its last
        spans: Sequence[tuple[int, int]],
        size: int,  # approximate number of views of a group
        *,
        focal_known: bool = True,
    ) -> None:
        self._views, self._matches, self._spans = views, matches, spans
        self._camera, self._shape, self._size = camera, shape, size
        self._focal_known = focal_known
        self._elsewhere = _matched_elsewhere(matches, spans)

    def parts(self) -> list[Submap]:
        """Return all submaps. One span may have several submaps."""
        found = [self._grown(list(range(*span))) for span in self._spans]
        # Remaining views of a span are added to a submap of the previous or the next span.
        count = len(found)
        for k in range(1, count):
            found[k] += self._continued(self._spans[k], found[k], found[k - 1])
        for k in reversed(range(count - 1)):
            found[k] += self._continued(self._spans[k], found[k], found[k + 1])
        return [part for several in found for part in several]

    def _continued(
        self, span: tuple[int, int], own: Sequence[Submap], others: Sequence[Submap]
    ) -> list[Submap]:
        """Return submaps of the remaining views of a span, continued from a neighbour submap."""
        left = set(range(*span)).difference(*(part.poses for part in own))
        if len(left) < MIN_VIEWS:
            return []
        for other in sorted(others, key=lambda part: -len(part.poses)):
            known = {view: pose for view, pose in other.poses.items() if span[0] <= view < span[1]}
            if len(known) < 2:
                continue
            grown = self._grown(sorted(left.union(known)), known)
            if any(not left.isdisjoint(part.poses) for part in grown):
                return grown
        return []

    def _grown(
        self, numbers: Sequence[int], known: Mapping[int, np.ndarray] | None = None
    ) -> list[Submap]:
        """Return submaps of some views, mapped by themselves or continued from known poses."""
        views, place = (
            [self._views[k] for k in numbers],
            {view: k for k, view in enumerate(numbers)},
        )
        inside = {
            (place[earlier], place[later]): both
            for (earlier, later), both in self._matches.items()
            if earlier in place and later in place
        }
        shared = ViewGraph.of(views, inside, self._shape, focal_known=self._focal_known)
        if known is None:
            grown = shared.grow_models(self._camera)
        else:
            by_frame = {views[place[view]].frame: pose for view, pose in known.items()}
            grown = [shared.continue_model(self._camera, by_frame)]
        return [
            self._part(shared, whole, views, numbers)
            for whole in grown
            if whole.num_reg_images() >= MIN_VIEWS
        ]

    def _part(
        self,
        shared: ViewGraph,
        whole: Any,
        views: Sequence[View],
        numbers: Sequence[int],
    ) -> Submap:
        model = shared.model(whole)
        inside = [k for k, view in enumerate(views) if view.frame in model.poses]
        groups = np.array_split(np.array(inside), max(1, round(len(inside) / self._size)))
        points, shown = _shown(whole)
        twice = [
            views[k].observations.tracks
            for k in inside
            if sum(begin <= numbers[k] < end for begin, end in self._spans) > 1
        ]
        return Submap(
            span=(numbers[0], numbers[-1] + 1),
            poses={numbers[k]: model.poses[views[k].frame] for k in inside},
            groups=[[numbers[k] for k in some] for some in groups],
            points=points,
            shows=_by_group(shown, [int(some[-1]) for some in groups], len(points)),
            tracks=model.points.select(np.concatenate([np.empty(0, np.int64), *twice])),
            detected=_detected(shared, points, shown, numbers, self._elsewhere),
        )


def _matched_elsewhere(matches: Matches, spans: Sequence[tuple[int, int]]) -> dict[int, np.ndarray]:
    """Return, by view, the detected points that match views outside every common span."""
    found: dict[int, list[np.ndarray]] = {}
    for (earlier, later), both in matches.items():
        if not any(begin <= earlier and later < end for begin, end in spans):
            for view, side in ((earlier, 0), (later, 1)):
                found.setdefault(view, []).append(both[:, side])
    return {view: np.unique(np.concatenate(lots)) for view, lots in found.items()}


def _shown(whole: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return the points of pycolmap's reconstruction, (P, 3), and their observations, (N, 3) int64.

    Each observation has the number of the point, of the view, and of the point within the view; all
    from 0.
    """
    points, shown = [], []
    for number, (_, point) in enumerate(sorted(whole.points3D.items())):
        points.append(np.array(point.xyz))
        shown += [(number, one.image_id - 1, one.point2D_idx) for one in point.track.elements]
    return np.array(points).reshape(-1, 3), np.array(shown, np.int64).reshape(-1, 3)


def _by_group(shown: np.ndarray, ends: Sequence[int], count: int) -> np.ndarray:
    """Return whether groups show points, (G, P) bool; `ends` has the last view of each group."""
    shows = np.zeros((len(ends), count), bool)
    shows[np.searchsorted(ends, shown[:, 1]), shown[:, 0]] = True
    return shows


def _detected(
    shared: ViewGraph,
    points: np.ndarray,
    shown: np.ndarray,
    numbers: Sequence[int],
    wanted: Mapping[int, np.ndarray],
) -> dict[int, tuple[np.ndarray, np.ndarray]]:
    """Return, by view, the numbers and positions of the wanted points with known positions."""
    found = {}
    for k in np.unique(shown[:, 1]).tolist():
        view = numbers[k]
        if view not in wanted:
            continue
        own = shown[shown[:, 1] == k]
        detected = own[:, 2] - len(shared.views[k].observations.tracks)
        kept = np.isin(detected, wanted[view])
        order = np.argsort(detected[kept])
        found[view] = detected[kept][order], points[own[kept, 0][order]]
    return found
