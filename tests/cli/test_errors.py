"""One line for every error of `tisfm run`, and what was finished is kept."""

import contextlib
import os
import subprocess
import tempfile
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.cli.command_line import FRAMES, TISFM, assert_one_line, files, forbid, promised, record
from tests.draws import nightly_except
from tisfm import interpretation_file, pair
from tisfm.cli import demo, evaluate
from tisfm.errors import InputError
from tisfm.evaluation import pairs
from tisfm.formats import write_png
from tisfm.running import pair_files


def damaged(kind, work_folder):
    """Make one bad input; return it as a list of sources."""
    good = work_folder / "frames" / "f1.png"
    bad = work_folder / "bad.png"
    if kind == "truncated file":
        data = good.read_bytes()
        bad.write_bytes(data[: len(data) // 2])
    elif kind == "empty file":
        bad.write_bytes(b"")
    elif kind == "garbage":
        bad.write_bytes(b"garbage" * 50)
    elif kind == "other size":
        write_png(bad, FRAMES[0][:, 1:])
    elif kind == "one pixel":
        write_png(bad, FRAMES[0][:1, :1])
        return [bad, bad]
    elif kind == "colour beside grey":
        write_png(bad, np.dstack([FRAMES[0]] * 3))
    elif kind == "16 bits beside 8":
        write_png(bad, FRAMES[0].astype(np.uint16))
    elif kind in ("NaN", "infinite"):
        pixels = FRAMES[0].astype(np.float32)
        bad, good = work_folder / "bad.tif", work_folder / "good.tif"
        cv2.imwrite(str(good), pixels)
        pixels[3, 5] = np.nan if kind == "NaN" else np.inf
        cv2.imwrite(str(bad), pixels)
    elif kind == "text as video":
        bad = work_folder / "bad.mp4"
        bad.write_text("no video\n" * 100)
        return [bad]
    elif kind == "empty folder":
        bad = work_folder / "bad"
        bad.mkdir()
        return [bad]
    elif kind == "single frame":
        return [good]
    elif kind == "pattern without a match":
        return [work_folder / "gone*.png"]
    return [bad, good]


BAD_INPUTS = {
    "missing file": ("bad.png", "there is no file"),
    "truncated file": ("bad.png", "cut off"),
    "empty file": ("bad.png", "empty"),
    "garbage": ("bad.png",),
    "other size": ("(24, 39)", "(24, 40)", "bad", "f1"),
    "one pixel": ("1 × 1", "at least 4 × 4"),
    "colour beside grey": ("(24, 40, 3)", "bad", "f1"),
    "16 bits beside 8": ("uint16", "uint8", "bad", "f1"),
    "NaN": ("NaN or infinite", "bad"),
    "infinite": ("NaN or infinite", "bad"),
    "text as video": ("bad.mp4", "not an image or a video"),
    "empty folder": ("bad", "no images"),
    "single frame": ("f1.png", "has 1 frame"),
    "pattern without a match": ("gone*.png", "no file matches"),
}


@pytest.mark.parametrize("kind", BAD_INPUTS)
def test_bad_frames_are_one_line(tisfm_run, frames, work_folder, kind):
    source = damaged(kind, work_folder)
    code, out, err = tisfm_run("run", *source, "-o", "out")
    assert out == ""
    assert_one_line(code, err, *BAD_INPUTS[kind])
    assert not (work_folder / "out").exists() or not files("out")


@pytest.mark.parametrize(
    "kind",
    nightly_except("text as video", of=("truncated file", "garbage", "NaN", "text as video")),
)
def test_bad_frames_are_one_line_in_a_process(frames, work_folder, kind):
    """Libraries that decode may print lines of their own, past Python."""
    source = damaged(kind, work_folder)
    done = subprocess.run([*TISFM, "run", *source, "-o", "out"], capture_output=True, text=True)
    assert done.stdout == ""
    assert_one_line(done.returncode, done.stderr, *BAD_INPUTS[kind])


@contextlib.contextmanager
def without_privileges():
    """Be somebody whom permissions apply to."""
    if os.name == "nt":
        pytest.skip("permissions are another matter on Windows")
    privileged = os.geteuid() == 0
    if privileged:
        os.seteuid(65534)
    try:
        yield
    finally:
        if privileged:
            os.seteuid(0)


@pytest.fixture
def public_frames():
    """Two frames and an output folder where everybody may look."""
    with tempfile.TemporaryDirectory() as folder:
        os.chmod(folder, 0o755)
        for k in range(2):
            write_png(f"{folder}/f{k}.png", FRAMES[k])
            os.chmod(f"{folder}/f{k}.png", 0o644)  # whatever the umask
        os.mkdir(f"{folder}/out")
        yield Path(folder)


def test_an_unreadable_file_is_one_line(tisfm_run, public_frames):
    os.chmod(public_frames / "out", 0o777)
    os.chmod(public_frames / "f1.png", 0o000)
    with without_privileges():
        code, _, err = tisfm_run(
            "run", public_frames / "f0.png", public_frames / "f1.png", "-o", public_frames / "out"
        )
    assert_one_line(code, err, "f1.png", "cannot be read")
    assert not files(public_frames / "out")


@pytest.mark.parametrize("below", ["out", "out/deeper"])
def test_an_unwritable_folder_is_one_line(tisfm_run, public_frames, monkeypatch, below):
    os.chmod(public_frames / "out", 0o555)
    monkeypatch.setattr(pair, "interpret", forbid)  # it is known before any work
    with without_privileges():
        code, _, err = tisfm_run("run", public_frames, "-o", public_frames / below)
    assert_one_line(code, err, public_frames / below, "Permission denied", "-o")
    assert not files(public_frames / "out")


@pytest.mark.parametrize("output", ["file", "file/out", "file/deep/out"])
@pytest.mark.parametrize("command", ["run", "demo", "eval", "figures"])
def test_an_output_that_is_a_file_is_one_line(
    tisfm_run, frames, benchmark_folder, work_folder, monkeypatch, output, command
):
    (work_folder / "file").write_text("mine")
    monkeypatch.setattr(pair, "interpret", forbid)
    monkeypatch.setattr(pairs, "interpret", forbid)
    monkeypatch.setattr(demo, "open_pool", forbid)
    source = {
        "run": ["frames"],
        "demo": [],
        "eval": ["flows"],
        "figures": ["frames/f0.png", "frames/f1.png"],
    }
    code, _, err = tisfm_run(command, *source[command], "-o", output)
    assert_one_line(code, err, output, "give another with -o")
    assert (work_folder / "file").read_text() == "mine"


LONG = (100_000, 4)  # px: a row more than .flo files can have


@pytest.mark.parametrize("size", [LONG, LONG[::-1]])
def test_frames_too_large_for_files_are_one_line(tisfm_run, work_folder, monkeypatch, size):
    monkeypatch.setattr(pair, "interpret", forbid)
    for name in ("a.png", "b.png"):
        write_png(work_folder / name, np.zeros(size, np.uint8))
    before = set(work_folder.rglob("*"))
    code, _, err = tisfm_run("run", "a.png", "b.png", "-o", "out", "--preset", "fast", "--flo")
    assert_one_line(code, err, f"frame a is {size[0]} × {size[1]} px", 99999, "scale the frames")
    options = ["--height", size[0], "--width", size[1]]
    code, _, err = tisfm_run("demo", "-o", "out", *options)
    assert_one_line(code, err, f"scene is {size[0]} × {size[1]} px", 99999, "scale the frames")
    assert set(work_folder.rglob("*")) == before


def _refuse_wide_frames(name, height, width):
    raise InputError(f"{name} is {width} px wide")


def test_pairs_too_large_for_files_are_faults(tisfm_run, benchmark_folder, monkeypatch):
    with monkeypatch.context() as patched:
        patched.setattr(evaluate, "require_writable_flow", _refuse_wide_frames)
        patched.setattr(pairs, "interpret", forbid)
        code, _, err = tisfm_run("eval", "flows", "-o", "out", "--preset", "fast")
    assert code == 1
    for name in ("Slow", "Fast"):
        line = f"tisfm: flows/{name}: frame0 is 40 px wide"
        assert line in err
    assert [path.name for path in Path("out").rglob("*")] == ["eval.json"]
    monkeypatch.setattr(evaluate, "require_writable_flow", _refuse_wide_frames)
    assert tisfm_run("eval", "flows", "--preset", "fast")[0] == 0  # nothing is written


@pytest.mark.parametrize("source", ["frames", "frames/*.png", "./frames/../frames"])
@pytest.mark.parametrize("output", ["frames", "./frames/"])
def test_results_do_not_go_among_the_frames(tisfm_run, frames, source, output):
    before = files("frames")
    code, _, err = tisfm_run("run", source, "-o", output)
    assert_one_line(code, err, "among the frames", "-o")
    assert files("frames") == before


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--focal", "0"], ["focal is 0", "positive"]),
        (["--focal", "-5"], ["focal is -5", "positive"]),
        (["--focal", "nan"], ["focal is nan", "finite"]),
        (["--focal", "inf"], ["focal is inf", "finite"]),
        (["--center", "nan", "3"], ["center[0] is nan", "finite"]),
        (["--distortion", "1,2,3"], ["distortion has 3 coefficients", "4, 5, 8, 12 or 14"]),
        (["--distortion", "1,x,0,0"], ["distortion is '1,x,0,0'", "commas between"]),
        (["--distortion", ""], ["distortion has 0 coefficients"]),
        (["--focal", "guess", "--step", "9"], ["has 4 frames"]),
        (["--focal", "guess", "--warps", "0"], ["warps is 0"]),
        (["--warps", "0"], ["warps is 0", "at least 1"]),
        (["--contrast", "-1"], ["contrast is -1.0", "at least 0.001"]),
        (["--relaxation", "2"], ["relaxation is 2.0", "below 2"]),
        (["--step", "0"], ["step is 0", "positive integer"]),
        (["--step", "9"], ["has 4 frames", "at least 10"]),
        (["--poses", "gone.txt", "--motion", "camera"], ["gone.txt"]),
        (["--threads", "0"], ["threads is 0", "positive integer"]),
        (["--arch", "vulkan"], ["Taichi ", "on 'vulkan'"]),
    ],
    ids=lambda value: " ".join(value),
)
def test_values_out_of_range_are_one_line(
    tisfm_run, frames, work_folder, without_vulkan, options, words
):
    code, out, err = tisfm_run("run", "frames", "-o", "out", *options)
    assert code == 1 and out == ""
    assert_one_line(code, err, *words)
    assert not (work_folder / "out").exists() or not files("out")


