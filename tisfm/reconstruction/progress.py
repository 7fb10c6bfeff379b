"""Reports of the progress of a reconstruction."""

from collections.abc import Callable
from typing import Literal

Stage = Literal["reading", "path", "depth"]
DepthOf = Literal["all", "keyframes", "none"]
"""The frames whose depth is found."""
Progress = Callable[[Stage, int, int | None], None]
"""Called with the stage, the number of finished frames, and the number of all frames, or None."""


class StopReading(Exception):  # noqa: N818  (it is no error)
    """Raised by a progress callback while frames are read: reading ends with this frame."""
