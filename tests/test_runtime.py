"""Starting Taichi: silence, threads, applications that started it first, and bare environments.

Taichi keeps one runtime per process, so each of these needs a process of its own.
"""

import hashlib
import os
import re
import subprocess
import sys
import textwrap
import warnings
from pathlib import Path

import numpy as np
import pytest

import tisfm
from tests.draws import nightly_except
from tests.waiting import PATIENCE
from tisfm import runtime

INTERPRET = """
import hashlib
import sys

import cv2
import numpy as np
import tisfm

noise = np.random.default_rng(0).uniform(0, 255, (67, 94)).astype(np.float32)
texture = cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 1.5), None, 0, 255, cv2.NORM_MINMAX)
frame0, frame1 = texture[:, 1:].astype(np.uint8), texture[:, :-1].astype(np.uint8)
result = tisfm.interpret(frame0, frame1, camera=tisfm.Camera(50.0))
"""
REPORT = """
print(hashlib.sha256(result.rho.tobytes() + result.flow.tobytes()).hexdigest())
"""


def run(code, *arguments, **environment):
    """Run a program; None for a variable of the environment removes it."""
    variables = {**os.environ, "PYTHONWARNINGS": "ignore::DeprecationWarning", **environment}
    return subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code), *map(str, arguments)],
        capture_output=True,
        text=True,
        env={name: value for name, value in variables.items() if value is not None},
        timeout=PATIENCE,
        check=False,
    )


def answer(code, *arguments, **environment):
    """Run a program that must succeed in silence but for what it prints; return that."""
    done = run(code, *arguments, **environment)
    assert done.returncode == 0, (done.returncode, done.stderr)
    assert done.stderr == ""
    return done.stdout.strip()


@pytest.fixture(scope="module")
def default_answer():
    """The bits of ρ̂ and of the flow when nothing is asked for."""
    return answer(INTERPRET + REPORT)


# Silence


def test_importing_is_quick_and_silent():
    code = """
    import sys
    import tisfm
    for name in ("taichi", "matplotlib", "rich", "tyro"):
        assert name not in sys.modules, name
    """
    assert answer(code) == ""


def test_interpreting_is_silent(default_answer):
    """No banner, greeting or warning of Taichi's, in Python or past it: the report is all."""
    assert re.fullmatch("[0-9a-f]{64}", default_answer)


def test_the_process_of_these_tests_agrees(default_answer):
    variables: dict = {}
    exec(INTERPRET, variables)
    result = variables["result"]
    digest = hashlib.sha256(result.rho.tobytes() + result.flow.tobytes()).hexdigest()
    assert digest == default_answer


# The same bits


def test_two_threads_give_the_same_bits(default_answer):
    """`tests/test_pair.py` compares one thread with all."""
    code = "from tisfm import runtime; runtime.start(threads=2)\n"
    assert answer(code + INTERPRET + REPORT) == default_answer


@pytest.mark.parametrize(
    ("options", "bits"),
    [
        ("real_matrix_scalarize=False, cpu_max_num_threads=1", True),
        ("", False),  # the compiler takes vectors apart, and rounds otherwise
    ],
)
def test_an_application_that_started_taichi_gets_the_same_answer(
    default_answer, tmp_path, options, bits
):
    code = f"""
    import os
    os.environ["ENABLE_TAICHI_HEADER_PRINT"] = "0"
    import taichi as ti
    ti.init(ti.cpu, log_level=ti.WARN, {options})
    field = ti.field(ti.f32, 3)
    field.fill(7.0)
    from tisfm import runtime
    assert runtime.lanes() > 1
    """
    after = """
    assert field[1] == 7.0  # its fields still live
    np.save(sys.argv[1], result.rho)
    """
    program = textwrap.dedent(code) + INTERPRET + textwrap.dedent(after) + REPORT
    ignored = "ignore::DeprecationWarning" if bits else "ignore"  # of slow compiling
    digest = answer(program, tmp_path / "rho.npy", PYTHONWARNINGS=ignored).splitlines()[-1]
    if bits:
        assert digest == default_answer
    variables: dict = {}
    exec(INTERPRET, variables)
    rho = variables["result"].rho
    assert np.abs(rho).max() > 0.1
    # A few units in the last place per iteration; seen: 2.5e-6 of values of about 1.
    np.testing.assert_allclose(np.load(tmp_path / "rho.npy"), rho, atol=1e-4)