def test_pairs_before_an_error_are_kept(tisfm_run, frames):
    (frames / "f3.png").write_bytes(b"damaged")
    run = ("run", "frames", "--no-figures", "-o")
    code, _, err = tisfm_run(*run, "out")
    assert_one_line(code, err, "f3.png")
    assert set(files("out")) == promised("f0", "f1", figures=False)
    assert list(record("out")["pairs"]) == ["f0", "f1"]
    write_png(frames / "f3.png", FRAMES[3])
    assert tisfm_run(*run, "out", "--resume")[0] == 0
    assert tisfm_run(*run, "whole")[0] == 0
    assert files("out") == files("whole")


def test_a_full_disk_is_one_line(tisfm_run, frames, monkeypatch):
    def full(*arguments, **options):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(interpretation_file, "write_npz", full)
    code, _, err = tisfm_run("run", "frames", "-o", "out", "--no-figures")
    assert_one_line(code, err, "No space left on device")
    assert set(files("out")) < promised("f0", figures=False)


def test_source_is_required(tisfm_run):
    code, out, err = tisfm_run("run", "-o", "out")
    assert code == 1 and out == ""
    assert_one_line(code, err, "SOURCE is missing", "two or more images", "tisfm run FOLDER -o DIR")


@pytest.mark.parametrize(
    "arguments",
    [[], ["run"], ["run", "frames"], ["figures", "a.png", "-o", "out"], ["walk"],
     ["run", "frames", "-o", "out", "--presett", "paper"],
     ["run", "frames", "-o", "out", "--preset", "best"],
     ["run", "frames", "-o", "out", "--preset"],
     ["run", "frames", "-o", "out", "--motion", "layers"],
     ["run", "frames", "-o", "out", "--focal", "wide"]],
    ids=" ".join,
)  # fmt: skip
def test_wrong_usage_is_code_2(tisfm_run, frames, work_folder, arguments):
    code, out, err = tisfm_run(*arguments)
    assert code == 2 and out == ""
    assert err and "Traceback" not in err and "dummy" not in err
    assert not (work_folder / "out").exists()


