"""How far a reconstruction is."""

from collections.abc import Callable
from typing import Literal

Stage = Literal["reading", "path", "depth"]
Progress = Callable[[Stage, int, int | None], None]
"""Called with the stage, the frames that are done, and how many there are, None if not known."""
