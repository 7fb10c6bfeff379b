"""Tracks of points whose depth is known: it leads to the frames that see them."""

from bisect import bisect_left, bisect_right
from collections.abc import Callable

import numpy as np

from tisfm.exports.guided_matching import is_smooth, measured, positions_of
from tisfm.exports.track_frames import PieceFrames, SeenPoints
from tisfm.exports.track_triangulation import consistent
from tisfm.reconstruction.tracks.tracker import choose_new_points

AROUND = 4  # keyframes to either side that a keyframe is compared with, and all frames to the next
MOST = 120  # frames to either side
ELSEWHERE, SHARED = 4, 0.5  # keyframes further off, and the share of points that each sees
LARGEST_RATIO = 1.6  # of distances: beyond, a point does not look the same
SAMPLE = 64  # points that tell which keyframes see the same
FEW = 150  # points of a frame: with fewer, it begins some itself
NEAR = (1, 2, 3, 4, 6, 8, 12)  # frames to either side that such a frame is compared with
LARGEST_STD = 0.3  # of the inverse depth that leads to other frames, as a share of it

Others = Callable[[int, np.ndarray, np.ndarray], list[int]]


class DepthTracks:
    """Begins points in keyframes, and in frames that see few, and finds them in others.

    Parameters
    ----------
    frames : PieceFrames
    cells : int
        Along the longer side: a point is begun in every cell that has none.
    """

    def __init__(self, frames: PieceFrames, cells: int) -> None:
        self._frames, self._cells = frames, cells
        self._taken: dict[int, list[np.ndarray]] = {frame: [] for frame in frames.numbers}

    def found(self, progress: Callable[[int, int], None]) -> list[SeenPoints]:
        """Return the points of all frames; progress is told frames that are done, and all."""
        numbers, keyframes = self._frames.numbers, self._frames.keyframes
        found = []
        for frame in keyframes:
            found += self._begun(frame, self._around)
            progress(frame - numbers[0] + 1, len(numbers))
        for frame in sorted(set(numbers) - set(keyframes)):
            if sum(map(len, self._taken[frame])) < FEW:
                found += self._begun(frame, self._near)
        progress(len(numbers), len(numbers))
        return found

    def _begun(self, frame: int, others: Others) -> list[SeenPoints]:
        """Begin points in a frame where it has none, and find them in others."""
        frames, result = self._frames, self._frames.result
        inverse_depth = result.inverse_depth(frame)
        with np.errstate(invalid="ignore", divide="ignore"):
            relative_std = result.inverse_depth_std(frame) / inverse_depth
            trusted = (inverse_depth > 0) & (relative_std < LARGEST_STD)
        trusted &= frames.usable(frame) & is_smooth(inverse_depth)
        taken = np.vstack([np.empty((0, 2)), *self._taken[frame]])
        points = choose_new_points(frames.grey(frame), taken, ~trusted, self._cells)
        if not len(points):
            return []
        column, row = points.astype(np.intp).T
        inverse, std = (
            values[row, column].astype(float) for values in (inverse_depth, relative_std)
        )
        begun = positions_of(points, inverse, frames.pose(frame), result.shape)
        seen_by = [frame, *(k for k in others(frame, begun, 1 / inverse) if k != frame)]
        places = np.stack(
            [points, *(self._places(frame, k, points, inverse_depth) for k in seen_by[1:])], axis=1
        )
        poses = [frames.pose(k) for k in seen_by]
        kept, places, found = consistent(places, poses, result.shape, begun, std, frames.fewest)
        for number, one in enumerate(seen_by):
            there = places[np.isfinite(places[:, number, 0]), number]
            self._taken[one].append(there.astype(np.float32))
        of_frame = SeenPoints(
            frames=seen_by,
            places=places,
            positions=found.positions,
            residual=found.residual,
            colors=frames.colors(frame, points[kept]),
        )
        return [of_frame]

    def _places(
        self, frame: int, other: int, points: np.ndarray, inverse_depth: np.ndarray
    ) -> np.ndarray:
        """Return where another frame sees points, (N, 2), NaN where not, or what is there moves."""
        frames = self._frames
        places = measured(
            frames.grey(frame),
            frames.grey(other),
            points,
            inverse_depth,
            frames.pose(frame),
            frames.pose(other),
        )
        seen = np.flatnonzero(np.isfinite(places[:, 0]))
        column, row = np.rint(places[seen]).astype(np.intp).T
        places[seen[~frames.usable(other)[row, column]]] = np.nan
        return places

    def _around(self, frame: int, begun: np.ndarray, depth: np.ndarray) -> list[int]:
        """Return frames that see much of what a keyframe sees."""
        numbers, keyframes = self._frames.numbers, self._frames.keyframes
        place = bisect_left(keyframes, frame)
        first = keyframes[place - 1] if place else numbers[0]
        last = keyframes[place + 1] if place + 1 < len(keyframes) else numbers[-1]
        begin = bisect_left(numbers, max(first, frame - MOST))
        end = bisect_right(numbers, min(last, frame + MOST))
        near = {*numbers[begin:end], *keyframes[max(0, place - AROUND) : place + AROUND + 1]}
        return sorted(near | self._elsewhere(near, begun, depth))

    def _elsewhere(self, near: set[int], begun: np.ndarray, depth: np.ndarray) -> set[int]:
        """Return other keyframes that see most of the points, (N, 3), from about as near, (N,)."""
        result, keyframes = self._frames.result, self._frames.keyframes
        sample = np.linspace(0, len(begun) - 1, min(SAMPLE, len(begun))).astype(np.intp)
        poses = result.poses[keyframes]
        local = (begun[sample] - poses[:, None, :3, 3]) @ poses[:, :3, :3]
        z = local[..., 2]
        height, width = result.shape
        with np.errstate(invalid="ignore", divide="ignore"):
            places = local[..., :2] / z[..., None] * result.camera.focal
            places += result.camera.center_for(height, width)
            seen = (z > 0) & (np.abs(np.log(z / depth[sample])) < np.log(LARGEST_RATIO))
        share = (seen & ((places >= 0) & (places < (width, height))).all(axis=-1)).mean(axis=1)
        share[np.isin(keyframes, list(near))] = 0
        best = np.argsort(-share, kind="stable")[:ELSEWHERE]
        return {keyframes[k] for k in best if share[k] >= SHARED}

    def _near(self, frame: int, begun: np.ndarray, depth: np.ndarray) -> list[int]:
        """Return frames before and after one, in the order of time."""
        numbers = self._frames.numbers
        place = bisect_left(numbers, frame)
        steps = sorted({sign * step for step in NEAR for sign in (-1, 1)})
        return [numbers[place + step] for step in steps if 0 <= place + step < len(numbers)]
