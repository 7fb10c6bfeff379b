"""Depth of the frames of a piece: keyframes are estimated, frames between them are rendered."""

from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import cv2
import numpy as np

from tisfm.camera import Camera
from tisfm.reconstruction.depth.neighbour_frames import (
    choose_neighbours,
    choose_neighbours_of_unmatched,
)
from tisfm.reconstruction.depth.pose_adjustment import KeyframeWindow, make_keyframe_window
from tisfm.reconstruction.depth.settings import DEPTH
from tisfm.reconstruction.depth.view_fusion import (
    Keyframe,
    Projection,
    View,
    add_difference_to_deviation,
    align_edges,
    fill_holes,
    fuse_views,
    render_view,
    upsample,
)
from tisfm.reconstruction.depth.window_depth import Effort, WindowDepth, by_effort, window_depth
from tisfm.reconstruction.depth.window_matching import FurtherFrames, OtherFrames
from tisfm.reconstruction.mapping.solution import Piece
from tisfm.reconstruction.tracks.tracker import Observations
from tisfm.reconstruction.tracks.triangulation import track_depths
from tisfm.settings import Settings


@dataclass(frozen=True, kw_only=True)
class FrameDepth:
    """Depth of a frame, in the form in which a result stores it."""

    frame: int
    # inverse_depth, deviation: (H, W) float32, NaN and infinity where there is no depth. The
    # deviation is also infinite at masked pixels.
    inverse_depth: np.ndarray
    deviation: np.ndarray


class Frames(Protocol):
    """Frames that give depth, such as `PreparedFrames`."""

    camera: Camera
    shape: tuple[int, int]

    def grey(self, number: int) -> np.ndarray:
        """Return a frame, (H, W) float32."""

    def used_pixels(self, number: int) -> np.ndarray | None:
        """Return the mask of the used pixels, (H, W) bool; None for all pixels."""


