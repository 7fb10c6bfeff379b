"""Report of the expected errors of depth, while chunks are completed in any order."""

import math
from collections.abc import Sequence

from tisfm.reconstruction.chunks.chunk import Chunk
from tisfm.reconstruction.chunks.placement import ChunkResult
from tisfm.reconstruction.result.reconstruction import Reconstruction
from tisfm.reconstruction.stages.progress import ReportDepth


class ErrorReport:
    """The expected errors of depth of chunks, in the order of the frames.

    The number of a frame in the joined result is known only if all earlier chunks are complete, as
    frames that cannot be read do not count. So a chunk waits for the chunks before it.
    """

    def __init__(self, chunks: Sequence[Chunk], frames: range) -> None:
        self._chunks, self._frames = chunks, frames
        self._complete: set[int] = set()
        self._next = 0  # number of the next chunk in order
        self._numbers: dict[int, int] = {}  # by number in the source: number in the joined result
        self._reported: set[int] = set()  # numbers in the joined result

    def add(self, number: int, report_depth: ReportDepth) -> None:
        """Receive the number of a complete chunk; report each frame with depth once."""
        self._complete.add(number)
        while self._next in self._complete:
            chunk = self._chunks[self._next]
            result = Reconstruction.load(chunk.folder)
            part = ChunkResult.from_result(result, chunk.span, self._frames)
            for index, number_in_chunk in part.frames.items():
                frame = self._numbers.setdefault(index, len(self._numbers))
                error = float(result.depth_error[number_in_chunk])
                if frame not in self._reported and not math.isnan(error):
                    self._reported.add(frame)
                    report_depth(frame, error)
            self._next += 1
