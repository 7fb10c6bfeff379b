"""Tuned numbers of image motion between frames, set by hand."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class FrameFlowSettings:
    """Image motion between frames."""

    # image_motion
    min_pixels: int = 2**16  # frames are shrunk, but keep at least this number of pixels
    # px: distance of a pixel from its start after forward and backward motion
    max_return_error: float = 0.5
    # addition to this bound, divided by the length of the forward motion
    max_relative_return_error: float = 0.05
    # prepared_frames
    # frames whose motion from the previous frame is kept after tracking, for checks of the path;
    # one takes about half a megabyte
    max_kept_flows: int = 64


FRAME_FLOW = FrameFlowSettings()