def test_an_application_whose_kernels_compile_slowly_is_warned_at_once():
    """Before any compilation, once for each ``ti.init``, with the argument to pass."""
    code = """
    import os, sys, warnings
    os.environ["ENABLE_TAICHI_HEADER_PRINT"] = "0"
    import taichi as ti
    from tisfm import runtime

    def said(**options):
        ti.init(ti.cpu, log_level=ti.WARN, **options)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            runtime.start()
            runtime.start()
        return [str(one.message) for one in caught]

    (text,) = said()
    assert "ti.init(arch=ti.cpu, real_matrix_scalarize=False)" in text, text
    assert "minutes to compile" in text, text
    assert said(real_matrix_scalarize=False) == []
    assert len(said()) == 1
    """
    answer(code)


# Software Vulkan


def test_software_vulkan_gives_a_warning(monkeypatch):
    """It names the driver without a GPU, and the arch to take."""
    monkeypatch.setattr(runtime, "_is_running", lambda: False)
    monkeypatch.setattr(runtime, "_initialise", lambda arch, options: None)
    monkeypatch.setattr(runtime, "software_vulkan", lambda: "llvmpipe (LLVM 15)")
    with pytest.warns(UserWarning, match="vulkan runs on llvmpipe .LLVM 15., software on the CPU"):
        runtime._start("vulkan", None, False)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        runtime._start("cuda", None, False)
        monkeypatch.setattr(runtime, "software_vulkan", lambda: "")
        runtime._start("vulkan", None, False)


def test_software_vulkan_that_an_application_started_gives_one_warning(monkeypatch):
    monkeypatch.setattr(runtime, "running_arch", lambda: "vulkan")
    monkeypatch.setattr(runtime, "software_vulkan", lambda: "llvmpipe (LLVM 15)")
    monkeypatch.setattr(runtime, "_warned_of", None)
    with pytest.warns(runtime.SoftwareVulkanWarning, match="vulkan runs on llvmpipe"):
        runtime.start()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        runtime.start()
    monkeypatch.setattr(runtime, "_warned_of", None)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        runtime.start_worker()  # the main process has warned


# Asking again


def test_asking_for_the_same_again_changes_nothing():
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
    "before", ["runtime.start(threads=1)", "ti.init(ti.cpu, cpu_max_num_threads=1)"]
)
@pytest.mark.skipif(os.cpu_count() == 1, reason="there is one core, so one thread for any number")
def test_asking_for_other_threads_is_refused_with_advice(before):
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


# Bound to cores

CORES = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 0
BOUND = """
import os
from tisfm import runtime
from tisfm.threads import thread_ids
runtime.start({options})
import tisfm.kernels.model.flow
cores = [sorted(os.sched_getaffinity(thread)) for thread in thread_ids()]
alone = sorted(core[0] for core in cores if len(core) == 1)
"""


@pytest.mark.skipif(CORES < 2, reason="binding takes Linux and two cores")
def test_every_thread_that_works_gets_a_core_of_its_own():
    work = """
print(alone == sorted(os.sched_getaffinity(0)))
import numpy as np
import tisfm
frame = np.random.default_rng(0).integers(0, 255, (480, 640)).astype(np.uint8)
def ticks(thread):
    stat = open(f"/proc/self/task/{thread}/stat").read().rpartition(")")[2].split()
    return int(stat[11]) + int(stat[12])
tisfm.interpret(frame, frame[::-1])  # compiled in other threads
before = {thread: ticks(thread) for thread in thread_ids()}
for _ in range(3):
    tisfm.interpret(frame, frame[::-1])
work = {thread: ticks(thread) - before[thread] for thread in before}
bound = [thread for thread in work if len(os.sched_getaffinity(thread)) == 1]
free = [thread for thread in work if thread not in bound and thread != os.getpid()]
print(min(work[thread] for thread in bound) > max(work[thread] for thread in free))
"""
    assert answer(BOUND.format(options="") + work).split() == ["True", "True"]


@pytest.mark.skipif(CORES < 2, reason="binding takes Linux and two cores")
@pytest.mark.parametrize("options", ["threads=1", "bind_threads=False"])
def test_threads_stay_free(options):
    assert answer(BOUND.format(options=options) + "print(alone)") == "[]"


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


@pytest.mark.parametrize("arch", ["gpu", "x64", "", 1])
def test_unknown_arch(arch):
    with pytest.raises(ValueError, match=r"arch is .*expected one of 'cpu', 'cuda', 'vulkan', "):
        runtime.start(arch)


# Where kernels run


