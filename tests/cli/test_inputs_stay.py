"""No result replaces what is read, whatever its name: one line, and nothing is written."""

import os
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.cli.command_line import FRAMES, H, W, assert_one_line, files, forbid, promised
from tisfm import pair
from tisfm.cli import demo
from tisfm.evaluation import pairs
from tisfm.folders.result_folder import LOCK, InputFiles
from tisfm.formats import write_flo, write_png
from tisfm.running import pair_writer


@pytest.fixture
def d(work_folder):
    """A folder of frames, one of which is called like a result."""
    folder = work_folder / "d"
    folder.mkdir()
    for name, frame in zip(("x", "x_depth", "y"), FRAMES, strict=False):
        write_png(folder / f"{name}.png", frame)
    return folder


@pytest.fixture
def nothing_interpreted(monkeypatch):
    for module in (pair, pairs):
        monkeypatch.setattr(module, "interpret", forbid)
    monkeypatch.setattr(demo, "open_pool", forbid)


def everything(work_folder):
    return {str(path): path.read_bytes() for path in work_folder.rglob("*") if path.is_file()}


def assert_refused(tisfm_run, work_folder, *arguments, words=("would replace",)):
    before = everything(work_folder)
    code, out, err = tisfm_run(*arguments)
    assert out == ""
    assert_one_line(code, err, *words, "-o")
    assert everything(work_folder) == before


X = ("d/x.png", "d/x_depth.png", "d/y.png")


@pytest.mark.parametrize("output", ["d", "./d/", "d/../d", "link", "d/down/.."])
@pytest.mark.parametrize("options", [(), ("--resume",), ("--no-figures",), ("--step", "2")])
def test_frames_in_the_output_folder_are_not_replaced(
    tisfm_run, d, work_folder, nothing_interpreted, output, options
):
    (work_folder / "link").symlink_to(d, target_is_directory=True)
    (d / "down").mkdir()
    words = ("would replace", "x_depth.png")
    assert_refused(tisfm_run, work_folder, "run", *X, "-o", output, *options, words=words)


def test_files_listed_by_the_shell_are_not_replaced(tisfm_run, d, work_folder, nothing_interpreted):
    listed = sorted(map(str, Path("d").glob("*.png")))
    assert_refused(tisfm_run, work_folder, "run", *listed, "-o", "d")


@pytest.mark.parametrize("pattern", ["d?/*.png", "*/*.png", "./d[12]/x*", "d1/../d?/*.png"])
@pytest.mark.parametrize("frames_there", [True, False])
def test_frames_of_a_pattern_are_not_replaced(
    tisfm_run, d, work_folder, nothing_interpreted, pattern, frames_there
):
    shutil.copytree(d, work_folder / "d1")
    if frames_there:
        shutil.copytree(d, work_folder / "d2")
    shutil.rmtree(d)
    assert_refused(
        tisfm_run, work_folder, "run", pattern, "-o", "d2", words=("among the frames", "d2")
    )


@pytest.mark.parametrize("link", [os.symlink, os.link])
@pytest.mark.parametrize("name", ["x_depth.png", "x.npz", "x_figure.png", "run.json", "x.ply"])
def test_links_to_frames_among_the_results_are_not_replaced(
    tisfm_run, d, work_folder, nothing_interpreted, link, name
):
    """The frame lies elsewhere; a link of a result's name leads to it."""
    (work_folder / "out").mkdir()
    link(os.path.abspath("d/x.png"), f"out/{name}")
    arguments = ("run", "d/x.png", "d/y.png", "-o", "out")
    assert_refused(tisfm_run, work_folder, *arguments, words=("would replace", "x.png", name))


def test_a_frame_that_links_to_a_result_is_refused(tisfm_run, d, work_folder, nothing_interpreted):
    (work_folder / "out").mkdir()
    shutil.copy("d/x.png", "out/a_anaglyph.png")
    (work_folder / "a.png").symlink_to("out/a_anaglyph.png")
    assert_refused(tisfm_run, work_folder, "run", "a.png", "d/y.png", "-o", "out")


