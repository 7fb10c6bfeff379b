"""Matches of a keyframe, with other frames for the part that has no matches in the first ones."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from tisfm.errors import InputError
from tisfm.reconstruction.depth.window_planes import Window, WindowPlanes, window_planes


@dataclass(frozen=True, kw_only=True)
class OtherFrames:
    """The other frames of a keyframe's window."""

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


# Returns the frames for the cells without a match, (h, w) bool: indices of first frames that suit
# these cells, too, and further frames; None if the first frames suit them as well as any.
ChooseFurther = Callable[[np.ndarray], tuple[Sequence[int], OtherFrames] | None]


def match_window(
    frames: OtherFrames,
    make_window: Callable[[OtherFrames], Window],
    choose_further: ChooseFurther | None,
) -> tuple[OtherFrames, Window, WindowPlanes]:
    """Match planes of a keyframe; cells without a match are matched again in their own frames.

    The returned frames and window are those of both searches.
    """
    window = make_window(frames)
    planes = window_planes(window)
    is_unmatched = ~planes.is_reliable & window.used_cells
    choice = choose_further(is_unmatched) if choose_further and is_unmatched.any() else None
    if choice is None:
        return frames, window, planes
    kept, further = choice
    second_window = make_window(frames.select(kept) + further)
    second_planes = window_planes(second_window)
    all_frames = frames + further
    whole_window = make_window(all_frames)
    is_second = second_planes.is_reliable & ~planes.is_reliable
    # D is in the unit of its window
    units = np.where(is_second, second_window.unit, window.unit)
    factor = (whole_window.unit / units).astype(np.float32)
    merged_planes = WindowPlanes(
        level=planes.level,
        inverse_depth=factor
        * np.where(is_second, second_planes.inverse_depth, planes.inverse_depth),
        slopes=factor * np.where(is_second, second_planes.slopes, planes.slopes),
        is_reliable=planes.is_reliable | is_second,
    )
    return all_frames, whole_window, merged_planes