@pytest.mark.parametrize("arch", ["cuda", "vulkan", "metal"])
def test_an_arch_that_is_not_there_is_refused_and_another_can_be_had(arch):
    code = f"""
    import os
    from tisfm import runtime
    try:
        runtime.start({arch!r})
    except RuntimeError as error:
        print(error)
        runtime.start()
    print(runtime.running_arch(), min(runtime.lanes(), 8), "TI_ARCH" in os.environ)
    """
    # Software Vulkan is warned of.
    *refusal, last = answer(code, TI_ARCH=None, PYTHONWARNINGS="ignore").splitlines()
    if not refusal:
        assert last == f"{arch} 1 False"
        pytest.skip(f"Taichi runs on {arch} here")
    assert refusal[0].startswith(f"Taichi cannot run on {arch!r} here: it needs ")
    assert last == "cpu 8 False"


def test_another_arch_than_the_running_one_is_refused(monkeypatch):
    monkeypatch.setattr(runtime, "running_arch", lambda: "cpu")
    with pytest.raises(RuntimeError, match="Taichi already runs on 'cpu', not on 'metal'"):
        runtime.start("metal")


@pytest.mark.parametrize(
    ("variable", "arch", "expected"),
    [
        ("x64", None, "cpu"),
        ("cpu", None, "cpu"),
        ("cuda", "cpu", "cpu"),  # what is asked for wins
        ("gpu", None, "the environment variable TI_ARCH is 'gpu': expected one of 'cpu', 'cuda'"),
        ("cuda", None, "Taichi cannot run on 'cuda' here"),
    ],
)
def test_the_environment_says_where(variable, arch, expected):
    code = f"""
    import os
    from tisfm import runtime
    try:
        runtime.start({arch!r})
        print(runtime.running_arch())
    except (RuntimeError, ValueError) as error:
        print(error)
    assert os.environ["TI_ARCH"] == {variable!r}
    """
    told = answer(code, TI_ARCH=variable)
    assert told.startswith(expected) or told == variable


@pytest.mark.parametrize("threads", [0, -1, 1.5, 2.0, "2", True, np.float64(1)], ids=repr)
def test_threads_must_be_a_positive_integer(threads):
    with pytest.raises(ValueError, match=r"threads is .*expected a positive integer, or None"):
        runtime.start(threads=threads)


# Bare environments


UNDISTORT = """
import numpy as np
import tisfm

frame = np.random.default_rng(0).integers(0, 255, (30, 40)).astype(np.uint8)
camera = tisfm.Camera(40.0, distortion=(-0.2, 0.0, 0.0, 0.0))
print(tisfm.lens.undistort(frame, camera).sum(dtype=int))
"""
HORN_SCHUNCK = """
import numpy as np
from tisfm.horn_schunck import horn_schunck
print(horn_schunck(np.zeros((20, 20)), np.zeros((20, 20))).shape)
"""
on_posix = pytest.mark.skipif(os.name == "nt", reason="Taichi keeps its cache elsewhere on Windows")


@on_posix
def test_no_folder_for_a_cache(default_answer):
    """Taichi alone ends such a process by a signal, when it starts or when it ends."""
    nowhere = {"HOME": "/proc/nonexistent", "XDG_CACHE_HOME": None}
    assert answer(INTERPRET + REPORT, **nowhere) == default_answer


@on_posix
def test_horn_schunck_needs_no_home_either():
    """It starts the runtime before Taichi is loaded, as `interpret` does."""
    assert answer(HORN_SCHUNCK, HOME=None, XDG_CACHE_HOME=None) == "(20, 20, 2)"


@on_posix
def test_a_cache_in_a_folder_of_its_own(tmp_path):
    """Kernels are compiled, then found there; or compiled again where a file is in the way."""
    folders = [tmp_path, tmp_path, "/dev/null"]
    sums = {answer(UNDISTORT, XDG_CACHE_HOME=str(folder)) for folder in folders}
    assert len(sums) == 1 and int(sums.pop()) > 0
    assert list((tmp_path / "taichi" / "ticache").iterdir())


def test_a_checkout_has_its_kernels(monkeypatch):
    """Started there, Python takes its package, though another may be the installed one."""
    root = Path(__file__).parents[1]
    monkeypatch.chdir(root)
    code = """
    import importlib.util
    import sys
    sys.meta_path = [finder for finder in sys.meta_path if "editable" not in repr(finder)]
    import tisfm.kernels
    assert importlib.util.find_spec("tisfm.tisfm") is None
    print(tisfm.kernels.__path__[0])
    """
    assert Path(answer(code)) == root / "kernels"


def test_the_version_is_that_of_the_package():
    from importlib.metadata import version

    assert tisfm.__version__ == version("tisfm")


# Python's threads

