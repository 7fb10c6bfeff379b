"""The camera's path through a sequence."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import cv2
import numpy as np

from tisfm.camera import Camera
from tisfm.motion.sparse_matches import Described, alike, described
from tisfm.outcome import Status
from tisfm.reconstruction.mapping import Model, View, models_of, pose_from_points
from tisfm.reconstruction.tracks import Seen, Tracker
from tisfm.settings import Settings

# A frame becomes a view where tracks have moved by this share of the longer side since the last
# view, or fewer than this share of its tracks are still seen.
MOVED, KEPT = 0.025, 0.7
MATCHED = (1, 2, 3)  # views before, that a view is matched with by what points look like
FEWEST_MATCHES = 15
INLIER = 2.0  # px, of 640 across: from an epipolar line
TRIALS = 500
TRACKING = Settings.preset("fast")  # of the image motion that tracks follow


@dataclass(frozen=True, kw_only=True)
class Piece:
    """Frames in one coordinate system, of one scale.

    Attributes
    ----------
    poses : dict of int to (4, 4) float64
        Camera to world, by frame, in order.
    views : tuple of int
        Frames that poses and points were adjusted for.
    points : dict of int to (3,) float64
        Positions of tracks, in the world.
    """

    poses: dict[int, np.ndarray]
    views: tuple[int, ...]
    points: dict[int, np.ndarray]


@dataclass(frozen=True, kw_only=True)
class CameraPath:
    """Poses of frames, in pieces, and why others have none.

    Attributes
    ----------
    pieces : tuple of Piece
        In the order of their first frames. A frame is in one of them at most.
    lost : dict of int to Status
        Frames in none of them.
    seen : tuple of Seen
        Tracks in every frame.
    """

    pieces: tuple[Piece, ...]
    lost: dict[int, Status]
    seen: tuple[Seen, ...]


class PathFinder:
    """Takes the frames of a sequence one after the other, and finds where the camera was.

    Parameters
    ----------
    camera : Camera
        A pinhole, of the frames.
    """

    def __init__(self, camera: Camera) -> None:
        self._camera = camera
        self._tracker = Tracker(camera, TRACKING)
        self._seen: list[Seen] = []
        self._views: list[View] = []
        self._described: dict[int, Described] = {}  # of the last views
        self._matches: dict[tuple[int, int], np.ndarray] = {}
        self._last: np.ndarray | None = None
        self._shape = (0, 0)

    def add(self, grey: np.ndarray, ignored: np.ndarray | None = None) -> None:
        """Take the next frame, (H, W) uint8, and which of its pixels to ignore, (H, W) bool."""
        seen = self._tracker.go_on(grey, ignored)
        self._shape = grey.shape
        if not self._views or self._moved_on(self._views[-1].seen, seen):
            self._add_view(grey, seen)
        self._seen.append(seen)
        self._last = grey

    def finish(self) -> CameraPath:
        """Return the path of the frames so far."""
        last = len(self._seen) - 1
        if self._last is not None and self._views[-1].frame != last:
            self._add_view(self._last, self._seen[last])
        models = models_of(self._views, self._matches, self._camera, self._shape)
        pieces = _without_overlap(models)
        pieces, unplaced = self._with_others(pieces)
        lost = {frame: self._why(frame, pieces) for frame in unplaced}
        ordered = sorted(pieces, key=lambda piece: min(piece.poses))
        return CameraPath(pieces=tuple(ordered), lost=lost, seen=tuple(self._seen))

    def _moved_on(self, before: Seen, now: Seen) -> bool:
        _, index0, index1 = np.intersect1d(
            before.tracks, now.tracks, assume_unique=True, return_indices=True
        )
        if len(index0) < KEPT * len(before.tracks):
            return True
        if len(index0) == 0:  # nothing to track at all
            return False
        moved = np.hypot(*(now.points[index1] - before.points[index0]).T)
        return bool(np.median(moved) > MOVED * max(self._shape))

    def _add_view(self, grey: np.ndarray, seen: Seen) -> None:
        number = len(self._views)
        found = described(grey.astype(np.float32))
        self._views.append(View(frame=len(self._seen), seen=seen, detected=found.points))
        if self._views[-1].frame == len(self._seen) and self._last is grey:
            self._views[-1] = replace(self._views[-1], frame=len(self._seen) - 1)
        self._described[number] = found
        for apart in MATCHED:
            if number - apart in self._described:
                both = self._verified(self._described[number - apart], found)
                if len(both):
                    self._matches[number - apart, number] = both
        self._described.pop(number - max(MATCHED), None)

    def _verified(self, first: Described, second: Described) -> np.ndarray:
        """Return indices of points that look alike and that one motion explains, (N, 2)."""
        both = np.stack(alike(first, second), axis=1)
        if len(both) < FEWEST_MATCHES:
            return both[:0]
        _, inlier = cv2.findFundamentalMat(
            first.points[both[:, 0]],
            second.points[both[:, 1]],
            method=cv2.USAC_MAGSAC,
            ransacReprojThreshold=INLIER * max(self._shape) / 640,
            confidence=0.999,
            maxIters=TRIALS,
        )
        if inlier is None:
            return both[:0]
        both = both[inlier[:, 0] > 0]
        return both if len(both) >= FEWEST_MATCHES else both[:0]

    def _with_others(self, pieces: list[Piece]) -> tuple[list[Piece], list[int]]:
        """Add the frames between views to the pieces; return those that are in none as well."""
        placed = {frame: k for k, piece in enumerate(pieces) for frame in piece.poses}
        added: list[dict[int, np.ndarray]] = [dict(piece.poses) for piece in pieces]
        unplaced = []
        for frame, seen in enumerate(self._seen):
            if frame in placed:
                continue
            for k in _nearest(frame, placed):
                pose = pose_from_points(seen, pieces[k].points, self._camera, self._shape)
                if pose is not None:
                    added[k][frame] = pose
                    break
            else:
                unplaced.append(frame)
        return [
            replace(piece, poses=dict(sorted(poses.items())))
            for piece, poses in zip(pieces, added, strict=True)
        ], unplaced

    def _why(self, frame: int, pieces: list[Piece]) -> Status:
        """Return the status of a frame without a pose."""
        count = len(self._seen[frame].tracks)
        if not pieces:
            return Status(
                "little_parallax",
                "no pair of frames shows enough parallax to begin with: the camera has to change "
                "its place, before something that has texture",
            )
        return Status(
            "unrelated",
            f"none of its {count} tracks lead to points that are known: it is blurred, or shows "
            "what other frames do not; take frames closer in time",
        )


def _nearest(frame: int, placed: Mapping[int, int]) -> list[int]:
    """Return the pieces of the nearest frames before and after, without repetition."""
    before = [f for f in placed if f < frame]
    after = [f for f in placed if f > frame]
    near = ([max(before)] if before else []) + ([min(after)] if after else [])
    near.sort(key=lambda other: abs(other - frame))
    return list(dict.fromkeys(placed[other] for other in near))


def _without_overlap(models: Iterable[Model]) -> list[Piece]:
    """Return a piece for each model; a view that is in several is left to the largest."""
    pieces: list[Piece] = []
    taken: set[int] = set()
    for model in models:
        poses = {frame: pose for frame, pose in model.poses.items() if frame not in taken}
        if len(poses) >= 2:
            taken |= set(poses)
            pieces.append(Piece(poses=poses, views=tuple(poses), points=model.points))
    return pieces
