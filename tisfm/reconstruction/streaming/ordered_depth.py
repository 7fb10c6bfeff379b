"""Depth of the frames of a piece in their order."""

from collections.abc import Iterator

from tisfm.reconstruction.depth.segment_depth import FrameDepth, PieceDepths
from tisfm.reconstruction.depth.window_depth import WindowDepth


class OrderedDepth:
    """Depth of frames in order; `PieceDepths` yields keyframes before the frames between them."""

    def __init__(self, depths: PieceDepths) -> None:
        # number and depth of the last keyframe that was reached
        self.last_keyframe: tuple[int, WindowDepth] | None = None
        self._sorted = self._in_order(depths)
        self._next: FrameDepth | None = next(self._sorted, None)

    def depth_of(self, frame: int) -> FrameDepth | None:
        """Return the depth of a frame, or None. Frames have to be requested in order."""
        while self._next is not None and self._next.frame < frame:
            self._next = next(self._sorted, None)
        return self._next if self._next is not None and self._next.frame == frame else None

    def _in_order(self, depths: PieceDepths) -> Iterator[FrameDepth]:
        keyframe_depth: tuple[FrameDepth, WindowDepth] | None = None
        for depth in depths:
            if keyframe_depth is not None and depth.frame > keyframe_depth[0].frame:
                self.last_keyframe = keyframe_depth[0].frame, keyframe_depth[1]
                yield keyframe_depth[0]
                keyframe_depth = None
            if depth.frame in depths.final_depths:
                keyframe_depth = depth, depths.final_depths[depth.frame]
            else:
                yield depth
        if keyframe_depth is not None:
            self.last_keyframe = keyframe_depth[0].frame, keyframe_depth[1]
            yield keyframe_depth[0]
