"""How many frames an interpretation sees, and what a sequence keeps of the pair before."""

from typing import TYPE_CHECKING, Literal, get_args

from tisfm.errors import InputError, InputTypeError
from tisfm.settings import Settings

if TYPE_CHECKING:
    from tisfm.motion.previous_frame import PreviousPair

WindowSize = Literal[2, 3]


class Window:
    """What is kept from pair to pair, so that the next one has three frames.

    Pairs come in their order. What is kept is dropped where they do not follow one another evenly:
    after a pair whose flow is not to be relied on, as at cuts, and where frames are left out.

    Attributes
    ----------
    previous : PreviousPair or None
        Of the pair before.
    """

    def __init__(self) -> None:
        self.previous: PreviousPair | None = None
        self._apart: int | None = None

    def begin(self, apart: int) -> None:
        """Take notice of how many frames of the source lie between those of the next pair."""
        if apart != self._apart:
            self.previous = None
        self._apart = apart


def window_of(size: WindowSize, settings: Settings) -> Window | None:
    """Return what is kept from pair to pair, None for pairs each on its own.

    Raises
    ------
    TypeError, ValueError
        If `size` is not the number of frames of a window, or the motion takes pairs alone.
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
