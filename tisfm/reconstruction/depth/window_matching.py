"""Matches of a keyframe, with frames of its own for the part without matches in the first ones."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from tisfm.errors import InputError
from tisfm.reconstruction.depth.match_deviation import match_weights
from tisfm.reconstruction.depth.settings import DEPTH
from tisfm.reconstruction.depth.window_planes import Window, WindowPlanes, window_planes


@dataclass(frozen=True, kw_only=True)
class OtherFrames:
    """Frames in which a keyframe is matched."""

    grey: Sequence[np.ndarray]  # (H, W) float32: grey levels of each of M frames
    motions: np.ndarray  # (M, 3, 4) float64: R, t from the keyframe to each frame: P₁ = R P₀ + t
    masks: Sequence[np.ndarray | None]  # (H, W) bool or None: used pixels of each frame

    def check(self, shape: tuple[int, ...]) -> None:
        """Raise ValueError if there is no frame, a size differs, or a motion is useless."""
        if not self.grey:
            raise InputError("others is empty: expected at least one frame")
        count = len(self.grey)
        if self.motions.shape != (count, 3, 4):
            raise InputError(
                f"motions is {self.motions.shape} for {count} frames: expected ({count}, 3, 4)"
            )
        if not np.isfinite(self.motions).all():
            raise InputError("motions has values that are not finite: leave out these frames")
        if not self.motions[:, :, 3].any(axis=1).all():
            raise InputError("a motion has no translation: its frame gives no depth, leave it out")
        if len(self.masks) != count:
            raise InputError(f"masks has {len(self.masks)} for {count} frames: expected one each")
        for name, arrays in (("others", self.grey), ("masks", self.masks)):
            for k, array in enumerate(arrays):
                if array is not None and np.shape(array) != shape:
                    raise InputError(f"{name}[{k}] is {np.shape(array)} but key is {shape}")

    def select(self, indices: Sequence[int]) -> "OtherFrames":
        """Return some of the frames."""
        return OtherFrames(
            grey=[self.grey[k] for k in indices],
            motions=self.motions[list(indices)],
            masks=[self.masks[k] for k in indices],
        )

    def __add__(self, further: "OtherFrames") -> "OtherFrames":
        """Return all frames of both."""
        return OtherFrames(
            grey=[*self.grey, *further.grey],
            motions=np.concatenate([self.motions, further.motions]),
            masks=[*self.masks, *further.masks],
        )


@dataclass(frozen=True, kw_only=True)
class FurtherFrames:
    """Frames for the part of a keyframe that has no matches in the first frames."""

    kept: Sequence[int]  # indices of the first frames that suit this part, too
    frames: OtherFrames


# Returns frames for the cells with texture and without a match, (h, w) bool; None if no frames are
# clearly better for them.
ChooseFurther = Callable[[np.ndarray], FurtherFrames | None]


@dataclass(frozen=True, kw_only=True)
class Matches:
    """Planes of a keyframe, and the weights of its matches."""

    frames: OtherFrames  # all frames that were matched
    window: Window  # of these frames
    planes: WindowPlanes  # D is in the unit of the window
    anchors: np.ndarray  # (2, h, w) float32: weight of each cell, and its matched D, cells


def match_keyframe(
    frames: OtherFrames,
    make_window: Callable[[OtherFrames], Window],
    choose_further: ChooseFurther | None,
) -> Matches:
    """Match planes of a keyframe; a textured part without matches is matched again.

    It is matched in frames of its own, and a match there has the weight that it has among them.
    """
    window = make_window(frames)
    planes = window_planes(window)
    first = Matches(
        frames=frames, window=window, planes=planes, anchors=match_weights(window, planes)
    )
    # a cell that shows only noise, such as sky, has no match in any frame
    is_unmatched = planes.has_texture & ~planes.is_reliable & window.used_cells
    unmatched_count, used_count = is_unmatched.sum(), window.used_cells.sum()
    if choose_further is None or unmatched_count <= DEPTH.min_unmatched_share * used_count:
        return first
    further = choose_further(is_unmatched)
    return first if further is None else _add_matches(first, further, make_window)


def _add_matches(
    first: Matches, further: FurtherFrames, make_window: Callable[[OtherFrames], Window]
) -> Matches:
    second_frames = first.frames.select(further.kept) + further.frames
    second_window = make_window(second_frames)
    second = window_planes(second_window)
    second_weights = match_weights(second_window, second)[0]
    is_second = second.is_reliable & ~first.planes.is_reliable
    all_frames = first.frames + further.frames
    units = np.where(is_second, second_window.unit, first.window.unit)
    del second_window  # frees its images
    window = make_window(all_frames)
    factor = (window.unit / units).astype(np.float32)
    depth = np.where(is_second, second.inverse_depth, first.planes.inverse_depth)
    planes = WindowPlanes(
        level=window.level,
        inverse_depth=factor * depth,
        slopes=factor * np.where(is_second, second.slopes, first.planes.slopes),
        is_reliable=first.planes.is_reliable | is_second,
        has_texture=first.planes.has_texture,
    )
    weights = np.where(is_second, second_weights, first.anchors[0])
    anchors = np.stack([weights, np.where(weights > 0, planes.inverse_depth, 0)])
    return Matches(frames=all_frames, window=window, planes=planes, anchors=anchors)
