"""The disk cache of data of every frame."""

import errno
import io
import tempfile

import numpy as np
import pytest

from tisfm.reconstruction.frames.disk_cache import DiskCache
from tisfm.reconstruction.tracks.tracker import Observations


def seen_of(count, seed=0):
    points = np.random.default_rng(seed).normal(size=(count, 2))
    return Observations(points=points, tracks=np.arange(count) * 3)


def assert_same(found, kept):
    for one, other in zip(found.to_arrays(), kept.to_arrays(), strict=True):
        np.testing.assert_array_equal(one, other)
        assert one.dtype == other.dtype


def test_items_come_back_as_they_were_in_any_order():
    shelf = DiskCache(Observations.to_arrays, Observations.from_arrays)
    kept = [seen_of(count, seed=count) for count in (5, 0, 17)]
    for number, one in enumerate(kept):
        shelf.append(one)
        assert_same(shelf[number], one)
    for number in (2, 0, 1, -1):
        assert_same(shelf[number], kept[number])
    for found, one in zip(shelf, kept, strict=True):
        assert_same(found, one)


def test_changing_an_array_from_the_cache_leaves_the_cache():
    shelf = DiskCache(Observations.to_arrays, Observations.from_arrays)
    shelf.append(seen_of(4))
    shelf[0].points[:] = 0
    assert_same(shelf[0], seen_of(4))


def test_error_of_a_full_disk_has_advice(monkeypatch):
    class Full(io.BytesIO):
        def write(self, data):
            raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(tempfile, "TemporaryFile", lambda prefix: Full())
    with pytest.raises(OSError, match="No space left on device; set TMPDIR to another folder"):
        DiskCache(Observations.to_arrays, Observations.from_arrays).append(seen_of(1))


def test_there_is_no_item_after_the_last():
    with pytest.raises(IndexError):
        DiskCache(Observations.to_arrays, Observations.from_arrays)[0]
