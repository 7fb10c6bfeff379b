"""Reading ahead: order, errors, memory, and the end of the thread."""

import gc
import subprocess
import sys
import threading
import time
import weakref

import pytest

import tisfm
from tests.draws import nightly_except
from tests.sources.made import FRAMES, QUICK
from tests.waiting import PATIENCE, wait_for
from tisfm.formats import write_png
from tisfm.sources import FrameSource
from tisfm.sources.read_ahead import READ_AHEAD_COUNT, read_ahead


def own_threads():
    return [t for t in threading.enumerate() if t.name.startswith("tisfm-frames")]


@pytest.fixture(autouse=True)
def no_thread_is_left():
    def check():
        if own_threads():
            gc.collect()  # an error may still hold a reader
        assert not own_threads()

    check()
    yield
    check()


def test_items_come_in_order():
    assert list(read_ahead(k for k in range(20))) == list(range(20))
    assert list(read_ahead(k for k in range(0))) == []
    assert list(read_ahead(item for item in [None, 0, None])) == [None, 0, None]


def test_few_items_are_read_ahead():
    made = []

    def items():
        for k in range(20):
            made.append(k)
            yield k

    ahead = read_ahead(items())
    assert next(ahead) == 0
    for k in range(1, 5):
        wait_for(lambda k=k: len(made) >= k + READ_AHEAD_COUNT)
        time.sleep(0.01)
        assert made == list(range(k + READ_AHEAD_COUNT))
        assert next(ahead) == k
    ahead.close()


def test_items_are_read_in_another_thread():
    names = list(read_ahead(threading.current_thread().name for _ in range(3)))
    assert all(name.startswith("tisfm-frames") for name in names)


def test_an_error_comes_after_earlier_items():
    def items():
        yield from range(3)
        raise OSError("the disk is gone")

    found = []
    with pytest.raises(OSError, match="the disk is gone"):
        for item in read_ahead(items()):
            found.append(item)
    assert found == [0, 1, 2]


def test_closing_early_ends_the_thread_and_the_generator():
    ended = []

    def items():
        try:
            yield from range(1000)
        finally:
            ended.append(True)

    ahead = read_ahead(items())
    next(ahead)
    assert own_threads()
    ahead.close()
    assert ended and not own_threads()


def folder_of(tmp_path, count):
    for k in range(count):
        write_png(tmp_path / f"f{k:02d}.png", FRAMES[k % len(FRAMES)])
    return tmp_path


def test_closing_a_sequence_ends_the_thread(tmp_path):
    results = tisfm.interpret_sequence(folder_of(tmp_path, 8), settings=QUICK)
    next(results)
    assert own_threads()
    results.close()
    assert not own_threads()


def test_a_consumer_that_fails_ends_the_thread(tmp_path):
    def consume():
        for _ in FrameSource(folder_of(tmp_path, 8)):
            raise RuntimeError("no place to write to")

    with pytest.raises(RuntimeError, match="no place"):
        consume()


@pytest.mark.parametrize(
    "options",
    nightly_except({"size": 20}, of=({}, {"crop": (2, 2, 30, 20)}, {"size": 20})),
    ids=str,
)
def test_few_frames_are_alive_at_a_time(tmp_path, monkeypatch, options):
    """The two of a pair, and those that are read ahead."""
    alive, most = [], []

    def read(path):
        frame = FRAMES[0].copy()
        alive.append(frame.ctypes.data)
        weakref.finalize(frame, alive.remove, frame.ctypes.data)
        most.append(len(alive))
        return frame

    monkeypatch.setattr("tisfm.sources.image_files.read_image", read)
    gc.disable()  # what only the collector frees would be held in a cycle
    try:
        for _ in tisfm.interpret_sequence(folder_of(tmp_path, 12), settings=QUICK, **options):
            pass
    finally:
        gc.enable()
    assert len(most) == 12 and max(most) <= 2 + READ_AHEAD_COUNT
    assert not alive


def test_several_sources_at_a_time(tmp_path):
    source = FrameSource(folder_of(tmp_path, 6))
    for one, other in zip(source.frames(), source.frames(), strict=True):
        assert one.name == other.name and (one.image == other.image).all()


PROGRAM = """
import sys, threading
from tisfm.sources import FrameSource
frames = FrameSource(sys.argv[1]).frames()
print(next(frames).name, flush=True)
"""


@pytest.mark.parametrize(
    "end",
    [
        pytest.param("", marks=pytest.mark.nightly),
        "sys.exit(3)",
        "raise KeyboardInterrupt",
        "later = threading.Thread(target=lambda: [threading.main_thread().join(), "
        "print(len(list(frames)))]); later.start()",
    ],
    ids=["end", "exit", "Ctrl-C", "another thread goes on"],
)
def test_the_interpreter_ends_while_frames_are_read(tmp_path, end):
    """It does not wait for frames that nobody reads; another thread gets all frames."""
    program = [sys.executable, "-c", PROGRAM + end, str(folder_of(tmp_path, 12))]
    done = subprocess.run(program, capture_output=True, text=True, timeout=PATIENCE)
    lines = done.stdout.split()
    assert lines[0] == "f00"
    if "later" in end:
        assert (lines[1:], done.stderr, done.returncode) == (["11"], "", 0)
    elif not end:
        assert (done.stderr, done.returncode) == ("", 0)
    elif "exit" in end:
        assert (done.stderr, done.returncode) == ("", 3)
    else:
        assert done.stderr.rstrip().endswith("KeyboardInterrupt") and done.returncode != 0
