"""Tuned numbers of image motion between frames, set by hand."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class FrameFlowSettings:
    """Image motion between frames."""

    # image_motion
    min_pixels: int = 2**16  # pixels of the shrunk frames
    max_return_error: float = 0.5  # px: distance from the start after forward and backward motion,
    max_relative_return_error: float = 0.05  # plus this share of the length of the motion


FRAME_FLOW = FrameFlowSettings()
