"""How far a reconstruction is, and is to go."""

from collections.abc import Callable
from typing import Literal

Stage = Literal["reading", "path", "depth"]
DepthOf = Literal["all", "keyframes", "none"]
"""The frames that depth is found of."""
Progress = Callable[[Stage, int, int | None], None]
"""Called with the stage, the frames that are done, and how many there are, None if not known."""


class Enough(Exception):  # noqa: N818  (it is no error)
    """Raised by what is told of the progress, while frames are read: no more are wanted."""
