"""Frames that were read, as many as fit into a number of bytes."""

from collections import OrderedDict
from dataclasses import replace

from tisfm.results.frame import ViewFrame
from tisfm.results.result import Result

MOST_BYTES = 256 * 2**20


class FrameCache:
    """Frames of a result; those that were not asked for the longest are forgotten.

    Parameters
    ----------
    result : Result
    most_bytes : int
        Of all frames kept; the last one is kept whatever it takes.
    """

    def __init__(self, result: Result, most_bytes: int = MOST_BYTES) -> None:
        self._result, self._most = result, most_bytes
        self._frames: OrderedDict[str, ViewFrame] = OrderedDict()

    def __len__(self) -> int:
        return len(self._frames)

    @property
    def nbytes(self) -> int:
        """Bytes of the frames that are kept."""
        return sum(frame.nbytes for frame in self._frames.values())

    def __getitem__(self, number: int) -> ViewFrame:
        """Return a frame, and read it if need be.

        Raises
        ------
        OSError, ValueError
            If it cannot be read.
        """
        name = self._result.names[number]
        frame = self._frames.pop(name, None)
        if frame is None:
            frame = self._result.read(number)
        elif frame.number != number:  # others came before it
            frame = replace(frame, number=number)
        self._frames[name] = frame
        while len(self._frames) > 1 and self.nbytes > self._most:
            self._frames.popitem(last=False)
        return frame

    def clear(self) -> None:
        """Forget all frames."""
        self._frames.clear()
