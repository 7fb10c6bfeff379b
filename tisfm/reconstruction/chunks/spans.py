"""The frames of each chunk."""

from dataclasses import dataclass
from itertools import pairwise

from tisfm.errors import InputError
from tisfm.sources.frame_reader import is_integer

# Default number of frames of a chunk.
CHUNK = 150
# Largest number of frames that a chunk shares with the next one.
MAX_OVERLAP = 20
# A short chunk shares fewer frames: its length divided by this number.
MIN_OVERLAP_DIVISOR = 3
# Smallest allowed number of frames of a chunk.
MIN_CHUNK = 12


@dataclass(frozen=True, kw_only=True)
class Span:
    """The frames of a chunk."""

    start: int  # number of the first frame in the source
    stop: int | None  # number of the first frame after the chunk; None for the end of the source
    count: int  # number of frames

    def of(self, taken: range) -> slice:
        """Return the slice of the chunk in the selected frames."""
        begin = taken.index(self.start)
        return slice(begin, begin + self.count)


def check_chunk(chunk: int) -> None:
    """Raise InputError if chunks have too few frames."""
    if not is_integer(chunk) or chunk < MIN_CHUNK:
        raise InputError(f"chunk is {chunk!r}: expected a number of frames, at least {MIN_CHUNK}")


def overlap_of(chunk: int) -> int:
    """Return the number of frames that neighbour chunks of a length share."""
    return min(MAX_OVERLAP, chunk // MIN_OVERLAP_DIVISOR)


def spans_of(
    taken: range,  # numbers of all selected frames in the source
    stop: int | None,  # the end of the selection, as given; the last chunk ends there
    chunk: int,  # largest number of frames of a chunk
) -> list[Span]:
    """Return the frames of each chunk; their lengths are as equal as possible."""
    count, overlap = len(taken), overlap_of(chunk)
    chunks = 1 if count <= chunk else -(-(count - overlap) // (chunk - overlap))
    begins = [k * (count - overlap) // chunks for k in range(chunks + 1)]
    if chunks == 1:
        begins = [0, count - overlap]
    return [
        Span(
            start=taken[begin],
            stop=stop if end + overlap >= count else taken[end + overlap - 1] + 1,
            count=end + overlap - begin,
        )
        for begin, end in pairwise(begins)
    ]
