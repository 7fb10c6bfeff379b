"""Tracks of points through the frames of a reconstruction, measured in the images."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from tisfm.checks import Floats
from tisfm.exports.frame_files import picture_of
from tisfm.exports.tracks_measuring import Pose, is_smooth, measured, positions_of, predicted
from tisfm.exports.tracks_triangulation import consistent
from tisfm.reconstruction.result import Reconstruction
from tisfm.reconstruction.tracks import seeds

CELLS = 80  # along the longer side: a point is begun in every cell that has none
FEWEST = 3  # frames that see a point; 2 where a piece has no more
AROUND = 4  # keyframes to either side that a keyframe is compared with, and all frames to the next
MOST = 120  # frames to either side
ELSEWHERE, SHARED = 4, 0.5  # keyframes further off, and the share of points that each sees
LARGEST_RATIO = 1.6  # of distances: beyond, a point does not look the same
SAMPLE = 64  # points that tell which keyframes see the same
FEW = 150  # points of a frame: with fewer, it begins some itself
NEAR = (1, 2, 3, 4, 6, 8, 12)  # frames to either side that such a frame is compared with
LARGEST_STD = 0.3  # of the inverse depth that leads to other frames, as a share of it
HELD = 24  # frames in memory


@dataclass(frozen=True, kw_only=True, eq=False)
class Tracks:
    """Points of one piece, and where frames see them.

    Attributes
    ----------
    positions : (P, 3) float64
        In the world, in the unit of the poses.
    colors : (P, 3) uint8
        Red, green, blue.
    points : (O,) int32
        Of every observation: which point is seen. Observations of one point follow one another.
    frames : (O,) int32
        In which frame.
    places : (O, 2) float64
        Where: (x, y), px from the upper left pixel's centre, measured in the images.
    residual : (O,) float64
        How far that is from where the pose and the position say, px.
    """

    positions: Floats
    colors: np.ndarray
    points: np.ndarray
    frames: np.ndarray
    places: Floats
    residual: Floats

    def __len__(self) -> int:
        return len(self.positions)


def measured_tracks(
    result: Reconstruction,
    piece: int,
    *,
    spacing: float | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Tracks:
    """Return tracks of points that stand out, through the frames of a piece.

    A point is begun in a keyframe, at a corner whose depth is known; depth and poses lead to other
    frames, and there its position is measured in the images. It is kept where three frames or more
    agree on one point in space, within 1.5 px of each. What moves on its own, and masked pixels,
    have no points.

    Parameters
    ----------
    result : Reconstruction
    piece : int
    spacing : float, optional
        Between points that are begun in a frame, px; by default 1/80 of the longer side.
    progress : callable, optional
        Called with the number of frames that are done, and of those there are.

    Raises
    ------
    ValueError
        If there is no such piece, or the spacing is not positive.
    FileNotFoundError, tisfm.formats.FormatError
        If files of the reconstruction are missing or damaged.
    """
    if not 0 <= piece < len(result.unit):
        raise ValueError(f"piece is {piece}: expected 0 to {len(result.unit) - 1}")
    return _Tracking(result, piece, cells_of(result.shape, spacing)).tracks(progress)


def cells_of(shape: tuple[int, int], spacing: float | None) -> int:
    """Return how many cells there are along the longer side of frames.

    Raises
    ------
    ValueError
        If the spacing is not a positive number of px.
    """
    if spacing is None:
        return CELLS
    if not (np.isfinite(spacing) and spacing > 0):
        raise ValueError(f"spacing is {spacing}: expected a positive number of px")
    return max(1, round(max(shape) / spacing))


class _Tracking:
    """Takes the frames of a piece in turn; holds some of them, and the points found so far."""

    def __init__(self, result: Reconstruction, piece: int, cells: int) -> None:
        self._result, self._cells = result, cells
        self._frames = np.flatnonzero(result.piece == piece).tolist()
        self._keyframes = [k for k in result.keyframes if result.piece[k] == piece]
        self._fewest = min(FEWEST, max(2, len(self._frames)))
        self._taken: dict[int, list[np.ndarray]] = {frame: [] for frame in self._frames}
        self._found: list[Tracks] = []
        self._count = 0
        self._grey = lru_cache(HELD)(self._read_grey)
        self._usable = lru_cache(HELD)(self._read_usable)

    def tracks(self, progress: Callable[[int, int], None] | None) -> Tracks:
        """Return the tracks of all frames."""
        keyframes = set(self._keyframes)
        for frame in self._keyframes:
            self._begin(frame, self._around)
            if progress is not None:
                progress(frame - self._frames[0] + 1, len(self._frames))
        for frame in self._frames:
            if frame not in keyframes and sum(map(len, self._taken[frame])) < FEW:
                self._begin(frame, self._near)
        if progress is not None:
            progress(len(self._frames), len(self._frames))
        return _joined(self._found)

    def _begin(
        self, frame: int, others: Callable[[int, np.ndarray, np.ndarray], list[int]]
    ) -> None:
        """Begin points in a frame where it has none, and find them in others."""
        result = self._result
        inverse_depth = result.inverse_depth(frame)
        std = result.inverse_depth_std(frame)
        with np.errstate(invalid="ignore", divide="ignore"):
            relative = std / inverse_depth
            trusted = (inverse_depth > 0) & (relative < LARGEST_STD)
        trusted &= self._usable(frame) & is_smooth(inverse_depth)
        taken = np.vstack([np.empty((0, 2)), *self._taken[frame]])
        points = seeds(self._grey(frame), taken, ~trusted, self._cells)
        if not len(points):
            return
        column, row = points.astype(np.intp).T
        depth, deviation = inverse_depth[row, column].astype(float), relative[row, column]
        pose = self._pose(frame)
        begun = positions_of(points, depth, pose, result.shape)
        targets = [k for k in others(frame, begun, 1 / depth) if k != frame]
        places = np.full((len(points), 1 + len(targets), 2), np.nan)
        places[:, 0] = points
        for number, target in enumerate(targets, start=1):
            there = measured(
                self._grey(frame),
                self._grey(target),
                points,
                inverse_depth,
                pose,
                self._pose(target),
            )
            seen = np.flatnonzero(np.isfinite(there[:, 0]))
            column, row = np.rint(there[seen]).astype(np.intp).T
            seen = seen[self._usable(target)[row, column]]
            places[seen, number] = there[seen]
        poses = [pose, *map(self._pose, targets)]
        kept, places, found = consistent(
            places, poses, result.shape, begun, deviation.astype(float), self._fewest
        )
        colors = _colors(picture_of(result, frame), points[kept])
        self._add([frame, *targets], places, found.positions, found.residual, colors)

    def _add(
        self,
        frames: list[int],
        places: np.ndarray,
        positions: np.ndarray,
        residual: np.ndarray,
        colors: np.ndarray,
    ) -> None:
        seen = np.isfinite(places[..., 0])
        point, number = np.nonzero(seen)
        for k, frame in enumerate(frames):
            self._taken[frame].append(places[seen[:, k], k].astype(np.float32))
        tracks = Tracks(
            positions=positions,
            colors=colors,
            points=(point + self._count).astype(np.int32),
            frames=np.array(frames, np.int32)[number],
            places=places[seen],
            residual=residual[seen],
        )
        self._count += len(positions)
        self._found.append(tracks)

    def _around(self, frame: int, begun: np.ndarray, depth: np.ndarray) -> list[int]:
        """Return frames that see much of what a keyframe sees."""
        place = self._keyframes.index(frame)
        keyframes = self._keyframes[max(0, place - AROUND) : place + AROUND + 1]
        first = self._keyframes[place - 1] if place else self._frames[0]
        last = self._keyframes[place + 1] if frame != self._keyframes[-1] else self._frames[-1]
        near = [k for k in self._frames if max(first, frame - MOST) <= k <= min(last, frame + MOST)]
        others = self._elsewhere(set(keyframes) | set(near), begun, depth)
        return sorted({*keyframes, *near, *others})

    def _elsewhere(self, known: set[int], begun: np.ndarray, depth: np.ndarray) -> list[int]:
        """Return keyframes, apart from those known, that see most of the points from as near."""
        sample = np.linspace(0, len(begun) - 1, min(SAMPLE, len(begun))).astype(np.intp)
        shares = []
        for frame in self._keyframes:
            if frame in known:
                continue
            pose = self._pose(frame)
            places, z = predicted(begun[sample], pose, self._result.shape)
            with np.errstate(invalid="ignore", divide="ignore"):
                seen = (z > 0) & (np.abs(np.log(z / depth[sample])) < np.log(LARGEST_RATIO))
            height, width = self._result.shape
            seen &= ((places >= 0) & (places < (width, height))).all(axis=1)
            shares.append((float(seen.mean()), frame))
        best = sorted(shares, key=lambda one: -one[0])[:ELSEWHERE]
        return [frame for share, frame in best if share >= SHARED]

    def _near(self, frame: int, begun: np.ndarray, depth: np.ndarray) -> list[int]:
        """Return frames before and after one, in the order of time."""
        place = self._frames.index(frame)
        steps = sorted({sign * step for step in NEAR for sign in (-1, 1)})
        return [self._frames[k] for k in (place + s for s in steps) if 0 <= k < len(self._frames)]

    def _pose(self, frame: int) -> Pose:
        return Pose(camera=self._result.camera, matrix=self._result.poses[frame])

    def _read_grey(self, frame: int) -> np.ndarray:
        picture = picture_of(self._result, frame)
        if picture.ndim == 2:
            return picture
        return np.asarray(cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY))

    def _read_usable(self, frame: int) -> np.ndarray:
        """Return the pixels of a frame that are at rest, and not masked."""
        result = self._result
        usable = result.labels(frame) == 0
        known = np.isfinite(result.inverse_depth_std(frame))
        if known.any():
            usable &= known
        return np.asarray(usable)


def _colors(picture: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return the colours at pixels, (N, 3) uint8."""
    column, row = points.astype(np.intp).T
    colors = picture[row, column]
    return np.repeat(colors[:, None], 3, axis=1) if colors.ndim == 1 else colors


def _joined(found: Iterable[Tracks]) -> Tracks:
    """Return the tracks of all, whose points are numbered throughout."""
    parts = list(found)
    nothing = {
        "positions": np.empty((0, 3)),
        "colors": np.empty((0, 3), np.uint8),
        "points": np.empty(0, np.int32),
        "frames": np.empty(0, np.int32),
        "places": np.empty((0, 2)),
        "residual": np.empty(0),
    }
    arrays = {
        name: np.concatenate([empty, *(getattr(part, name) for part in parts)])
        for name, empty in nothing.items()
    }
    return Tracks(**arrays)
