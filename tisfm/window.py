"""The data of the previous pair, for interpretations that use three frames."""

from typing import TYPE_CHECKING, Literal, get_args

from tisfm.errors import InputError, InputTypeError
from tisfm.settings import Settings

if TYPE_CHECKING:
    from tisfm.motion.previous_frame import PreviousPair

WindowSize = Literal[2, 3]


class Window:
    """Storage for the previous pair of a sequence, so that the next pair has a third frame.

    Pairs come in order. The previous pair is dropped if its flow is unreliable, for example at a
    cut, and if the spacing of the frames changes because frames are left out.
    """

    def __init__(self) -> None:
        self.previous: PreviousPair | None = None  # data of the previous pair
        self._spacing: int | None = None

    def begin(self, spacing: int) -> None:
        """Drop the previous pair if the next pair has another frame spacing."""
        if spacing != self._spacing:
            self.previous = None
        self._spacing = spacing


def make_window(size: WindowSize, settings: Settings) -> Window | None:
    """Return a `Window` for three frames, None for two.

    Raises TypeError, ValueError if `size` is not 2 or 3, or is 3 for a motion model that uses pairs
    only.
    """
    if isinstance(size, bool) or not isinstance(size, int):
        raise InputTypeError(f"window is {size!r}: expected 2 or 3, a number of frames")
    if size not in get_args(WindowSize):
        raise InputError(
            f"window is {size}: expected 2 frames, a pair, or 3, with the frame before it"
        )
    if size == 2:
        return None
    if settings.motion != "field":
        raise InputError(
            f'window is 3, but motion="{settings.motion}" takes pairs: leave it out, or give '
            'motion="field"'
        )
    return Window()
