"""Memory that arrays leave is used again, and never while somebody still looks at it."""

import gc
import threading

import numpy as np
import pytest

from tisfm.kernels.layout.buffers import ALIGNMENT, MAX_REUSED_BYTES, MIN_REUSED_BYTES, Buffers

COUNT = MIN_REUSED_BYTES  # floats, so four times the bytes of the smallest reused block


def address(array):
    return array.__array_interface__["data"][0]


@pytest.fixture
def buffers():
    return Buffers()


def test_memory_is_used_again(buffers):
    array = buffers.allocate_floats(COUNT)
    assert array.dtype == np.float32 and array.shape == (COUNT,) and array.flags.writeable
    first = address(array)
    assert first % ALIGNMENT == 0 and buffers.unused_bytes == 0
    del array
    assert buffers.unused_bytes >= 4 * COUNT
    again = buffers.allocate_floats(COUNT)
    assert address(again) == first and buffers.unused_bytes == 0


def test_buffers_of_another_size_are_not_reused(buffers):
    array = buffers.allocate_floats(COUNT)
    first = address(array)
    del array
    assert address(buffers.allocate_floats(COUNT - 64)) != first
    assert address(buffers.allocate_floats(COUNT)) == first


def test_a_view_keeps_its_memory(buffers):
    array = buffers.allocate_floats(COUNT)
    first = address(array)
    view = array.reshape(4, -1)[1:, ::2].T.view()
    del array
    gc.collect()
    assert buffers.unused_bytes == 0
    other = buffers.allocate_floats(COUNT)
    assert address(other) != first
    view[...] = 7
    del view
    assert address(buffers.allocate_floats(COUNT)) == first


def test_two_users_share_nothing(buffers):
    for _ in range(3):
        arrays = [buffers.allocate_floats(COUNT) for _ in range(3)]
        for value, array in enumerate(arrays):
            array[:] = value
        assert [set(array) for array in arrays] == [{0.0}, {1.0}, {2.0}]
        del array, arrays
    assert 12 * COUNT <= buffers.unused_bytes < 16 * COUNT


def test_no_more_is_kept_than_allowed():
    buffers = Buffers(max_unused_bytes=9 * COUNT)
    arrays = [buffers.allocate_floats(COUNT) for _ in range(4)]
    del arrays
    assert 8 * COUNT <= buffers.unused_bytes <= 9 * COUNT
    array = buffers.allocate_floats(COUNT // 2)
    del array  # the last to be given back is the last to be let go
    assert 6 * COUNT <= buffers.unused_bytes < 7 * COUNT
    buffers.release()
    assert buffers.unused_bytes == 0


def test_a_large_array_releases_the_kept_memory(buffers):
    """For large frames, memory counts more than the time to get it again."""
    array = buffers.allocate_floats(COUNT)
    del array
    assert buffers.unused_bytes
    buffers.allocate_floats(MAX_REUSED_BYTES // 4)
    assert buffers.unused_bytes == 0


def test_small_arrays_are_not_kept(buffers):
    array = buffers.allocate_floats(8)
    assert address(array) % ALIGNMENT == 0
    del array
    assert buffers.unused_bytes == 0


def test_threads_take_different_memory(buffers):
    wrong = []

    def use(value):
        for _ in range(300):
            array = buffers.allocate_floats(COUNT // 4 + 16)
            array[:] = value
            if not (array == value).all():
                wrong.append(value)

    threads = [threading.Thread(target=use, args=(value,)) for value in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong


def test_zeros_are_zeros_wherever_they_come_from():
    from tisfm.kernels.layout.lanes import LaneGrid, aligned_zeros

    grid = LaneGrid(200, 300)
    dirty = grid.allocate(6)
    dirty.fill(np.nan)
    where = address(dirty)
    del dirty
    clean = grid.allocate(6)
    assert address(clean) == where and not clean.any()
    assert not aligned_zeros((3, 5)).any()


def test_pairs_of_a_sequence_share_memory():
    import tisfm
    from tisfm.kernels.layout.buffers import buffers

    gc.collect()
    buffers.release()  # what other tests have left
    frames = np.random.default_rng(0).integers(0, 255, (2, 100, 150), dtype=np.uint8)
    first = tisfm.interpret(*frames)
    second = tisfm.interpret(*frames)
    kept = []
    for _ in range(4):
        tisfm.interpret(*frames)
        kept.append(buffers.unused_bytes)
    assert kept[-1] == kept[-2] and 0 < max(kept) < 4 * 150 * frames[0].size
    np.testing.assert_array_equal(first.rho, second.rho)
    np.testing.assert_array_equal(first.confidence, second.confidence)
