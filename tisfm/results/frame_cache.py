"""A cache of frames that is limited by bytes."""

from collections import OrderedDict
from dataclasses import replace

from tisfm.results.frame import ResultFrame
from tisfm.results.result_frames import ResultFrames

MAX_BYTES = 256 * 2**20  # set by hand


class FrameCache:
    """Frames of a result; the least recently used frames are dropped."""

    def __init__(
        self,
        result: ResultFrames,
        # bytes of all frames in the cache; the latest frame is kept whatever its size
        max_bytes: int = MAX_BYTES,
    ) -> None:
        self._result, self._max_bytes = result, max_bytes
        self._frames: OrderedDict[str, ResultFrame] = OrderedDict()

    def __len__(self) -> int:
        return len(self._frames)

    @property
    def nbytes(self) -> int:
        """Bytes of the frames in the cache."""
        return sum(frame.nbytes for frame in self._frames.values())

    def __getitem__(self, number: int) -> ResultFrame:
        """Return a frame; read it if it is not in the cache.

        Raises OSError, ValueError if it cannot be read.
        """
        name = self._result.names[number]
        frame = self._frames.pop(name, None)
        if frame is None:
            frame = self._result.read(number)
        elif frame.number != number:  # a growing result has new frames before this one
            frame = replace(frame, number=number)
        self._frames[name] = frame
        while len(self._frames) > 1 and self.nbytes > self._max_bytes:
            self._frames.popitem(last=False)
        return frame

    def clear(self) -> None:
        """Drop all frames."""
        self._frames.clear()
