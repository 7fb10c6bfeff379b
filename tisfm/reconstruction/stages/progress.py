"""Reports of the progress of a reconstruction."""

from collections.abc import Callable
from typing import Literal

Stage = Literal["reading", "path", "depth"]
DepthOf = Literal["all", "keyframes", "none"]
"""The frames whose depth is found."""
Progress = Callable[[Stage, int, int | None], None]
"""A function that is called with the stage, the number of finished frames, and the number of all
frames, or None if it is unknown."""
ReportDepth = Callable[[int, float], None]
"""A function that is called with the number of a frame and the expected error of its depth."""


class StopReading(Exception):  # noqa: N818  (it is no error)
    """Raised by a progress function while frames are read: reading ends with this frame."""
