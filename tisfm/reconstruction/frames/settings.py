"""Tuned numbers of image motion between frames, set by hand."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class FrameFlowSettings:
    """Image motion between frames."""

    # image_motion
    min_pixels: int = 2**16  # pixels of a frame that is shrunk
    # px: distance of a pixel from its start after forward and backward motion
    max_return_error: float = 0.5
    # added to this bound, as a share of the length of the forward motion
    max_relative_return_error: float = 0.05


FRAME_FLOW = FrameFlowSettings()