# Bugs


class Broken:
    """Raises what NumPy, Taichi or a slip of ours would."""

    def shapes(*arguments, **options):
        return np.zeros(3) + np.zeros(4)

    def types(*arguments, **options):
        return len(3)

    def names(*arguments, **options):
        return {}["no"]

    def assertion(*arguments, **options):
        raise AssertionError("no")

    def taichi(*arguments, **options):
        raise RuntimeError("compilation failed")

    def opencv(*arguments, **options):
        return cv2.resize(np.zeros((0, 0), np.uint8), (3, 3))


KINDS = {
    "shapes": ValueError,
    "types": TypeError,
    "names": KeyError,
    "assertion": AssertionError,
    "taichi": RuntimeError,
    "opencv": cv2.error,
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("where", ["interpret", "write"])
def test_a_bug_leaves_its_traceback(tisfm_run, frames, monkeypatch, kind, where):
    """Whether it comes up in interpreting or, in its own thread, in writing."""
    module, name = (pair, "interpret") if where == "interpret" else (pair_files, "depth_grey")
    monkeypatch.setattr(module, name, getattr(Broken, kind))
    with pytest.raises(KINDS[kind]) as caught:
        tisfm_run("run", "frames", "-o", "out", "--no-figures")
    assert caught.traceback[-1].name == kind


@pytest.mark.parametrize("kind", ["shapes", "types", "taichi"])
def test_a_bug_is_raised(tisfm_run, benchmark_folder, monkeypatch, kind):
    monkeypatch.setattr(pairs, "interpret", getattr(Broken, kind))
    with pytest.raises(KINDS[kind]):
        tisfm_run("eval", "flows")


def no_memory(*arguments, **options):
    error = cv2.error("Failed to allocate 9663676416 bytes")
    error.code = cv2.Error.StsNoMem
    raise error


@pytest.mark.parametrize("where", ["interpret", "write", "read", "video"])
def test_no_memory_is_one_line(tisfm_run, frames, monkeypatch, where):
    """However OpenCV says it."""
    source = "frames"
    if where == "interpret":
        monkeypatch.setattr(pair, "interpret", no_memory)
    elif where == "write":
        monkeypatch.setattr(pair_files, "anaglyph", no_memory)
    elif where == "read":
        monkeypatch.setattr(cv2, "imdecode", no_memory)
    else:

        class Capture:
            """A video whose frames are too large; OpenCV's own class must not be derived from."""

            retrieve = no_memory

            def isOpened(self):
                return True

            grab = isOpened

            def get(self, what):
                return 2

            def release(self):
                pass

        Path("clip.avi").write_bytes(b"a video")
        monkeypatch.setattr(cv2, "VideoCapture", lambda path: Capture())
        source = "clip.avi"
    code, out, err = tisfm_run("run", source, "-o", "out", "--no-figures")
    assert out == ""
    assert_one_line(code, err, "not enough memory")


def test_errors_name_their_frames_once(tisfm_run, frames):
    write_png(frames / "f2.png", FRAMES[2][:, 1:])
    code, _, err = tisfm_run("run", "frames", "-o", "out", "--no-figures")
    assert_one_line(code, err, "frames f1 and f2: ")
    assert err.count("frames f1") == 1
