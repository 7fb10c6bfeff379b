"""Threads of Taichi, their cores, and threads of the calling program."""

import os
import threading

import numpy as np
import pytest

import tisfm
from tests.draws import nightly_except
from tests.runtime.programs import INTERPRET, answer, interpretation, run
from tisfm import runtime

# --- Threads of Taichi ------------------------------------------------------------------------


def test_starting_again_with_the_same_arguments_changes_nothing():
    code = """
    from tisfm import runtime
    import numpy
    runtime.start(threads=1)
    runtime.start(threads=numpy.int64(1))
    runtime.start()
    runtime.start("cpu")
    import taichi as ti
    field = ti.field(ti.i32, 3)
    runtime.start(threads=1)
    field[0] = 3  # a runtime that was reset would crash here
    print(field[0], runtime.lanes() > 1)
    """
    assert answer(code) == "3 True"


@pytest.mark.parametrize(
    "before",
    nightly_except(
        "runtime.start(threads=1)",
        of=["runtime.start(threads=1)", "ti.init(ti.cpu, cpu_max_num_threads=1)"],
    ),
)
@pytest.mark.skipif(os.cpu_count() == 1, reason="there is one core, so one thread for any number")
def test_another_number_of_threads_is_refused_with_advice(before):
    code = f"""
    import os
    os.environ["ENABLE_TAICHI_HEADER_PRINT"] = "0"
    import taichi as ti
    ti.set_logging_level(ti.ERROR)
    from tisfm import runtime
    {before}
    try:
        runtime.start(threads=2)
    except RuntimeError as error:
        print(error)
    runtime.start()
    """
    text = run(code).stdout.splitlines()[-1]
    assert text == (
        "Taichi already runs with 1 threads, asked for 2: call tisfm.runtime.start before the "
        "first interpretation"
    )


@pytest.mark.parametrize("threads", [0, -1, 1.5, 2.0, "2", True, np.float64(1)], ids=repr)
def test_threads_must_be_a_positive_integer(threads):
    with pytest.raises(ValueError, match=r"threads is .*expected a positive integer, or None"):
        runtime.start(threads=threads)


def test_no_more_threads_than_cores():
    code = """
    import os
    from tisfm import runtime
    runtime.start(threads=100_000)
    runtime.start(threads=200_000)
    from tisfm.kernels.layout.internals import configuration
    print(configuration().cpu_max_num_threads - os.cpu_count())
    """
    assert answer(code) == "0"


# --- Cores ------------------------------------------------------------------------------------

CORES = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 0
BOUND = """
import os
from tisfm import runtime
from tisfm.threads import thread_ids
runtime.start({options})
import tisfm.kernels.model.rigid_motion
cores = [sorted(os.sched_getaffinity(thread)) for thread in thread_ids()]
alone = sorted(core[0] for core in cores if len(core) == 1)
"""
needs_cores = pytest.mark.skipif(CORES < 2, reason="binding takes Linux and two cores")


@needs_cores
def test_every_thread_that_works_gets_a_core_of_its_own():
    work = """
print(alone == sorted(os.sched_getaffinity(0)))
import numpy as np
from tisfm.horn_schunck import horn_schunck
frame = np.random.default_rng(0).integers(0, 255, (240, 320)).astype(np.uint8)
def ticks(thread):
    stat = open(f"/proc/self/task/{thread}/stat").read().rpartition(")")[2].split()
    return int(stat[11]) + int(stat[12])
horn_schunck(frame, frame[::-1])  # compiled in other threads
before = {thread: ticks(thread) for thread in thread_ids()}
for _ in range(3):
    horn_schunck(frame, frame[::-1])
work = {thread: ticks(thread) - before[thread] for thread in before}
bound = [thread for thread in work if len(os.sched_getaffinity(thread)) == 1]
free = [thread for thread in work if thread not in bound and thread != os.getpid()]
print(min(work[thread] for thread in bound) > max(work[thread] for thread in free))
"""
    assert answer(BOUND.format(options="") + work).split() == ["True", "True"]