class PieceDepths:
    """An iterable over the depth of the frames of a piece."""

    def __init__(
        self,
        frames: Frames,
        piece: Piece,
        observations: Sequence[Observations],  # tracks of every frame
        settings: Settings,
        effort: Effort,
        *,
        # a keyframe with known depth, and its depth; only later frames get depth
        start_keyframe: tuple[int, WindowDepth] | None = None,
        written_until: int = -1,  # frames up to this number get no depth, except keyframes
        # height and width of the uncropped frames, px, if the frames are crops: tuned numbers are
        # relative to this size
        uncropped_shape: tuple[int, int] | None = None,
    ) -> None:
        self._frames, self._piece, self._observations = frames, piece, observations
        self._settings, self._effort = settings, effort
        self._camera = frames.camera
        self._uncropped_shape = uncropped_shape or frames.shape
        self._written_until = written_until
        # by keyframe: depth from the window of the keyframe, before fusion
        start_depths = [] if start_keyframe is None else [start_keyframe]
        self._window_depths: dict[int, WindowDepth] = dict(start_depths)
        self._start_key = next(iter(self._window_depths), None)
        # by keyframe, the last two keyframes: depth after fusion with their neighbour keyframes
        self.final_depths = dict(self._window_depths)
        # The iteration removes keyframes that get no depth.
        side = max(self._uncropped_shape)
        self.keyframes = choose_keyframes(piece, observations, side, self._start_key)

    def __iter__(self) -> Iterator[FrameDepth]:
        """Yield the depth of frames, if any; a keyframe waits for the next keyframe's depth."""
        previous = self._start_key
        for key in list(self.keyframes):
            depth = self._keyframe_depth(key, previous, self._effort)
            if depth is None:
                self.keyframes.remove(key)
                continue
            self._window_depths[key] = depth
            if previous is not None:
                yield from self._finish_keyframe(previous)
                recent = {k: v for k, v in self._window_depths.items() if k >= previous}
                self._window_depths = recent
            previous = key
        if previous is not None:
            yield from self._finish_keyframe(previous)
            yield from self._frames_between(previous, max(self._piece.poses) + 1)

    def _finish_keyframe(self, key: int) -> Iterator[FrameDepth]:
        """Yield the depth of the frames since the last finished keyframe, up to a keyframe."""
        if key in self.final_depths:
            return
        previous = max(self.final_depths, default=min(self._piece.poses) - 1)
        depth = self.final_depths[key] = self._fuse_neighbours(key)
        yield self._written_depth(key, depth.inverse_depth, depth.deviation)
        yield from self._frames_between(previous, key)
        self.final_depths = {key: depth}

    def _fuse_neighbours(self, key: int) -> WindowDepth:
        """Return the depth of a keyframe, fused with the depth of its neighbour keyframes.

        Differences between keyframes increase the deviation: they show errors of poses and matches
        that a single window does not show.
        """
        depth, shape, stride = self._window_depths[key], self._frames.shape, DEPTH.comparison_stride
        own = self._keyframe(depth, key, key, stride)
        views = [View(inverse_depth=own.inverse_depth, deviation=own.deviation, keyframe=own)]
        for other, other_depth in self._window_depths.items():
            if other != key:
                keyframe = self._keyframe(other_depth, other, key, stride)
                views.append(render_view(keyframe, self._projection(stride)))
        compared_views = add_difference_to_deviation(views, DEPTH.deviation_per_difference)
        mean, deviation = fuse_views(compared_views, own.grey, self._projection(stride))
        # The keyframe has depth at every pixel, so only the relative correction is upsampled.
        inverse_depth = depth.inverse_depth * upsample(mean / own.inverse_depth, stride, shape)
        deviation = upsample(deviation, stride, shape)
        return replace(depth, inverse_depth=inverse_depth, deviation=deviation)

    def keyframe_windows(self) -> list[KeyframeWindow]:
        """Return windows: each keyframe with rough depth, and all frames between its neighbours."""
        frames = sorted(self._piece.poses)
        limits = [frames[0], *self.keyframes, frames[-1]]
        windows = []
        for number, key in enumerate(self.keyframes):
            depth = self._keyframe_depth(key, None, "fast", searches_outlines=False)
            if depth is None:
                continue
            first, last = limits[number], limits[number + 2]
            members = [frame for frame in frames if first <= frame <= last and frame != key]
            grey, used_pixels = self._frames.grey(key), self._frames.used_pixels(key)
            images = grey, depth.inverse_depth, depth.deviation, used_pixels
            for start in range(0, len(members), DEPTH.max_window_frames):
                batch = members[start : start + DEPTH.max_window_frames]
                windows.append(make_keyframe_window(key, batch, *images))
        return windows

    def _frames_between(self, previous: int, following: int) -> Iterator[FrameDepth]:
        for frame in sorted(self._piece.poses):
            if max(previous, self._written_until) < frame < following:
                inverse_depth, deviation = self._render_depth(frame)
                if np.isfinite(inverse_depth).any():
                    yield self._written_depth(frame, inverse_depth, deviation)

    def _written_depth(
        self, frame: int, inverse_depth: np.ndarray, deviation: np.ndarray
    ) -> FrameDepth:
        """Return the depth to store; masked pixels, on other objects, have no finite deviation."""
        used_pixels = self._frames.used_pixels(frame)
        if used_pixels is not None:
            deviation = np.where(used_pixels, deviation, np.float32(np.inf))
        return FrameDepth(frame=frame, inverse_depth=inverse_depth, deviation=deviation)

    def _keyframe_depth(
        self, key: int, previous: int | None, effort: Effort, *, searches_outlines: bool = True
    ) -> WindowDepth | None:
        """Return the depth of a keyframe from neighbours; None without neighbours or matches."""
        poses = self._piece.poses
        rough_depth = self._rough_depth(key, previous)
        if rough_depth is None:
            return None
        nearby = [f for f in poses if abs(f - key) <= DEPTH.max_frame_distance]
        arguments = (
            np.array([poses[f] for f in nearby]),
            nearby.index(key),
            rough_depth,
            self._camera,
            self._frames.shape,
        )
        max_count = by_effort(DEPTH.max_neighbours, effort)
        first = choose_neighbours(
            *arguments, max_count=max_count, uncropped_shape=self._uncropped_shape
        )
        if not first:
            return None

        def choose_further(is_unmatched: np.ndarray) -> FurtherFrames | None:
            chosen = choose_neighbours_of_unmatched(
                *arguments,
                first=first,
                is_unmatched=is_unmatched,
                max_count=max_count,
                uncropped_shape=self._uncropped_shape,
            )
            further = [nearby[k] for k in chosen if k not in first]
            if not further:
                return None
            return FurtherFrames(
                kept=[n for n, k in enumerate(first) if k in chosen],
                frames=self._other_frames(key, further),
            )

        frames = self._other_frames(key, [nearby[k] for k in first])
        return window_depth(
            self._frames.grey(key),
            frames.grey,
            frames.motions,
            self._camera,
            self._settings,
            effort=effort,
            key_mask=self._frames.used_pixels(key),
            masks=frames.masks,
            uncropped_shape=self._uncropped_shape,
            searches_outlines=searches_outlines,
            choose_further=choose_further,
        )

    def _other_frames(self, key: int, others: Sequence[int]) -> OtherFrames:
        """Return the grey levels, motions and masks of other frames of a keyframe's window."""
        poses = self._piece.poses
        return OtherFrames(
            grey=[self._frames.grey(f) for f in others],
            motions=np.array([(np.linalg.inv(poses[f]) @ poses[key])[:3] for f in others]),
            masks=[self._frames.used_pixels(f) for f in others],
        )

    def _rough_depth(self, key: int, previous: int | None) -> np.ndarray | float | None:
        """Return a rough inverse depth of a keyframe, for the choice of neighbours.

        It comes from tracks, or else from the keyframe before, or else it is the median of the
        tracks of the next keyframe that has tracks with points.
        """
        shape = self._frames.shape
        rough_depth = _nearest_track_depth(*self._track_depths(key), shape)
        if rough_depth is not None:
            return rough_depth
        if previous is not None:
            keyframe = self._keyframe(self._window_depths[previous], previous, key, 1)
            rendered = render_view(keyframe, self._projection(1)).inverse_depth
            return rendered if np.isfinite(rendered).any() else None
        for later in self.keyframes:
            _, depths = self._track_depths(later)
            if later > key and len(depths):
                return 1 / float(np.median(depths))
        return None

    def _track_depths(self, key: int) -> tuple[np.ndarray, np.ndarray]:
        return track_depths(self._observations[key], self._piece.points, self._piece.poses[key])

    def _keyframe(self, source: WindowDepth, key: int, frame: int, stride: int) -> Keyframe:
        """Return a keyframe as a frame sees it: every `stride`-th row and column, from 0."""
        poses = self._piece.poses
        depth, deviation, grey = (
            np.ascontiguousarray(image[::stride, ::stride])
            for image in (source.inverse_depth, source.deviation, self._frames.grey(key))
        )
        return Keyframe(
            inverse_depth=np.nan_to_num(depth, posinf=0.0),
            deviation=np.nan_to_num(deviation, posinf=0.0),
            grey=grey,
            motion=(np.linalg.inv(poses[frame]) @ poses[key])[:3],
        )

    def _projection(self, stride: int) -> Projection:
        """Return the projection on every `stride`-th row and column, from 0."""
        cx, cy = self._camera.center_for(*self._frames.shape)
        return Projection(focal=self._camera.focal / stride, center=(cx / stride, cy / stride))

    def _render_depth(self, frame: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the depth of a frame, rendered from the keyframes, and its deviation."""
        stride, shape = by_effort(DEPTH.render_stride, self._effort), self._frames.shape
        projection = self._projection(stride)
        views = [
            render_view(self._keyframe(depth, key, frame, stride), projection, continued=True)
            for key, depth in self.final_depths.items()
        ]
        grey = np.ascontiguousarray(self._frames.grey(frame)[::stride, ::stride])
        inverse_depth, deviation = fuse_views(views, grey, projection)
        depth, std = align_edges(*fill_holes(inverse_depth, deviation, grey), grey)
        return upsample(depth, stride, shape), upsample(std, stride, shape)


def choose_keyframes(
    piece: Piece, observations: Sequence[Observations], side: int, previous: int | None = None
) -> list[int]:
    """Return the keyframes of a piece, in order; tracks move far enough between them.

    With `previous`, the number of the last known keyframe, all keyframes come after it.
    """
    frames = sorted(piece.poses)
    keys = frames[:1] if previous is None else [previous]
    for frame in frames[bisect_right(frames, keys[0]) :]:
        last, current = observations[keys[-1]], observations[frame]
        index0, index1 = last.common_tracks(current)
        if len(index0) < max(1, DEPTH.min_common_tracks * len(last.tracks)):
            keys.append(frame)
            continue
        distances = np.hypot(*(current.points[index1] - last.points[index0]).T)
        if np.median(distances) > DEPTH.min_keyframe_motion * side:
            keys.append(frame)
    return keys if previous is None else keys[1:]


def _nearest_track_depth(
    points: np.ndarray, depths: np.ndarray, shape: tuple[int, int]
) -> np.ndarray | None:
    """Return the inverse depth of the nearest track at every pixel; None without tracks."""
    if len(depths) == 0:
        return None
    x, y = np.rint(points).astype(np.intp).T
    values, no_track = np.zeros(shape, np.float32), np.ones(shape, np.uint8)
    values[y, x], no_track[y, x] = 1 / depths, 0
    _, nearest = cv2.distanceTransformWithLabels(
        no_track, cv2.DIST_L2, 3, labelType=cv2.DIST_LABEL_PIXEL
    )
    table = np.zeros(nearest.max() + 1, np.float32)
    table[nearest[y, x]] = values[y, x]
    return table[nearest]


def median_depth(inverse_depth: np.ndarray) -> float:
    """Return the median depth of a frame; 1 without depth."""
    valid = inverse_depth[np.isfinite(inverse_depth) & (inverse_depth > 0)]
    return 1 / float(np.median(valid)) if len(valid) else 1.0


def depth_effort(settings: Settings) -> Effort:
    """Return the effort of plane matching of the preset that is most similar to the settings."""
    if settings.finest_level > 0:
        return "fast"
    balanced = Settings.preset("balanced")
    if settings.warps == balanced.warps:
        return "accurate" if settings.tolerance < balanced.tolerance else "balanced"
    return "accurate" if settings.warps > balanced.warps else "balanced"
