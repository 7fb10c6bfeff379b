"""The frames of each chunk."""

from itertools import pairwise

import pytest

from tisfm.reconstruction.chunks.chunk import (
    DEFAULT_CHUNK,
    MIN_CHUNK,
    check_chunk,
    chunk_spans,
    overlap_length,
)
from tisfm.reconstruction.chunks.settings import CHUNKING


@pytest.mark.parametrize("count", [2, 12, 13, 149, 150, 151, 281, 1000, 4321])
@pytest.mark.parametrize("chunk", [MIN_CHUNK, 40, DEFAULT_CHUNK])
@pytest.mark.parametrize(("start", "step"), [(0, 1), (7, 3)])
def test_chunks_overlap_and_have_all_frames(count, chunk, start, step):
    taken = range(start, start + step * count, step)
    spans = chunk_spans(taken, None, chunk)
    frames = [list(taken[span.slice_in(taken)]) for span in spans]
    assert frames[0][0] == taken[0] and frames[-1][-1] == taken[-1]
    assert all(2 <= len(part) <= chunk for part in frames)
    shared = [len(set(before) & set(after)) for before, after in pairwise(frames)]
    assert shared == [overlap_length(chunk)] * (len(frames) - 1)
    assert (len(spans) == 1) == (count <= chunk)
    for span, part in zip(spans, frames, strict=True):
        assert list(range(span.start, span.stop or taken.stop, step)) == part
    assert spans[-1].stop is None  # a video may have more frames than it states


def test_last_chunk_ends_at_the_given_stop():
    assert chunk_spans(range(0, 30), 30, 12)[-1].stop == 30


def test_chunks_are_even():
    lengths = [span.count for span in chunk_spans(range(1000), None, 150)]
    assert max(lengths) - min(lengths) <= 1


def test_overlaps_are_short_where_chunks_are():
    assert overlap_length(DEFAULT_CHUNK) == CHUNKING.max_overlap and overlap_length(30) == 10


@pytest.mark.parametrize("chunk", [0, -1, MIN_CHUNK - 1, 20.0, True, "30"])
def test_short_chunks_are_refused(chunk):
    with pytest.raises(ValueError, match="chunk is"):
        check_chunk(chunk)