def test_images_of_any_suffix_are_not_replaced(tisfm_run, d, work_folder, nothing_interpreted):
    """What a picture is follows from its contents: one that is called .npz would be deleted."""
    (d / "x.png").rename(work_folder / "x.npz")
    assert_refused(tisfm_run, work_folder, "run", "x.npz", "d/y.png", "-o", ".")


@pytest.mark.parametrize("name", ["run.json", "x_pose.txt"])
def test_a_pose_file_among_the_results_is_refused(
    tisfm_run, d, work_folder, nothing_interpreted, name
):
    (work_folder / "out").mkdir()
    (work_folder / "out" / name).write_text("1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 1 0 1 0 0 0 0 1 0\n")
    arguments = ("run", "d/x.png", "d/y.png", "-o", "out", "--motion", "camera", "--focal", "40")
    poses = ("--poses", f"out/{name}")
    assert_refused(tisfm_run, work_folder, *arguments, *poses, words=("would replace", name))


def make_video(path):
    writer = cv2.VideoWriter("v.avi", cv2.VideoWriter_fourcc(*"MJPG"), 10, (64, 48))
    if not writer.isOpened():
        pytest.skip("this build of OpenCV cannot write MJPG video")
    for frame in FRAMES[:3]:
        writer.write(cv2.resize(cv2.cvtColor(frame, cv2.COLOR_GRAY2BGR), (64, 48)))
    writer.release()
    os.rename("v.avi", path)


@pytest.mark.parametrize("link", [os.symlink, os.link])
@pytest.mark.parametrize("name", ["clip_000001_depth.png", "run.json"])
def test_a_video(tisfm_run, work_folder, nothing_interpreted, link, name):
    make_video("clip.avi")
    (work_folder / "out").mkdir()
    link(os.path.abspath("clip.avi"), f"out/{name}")
    assert_refused(tisfm_run, work_folder, "run", "clip.avi", "-o", "out", words=("clip.avi", name))


def test_results_may_lie_beside_a_video(tisfm_run, work_folder):
    make_video("clip.avi")
    before = Path("clip.avi").read_bytes()
    assert tisfm_run("run", "clip.avi", "-o", ".", "--no-figures")[0] == 0
    assert Path("clip.avi").read_bytes() == before
    names = ("clip_000000", "clip_000001")
    assert set(files(".")) == promised(*names, figures=False) | {"clip.avi"}


def test_results_may_lie_beside_two_frames(tisfm_run, d):
    """They replace nothing, and are welcome there."""
    before = files("d")
    assert tisfm_run("run", "d/x.png", "d/y.png", "-o", "d/new", "--no-figures")[0] == 0
    assert tisfm_run("run", "d/y.png", "d/x.png", "-o", "d", "--no-figures")[0] == 0
    after = files("d")
    assert {name: after[name] for name in before} == before
    assert set(after) == set(before) | promised("y", figures=False)


def test_a_link_that_appears_during_the_run_is_not_followed(tisfm_run, d, work_folder, monkeypatch):
    """A link that appears while a run is on its way is met when the file is written."""
    (work_folder / "out").mkdir()
    before = files("d")
    original = pair_writer.PairWriter.write

    def write(self, *arguments, **options):
        os.symlink(os.path.abspath("d/y.png"), "out/x_anaglyph.png")
        return original(self, *arguments, **options)

    monkeypatch.setattr(pair_writer.PairWriter, "write", write)
    code, _, err = tisfm_run("run", "d/x.png", "d/y.png", "-o", "out", "--no-figures")
    assert_one_line(code, err, "would replace", "x_anaglyph.png")
    assert files("d") == before


def test_names_that_differ_in_case_have_other_results(tisfm_run, d, work_folder):
    """Without regard to case: results of A.png and a.png may not be the same files."""
    for name in ("a.png", "A.jpg"):
        shutil.copy("d/x.png", name)
    arguments = ("run", "a.png", "A.jpg", "d/y.png", "-o", "out", "--no-figures")
    assert tisfm_run(*arguments)[0] == 0
    assert set(files("out")) == promised("000000_a", "000001_A", figures=False)


