"""Tuned numbers of chunks; without another source, a number was set by hand."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class ChunkSettings:
    """Lengths, scales and the camera of chunks."""

    # chunk
    max_overlap: int = 20  # frames that a chunk shares with the next chunk
    overlap_divisor: int = 3  # a short chunk shares its length divided by this number, in frames
    # overlaps: differences and standard deviations of scales refer to the logarithms of scales
    # relative standard deviation of depth; less certain depth is ignored
    max_depth_deviation: float = 0.25
    max_frames: int = 20  # shared frames whose depth is compared
    pixels_per_frame: int = 1500  # approximate number of compared pixels in each of these frames
    min_pixels: int = 100  # pixels with comparable depth
    min_agreeing_share: float = 0.5  # share of these pixels that have to agree on the scale
    max_scale_difference: float = 0.1  # difference of scales within which pixels agree
    min_positions: int = 4  # camera positions for an estimate of the scale
    # standard deviation of the scale; a less certain estimate is ignored
    max_scale_deviation: float = 0.1
    # standard deviation of the scale; depth and positions drift along a chunk, which limits the
    # certainty of every estimate
    min_scale_deviation: float = 0.01
    # moving_objects
    # share of the smaller of two labels, in the shared frames, that the other one covers: least
    # share for one object; two rendered walkers had 0.7 and 0.99
    min_object_overlap: float = 0.5
    # shared_camera
    max_tried_chunks: int = 8  # chunks whose frames may give the focal length


CHUNKING = ChunkSettings()
