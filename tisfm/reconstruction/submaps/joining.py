"""The path of a long sequence from overlapping submaps, in bounded memory.

Each submap is mapped by itself. The views of a submap are divided into groups. A graph of
similarities then moves each group, so that shared points coincide: points of neighbouring groups,
of consecutive submaps, and of loops. This also corrects the drift of scale along a submap.
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
from tisfm.reconstruction.mapping.incremental import MIN_VIEWS
from tisfm.reconstruction.mapping.models import Model
from tisfm.reconstruction.mapping.solution import FocalEstimate
from tisfm.reconstruction.result.calibration import Calibrate
from tisfm.reconstruction.submaps.submap import Matches, Submap, SubmapBuilder
from tisfm.reconstruction.tracks.tracker import Observations
from tisfm.reconstruction.tracks.triangulation import triangulate_tracks
from tisfm.reconstruction.tracks.views import View

# Values without a stated source were set by hand.

# Largest number of views of a submap.
MAX_VIEWS = 370
# Views that consecutive submaps share.
OVERLAP_VIEWS = 40
# Approximate number of groups into which the views of all submaps are divided.
GROUP_COUNT = 120
# Smallest number of views of a group, roughly.
MIN_GROUP_VIEWS = 8
# The fewest points that two groups of one submap share.
MIN_SHARED_POINTS = 15
# The fewest inliers of a similarity, between submaps and at loops,
MIN_INLIERS = 20
# and their smallest share of all points.
MIN_INLIER_SHARE = 0.5
# Largest number of points that an edge of the graph keeps.
EDGE_POINTS = 60
# Smallest assumed error of a point, as a share of its distance.
MIN_POINT_ERROR = 0.002


def submap_spans(count: int) -> list[tuple[int, int]]:
    """Return the first view of each submap, and the view after its last."""
    if count <= MAX_VIEWS:
        return [(0, count)]
    parts = -(-(count - OVERLAP_VIEWS) // (MAX_VIEWS - OVERLAP_VIEWS))
    begins = [k * (count - OVERLAP_VIEWS) // parts for k in range(parts + 1)]
    return [(begin, end + OVERLAP_VIEWS) for begin, end in pairwise(begins)]


def focal_from_submaps(
    views: Sequence[View],
    matches: Matches,
    camera: Camera,
    shape: tuple[int, int],
    calibrate: Calibrate,
    *,
    max_deviation: float,
) -> FocalEstimate | None:
    """Return the focal length of the first submap that shows it, or else the most certain estimate.

    Arguments are as for `find_models_and_focal`. None is returned if no submap has a path.
    """
    best = None
    for begin, end in submap_spans(len(views)):
        inside = {
            (earlier - begin, later - begin): both
            for (earlier, later), both in matches.items()
            if begin <= earlier and later < end
        }
        own = [views[k] for k in range(begin, end)]
        _, found = find_models_and_focal(
            own, inside, camera, shape, calibrate, max_deviation=max_deviation
        )
        if found is None:
            continue
        if best is None or found.deviation * best.focal < best.deviation * found.focal:
            best = found
        if best.is_certain:
            break
    return best


def models_from_submaps(
    # views, matches, camera, shape, focal_known: as for
    # `tisfm.reconstruction.mapping.models.find_models`
    views: Sequence[View],
    matches: Matches,
    camera: Camera,
    shape: tuple[int, int],
    seen: Sequence[Observations],  # tracks in every frame
    *,
    focal_known: bool = True,
) -> list[Model]:  # The largest model first. Each view is in at most one model.
    """Find poses of views and points of tracks, as `find_models` does, in bounded memory."""
    size = max(MIN_GROUP_VIEWS, len(views) // GROUP_COUNT)
    spans = submap_spans(len(views))
    grower = SubmapBuilder(views, matches, camera, shape, spans, size, focal_known=focal_known)
    parts = grower.parts()
    begins = np.cumsum([0, *(len(part.groups) for part in parts)]).tolist()
    edges = [*_inside(parts, begins), *_joints(parts, begins, views)]
    edges += sorted(_loops(parts, begins, matches), key=lambda edge: -edge.worth)
    whole = []
    for place in optimise_sim3_graph(begins[-1], edges):
        inside = [number for number, begin in enumerate(begins[:-1]) if begin in place]
        poses = _merged(
            [parts[k] for k in inside],
            [[place[node] for node in range(*begins[k : k + 2])] for k in inside],
        )
        whole.append({views[view].frame: pose for view, pose in sorted(poses.items())})
    models, taken = [], set[int]()
    # Submaps that cannot be joined both have the views of their overlap: the larger model keeps
    # them.
    for poses in sorted(whole, key=lambda one: (-len(one), min(one))):
        own = {frame: pose for frame, pose in poses.items() if frame not in taken}
        if len(own) >= MIN_VIEWS:
            taken.update(own)
            models.append(Model(poses=own, points=triangulate_tracks(seen, own, camera, shape)))
    return sorted(models, key=lambda one: (-len(one.poses), min(one.poses)))


def _inside(parts: Sequence[Submap], begins: Sequence[int]) -> Iterator[Edge]:
    """Yield edges between groups of one submap: their coordinates already agree."""
    for part, begin in zip(parts, begins[:-1], strict=True):
        for first in range(len(part.groups)):
            for second in range(first + 1, len(part.groups)):
                both = part.shows[first] & part.shows[second]
                if both.sum() < MIN_SHARED_POINTS:
                    if second > first + 1:
                        continue
                    both = part.shows[first] | part.shows[second]  # the submap stays connected
                points = part.points[both]
                distances = part.distances(first, points)
                yield _edge(
                    begin + first, begin + second, np.eye(4), points, distances, MIN_POINT_ERROR
                )


def _joints(
    parts: Sequence[Submap], begins: Sequence[int], views: Sequence[View]
) -> Iterator[Edge]:
    """Yield edges between groups of submaps with common views, from the tracks of these views."""
    for k, part in enumerate(parts):
        for n, other in enumerate(parts[k + 1 :], start=k + 1):
            shared = sorted(set(part.poses) & set(other.poses))
            if len(shared) < 2:
                continue
            tracks, at, there = np.intersect1d(
                part.tracks.tracks, other.tracks.tracks, assume_unique=True, return_indices=True
            )
            points, others = part.tracks.positions[at], other.tracks.positions[there]
            middle = part.posed(shared)[:, :3, 3].mean(axis=0)
            distances = np.linalg.norm(points - middle, axis=1)
            found = fit_sim3_ransac(
                points, others, distances, fewest=MIN_INLIERS, share=MIN_INLIER_SHARE
            )
            if found is None:
                continue
            similarity, agree = found
            similarity = refine_sim3(
                similarity,
                (points[agree], others[agree]),
                distances[agree],
                (part.posed(shared), other.posed(shared)),
            )
            for first, second, common in _common(part, other, shared):
                here = np.unique(
                    np.concatenate([views[view].observations.tracks for view in common])
                )
                both = agree & np.isin(tracks, here)
                if both.sum() >= MIN_SHARED_POINTS:
                    yield _edge(
                        begins[k] + first, begins[n] + second, similarity,
                        points[both], distances[both], MIN_POINT_ERROR,
                    )  # fmt: skip


def _common(
    part: Submap, other: Submap, shared: Sequence[int]
) -> Iterator[tuple[int, int, list[int]]]:
    """Yield pairs of groups of two submaps, with their common views."""
    for first, views in enumerate(part.groups):
        for second, others in enumerate(other.groups):
            common = sorted(set(shared).intersection(views, others))
            if common:
                yield first, second, common


def _loops(parts: Sequence[Submap], begins: Sequence[int], matches: Matches) -> Iterator[Edge]:
    """Yield edges between groups of different submaps that show the same scene (loops)."""
    found: dict[tuple[int, int], list[tuple[np.ndarray, ...]]] = {}
    holding: dict[int, list[int]] = {}
    for number, part in enumerate(parts):
        for view in part.detected:
            holding.setdefault(view, []).append(number)
    for (earlier, later), both in sorted(matches.items()):
        for k in holding.get(earlier, ()):
            for n in holding.get(later, ()):
                part, other = parts[k], parts[n]
                if part.span == other.span:
                    continue
                points = part.detected_at(earlier, both[:, 0])
                others = other.detected_at(later, both[:, 1])
                known = np.isfinite(points[:, 0]) & np.isfinite(others[:, 0])
                if not known.any():
                    continue
                first, second = part.group_of(earlier), other.group_of(later)
                distances = part.distances(first, points[known])
                found.setdefault((begins[k] + first, begins[n] + second), []).append(
                    (points[known], others[known], distances)
                )
    for (first, second), lots in sorted(found.items()):
        points, others, distances = map(np.concatenate, zip(*lots, strict=True))
        _, once = np.unique(np.hstack([points, others]), axis=0, return_index=True)
        points, others, distances = points[once], others[once], distances[once]
        fit = fit_sim3_ransac(points, others, distances, fewest=MIN_INLIERS, share=MIN_INLIER_SHARE)
        if fit is not None:
            similarity, agree = fit
            off = relative_errors(similarity, points[agree], others[agree], distances[agree])
            deviation = float(np.median(off))
            yield _edge(
                first, second, similarity, points[agree], distances[agree], deviation, certain=False
            )


def _edge(
    first: int,
    second: int,
    similarity: np.ndarray,
    points: np.ndarray,
    distances: np.ndarray,
    deviation: float,
    certain: bool = True,
) -> Edge:
    some = np.linspace(0, len(points) - 1, min(len(points), EDGE_POINTS)).astype(int)
    return Edge(
        first=first,
        second=second,
        similarity=similarity,
        points=points[some],
        distances=distances[some],
        deviation=max(deviation, MIN_POINT_ERROR),
        worth=float(len(points)),
        certain=certain,
    )


def _merged(
    parts: Sequence[Submap], places: Sequence[Sequence[np.ndarray]]
) -> dict[int, np.ndarray]:
    """Return the poses of views in common coordinates.

    The pose of a view is a weighted mean. Weights change linearly from the middle of a group to the
    middle of the next group, and decrease towards both ends of a submap.
    """
    found: dict[int, list[tuple[np.ndarray, float]]] = {}
    for part, place in zip(parts, places, strict=True):
        middles = [float(np.mean(views)) for views in part.groups]
        begin, end = part.span
        for view, pose in part.poses.items():
            inside = min(view - begin + 1, end - view)  # weight, small near both ends
            at = float(np.interp(view, middles, np.arange(len(middles))))
            low = min(int(at), len(middles) - 1)
            high = min(low + 1, len(middles) - 1)
            for group, share in ((low, 1 - at + low), (high, at - low)):
                if share > 0:
                    found.setdefault(view, []).append(
                        (transform_pose(place[group], pose), share * inside)
                    )
    return {
        view: mean_pose(np.array([pose for pose, _ in several]), np.array([w for _, w in several]))
        for view, several in found.items()
    }