def test_inputs_are_found_in_another_case(d):
    """By whatever name a file system knows it."""
    inputs = InputFiles([d / "x_depth.png"])
    other = d / "X_DEPTH.PNG"
    if other.exists():
        with pytest.raises(ValueError, match="would replace"):
            inputs.refuse(other)
    else:
        inputs.refuse(other)


@pytest.mark.parametrize("name", ["figure_lambda.png", "figure_contrast.png"])
@pytest.mark.parametrize("link", [None, os.symlink, os.link])
def test_figures(tisfm_run, d, work_folder, nothing_interpreted, name, link):
    if link is None:
        (d / "x.png").rename(d / name)
        source = f"d/{name}"
    else:
        link(d / "x.png", d / name)
        source = "d/x.png"
    assert_refused(tisfm_run, work_folder, "figures", source, "d/y.png", "-o", "d")


@pytest.mark.parametrize("name", ["flow10.flo", "frame11.png"])
@pytest.mark.parametrize("link", [os.symlink, os.link])
def test_eval(tisfm_run, benchmark_folder, work_folder, nothing_interpreted, name, link):
    (work_folder / "out" / "flows").mkdir(parents=True)
    link(benchmark_folder / "Slow" / name, work_folder / "out" / "flows" / "Slow_error.png")
    assert_refused(
        tisfm_run, work_folder, "eval", "flows", "-o", "out", words=("Slow_error.png", name)
    )


def test_eval_into_the_folder_of_its_dataset(tisfm_run, work_folder, nothing_interpreted):
    """The dataset X of D is D/X, and so is the folder of its results."""
    folder = work_folder / "D" / "X"
    folder.mkdir(parents=True)
    write_png(folder / "yos1.png", FRAMES[0])
    write_png(folder / "yos2.png", FRAMES[1])
    write_flo(folder / "yos1_flow.flo", np.zeros((H, W, 2)))
    os.link(folder / "yos1_flow.flo", folder / "flow01.flo")
    assert_refused(tisfm_run, work_folder, "eval", "D", "-o", "D", words=("yos1_flow.flo",))


def test_the_record_of_eval(tisfm_run, benchmark_folder, work_folder, nothing_interpreted):
    (work_folder / "out").mkdir()
    os.link(benchmark_folder / "Slow" / "frame10.png", work_folder / "out" / "eval.json")
    assert_refused(tisfm_run, work_folder, "eval", "flows", "-o", "out", words=("eval.json",))


@pytest.mark.parametrize(
    "name", ["demo_depth.png", "figure_lambda.png", "demo.webp", "camera/demo.npz"]
)
def test_the_demo_does_not_replace_other_files(
    tisfm_run, d, work_folder, nothing_interpreted, name
):
    target = work_folder / "out" / name
    target.parent.mkdir(parents=True)
    shutil.copy("d/x.png", target)
    words = ("would replace", target.name, "no demo wrote")
    assert_refused(tisfm_run, work_folder, "demo", "-o", "out", words=words)


def test_the_demo_does_not_replace_a_run(tisfm_run, d, work_folder):
    assert tisfm_run("run", "d/x.png", "d/y.png", "-o", "out", "--preset", "fast")[0] == 0
    assert_refused(
        tisfm_run, work_folder, "demo", "-o", "out", words=("would replace the run in out",)
    )


def test_a_killed_demo_is_replaced(work_folder):
    out = work_folder / "out"
    for folder in (out, out / "camera", out / "objects"):
        folder.mkdir()
    write_png(out / "demo_depth.png", FRAMES[0])
    with pytest.raises(ValueError, match="no demo wrote"):
        demo._refuse_foreign([out])
    (out / LOCK).touch()
    demo._refuse_foreign([out, out / "camera", out / "objects"])
