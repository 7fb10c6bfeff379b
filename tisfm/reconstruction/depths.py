"""Depth of the frames of a piece: keyframes from windows, the others rendered from theirs."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from tisfm.kernels.rigid.rendering import rendered
from tisfm.reconstruction.adjustment import Star, star_of
from tisfm.reconstruction.frames import PreparedFrames
from tisfm.reconstruction.neighbours import choose_neighbours
from tisfm.reconstruction.path import Piece
from tisfm.reconstruction.sparse_points import depths_of
from tisfm.reconstruction.tracks import Seen
from tisfm.reconstruction.window_depth import Effort, WindowDepth, window_depth
from tisfm.settings import Settings

# A frame becomes a keyframe where tracks have moved by this share of the longer side since the
# last keyframe, or fewer than this share of its tracks are still seen.
MOVED, KEPT = 0.1, 0.5
REACH = 40  # frames before and after a keyframe that it may be compared with
MOST: dict[Effort, int] = {"fast": 3, "balanced": 4, "accurate": 6}
GUESSED = 0.5  # relative deviation of what no keyframe shows, and is filled in
DISAGREE = 0.1  # of the inverse depth: rendered surfaces that differ by more are different ones
# Of the relative deviation of a keyframe: times how far the keyframes before and after are from it
# around a pixel, in a window of so much of the longer side; no difference counts for more than so
# much; and as many pixels' worth, of a window, as the median of the frame counts for.
APART, NEARBY, MOST_APART, USUAL = 1.75, 0.1, 0.5, 0.02


@dataclass(frozen=True, kw_only=True)
class FrameDepth:
    """Depth of a frame, as it is written.

    Attributes
    ----------
    frame : int
    inverse_depth, deviation : (H, W) float32
        NaN and infinity where there is none.
    """

    frame: int
    inverse_depth: np.ndarray
    deviation: np.ndarray


class PieceDepths:
    """Depth of the frames of a piece, one after the other.

    Parameters
    ----------
    frames : PreparedFrames
    piece : Piece
    seen : sequence of Seen
        Tracks of every frame.
    settings : Settings
    effort : {"fast", "balanced", "accurate"}

    Attributes
    ----------
    keyframes : list of int
        Chosen beforehand; those without depth are taken out as they turn up.
    """

    def __init__(
        self,
        frames: PreparedFrames,
        piece: Piece,
        seen: Sequence[Seen],
        settings: Settings,
        effort: Effort,
    ) -> None:
        self._frames, self._piece, self._seen = frames, piece, seen
        self._settings, self._effort = settings, effort
        self._camera = frames.camera
        # Of the keyframes in use: as their windows have it, and as it is written.
        self._known: dict[int, WindowDepth] = {}
        self._settled: dict[int, WindowDepth] = {}
        self.keyframes = chosen_keyframes(piece, seen, max(frames.shape))

    def __iter__(self) -> Iterator[FrameDepth]:
        """Yield the depth of every frame that has any: keyframes once the next one is known."""
        previous: int | None = None
        for key in list(self.keyframes):
            found = self._keyframe(key, previous, self._effort)
            if found is None:
                self.keyframes.remove(key)
                continue
            self._known[key] = found
            if previous is not None:
                yield from self._up_to(previous)
                self._known = {k: v for k, v in self._known.items() if k >= previous}
            previous = key
        if previous is not None:
            yield from self._up_to(previous)
            yield from self._between(previous, max(self._piece.poses) + 1)

    def _up_to(self, key: int) -> Iterator[FrameDepth]:
        """Yield a keyframe, whose neighbours are known, and the frames between the last and it."""
        after = max(self._settled, default=min(self._piece.poses) - 1)
        found = self._settled[key] = self._compared(key)
        yield FrameDepth(frame=key, inverse_depth=found.inverse_depth, deviation=found.deviation)
        yield from self._between(after, key)
        self._settled = {key: found}

    def _compared(self, key: int) -> WindowDepth:
        """Return the depth of a keyframe, as unsure as those before and after it differ from it.

        They say the same but for errors of poses and of matches, which a window knows nothing of.
        """
        found = self._known[key]
        others = [self._shown(self._known[k], k, key)[0] for k in self._known if k != key]
        apart = np.float32(APART) * _apart(found.inverse_depth, others)
        deviation = np.hypot(found.deviation, apart * found.inverse_depth)
        return replace(found, deviation=deviation)

    def stars(self) -> list[Star]:
        """Return the keyframes with a rough depth, each with the frames up to the next ones."""
        frames = sorted(self._piece.poses)
        limits = [frames[0], *self.keyframes, frames[-1]]
        stars = []
        for number, key in enumerate(self.keyframes):
            found = self._keyframe(key, None, "fast")
            if found is None:
                continue
            first, last = limits[number], limits[number + 2]
            members = [frame for frame in frames if first <= frame <= last and frame != key]
            stars.append(
                star_of(
                    key,
                    members,
                    self._frames.grey(key),
                    found.inverse_depth,
                    found.deviation,
                    self._frames.counted(key),
                )
            )
        return stars

    def _between(self, after: int, before: int) -> Iterator[FrameDepth]:
        for frame in sorted(self._piece.poses):
            if after < frame < before:
                inverse_depth, deviation = self._rendered(frame)
                if np.isfinite(inverse_depth).any():
                    yield FrameDepth(frame=frame, inverse_depth=inverse_depth, deviation=deviation)

    def _keyframe(self, key: int, previous: int | None, effort: Effort) -> WindowDepth | None:
        """Return the depth of a keyframe from the frames around it, None if they show none.

        They are chosen by what its tracks say of its depth, or else the keyframe before.
        """
        poses = self._piece.poses
        places, depths = depths_of(self._seen[key], self._piece.points, poses[key])
        rough = _spread(places, depths, self._frames.shape)
        if rough is None and previous is not None:
            rough = self._shown(self._known[previous], previous, key)[0]
        if rough is None or not np.isfinite(rough).any():
            return None
        near = [f for f in poses if abs(f - key) <= REACH]
        neighbours = choose_neighbours(
            np.array([poses[f] for f in near]),
            near.index(key),
            rough,
            self._camera,
            self._frames.shape,
            most=MOST[effort],
        )
        chosen = [near[k] for k in neighbours]
        if not chosen:
            return None
        motions = np.array([(np.linalg.inv(poses[f]) @ poses[key])[:3] for f in chosen])
        return window_depth(
            self._frames.grey(key),
            [self._frames.grey(f) for f in chosen],
            motions,
            self._camera,
            self._settings,
            effort=effort,
            key_mask=self._frames.counted(key),
            masks=[self._frames.counted(f) for f in chosen],
        )

    def _shown(self, known: WindowDepth, key: int, frame: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the depth of a keyframe as a frame sees it, and its deviation; NaN for none."""
        poses = self._piece.poses
        motion = (np.linalg.inv(poses[frame]) @ poses[key])[:3]
        out, deviation = (np.empty(self._frames.shape, np.float32) for _ in range(2))
        rendered(
            np.ascontiguousarray(np.nan_to_num(known.inverse_depth)),
            np.ascontiguousarray(np.nan_to_num(known.deviation, posinf=0.0)),
            motion,
            out,
            deviation,
            center=self._camera.center_for(*self._frames.shape),
            focal=self._camera.focal,
        )
        seen = out > 0
        return np.where(seen, out, np.nan), np.where(seen, deviation, np.nan)

    def _rendered(self, frame: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the depth of a frame as the keyframes show it, and its deviation."""
        views = [self._shown(known, key, frame) for key, known in self._settled.items()]
        inverse_depth, deviation = views[0]
        for other, its_deviation in views[1:]:
            inverse_depth, deviation = _merged(inverse_depth, deviation, other, its_deviation)
        return _filled(inverse_depth, deviation)


def chosen_keyframes(piece: Piece, seen: Sequence[Seen], side: int) -> list[int]:
    """Return the frames of a piece that are far enough from one another, in order."""
    frames = sorted(piece.poses)
    keys = frames[:1]
    for frame in frames[1:]:
        before, now = seen[keys[-1]], seen[frame]
        _, index0, index1 = np.intersect1d(
            before.tracks, now.tracks, assume_unique=True, return_indices=True
        )
        if len(index0) < max(1, KEPT * len(before.tracks)):
            keys.append(frame)
            continue
        moved = np.hypot(*(now.points[index1] - before.points[index0]).T)
        if np.median(moved) > MOVED * side:
            keys.append(frame)
    return keys


def _spread(places: np.ndarray, depths: np.ndarray, shape: tuple[int, int]) -> np.ndarray | None:
    """Return inverse depth of the nearest known place at every pixel, None where none is known."""
    if len(depths) == 0:
        return None
    x, y = np.rint(places).astype(np.intp).T
    values, known = np.zeros((1, *shape), np.float32), np.zeros(shape, bool)
    values[0, y, x], known[y, x] = 1 / depths, True
    return _from_nearest(values, known)[0]


def _from_nearest(values: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Return values, (k, H, W) float32, each pixel with those of the nearest that is known."""
    _, nearest = cv2.distanceTransformWithLabels(
        (~known).astype(np.uint8), cv2.DIST_L2, 3, labelType=cv2.DIST_LABEL_PIXEL
    )
    table = np.zeros((len(values), nearest.max() + 1), np.float32)
    table[:, nearest[known]] = values[:, known]
    return table[:, nearest]


def _apart(inverse_depth: np.ndarray, others: Sequence[np.ndarray]) -> np.ndarray:
    """Return how far others, NaN where they show nothing, are from it around every pixel.

    A share of the inverse depth, (H, W) float32; 0 where there are no others.
    """
    total, count = np.zeros((2, *inverse_depth.shape), np.float32)
    for other in others:
        shown = np.isfinite(other)
        share = np.abs(np.where(shown, other, inverse_depth) - inverse_depth) / inverse_depth
        total += np.minimum(share, np.float32(MOST_APART))
        count += shown
    seen = count > 0
    if not seen.any():
        return total
    usual = np.float32(USUAL) * np.median(total[seen] / count[seen])
    side = 2 * round(NEARBY * max(inverse_depth.shape) / 2) + 1
    around = cv2.blur(np.dstack([total, count]), (side, side))
    apart: np.ndarray = (around[..., 0] + usual) / (around[..., 1] + np.float32(USUAL))
    return apart


def _merged(
    first: np.ndarray, deviation0: np.ndarray, second: np.ndarray, deviation1: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return what two views say of the same pixels: the mean where they agree, else the surer."""
    both = np.isfinite(first) & np.isfinite(second)
    with np.errstate(invalid="ignore", divide="ignore"):
        alike = both & (np.abs(first - second) < DISAGREE * np.maximum(first, second))
        weight0, weight1 = 1 / deviation0**2, 1 / deviation1**2
        mean = (weight0 * first + weight1 * second) / (weight0 + weight1)
        surer = deviation0 / first <= deviation1 / second
    inverse_depth = np.where(np.isfinite(first) & (~both | surer), first, second)
    deviation = np.where(np.isfinite(first) & (~both | surer), deviation0, deviation1)
    # Both come from overlapping sets of images: their mean is not surer than the surer of them.
    return np.where(alike, mean, inverse_depth), np.where(
        alike, np.minimum(deviation0, deviation1), deviation
    )


def _filled(inverse_depth: np.ndarray, deviation: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Fill what no keyframe shows from around it, and say how unsure that is."""
    known = np.isfinite(inverse_depth)
    if known.all() or not known.any():
        return inverse_depth, np.where(known, deviation, np.inf).astype(np.float32)
    value, spread = _from_nearest(np.stack([inverse_depth, deviation]), known)
    unsure = np.maximum(spread, GUESSED * value)
    return (
        np.where(known, inverse_depth, value).astype(np.float32),
        np.where(known, deviation, unsure).astype(np.float32),
    )


def unit_of(inverse_depth: np.ndarray) -> float:
    """Return the median depth of a frame; 1 if it has none."""
    known = inverse_depth[np.isfinite(inverse_depth) & (inverse_depth > 0)]
    return 1 / float(np.median(known)) if len(known) else 1.0


def effort_of(settings: Settings) -> Effort:
    """Return how densely planes are sought: as much as the preset that does as many warps."""
    if settings.finest_level > 0:
        return "fast"
    return "balanced" if settings.warps <= Settings.preset("balanced").warps else "accurate"
