"""Writing beside interpreting: in order, whole, and with its errors."""

import contextlib
import signal
import subprocess
import sys
import threading
import time
import weakref
from pathlib import Path

import pytest

from tests.cli.command_line import assert_one_line, files, promised, record
from tests.waiting import PATIENCE, started, wait_for
from tisfm import pair
from tisfm.folders import run_record
from tisfm.formats.atomic import atomic_write
from tisfm.running import pair_files
from tisfm.running.background import BackgroundThread


def test_work_is_done_in_order_in_one_other_thread():
    done = []
    with BackgroundThread() as background:
        for k in range(20):
            background.submit(lambda k=k: done.append((k, threading.get_ident())))
    assert [k for k, _ in done] == list(range(20))
    threads = {thread for _, thread in done}
    assert len(threads) == 1 and threading.get_ident() not in threads


@pytest.mark.parametrize("fault", [None, KeyboardInterrupt])
def test_turns_are_shorter_for_a_while(fault):
    usual = sys.getswitchinterval()
    with contextlib.suppress(KeyboardInterrupt), BackgroundThread():
        assert sys.getswitchinterval() < usual
        if fault is not None:
            raise fault
    assert sys.getswitchinterval() == usual


def test_one_waits_and_the_next_is_waited_for():
    free, given = threading.Event(), []
    with BackgroundThread() as background:

        def give():
            for k in range(3):
                background.submit(free.wait)
                given.append(k)

        giving = threading.Thread(target=give)
        giving.start()
        wait_for(lambda: len(given) == 2)
        time.sleep(0.1)
        assert given == [0, 1]
        free.set()
        giving.join()
    assert given == [0, 1, 2]


@pytest.mark.parametrize("fault", [OSError, KeyboardInterrupt, SystemExit])
def test_an_error_is_raised_and_ends_the_work(fault):
    done = []

    def fail():
        raise fault("in the thread")

    with pytest.raises(fault, match="in the thread"), BackgroundThread() as background:
        background.submit(fail)
        for k in range(5):
            background.submit(done.append, k)
            time.sleep(0.05)
    assert not done


def test_an_error_of_the_last_piece_is_raised():
    def fail():
        time.sleep(0.1)
        raise OSError("at the end")

    with pytest.raises(OSError, match="at the end"), BackgroundThread() as background:
        background.submit(fail)


@pytest.mark.parametrize("fault", [ValueError, KeyboardInterrupt])
def test_work_submitted_before_an_error_is_done(fault):
    done = []
    with pytest.raises(fault, match="outside"), BackgroundThread() as background:
        for k in range(2):
            background.submit(lambda k=k: (time.sleep(0.1), done.append(k)))
        raise fault("outside")
    assert done == [0, 1]


def test_finished_work_is_released():
    class Held:
        pass

    held = Held()
    gone = weakref.ref(held)
    with BackgroundThread() as background:
        background.submit(lambda what: None, held)
        del held
        wait_for(lambda: gone() is None)


def test_an_error_of_writing_ends_the_run(tisfm_run, frames, monkeypatch):
    original, calls = pair_files.write_depth_png, []

    def full(*arguments, **options):
        calls.append(1)
        if len(calls) == 2:
            raise OSError(28, "No space left on device")
        return original(*arguments, **options)

    monkeypatch.setattr(pair_files, "write_depth_png", full)
    code, out, err = tisfm_run("run", "frames", "-o", "out", "--no-figures")
    assert out == ""
    assert_one_line(code, err, "No space left on device")
    assert set(promised("f0", figures=False)) <= set(files("out"))
    assert list(record("out")["pairs"]) == ["f0"]


@pytest.mark.parametrize("slow", [True, False])
def test_ctrl_c_keeps_interpreted_pairs(tisfm_run, frames, monkeypatch, slow):
    """Writing may lag behind: what was interpreted before is written whole."""
    original, calls = pair_files.write_depth_png, []

    def write_depth_png(*arguments, **options):
        time.sleep(0.5 * slow)
        return original(*arguments, **options)

    interpret = pair.interpret

    def interrupted(*arguments, **options):
        calls.append(1)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return interpret(*arguments, **options)

    monkeypatch.setattr(pair_files, "write_depth_png", write_depth_png)
    monkeypatch.setattr(pair, "interpret", interrupted)
    code, out, err = tisfm_run("run", "frames", "-o", "out", "--no-figures")
    assert (code, out, err) == (130, "", "tisfm: interrupted\n")
    assert set(files("out")) == promised("f0", "f1", figures=False)
    assert list(record("out")["pairs"]) == ["f0", "f1"]


def test_a_run_that_ignores_ctrl_c_continues(tisfm_run, frames, monkeypatch):
    """A shell tells this to jobs in the background of a script."""
    interpret = pair.interpret

    def interrupted(*arguments, **options):
        signal.raise_signal(signal.SIGINT)
        return interpret(*arguments, **options)

    monkeypatch.setattr(pair, "interpret", interrupted)
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        code, _, err = tisfm_run("run", "frames", "-o", "out", "--no-figures")
    finally:
        signal.signal(signal.SIGINT, before)
    assert code == 0 and err.startswith("3 pairs: ")
    assert list(record("out")["pairs"]) == ["f0", "f1", "f2"]


def test_the_record_of_a_long_run_is_not_renewed_after_every_pair(tisfm_run, frames, monkeypatch):
    written = []

    def counted(path, **options):
        written.append(Path(path).name)
        return atomic_write(path, **options)

    monkeypatch.setattr(run_record, "atomic_write", counted)
    monkeypatch.setattr(run_record, "_MIN_WRITE_INTERVAL", 1000.0)
    assert tisfm_run("run", "frames", "-o", "out", "--no-figures")[0] == 0
    assert (
        written == ["timings.csv", "run.csv", "run.json"] * 2
    )  # after the first pair, and at the end
    assert list(record("out")["pairs"]) == ["f0", "f1", "f2"]


def test_a_second_interrupt_ends_the_process():
    """With one piece at work and one that waits: the first is done, the other left out."""
    script = f"""
import sys
import threading
import time
from tisfm.running.background import BackgroundThread

begun = threading.Event()

def piece(name):
    begun.set()
    sys.stdin.readline()  # the test ends the piece
    print("end", name, flush=True)

def told(item, block=True):
    print("leaving", flush=True)
    put(item, block)

with BackgroundThread() as background:
    background.submit(piece, 1)
    begun.wait()
    background.submit(piece, 2)
    put, background._jobs.put = background._jobs.put, told
    print("ready", flush=True)
    time.sleep({PATIENCE})
"""
    with started(
        [sys.executable, "-c", script],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as process:
        assert process.stdout.readline() == "ready\n"
        for _ in range(2):
            process.send_signal(signal.SIGINT)
            assert process.stdout.readline() == "leaving\n"
        out, err = process.communicate("\n\n", timeout=PATIENCE)
    assert "KeyboardInterrupt" in err
    assert out.split() == ["end", "1"]