@needs_cores
@pytest.mark.parametrize(
    "options", nightly_except("bind_threads=False", of=["threads=1", "bind_threads=False"])
)
def test_threads_stay_free(options):
    assert answer(BOUND.format(options=options) + "print(alone)") == "[]"


# --- Threads of Python ------------------------------------------------------------------------


def test_first_interpretations_in_three_threads_are_silent_and_get_the_same_bits():
    """Standard output goes elsewhere, as in a notebook: Taichi would look there after each kernel.

    No banner, greeting or warning of Taichi's, in Python or past it: the report is all.
    """
    before = "import io, sys, threading\nsys.stdout = io.StringIO()\n"
    code = """
digests = []
threads = [
    threading.Thread(target=lambda: digests.append(digest(interpret()))) for _ in range(3)
]
for thread in threads:
    thread.start()
for thread in threads:
    thread.join()
printed, sys.stdout = sys.stdout.getvalue(), sys.__stdout__
print(repr(printed), len(digests), *set(digests))
"""
    assert answer(before + INTERPRET + code) == f"'' 3 {interpretation()[1]}"


OUTLIVE = """
import threading
import time
from tisfm import runtime
runtime.start(threads=2)

def afterwards():
    while threading.main_thread().is_alive():
        time.sleep(0.01)
    print(digest(interpret()))

{before}
threading.Thread(target=afterwards).start()
"""


@pytest.mark.nightly
@pytest.mark.parametrize("before", nightly_except("", of=["", "interpret()"]))
def test_an_interpretation_may_outlive_the_main_thread(before):
    """It has no second thread then; the bits are the same, and with two threads of Taichi."""
    assert answer(INTERPRET + OUTLIVE.format(before=before)) == interpretation()[1]


@pytest.mark.parametrize(
    ("motion", "turns"),
    [
        ("camera", 1),
        *(pytest.param(m, 4, marks=pytest.mark.nightly) for m in ("field", "camera", "objects")),
    ],
)
def test_eight_threads_at_once_get_the_bits_of_one(motion, turns):
    settings = tisfm.Settings.preset("fast", motion=motion)
    pairs = [tisfm.scenes.two_blocks(40, 56, seed=seed) for seed in range(2 * turns)]

    def bits(pair):
        result = tisfm.interpret(pair.frame0, pair.frame1, camera=pair.camera, settings=settings)
        arrays = (result.rho, result.flow, result.confidence, result.occlusion)
        return b"".join(array.tobytes() for array in arrays)

    alone = [bits(pair) for pair in pairs]
    same, together = [], threading.Barrier(8)

    def work(thread):
        together.wait(60)
        for turn in range(turns):
            index = (thread + turn) % len(pairs)
            same.append(bits(pairs[index]) == alone[index])

    threads = [threading.Thread(target=work, args=(thread,)) for thread in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(set(alone)) == len(pairs) and same == [True] * 8 * turns


# --- Forks ------------------------------------------------------------------------------------

FORK = """
import os
import sys

{before}
child = os.fork()
if child == 0:
    try:
        import tisfm
        tisfm.runtime.start()
        print("started")
    except RuntimeError as error:
        print(error)
    sys.stdout.flush()
    os._exit(0)
os.waitpid(child, 0)
"""
needs_fork = pytest.mark.skipif(not hasattr(os, "fork"), reason="this system does not fork")


@needs_fork
@pytest.mark.parametrize(
    ("before", "expected"),
    [("import tisfm", "started"), ("import tisfm; tisfm.runtime.start()", "spawn")],
    ids=["before", "after"],
)
def test_forking(before, expected):
    """After Taichi was started, a child would wait for threads that it does not have."""
    assert expected in answer(FORK.format(before=before))


@needs_fork
def test_forking_while_another_thread_starts():
    """A child that has nothing to do with interpretations is not held up."""
    code = """
    import os
    import threading
    import time

    import tisfm

    started = threading.Thread(target=tisfm.runtime.start)
    started.start()
    for _ in range(8):
        time.sleep(0.02)
        child = os.fork()
        if child == 0:
            os._exit(0)
        os.waitpid(child, 0)
    started.join()
    print("done")
    """
    assert answer(code) == "done"