INTERPRET_IN_THREADS = """
import threading
import numpy as np
import tisfm
from tisfm import runtime
frames = np.random.default_rng(0).integers(0, 255, (2, 60, 90), dtype=np.uint8)
found = []
def interpret():
    found.append(tisfm.interpret(*frames).rho.tobytes())
threads = [threading.Thread(target=interpret) for _ in range({count})]
{before}
for thread in threads:
    thread.start()
for thread in threads:
    thread.join()
print(len(found), len(set(found)))
"""


@pytest.mark.parametrize(
    ("count", "before"),
    [pytest.param(1, "runtime.start()", marks=pytest.mark.nightly), (3, "")],
)
def test_the_first_interpretation_may_be_in_any_thread(count, before):
    code = INTERPRET_IN_THREADS.format(count=count, before=before)
    assert answer(code) == f"{count} 1"


EIGHT = """
import sys
import threading
import numpy as np
import tisfm
settings = tisfm.Settings.preset("fast", motion=sys.argv[1])
pairs = [tisfm.scenes.two_blocks(40, 56, seed=seed) for seed in range(4)]
def interpret(pair):
    result = tisfm.interpret(pair.frame0, pair.frame1, camera=pair.camera, settings=settings)
    arrays = (result.rho, result.flow, result.confidence, result.occlusion)
    return b"".join(array.tobytes() for array in arrays)
alone = [interpret(pair) for pair in pairs]
found = [[] for _ in range(8)]
together = threading.Barrier(8)
def work(thread):
    together.wait(60)
    for turn in range(4):
        index = (thread + turn) % 4
        found[thread].append(interpret(pairs[index]) == alone[index])
threads = [threading.Thread(target=work, args=(thread,)) for thread in range(8)]
for thread in threads:
    thread.start()
for thread in threads:
    thread.join()
print(len(set(alone)), sum(map(sum, found)))
"""


@pytest.mark.parametrize("motion", nightly_except("objects", of=["field", "camera", "objects"]))
def test_eight_threads_at_once_get_the_bits_of_one(motion):
    assert answer(EIGHT, motion) == "4 32"


OUTLIVE = """
import threading
import time

import numpy as np
import tisfm

image = np.random.default_rng(0).uniform(0, 255, (260, 260)).astype(np.float32)

def interpret():
    return tisfm.interpret(image, np.roll(image, 1, axis=1), camera=tisfm.Camera(300.0))

def afterwards():
    while threading.main_thread().is_alive():
        time.sleep(0.01)
    print(interpret().status)

{before}
threading.Thread(target=afterwards).start()
"""


@pytest.mark.parametrize("before", nightly_except("", of=["", "interpret()"]))
def test_an_interpretation_may_outlive_the_main_thread(before):
    """It has no second thread then."""
    assert answer(OUTLIVE.format(before=before)) == "converged"


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


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system does not fork")
@pytest.mark.parametrize(
    ("before", "expected"),
    [("import tisfm", "started"), ("import tisfm; tisfm.runtime.start()", "spawn")],
    ids=["before", "after"],
)
def test_forking(before, expected):
    """After Taichi was started, a child would wait for threads that it does not have."""
    assert expected in answer(FORK.format(before=before))


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system does not fork")
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


def test_an_application_may_let_taichi_check_every_index():
    before = "import taichi as ti\nti.init(ti.cpu, debug=True, log_level=ti.ERROR)\n"
    after = "print(result.status, float(np.abs(result.flow).max()) > 0.5)"
    said = answer(before + INTERPRET + after, PYTHONWARNINGS="ignore")  # of slow compiling
    assert said.endswith("converged True")


def test_integers_of_64_bits_are_refused_with_advice():
    before = "import taichi as ti\nti.init(ti.cpu, default_ip=ti.i64, log_level=ti.ERROR)\n"
    done = run(before + INTERPRET)
    assert done.returncode == 1
    assert "start it with ti.i32" in done.stderr.splitlines()[-1]


def test_nothing_is_printed_where_output_goes_elsewhere():
    """As in a notebook, whose output Taichi would look for after every kernel."""
    text = run(
        "import io, sys\nsys.stdout = io.StringIO()\nimport numpy as np, tisfm\n"
        "frame = np.random.default_rng(0).uniform(0, 255, (32, 40))\n"
        "tisfm.interpret(frame, np.roll(frame, 1, 1), camera=tisfm.Camera(40.0))\n"
        "said, sys.stdout = sys.stdout.getvalue(), sys.__stdout__\nprint(repr(said))"
    ).stdout
    assert text == "''\n"
