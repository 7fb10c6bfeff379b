"""The largest frame of a video: a file of kilobytes may state any size."""

from tisfm.formats import FormatError

LARGEST_FRAME = 2**26
"""Pixels beyond which no video is decoded; 8192 × 8192. Decoders hold up to 17 frames at once."""


def refuse_large_frames(path: str, width: int, height: int) -> None:
    """Raise FormatError for frames of more than `LARGEST_FRAME` pixels."""
    if width * height > LARGEST_FRAME:
        raise FormatError(
            f"{path} has frames of {width} × {height} px, more than {LARGEST_FRAME} pixels: it is "
            "damaged, or has to be shrunk"
        )
