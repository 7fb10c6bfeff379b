"""Views: the frames from which a path is built, with their matches and their long tracks."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from tisfm.camera import Camera
from tisfm.errors import InputTypeError
from tisfm.motion.sparse_matches import Features, detect_features, match_features
from tisfm.reconstruction.frames.disk_cache import DiskCache
from tisfm.reconstruction.frames.frame_flow import flow_scale, shrink_for_flow
from tisfm.reconstruction.tracks.retrieval import ImageDescriptors, find_similar_views
from tisfm.reconstruction.tracks.tracker import Observations

# Values without a stated source were set by hand.

# A frame becomes a view if the median motion of tracks since the last view exceeds this share of
# the longer side,
MIN_MOTION = 0.025
# or if less than this share of the last view's tracks is still visible.
MIN_KEPT_TRACKS = 0.35
# Detected points per cell: fewer than for pairs, since a view is matched with several views.
POINTS_PER_CELL = 4
# Number of previous views with which a view is matched by appearance.
MATCHED_VIEWS = 3
# The fewest matches of two neighbouring views.
MIN_MATCHES = 15
# The fewest matches of two views at a loop that one motion explains,
MIN_LOOP_MATCHES = 25
# and their smallest share of all matches.
MIN_LOOP_SHARE = 0.4
# Frames are out of order if, of at least this number of views,
MIN_ORDERED_VIEWS = 8
# at most this share matches the previous view,
MAX_FOLLOWING_SHARE = 0.4
# and at least this share matches other views.
MIN_ELSEWHERE_SHARE = 0.7
# px, if the longer side has 640: largest distance of a match from its epipolar line.
EPIPOLAR_TOLERANCE = 2.0
# Largest number of RANSAC trials.
RANSAC_TRIALS = 500
# Cells along the longer side: each cell of a view keeps the track that most views see. The first
# number with enough tracks is used, since parts of frames may be bare.
CELL_COUNTS = (10, 16, 24)
# Median number of tracks of a view that is enough.
MIN_TRACKS = 60


@dataclass(frozen=True, kw_only=True)
class View:
    """Tracks and detected points of a frame."""

    frame: int
    observations: Observations  # tracks in the frame
    detected: np.ndarray  # (M, 2) float64: points that are matched by appearance, px

    @classmethod
    def of_arrays(cls, frame: np.ndarray, *arrays: np.ndarray) -> "View":
        """Return the view with these arrays."""
        points, tracks, detected = arrays
        return cls(
            frame=int(frame.item()),
            observations=Observations.of_arrays(points, tracks),
            detected=detected,
        )

    def arrays(self) -> tuple[np.ndarray, ...]:
        """Return its arrays."""
        return np.array(self.frame), *self.observations.arrays(), self.detected


class ViewSelection:
    """Selects views among the frames of a sequence, and matches them."""

    def __init__(
        self,
        camera: Camera,  # pinhole camera of the frames
        *,
        # Whether matches have to fit its focal length. Otherwise any focal length may fit.
        focal_known: bool = True,
        on_disk: bool = False,  # whether views are stored on disk: then they cannot be dropped
    ) -> None:
        # selected views, in the order of their frames
        self.views: list[View] | DiskCache[View] = (
            DiskCache(View.arrays, View.of_arrays) if on_disk else []
        )
        # dict of (int, int) to (N, 2) int32 array: for pairs of indices of views: indices of their
        # detected points that match
        self.matches: dict[tuple[int, int], np.ndarray] = {}
        self._camera, self._focal_known = camera, focal_known
        self._looks: list[ImageDescriptors] | DiskCache[ImageDescriptors] = (
            DiskCache(ImageDescriptors.arrays, ImageDescriptors.of_arrays) if on_disk else []
        )
        self._matchable: list[int] = []  # views with enough detected points
        self._compared: set[tuple[int, int]] = set()

    def set_camera(self, camera: Camera) -> None:
        """Use a camera with a known focal length for later matches."""
        self._camera, self._focal_known = camera, True

    def needs_view(self, seen: Observations, longer_side: int, share: float = MIN_MOTION) -> bool:
        """Return whether a frame differs enough from the last view to become a view."""
        if not self.views:
            return len(seen.tracks) > 0
        before = self.views[-1].observations
        index0, index1 = before.shared(seen)
        if len(index0) < MIN_KEPT_TRACKS * len(before.tracks):
            return True
        if len(index0) == 0:
            return len(seen.tracks) > 0
        moved = np.hypot(*(seen.points[index1] - before.points[index0]).T)
        return bool(np.median(moved) > share * longer_side)

    def add(
        self, frame: int, grey: np.ndarray, seen: Observations, ignored: np.ndarray | None
    ) -> None:
        """Add a frame, (H, W) uint8, as a view; ignored pixels, (H, W) bool, get no points."""
        found = _described(grey, ignored)
        number = len(self.views)
        self.views.append(View(frame=frame, observations=seen, detected=found.points))
        self._looks.append(ImageDescriptors.of(found))
        for earlier in self._matchable[-MATCHED_VIEWS:]:
            self._match(earlier, number, grey.shape, fewest=MIN_MATCHES, share=0.0)
        if len(found.points) >= MIN_MATCHES:
            self._matchable.append(number)

    def close_loops(self, shape: tuple[int, int]) -> None:
        """Match views that show the same scene again (loops), in frames of this shape, px."""
        for pair in find_similar_views(self._looks, apart=MATCHED_VIEWS + 1):
            if pair not in self._compared:
                self._match(*pair, shape, fewest=MIN_LOOP_MATCHES, share=MIN_LOOP_SHARE)

    def drop_first(self, count: int) -> None:
        """Drop the first views."""
        if isinstance(self.views, DiskCache) or isinstance(self._looks, DiskCache):
            raise InputTypeError("views lie on disk: they cannot be forgotten")
        del self.views[:count], self._looks[:count]
        self._matchable = [k - count for k in self._matchable if k >= count]
        self.matches = {
            (earlier - count, later - count): both
            for (earlier, later), both in self.matches.items()
            if earlier >= count
        }
        self._compared = {(i - count, k - count) for i, k in self._compared if i >= count}

    def is_out_of_order(self) -> bool:
        """Return whether most views match other views, but not the previous one."""
        count = len(self.views)
        if count < MIN_ORDERED_VIEWS:
            return False
        follows = sum(
            (k, k + 1) in self.matches or self._share_tracks(k, k + 1) for k in range(count - 1)
        )
        others = {view for pair in self.matches if pair[1] - pair[0] > 1 for view in pair}
        return (
            follows < MAX_FOLLOWING_SHARE * (count - 1)
            and len(others) > MIN_ELSEWHERE_SHARE * count
        )

    def _share_tracks(self, first: int, second: int) -> bool:
        index, _ = self.views[first].observations.shared(self.views[second].observations)
        return len(index) >= MIN_MATCHES

    def _match(
        self, earlier: int, later: int, shape: tuple[int, ...], *, fewest: int, share: float
    ) -> None:
        self._compared.add((earlier, later))
        first, second = self._looks[earlier].described(), self._looks[later].described()
        both = np.stack(match_features(first, second), axis=1)
        if len(both) < fewest:
            return
        inlier = self._fitting(first.points[both[:, 0]], second.points[both[:, 1]], shape)
        if inlier is None:
            return
        agreed = both[inlier[:, 0] > 0]
        if len(agreed) >= max(fewest, share * len(both)):
            self.matches[earlier, later] = agreed.astype(np.int32)

    def _fitting(
        self, before: np.ndarray, after: np.ndarray, shape: tuple[int, ...]
    ) -> np.ndarray | None:
        """Return the inliers of one motion, (N, 1); None if there is no motion."""
        height, width = shape
        threshold = EPIPOLAR_TOLERANCE * max(height, width) / 640
        try:
            if self._focal_known:
                cx, cy = self._camera.center_for(height, width)
                focal = self._camera.focal
                _, inlier = cv2.findEssentialMat(
                    before,
                    after,
                    np.array([[focal, 0, cx], [0, focal, cy], [0, 0, 1]]),
                    method=cv2.USAC_MAGSAC,
                    prob=0.999,
                    threshold=threshold,
                    maxIters=RANSAC_TRIALS,
                )
            else:
                _, inlier = cv2.findFundamentalMat(
                    before, after, cv2.USAC_MAGSAC, threshold, 0.999, RANSAC_TRIALS
                )
        except cv2.error:  # OpenCV fails on degenerate matches, for example of overlays
            return None
        return None if inlier is None else np.asarray(inlier)


def _described(grey: np.ndarray, ignored: np.ndarray | None) -> Features:
    """Return points of a frame and their descriptors, found on the shrunk frame."""
    small = shrink_for_flow(grey)
    found = detect_features(small, per_cell=POINTS_PER_CELL)
    points = (found.points + 0.5) / flow_scale(small, grey) - 0.5
    if ignored is None:
        return Features(points=points, roots=found.roots)
    column, row = np.rint(points).astype(np.intp).T
    height, width = grey.shape
    kept = ~ignored[row.clip(0, height - 1), column.clip(0, width - 1)]
    return Features(points=points[kept], roots=found.roots[kept])


def choose_long_tracks(
    seen: Sequence[Observations],  # tracks in views
    longer_side: int,  # longer side of the frames, px
) -> list[Observations]:
    """Return the observations of the longest track in each cell of each view.

    A track that few views see adds work but hardly any information that long tracks do not have.
    With fewer tracks, matches of points by appearance, which do not drift, get more weight.
    """
    if not seen:
        return []
    chosen: list[np.ndarray] = []
    for cells in CELL_COUNTS:
        chosen = _chosen(seen, longer_side / cells)
        if np.median([len(one) for one in chosen]) >= MIN_TRACKS:
            break
    kept = np.unique(np.concatenate(chosen))
    return [_of(one, np.isin(one.tracks, kept)) for one in seen]


def _chosen(seen: Sequence[Observations], side: float) -> list[np.ndarray]:
    """Return, for each view, the track of each cell of a side in px that most views see."""
    tracks, views = np.unique(np.concatenate([one.tracks for one in seen]), return_counts=True)
    chosen = []
    for one in seen:
        count = views[np.searchsorted(tracks, one.tracks)]
        column, row = (one.points // side).astype(np.int64).T
        order = np.lexsort((one.tracks, -count, column, row))
        cell = np.stack([row, column], axis=1)[order]
        first = np.ones(len(order), bool)
        first[1:] = (np.diff(cell, axis=0) != 0).any(axis=1)
        chosen.append(one.tracks[order[first]])
    return chosen


def _of(seen: Observations, kept: np.ndarray) -> Observations:
    return Observations(points=seen.points[kept], tracks=seen.tracks[kept])
