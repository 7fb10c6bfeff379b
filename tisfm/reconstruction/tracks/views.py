"""Views: the frames from which a path is built, with their matches and their long tracks."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from tisfm.camera import Camera
from tisfm.errors import InputTypeError
from tisfm.motion.sparse_matches import Features, detect_features, match_features
from tisfm.reconstruction.frames.disk_cache import DiskCache
from tisfm.reconstruction.frames.image_motion import flow_scale, halve_down_to, shrink_for_flow
from tisfm.reconstruction.tracks.retrieval import ImageDescriptors, find_similar_views
from tisfm.reconstruction.tracks.settings import TRACKS
from tisfm.reconstruction.tracks.tracker import Observations


@dataclass(frozen=True, kw_only=True)
class View:
    """Tracks and detected points of a frame."""

    frame: int
    observations: Observations  # tracks in the frame
    detected: np.ndarray  # (M, 2) float64: points that are matched by appearance, px

    @classmethod
    def from_arrays(cls, frame: np.ndarray, *arrays: np.ndarray) -> "View":
        """Return the view with these arrays."""
        points, tracks, detected = arrays
        return cls(
            frame=int(frame.item()),
            observations=Observations.from_arrays(points, tracks),
            detected=detected,
        )

    def to_arrays(self) -> tuple[np.ndarray, ...]:
        """Return the frame number, the arrays of the observations, and the detected points."""
        return np.array(self.frame), *self.observations.to_arrays(), self.detected


class ViewSelection:
    """Selects views among the frames of a sequence, and matches them."""

    def __init__(
        self,
        camera: Camera,  # pinhole camera of the frames
        *,
        # Whether matches have to fit the focal length of the camera. Otherwise any focal length may
        # fit.
        is_focal_known: bool = True,
        on_disk: bool = False,  # whether views are stored on disk: then they cannot be dropped
        # whether frames are photographs far apart: many points of large frames are matched
        has_photographs: bool = False,
    ) -> None:
        # selected views, in the order of their frames
        self.views: list[View] | DiskCache[View] = (
            DiskCache(View.to_arrays, View.from_arrays) if on_disk else []
        )
        # by pair of view indices: (N, 2) int32, the indices of their detected points that match
        self.matches: dict[tuple[int, int], np.ndarray] = {}
        self._camera, self._is_focal_known = camera, is_focal_known
        self._has_photographs = has_photographs
        self._descriptors: list[ImageDescriptors] | DiskCache[ImageDescriptors] = (
            DiskCache(ImageDescriptors.to_arrays, ImageDescriptors.from_arrays) if on_disk else []
        )
        self._matchable_views: list[int] = []  # indices of views with enough detected points
        self._tested_pairs: set[tuple[int, int]] = set()

    def set_camera(self, camera: Camera) -> None:
        """Use a camera with a known focal length for later matches."""
        self._camera, self._is_focal_known = camera, True

    def needs_view(
        self,
        observations: Observations,
        longer_side: int,
        min_motion: float | None = None,  # share of the longer side; by default `TRACKS.min_motion`
    ) -> bool:
        """Return whether a frame differs enough from the last view to become a view."""
        min_motion = TRACKS.min_motion if min_motion is None else min_motion
        if not self.views:
            return len(observations.tracks) > 0
        last_observations = self.views[-1].observations
        index0, index1 = last_observations.common_tracks(observations)
        if len(index0) < TRACKS.min_visible_tracks * len(last_observations.tracks):
            return True
        if len(index0) == 0:
            return len(observations.tracks) > 0
        motion = np.hypot(*(observations.points[index1] - last_observations.points[index0]).T)
        return bool(np.median(motion) > min_motion * longer_side)

    def add(
        self, frame: int, grey: np.ndarray, observations: Observations, ignored: np.ndarray | None
    ) -> None:
        """Add a frame, (H, W) uint8, as a view; ignored pixels, (H, W) bool, get no points."""
        features = _detect_features(grey, ignored, in_photograph=self._has_photographs)
        view_index = len(self.views)
        self.views.append(View(frame=frame, observations=observations, detected=features.points))
        self._descriptors.append(ImageDescriptors.from_features(features))
        min_matches, min_share = TRACKS.min_matches, 0.0
        if self._has_photographs:
            min_matches, min_share = TRACKS.min_loop_matches, TRACKS.min_loop_share
        for earlier in self._matchable_views[-TRACKS.matched_views :]:
            self._match(
                earlier, view_index, grey.shape, min_matches=min_matches, min_share=min_share
            )
        if len(features.points) >= TRACKS.min_matches:
            self._matchable_views.append(view_index)

    def close_loops(self, shape: tuple[int, int]) -> None:
        """Match views that show the same scene again (loops), in frames of this shape, px."""
        for pair in find_similar_views(self._descriptors, min_distance=TRACKS.matched_views + 1):
            if pair not in self._tested_pairs:
                self._match(
                    *pair,
                    shape,
                    min_matches=TRACKS.min_loop_matches,
                    min_share=TRACKS.min_loop_share,
                )

    def drop_first(self, count: int) -> None:
        """Drop the first `count` views: the indices of the other views decrease by `count`."""
        if isinstance(self.views, DiskCache) or isinstance(self._descriptors, DiskCache):
            raise InputTypeError("views are stored on disk: they cannot be dropped")
        del self.views[:count], self._descriptors[:count]
        self._matchable_views = [k - count for k in self._matchable_views if k >= count]
        self.matches = {
            (earlier - count, later - count): matches
            for (earlier, later), matches in self.matches.items()
            if earlier >= count
        }
        self._tested_pairs = {(i - count, k - count) for i, k in self._tested_pairs if i >= count}

    def is_out_of_order(self) -> bool:
        """Return whether most views match other views, but not the previous view."""
        count = len(self.views)
        if count < TRACKS.min_ordered_views:
            return False
        next_matches = sum(
            (k, k + 1) in self.matches or self._have_common_tracks(k, k + 1)
            for k in range(count - 1)
        )
        other_matches = {view for pair in self.matches if pair[1] - pair[0] > 1 for view in pair}
        return (
            next_matches < TRACKS.max_next_share * (count - 1)
            and len(other_matches) > TRACKS.min_other_share * count
        )

    def _have_common_tracks(self, first: int, second: int) -> bool:
        index, _ = self.views[first].observations.common_tracks(self.views[second].observations)
        return len(index) >= TRACKS.min_matches

    def _match(
        self,
        earlier: int,
        later: int,
        shape: tuple[int, ...],
        *,
        min_matches: int,
        min_share: float,
    ) -> None:
        """Match two views by appearance; store the matches if enough of them fit one motion."""
        self._tested_pairs.add((earlier, later))
        first, second = (
            self._descriptors[earlier].to_features(),
            self._descriptors[later].to_features(),
        )
        matches = np.stack(match_features(first, second), axis=1)
        if len(matches) < min_matches:
            return
        is_inlier = self._find_inliers(
            first.points[matches[:, 0]], second.points[matches[:, 1]], shape
        )
        if is_inlier is None:
            return
        inliers = matches[is_inlier[:, 0] > 0]
        if len(inliers) >= max(min_matches, min_share * len(matches)):
            self.matches[earlier, later] = inliers.astype(np.int32)

    def _find_inliers(
        self, before: np.ndarray, after: np.ndarray, shape: tuple[int, ...]
    ) -> np.ndarray | None:
        """Return the inliers of one motion among matching points, (N, 2) px, as (N, 1) uint8.

        None is returned if no motion is found.
        """
        height, width = shape
        threshold = TRACKS.epipolar_tolerance * max(height, width) / 640
        try:
            if self._is_focal_known:
                cx, cy = self._camera.center_for(height, width)
                focal = self._camera.focal
                _, is_inlier = cv2.findEssentialMat(
                    before,
                    after,
                    np.array([[focal, 0, cx], [0, focal, cy], [0, 0, 1]]),
                    method=cv2.USAC_MAGSAC,
                    prob=TRACKS.ransac_confidence,
                    threshold=threshold,
                    maxIters=TRACKS.ransac_trials,
                )
            else:
                _, is_inlier = cv2.findFundamentalMat(
                    before,
                    after,
                    cv2.USAC_MAGSAC,
                    threshold,
                    TRACKS.ransac_confidence,
                    TRACKS.ransac_trials,
                )
        except cv2.error:  # OpenCV fails on degenerate matches, for example of overlays
            return None
        return None if is_inlier is None else np.asarray(is_inlier)


def _detect_features(
    grey: np.ndarray, ignored: np.ndarray | None, *, in_photograph: bool = False
) -> Features:
    """Return points of a frame and their descriptors, found on the shrunk frame."""
    if in_photograph:
        small = halve_down_to(grey, TRACKS.photograph_pixels)
        features = detect_features(small, per_cell=TRACKS.photograph_points_per_cell)
    else:
        small = shrink_for_flow(grey)
        features = detect_features(small, per_cell=TRACKS.points_per_cell)
    points = (features.points + 0.5) / flow_scale(small, grey) - 0.5
    if ignored is None:
        return Features(points=points, roots=features.roots)
    column, row = np.rint(points).astype(np.intp).T
    height, width = grey.shape
    is_used = ~ignored[row.clip(0, height - 1), column.clip(0, width - 1)]
    return Features(points=points[is_used], roots=features.roots[is_used])


def choose_long_tracks(
    observations: Sequence[Observations],  # tracks in views
    longer_side: int,  # px, of the frames
) -> list[Observations]:
    """Return the observations of the longest track in each cell of each view.

    Short tracks add work, but hardly any information. With fewer tracks, matches of points by
    appearance, which do not drift, get more weight.
    """
    if not observations:
        return []
    selected: list[np.ndarray] = []
    for cells in TRACKS.cell_counts:
        selected = _longest_per_cell(observations, longer_side / cells)
        if np.median([len(view_tracks) for view_tracks in selected]) >= TRACKS.min_tracks:
            break
    tracks = np.unique(np.concatenate(selected))
    return [
        view_observations.select(np.isin(view_observations.tracks, tracks))
        for view_observations in observations
    ]


def _longest_per_cell(observations: Sequence[Observations], side: float) -> list[np.ndarray]:
    """Return, for each view, the track in each cell that most views show.

    `side` is the side of a cell, px.
    """
    tracks, view_counts = np.unique(
        np.concatenate([view_observations.tracks for view_observations in observations]),
        return_counts=True,
    )
    selected = []
    for view_observations in observations:
        lengths = view_counts[np.searchsorted(tracks, view_observations.tracks)]
        column, row = (view_observations.points // side).astype(np.int64).T
        order = np.lexsort((view_observations.tracks, -lengths, column, row))
        cell = np.stack([row, column], axis=1)[order]
        first = np.ones(len(order), bool)
        first[1:] = (np.diff(cell, axis=0) != 0).any(axis=1)
        selected.append(view_observations.tracks[order[first]])
    return selected
