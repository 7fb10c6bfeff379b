"""The command line: the files it promises, one line for every error, and going on after Ctrl-C."""

import contextlib
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import ExifTags, Image

import tisfm
from tisfm import commands, demo, evaluation, pair
from tisfm.cli import main
from tisfm.formats import read_depth_png, read_flo, read_image, write_flo, write_png
from tisfm.lens import undistort
from tisfm.settings import Settings
from tisfm.show import depth_grey

H, W = 24, 40
ENDINGS = {".npz", "_depth.png", "_depth16.png", "_flow.flo", "_anaglyph.png", "_figure.png"}
# -c so that a test does not depend on where scripts were installed.
TISFM = (sys.executable, "-c", "import sys; from tisfm.cli import main; sys.exit(main())")


def make_frames(count, seed=3):
    """Frames of a texture that moves by one pixel more each time."""
    width = W + count**2
    noise = np.random.default_rng(seed).uniform(0, 255, (H, width)).astype(np.float32)
    texture = cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 1.5), None, 0, 255, cv2.NORM_MINMAX)
    starts = [count**2 - k * (k + 1) // 2 for k in range(count)]
    return [texture[:, start : start + W].astype(np.uint8) for start in starts]


FRAMES = make_frames(4)


@pytest.fixture(autouse=True)
def place(tmp_path, monkeypatch):
    """An empty working folder, and the width of a terminal."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "100")
    return tmp_path


@pytest.fixture
def frames(place):
    """A folder of four frames f0.png to f3.png."""
    folder = place / "frames"
    folder.mkdir()
    for k, frame in enumerate(FRAMES):
        write_png(folder / f"f{k}.png", frame)
    return folder


@pytest.fixture
def benchmark_folder(place):
    """Two pairs in the layout of Middlebury, with the motion that `make_frames` gives them."""
    folder = place / "flows"
    for k, name in enumerate(("Slow", "Fast")):
        (folder / name).mkdir(parents=True)
        write_png(folder / name / "frame10.png", FRAMES[k])
        write_png(folder / name / "frame11.png", FRAMES[k + 1])
        write_flo(folder / name / "flow10.flo", np.full((H, W, 2), (k + 1.0, 0.0)))
    return folder


@pytest.fixture
def sequence_folder(place):
    """A sequence in the layout of New Tsukuba, whose camera moves to the left."""
    folder = place / "walk"
    folder.mkdir()
    for k, frame in enumerate(FRAMES):
        write_png(folder / f"rgb_{k:05d}.png", frame)
    rows = [f"1 0 0 {-k} 0 1 0 0 0 0 1 0" for k in range(len(FRAMES))]
    (folder / "poses_camera_to_world_3x4_cm.txt").write_text("\n".join(rows))
    return folder


@pytest.fixture
def tisfm_run(capsys):
    """Run the command line in this process; return exit code, stdout and stderr."""

    def run(*arguments):
        try:
            code = main([str(argument) for argument in arguments])
        except SystemExit as end:  # of help and of options that do not exist
            code = end.code
        return code, *capsys.readouterr()

    return run


def files(folder):
    return {path.name: path.read_bytes() for path in Path(folder).iterdir() if path.is_file()}


def promised(*names, figures=True):
    endings = ENDINGS if figures else ENDINGS - {"_figure.png"}
    return {name + ending for name in names for ending in endings} | {"run.json"}


def record(folder):
    return json.loads((Path(folder) / "run.json").read_text(encoding="utf-8"))


def load(folder, name):
    return tisfm.Interpretation.load(Path(folder) / f"{name}.npz")


# What run writes


@pytest.mark.parametrize(
    "source",
    [["frames/f0.png", "frames/f1.png", "frames/f2.png"], ["frames"], ["frames/f?.png"]],
    ids=["files", "folder", "pattern"],
)  # fmt: skip
def test_run_writes_the_promised_files(tisfm_run, frames, source):
    (frames / "f3.png").unlink()
    code, out, err = tisfm_run("run", *source, "-o", "out")
    assert code == 0 and out == ""
    assert re.fullmatch(
        r"2 pairs: .*, \d+\.\d\d s each \(median\)\. Results in out, settings and scales in "
        r"out/run\.json\.\n",
        err,
    )
    assert set(files("out")) == promised("f0", "f1")


def test_run_of_two_images(tisfm_run, frames):
    code, _, err = tisfm_run("run", "frames/f2.png", "frames/f0.png", "--output", "deep/er/out")
    assert code == 0 and err.startswith("1 pair: ")
    assert set(files("deep/er/out")) == promised("f2")
    expected = tisfm.interpret(FRAMES[2], FRAMES[0])
    np.testing.assert_array_equal(load("deep/er/out", "f2").rho, expected.rho)


def test_run_of_a_video(tisfm_run, place):
    writer = cv2.VideoWriter("clip.avi", cv2.VideoWriter_fourcc(*"MJPG"), 10, (64, 48))
    if not writer.isOpened():
        pytest.skip("this build of OpenCV cannot write MJPG video")
    for frame in FRAMES[:3]:
        writer.write(cv2.resize(cv2.cvtColor(frame, cv2.COLOR_GRAY2BGR), (64, 48)))
    writer.release()
    code, _, _ = tisfm_run("run", "clip.avi", "-o", "out", "--no-figures")
    assert code == 0
    assert set(files("out")) == promised("clip_000000", "clip_000001", figures=False)


def test_all_files_of_a_run_agree(tisfm_run, frames):
    assert tisfm_run("run", "frames", "-o", "out", "--focal", "50")[0] == 0
    about = record("out")
    assert about["version"] == tisfm.__version__
    assert about["camera"] == {"focal": 50.0, "center": None, "distortion": None}
    assert Settings(**about["settings"]) == Settings()
    assert list(about["pairs"]) == ["f0", "f1", "f2"]
    scale = about["depth16_values_per_unit"]
    for k, name in enumerate(about["pairs"]):
        result = load("out", name)
        limit = about["depth_range"] * float(result.inverse_depth.mean())
        expected = tisfm.interpret(FRAMES[k], FRAMES[k + 1], camera=tisfm.Camera(50.0))
        np.testing.assert_array_equal(result.rho, expected.rho)
        np.testing.assert_array_equal(result.frame, FRAMES[k])
        np.testing.assert_array_equal(read_flo(f"out/{name}_flow.flo"), result.flow)
        np.testing.assert_array_equal(
            read_image(f"out/{name}_depth.png"), depth_grey(result.inverse_depth, limit=limit)
        )
        stored = read_image(f"out/{name}_depth16.png")
        assert stored.dtype == np.uint16
        inside = (stored > 1) & (stored < 65535)
        assert inside.mean() > 0.9
        # Half a step of the file, and the rounding of float32.
        error = np.abs(stored / scale - result.depth)[inside]
        assert (error <= 0.5 / scale + 1e-6 * result.depth[inside]).all()
        depth = read_depth_png(f"out/{name}_depth16.png")
        np.testing.assert_allclose(depth[inside], (stored / scale)[inside], rtol=1e-6)
        assert read_image(f"out/{name}_anaglyph.png").shape == (H, W, 3)
        assert read_image(f"out/{name}_figure.png").ndim == 3
        pair_record = about["pairs"][name]
        assert pair_record["status"] == result.status
        assert pair_record["message"] == result.status.message


def test_one_scale_and_range_for_a_whole_sequence(tisfm_run, frames):
    """The second pair moves less far than the first: no darker for that, but on its range."""
    files = [frames / f"f{k}.png" for k in (3, 2, 1)]
    assert tisfm_run("run", *files, "-o", "out", "--no-figures")[0] == 0
    assert tisfm_run("run", *files[1:], "-o", "alone", "--no-figures")[0] == 0
    together, alone = (read_image(f"{folder}/f2_depth.png") for folder in ("out", "alone"))
    both, second = record("out"), record("alone")
    assert both["depth_range"] != second["depth_range"]
    ratio = second["depth_range"] / both["depth_range"]
    assert np.median(together) == pytest.approx(np.median(alone) * ratio, abs=1.5)
    slow, fast = (np.median(read_image(f"out/f{k}_depth.png")) for k in (2, 3))
    assert slow == pytest.approx(fast, rel=0.15)
    assert both["depth16_values_per_unit"] > second["depth16_values_per_unit"] * 1.2


def test_a_pair_without_motion_does_not_set_the_ranges(tisfm_run, frames):
    arguments = ("run", frames / "f0.png", *sorted(frames.iterdir()))
    assert tisfm_run(*arguments, "-o", "out")[0] == 0
    assert tisfm_run("run", frames, "-o", "moving", "--no-figures")[0] == 0
    about, moving = record("out"), record("moving")
    assert about["pairs"]["000000_f0"]["status"] == "no_motion"
    for key in ("depth16_values_per_unit", "depth_range", "flow_limit"):
        assert about[key] == moving[key]
    assert not read_image("out/000000_f0_depth16.png").any()
    assert np.isnan(read_depth_png("out/000000_f0_depth16.png")).all()
    assert not read_image("out/000000_f0_depth.png").any()


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_a_pair_that_diverges_is_said_and_does_not_set_the_ranges(tisfm_run, frames, place):
    for k in range(2):
        cv2.imwrite(f"h{k}.tif", FRAMES[k].astype(np.float32) * 1e30)
    cv2.imwrite("g1.tif", FRAMES[1].astype(np.float32))
    cv2.imwrite("g2.tif", FRAMES[2].astype(np.float32))
    code, _, err = tisfm_run("run", "h0.tif", "h1.tif", "g1.tif", "g2.tif", "-o", "out")
    assert code == 0 and "2 diverged" in err
    assert set(files("out")) == promised("h0", "h1", "g1")
    expected = tisfm.interpret(FRAMES[1], FRAMES[2])
    usual = np.percentile(expected.inverse_depth, 95) / expected.inverse_depth.mean()
    assert record("out")["depth_range"] == pytest.approx(usual, rel=0.02)


@pytest.mark.parametrize(
    ("options", "settings"),
    [
        (["--preset", "paper"], Settings.preset("paper")),
        (["--preset=fast"], Settings.preset("fast")),
        (["--preset", "paper", "--beta", "0.5"], Settings.preset("paper", beta=0.5)),
        (["--beta", "0.5", "--preset", "paper"], Settings.preset("paper", beta=0.5)),
        (["--preset", "fast", "--preset", "paper"], Settings.preset("paper")),
        (["--model", "translation"], Settings(model="translation")),
        (["--contrast", "None"], Settings(contrast=None)),
        (["--no-joint-edges", "--data-contrast", "None"],
         Settings(joint_edges=False, data_contrast=None)),
        (["--stiffness", "1", "1", "0.1", "2", "2", "3"],
         Settings(stiffness=(1, 1, 0.1, 2, 2, 3))),
        (["--preset", "paper", "--contrast", "0.1"], Settings.preset("paper", contrast=0.1)),
        (["--pyramid-levels", "1", "--solver", "closed_form"],
         Settings(pyramid_levels=1, solver="closed_form")),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)  # fmt: skip
def test_options_reach_the_result(tisfm_run, frames, options, settings):
    two = [frames / "f0.png", frames / "f1.png"]
    assert tisfm_run("run", *two, "-o", "out", "--no-figures", *options)[0] == 0
    result = load("out", "f0")
    assert result.settings == settings
    expected = tisfm.interpret(*FRAMES[:2], settings=settings)
    np.testing.assert_array_equal(result.rho, expected.rho)
    assert not np.array_equal(result.rho, tisfm.interpret(*FRAMES[:2]).rho)


@pytest.mark.parametrize(
    ("options", "camera"),
    [
        (["--focal", "50"], tisfm.Camera(50.0)),
        (["--center", "3", "4.5"], tisfm.Camera(600.0, (3.0, 4.5))),
    ],
)
def test_the_camera_reaches_the_result(tisfm_run, frames, options, camera):
    two = [frames / "f0.png", frames / "f1.png"]
    assert tisfm_run("run", *two, "-o", "out", "--no-figures", *options)[0] == 0
    result = load("out", "f0")
    assert result.camera == camera
    assert not np.array_equal(result.rho, tisfm.interpret(*FRAMES[:2]).rho)


@pytest.mark.parametrize(
    "option",
    [["--distortion", "-0.3,0.1,0,1e-3"], ["--distortion=-0.3, 0.1, 0, 1e-3"],
     ["--distortion", "-0.3 0.1 0 1e-3"]],
    ids=" ".join,
)  # fmt: skip
def test_distortion_is_removed(tisfm_run, frames, option):
    two = [frames / "f0.png", frames / "f1.png"]
    code, _, _ = tisfm_run("run", "-o", "out", "--focal", "50", *option, *two)
    assert code == 0 and set(files("out")) == promised("f0")
    camera = tisfm.Camera(50.0, distortion=(-0.3, 0.1, 0, 1e-3))
    expected = tisfm.interpret(*FRAMES[:2], camera=camera)
    result = load("out", "f0")
    np.testing.assert_array_equal(result.rho, expected.rho)
    np.testing.assert_array_equal(result.frame, undistort(FRAMES[0], camera))
    assert record("out")["camera"]["distortion"] == list(camera.distortion)
    assert result.camera == camera.pinhole()


@pytest.mark.parametrize("lens", [None, (-0.3, 0.1, 0.0, 0.0)])
def test_the_baseline_is_of_the_same_frames(tisfm_run, frames, monkeypatch, lens):
    seen = []

    def baseline(*frames, **options):
        seen.extend(frames)
        return np.zeros((H, W, 2), np.float32)

    monkeypatch.setattr(commands, "horn_schunck", baseline)
    options = [] if lens is None else ["--distortion", ",".join(map(str, lens))]
    (frames / "f3.png").unlink()
    (frames / "f2.png").unlink()
    assert tisfm_run("run", "frames", "-o", "out", "--focal", "50", *options)[0] == 0
    camera = tisfm.Camera(50.0, distortion=lens)
    np.testing.assert_array_equal(seen, [undistort(frame, camera) for frame in FRAMES[:2]])


def test_point_clouds(tisfm_run, frames):
    assert tisfm_run("run", "frames", "-o", "out", "--no-figures", "--ply")[0] == 0
    clouds = {f"f{k}.ply" for k in range(3)}
    assert set(files("out")) == promised("f0", "f1", "f2", figures=False) | clouds
    load("out", "f1").points().save("expected.ply")
    assert Path("out/f1.ply").read_bytes() == Path("expected.ply").read_bytes()
    assert b"element vertex 0\n" not in Path("out/f1.ply").read_bytes()
    assert record("out")["ply"] is True
    Path("out/f1.ply").unlink()
    Path("out/f1.npz").unlink()
    options = ("run", "frames", "-o", "out", "--no-figures", "--resume")
    assert_one_line(*tisfm_run(*options)[::2], "another camera, other settings or outputs")
    assert tisfm_run(*options, "--ply")[0] == 0
    assert Path("out/f1.ply").read_bytes() == Path("expected.ply").read_bytes()


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_point_clouds_of_pairs_without_depth(tisfm_run, frames):
    for k in range(2):
        cv2.imwrite(f"h{k}.tif", FRAMES[k].astype(np.float32) * 1e30)
    source = (frames / "f0.png", frames / "f0.png")
    assert tisfm_run("run", *source, "-o", "still", "--no-figures", "--ply")[0] == 0
    assert b"element vertex 0\n" in Path("still/000000_f0.ply").read_bytes()
    assert tisfm_run("run", "h0.tif", "h1.tif", "-o", "wild", "--no-figures", "--ply")[0] == 0
    assert Path("wild/h0.ply").read_bytes().startswith(b"ply\n")


def with_exif(path, frame, film):
    exif = Image.Exif()
    exif[ExifTags.IFD.Exif] = {ExifTags.Base.FocalLengthIn35mmFilm: film}
    Image.fromarray(frame).save(path, exif=exif.tobytes())


@pytest.mark.parametrize("command", ["run", "figures"])
@pytest.mark.parametrize("film", [35, None])
def test_the_focal_length_can_be_guessed(tisfm_run, frames, command, film):
    if film:
        with_exif(frames / "f0.png", FRAMES[0], film)
    two = [frames / "f0.png", frames / "f1.png"]
    code, out, err = tisfm_run(command, "--focal", "guess", *two, "-o", "out")
    assert code == 0 and out == ""
    focal = 35 * np.hypot(H, W) / np.hypot(24, 36) if film else 1.2 * W
    line, *others = err.splitlines()
    assert len(others) == 1
    reason = "35 mm in terms of" if film else "1.2 times the longer side"
    assert line.startswith(f"focal length guessed: {focal:.0f} px, ")
    assert reason in line and "give --focal" in line
    if command == "run":
        assert load("out", "f0").camera.focal == pytest.approx(focal)
        assert record("out")["camera"]["focal"] == pytest.approx(focal)


def test_the_focal_length_of_a_video_is_guessed_by_its_size(tisfm_run, place):
    writer = cv2.VideoWriter("clip.avi", cv2.VideoWriter_fourcc(*"MJPG"), 10, (64, 48))
    if not writer.isOpened():
        pytest.skip("this build of OpenCV cannot write MJPG video")
    for frame in FRAMES[:3]:
        writer.write(cv2.resize(cv2.cvtColor(frame, cv2.COLOR_GRAY2BGR), (64, 48)))
    writer.release()
    code, _, err = tisfm_run("run", "clip.avi", "-o", "out", "--no-figures", "--focal", "guess")
    assert code == 0 and err.startswith("focal length guessed: 77 px, ")
    assert load("out", "clip_000000").camera.focal == pytest.approx(1.2 * 64)


def test_without_figures(tisfm_run, frames, monkeypatch):
    monkeypatch.setattr(commands, "horn_schunck", None)  # not needed then
    assert tisfm_run("run", "frames", "-o", "out", "--no-figures")[0] == 0
    assert set(files("out")) == promised("f0", "f1", "f2", figures=False)


def test_step(tisfm_run, frames):
    assert tisfm_run("run", "frames", "-o", "out", "--step", "2", "--no-figures")[0] == 0
    assert set(files("out")) == promised("f0", figures=False)
    np.testing.assert_array_equal(load("out", "f0").rho, tisfm.interpret(FRAMES[0], FRAMES[2]).rho)


def test_markup_in_names_is_printed_as_it_is(tisfm_run, frames, place):
    for k in range(2):
        (frames / f"f{k}.png").rename(place / f"[red]{k}.png")
    code, _, err = tisfm_run(
        "run", "[red]0.png", "[red]1.png", "-o", "out [bold] x", "--no-figures"
    )
    assert code == 0 and "Results in out [bold] x, settings" in err
    assert set(files("out [bold] x")) == promised("[red]0", figures=False)


# Going on


def forbid(*arguments, **options):
    raise AssertionError("nothing is left to interpret")


def test_resume_skips_what_is_finished(tisfm_run, frames, monkeypatch):
    assert tisfm_run("run", "frames", "-o", "out")[0] == 0
    before = files("out")
    monkeypatch.setattr(pair, "interpret", forbid)
    monkeypatch.setattr(commands, "horn_schunck", forbid)
    code, _, err = tisfm_run("run", "frames", "-o", "out", "--resume")
    assert code == 0 and err.startswith("3 pairs: ") and "median" not in err
    assert files("out") == before


def test_resume_makes_again_what_was_deleted(tisfm_run, frames):
    run = ("run", "frames", "-o", "out", "--no-figures")
    assert tisfm_run(*run)[0] == 0
    before = files("out")
    for name in ENDINGS - {"_figure.png"}:
        Path(f"out/f1{name}").unlink()
    assert tisfm_run(*run, "--resume")[0] == 0
    assert files("out") == before


def test_resume_without_a_run_before(tisfm_run, frames):
    assert tisfm_run("run", "frames", "-o", "out", "--no-figures", "--resume")[0] == 0
    assert tisfm_run("run", "frames", "-o", "fresh", "--no-figures")[0] == 0
    assert files("out") == files("fresh")


def test_without_resume_all_is_made_again(tisfm_run, frames, monkeypatch):
    assert tisfm_run("run", "frames", "-o", "out", "--no-figures")[0] == 0
    monkeypatch.setattr(pair, "interpret", forbid)
    with pytest.raises(AssertionError, match="nothing is left"):
        main(["run", "frames", "-o", "out", "--no-figures"])


@pytest.mark.parametrize(
    "options",
    [["--focal", "50"], ["--preset", "fast"], ["--beta", "0.5"], ["--center", "3", "4"],
     ["--distortion", "0.1,0,0,0"], ["--focal", "guess"], ["--figures"]],
    ids=" ".join,
)  # fmt: skip
def test_resume_refuses_other_options(tisfm_run, frames, options):
    assert tisfm_run("run", "frames", "-o", "out", "--no-figures")[0] == 0
    before = files("out")
    arguments = ["run", "frames", "-o", "out", "--resume"]
    code, _, err = tisfm_run(*arguments, *options, *["--no-figures"] * ("--figures" not in options))
    *before_it, last = err.splitlines(keepends=True)
    assert len(before_it) == ("guess" in options)
    assert_one_line(code, last, "out holds a run with another camera, other settings", "--resume")
    assert files("out") == before


def test_resume_refuses_other_frames(tisfm_run, frames):
    assert tisfm_run("run", "frames", "-o", "out", "--no-figures")[0] == 0
    before = files("out")
    again = ("run", "frames", "-o", "out", "--no-figures", "--resume")
    code, _, err = tisfm_run(*again, "--step", "2")
    assert_one_line(code, err, "f0 was another pair of frames", "same frames and step")
    write_png(frames / "f1.png", 255 - FRAMES[1])
    code, _, err = tisfm_run(*again)
    assert_one_line(code, err, "f0 was another pair of frames")
    assert files("out") == before


@pytest.mark.parametrize("text", ["", "{", "[]", "3", "{}", '{"camera": 1}', "null"])
def test_resume_refuses_a_damaged_record(tisfm_run, frames, text):
    Path("out").mkdir()
    Path("out/run.json").write_text(text)
    code, _, err = tisfm_run("run", "frames", "-o", "out", "--resume")
    assert_one_line(code, err, "run.json", "is damaged", "without --resume")


@pytest.mark.parametrize("when", ["interpret", "write_flo", "save_figure", "first", "savez"])
def test_an_interrupted_run_goes_on_to_the_same_bytes(tisfm_run, frames, monkeypatch, when):
    """Ctrl-C comes at the second pair ("first": at the first one), here or there."""
    options = [] if when == "save_figure" else ["--no-figures"]
    (frames / "f3.png").unlink()
    assert tisfm_run("run", "frames", "-o", "whole", *options)[0] == 0
    module, name = {
        "interpret": (pair, "interpret"),
        "first": (pair, "interpret"),
        "write_flo": (tisfm.outputs, "write_flo"),
        "save_figure": (tisfm.outputs, "save_figure"),
        "savez": (np, "savez_compressed"),
    }[when]
    original, calls = getattr(module, name), []

    def interrupted(*arguments, **options):
        calls.append(1)
        if len(calls) == (1 if when == "first" else 2):
            if when == "savez":  # half-way through a file
                arguments[0].write(b"PK")
            raise KeyboardInterrupt
        return original(*arguments, **options)

    with monkeypatch.context() as patch:
        patch.setattr(module, name, interrupted)
        code, out, err = tisfm_run("run", "frames", "-o", "out", *options)
    assert (code, out, err) == (130, "", "tisfm: interrupted\n")
    left, whole = files("out"), files("whole")
    assert set(left) <= set(whole)
    assert ("f0.npz" in left) == (when != "first") and "f1.npz" not in left
    for name in set(left) - {"run.json"}:
        assert left[name] == whole[name], name
    assert tisfm_run("run", "frames", "-o", "out", "--resume", *options)[0] == 0
    assert files("out") == whole


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="Windows has no SIGINT to send to one process")
def test_ctrl_c_in_a_process_of_its_own(place):
    """The signal comes at any moment, in the middle of a kernel as well."""
    noise = np.random.default_rng(0).integers(0, 256, (120, 200), dtype=np.uint8)
    texture = cv2.GaussianBlur(noise, (0, 0), 1.5)
    os.mkdir("many")
    for k in range(60):
        write_png(f"many/f{k}.png", texture[:, 60 - k : 190 - k])
    command = [*TISFM, "run", "many", "-o", "out", "--preset", "paper", "--no-figures"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        deadline = time.monotonic() + 60
        while not Path("out/f0.npz").exists() and time.monotonic() < deadline:
            assert process.poll() is None, process.stderr.read()
            time.sleep(0.02)
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=30)
    finally:
        process.kill()
    assert (process.returncode, out, err) == (130, "", "tisfm: interrupted\n")
    left = set(files("out"))
    finished = record("out")["pairs"]
    assert 1 <= len(finished) < 59
    assert not [name for name in left if name.endswith(".tmp") or name.startswith(".")]
    for name in finished:
        assert load("out", name).rho.any()


# Errors


def assert_one_line(code, err, *words):
    assert code not in (0, None)
    assert err.startswith("tisfm: ") and err.endswith("\n")
    assert err.count("\n") == 1, err
    assert "Traceback" not in err
    for word in words:
        assert str(word) in err, err


def damaged(kind, place):
    """Make one bad input; return it as a list of sources."""
    good = place / "frames" / "f1.png"
    bad = place / "bad.png"
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
        bad, good = place / "bad.tif", place / "good.tif"
        cv2.imwrite(str(good), pixels)
        pixels[3, 5] = np.nan if kind == "NaN" else np.inf
        cv2.imwrite(str(bad), pixels)
    elif kind == "text as video":
        bad = place / "bad.mp4"
        bad.write_text("no video\n" * 100)
        return [bad]
    elif kind == "empty folder":
        bad = place / "bad"
        bad.mkdir()
        return [bad]
    elif kind == "single frame":
        return [good]
    elif kind == "pattern without a match":
        return [place / "gone*.png"]
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
def test_bad_frames_are_one_line(tisfm_run, frames, place, kind):
    source = damaged(kind, place)
    code, out, err = tisfm_run("run", *source, "-o", "out")
    assert out == ""
    assert_one_line(code, err, *BAD_INPUTS[kind])
    assert not (place / "out").exists() or not files("out")


@pytest.mark.slow
def test_bad_frames_are_one_line_in_a_process_of_its_own(frames, place):
    """Libraries that decode may print lines of their own, past Python."""
    for kind in ("truncated file", "garbage", "NaN", "text as video"):
        source = damaged(kind, place)
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
def test_an_output_that_is_no_folder_is_one_line(
    tisfm_run, frames, benchmark_folder, place, monkeypatch, output, command
):
    (place / "file").write_text("mine")
    monkeypatch.setattr(pair, "interpret", forbid)
    monkeypatch.setattr(evaluation, "interpret", forbid)
    monkeypatch.setattr(demo, "interpret", forbid)
    source = {
        "run": ["frames"],
        "demo": [],
        "eval": ["flows"],
        "figures": ["frames/f0.png", "frames/f1.png"],
    }
    code, _, err = tisfm_run(command, *source[command], "-o", output)
    assert_one_line(code, err, output, "give another with -o")
    assert (place / "file").read_text() == "mine"


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
def test_values_out_of_range_are_one_line(tisfm_run, frames, place, options, words):
    code, out, err = tisfm_run("run", "frames", "-o", "out", *options)
    assert code == 1 and out == ""
    assert_one_line(code, err, *words)
    assert not (place / "out").exists() or not files("out")


def test_an_error_on_the_way_keeps_the_pairs_before(tisfm_run, frames):
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

    monkeypatch.setattr(np, "savez_compressed", full)
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
def test_wrong_usage_is_code_2(tisfm_run, frames, place, arguments):
    code, out, err = tisfm_run(*arguments)
    assert code == 2 and out == ""
    assert err and "Traceback" not in err and "dummy" not in err
    assert not (place / "out").exists()


# Help


def options_of(text):
    return set(re.findall(r"--[a-z][a-z-]+", text))


def test_help_names_the_commands(tisfm_run):
    code, out, _ = tisfm_run("--help")
    assert code == 0
    for word in ("run", "demo", "eval", "figures", "tisfm run --help"):
        assert word in out


def test_help_of_run_names_every_setting_and_its_default(tisfm_run):
    code, out, _ = tisfm_run("run", "--help")
    assert code == 0
    settings = {"--" + name.replace("_", "-") for name in vars(Settings())}
    expected = {"--output", "--preset", "--step", "--resume", "--figures", "--no-figures"}
    expected |= {"--ply", "--no-ply", "--poses"}
    assert options_of(out) >= expected | settings | {
        "--arch",
        "--threads",
        "--focal",
        "--center",
        "--distortion",
    }
    assert "SOURCE [SOURCE ...]" in out
    text = " ".join(re.sub("[│╭╮╰╯─]", " ", out).split())
    assert "(default: balanced)" in text and f"(default: {Settings().smoothness})" in text


@pytest.mark.parametrize("spelling", [["--preset", "paper"], ["--preset=paper"]])
def test_help_shows_the_values_of_the_preset(tisfm_run, spelling):
    code, out, _ = tisfm_run("run", *spelling, "--help")
    assert code == 0
    text = " ".join(re.sub("[│╭╮╰╯─]", " ", out).split())
    assert re.search(r"--preset {paper,fast,balanced,accurate} .{0,100}\(default: paper\)", text)
    for name, value in vars(Settings.preset("paper")).items():
        option = "--" + name.replace("_", "-")
        following = re.split(re.escape(option) + "[ ,]", text, maxsplit=1)[1]
        shown = " ".join(map(str, value)) if isinstance(value, tuple) else str(value)
        assert re.search(r"\(default: ([^)]*)\)", following).group(1) == shown, option


@pytest.mark.parametrize(
    ("command", "options"),
    [
        ("demo", {"--output", "--height", "--width", "--seed", "--threads", "--help"}),
        ("figures", {"--output", "--threads", "--focal", "--center", "--distortion", "--help"}),
        (
            "eval",
            {"--output", "--layout", "--step", "--preset", "--threads", "--focal", "--center"}
            | {"--arch", "--no-joint-edges", "--no-align-scales", "--help"}
            | {"--" + name.replace("_", "-") for name in vars(Settings())},
        ),
    ],
)
def test_help_of_the_others(tisfm_run, command, options):
    code, out, _ = tisfm_run(command, "--help")
    assert code == 0
    assert options_of(out) == options


# The other commands

DEMO_FILES = promised("demo") | {
    "figure_lambda.png",
    "figure_presmoothing.png",
    "figure_contrast.png",
}


def test_demo(tisfm_run):
    code, out, err = tisfm_run("demo", "--height", "60", "--width", "80", "-o", "out")
    assert code == 0
    assert err.startswith("Pictures and data in out: look at demo_figure.png first")
    rows = [line for line in out.splitlines() if line.startswith("│")]
    assert len(rows) == 6
    for row, label in zip(rows[:3], ("paper", "balanced", "Horn–Schunck"), strict=True):
        cells = [cell.strip() for cell in row.strip("│").split("│")]
        assert label in cells[0]
        assert 0 < float(cells[1]) < 0.5  # px
    assert set(files("out")) == DEMO_FILES
    assert load("out", "demo").settings == Settings()
    assert list(record("out")["pairs"]) == ["demo"]


@pytest.mark.slow
def test_demo_has_an_output_of_its_own(tisfm_run, place):
    assert tisfm_run("demo", "--height", "24", "--width", "32")[0] == 0
    assert set(files("tisfm-demo")) == DEMO_FILES


@pytest.mark.parametrize(
    "options", [["--height", "0"], ["--width", "-3"], ["--height", "2"], ["--seed", "-1"]],
    ids=" ".join,
)  # fmt: skip
def test_bad_sizes_of_the_demo_are_one_line(tisfm_run, options):
    code, out, err = tisfm_run("demo", "-o", "out", "--width", "16", "--height", "12", *options)
    assert out == ""
    assert_one_line(code, err)


def test_figures(tisfm_run, frames):
    code, out, err = tisfm_run("figures", "frames/f0.png", "frames/f1.png", "-o", "out")
    assert code == 0 and out == ""
    names = ["figure_lambda.png", "figure_presmoothing.png", "figure_contrast.png"]
    assert err == "wrote " + ", ".join(f"out/{name}" for name in names) + "\n"
    written = files("out")
    assert set(written) == set(names) and len(set(written.values())) == 3
    for name in names:
        assert read_image(f"out/{name}").shape[1] > 300


def test_figures_of_a_missing_file(tisfm_run, frames, place):
    code, _, err = tisfm_run("figures", "frames/f0.png", "gone.png", "-o", "out")
    assert_one_line(code, err, "gone.png")
    assert not (place / "out").exists()


# Evaluation


def evaluated(folder):
    return json.loads((Path(folder) / "eval.json").read_text(encoding="utf-8"))


def table_of(out):
    rows = [line.strip("│").split("│") for line in out.splitlines() if line.startswith("│")]
    return {cells[0].strip(): [cell.strip() for cell in cells[1:]] for cells in rows}


@pytest.mark.parametrize("columns", ["100", "30"])  # a narrow terminal loses no column
def test_eval_prints_a_table(tisfm_run, benchmark_folder, place, monkeypatch, columns):
    monkeypatch.setenv("COLUMNS", columns)
    before = set(place.rglob("*"))
    code, out, err = tisfm_run("eval", "flows", "flows/Slow")
    assert code == 0 and err == "2 pairs: 2 converged.\n"
    rows = table_of(out)
    assert list(rows) == ["flows/Fast", "flows/Slow", "flows, mean of 2"]
    assert all(0 < float(row[0]) < 0.2 for row in rows.values())
    assert set(place.rglob("*")) == before


def test_eval_writes_what_it_prints(tisfm_run, benchmark_folder):
    code, out, err = tisfm_run("eval", "flows", "-o", "deep/out", "--preset", "fast")
    assert code == 0
    assert err == (
        "2 pairs: 2 converged. Pictures and flow in deep/out, every number in deep/out/eval.json.\n"
    )
    about = evaluated("deep/out")
    assert about["complete"] is True
    assert Settings(**about["settings"]) == Settings.preset("fast")
    rows = table_of(out)
    for entry in about["pairs"]:
        assert f"{entry['errors']['endpoint']:.3f}" == rows[f"flows/{entry['name']}"][0]
        flow = read_flo(f"deep/out/{entry['outputs']}_flow.flo")
        expected = tisfm.interpret(
            *(read_image(entry["inputs"][key]) for key in ("frame0", "frame1")),
            settings=Settings.preset("fast"),
        )
        np.testing.assert_array_equal(flow, expected.flow)
    assert f"{about['mean']['errors']['endpoint']:.3f}" == rows["flows, mean of 2"][0]


def test_options_reach_the_evaluation(tisfm_run, benchmark_folder):
    options = [
        "--preset",
        "paper",
        "--outer-iterations",
        "7",
        "--focal",
        "55",
        "--center",
        "3",
        "4",
    ]
    code, _, err = tisfm_run("eval", "flows", "-o", "out", *options)
    assert code == 0
    about = evaluated("out")
    assert Settings(**about["settings"]) == Settings.preset("paper", outer_iterations=7)
    camera = {"focal": 55.0, "center": [3.0, 4.0], "distortion": None}
    assert about["camera"] == camera and {str(p["camera"]) for p in about["pairs"]} == {str(camera)}
    assert "2 iteration_limit" in err and "raise outer_iterations" in err


def test_a_fault_is_told_at_the_end(tisfm_run, benchmark_folder):
    (benchmark_folder / "Fast" / "frame11.png").unlink()
    code, out, err = tisfm_run("eval", "flows", "-o", "out")
    assert code == 1
    assert list(table_of(out)) == ["flows/Fast (failed)", "flows/Slow", "flows, mean of 1"]
    lines = err.splitlines()
    assert len(lines) == 2 and lines[0].startswith("1 pair: 1 converged.")
    assert lines[1].startswith("tisfm: flows/Fast: ") and "frame11.png does not exist" in lines[1]
    assert evaluated("out")["complete"] is True
    assert [bool(entry["fault"]) for entry in evaluated("out")["pairs"]] == [True, False]


@pytest.mark.parametrize("step", [1, 2])
def test_eval_of_a_sequence(tisfm_run, sequence_folder, benchmark_folder, step):
    given = ["--step", step] if step > 1 else []
    code, out, err = tisfm_run("eval", "walk", "flows", "-o", "out", *given, "--preset", "fast")
    assert code == 0 and err.startswith(f"{6 - step} pairs: {6 - step} converged.")
    names = [f"walk/rgb_{k:05d}" for k in range(4 - step)]
    assert list(table_of(out)) == ["flows/Fast", "flows/Slow", "flows, mean of 2", *names]
    about = evaluated("out")
    pairs = {f"{entry['dataset']}/{entry['name']}": entry for entry in about["pairs"]}
    assert list(pairs) == [*names, "flows/Fast", "flows/Slow"]
    for k, name in enumerate(names):
        assert pairs[name]["inputs"]["pose_rows"] == [k, k + step]
        assert pairs[name]["inputs"]["frame1"].endswith(f"rgb_{k + step:05d}.png")
        assert (Path("out") / f"{name}_flow.flo").is_file()
        assert not (Path("out") / f"{name}_flow.png").exists()
    assert about["mean"]["pairs"] == 6 - step and about["mean"]["flow_pairs"] == 2


def test_a_damaged_pose_is_one_line(tisfm_run, sequence_folder):
    poses = sequence_folder / "poses_camera_to_world_3x4_cm.txt"
    poses.write_text(poses.read_text().replace("-3", "nan"))
    code, out, err = tisfm_run("eval", "walk", "--preset", "fast")
    assert code == 1 and "walk/rgb_00002 (failed)" in out
    lines = err.splitlines()
    assert len(lines) == 2 and lines[0] == "2 pairs: 2 converged."
    assert lines[1].startswith("tisfm: walk/rgb_00002: ")
    assert lines[1].endswith("cm.txt, row 3 is not finite: there is no pose of this frame")


def test_an_interrupted_evaluation_is_one_line(tisfm_run, benchmark_folder, monkeypatch):
    def interrupted(*arguments, **options):
        raise KeyboardInterrupt

    monkeypatch.setattr(tisfm.evaluation_outputs, "save_figure", interrupted)
    assert tisfm_run("eval", "flows", "-o", "out") == (130, "", "tisfm: interrupted\n")
    assert evaluated("out")["complete"] is False and evaluated("out")["pairs"] == []


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], ["FOLDER is missing", "tisfm eval FOLDER -o DIR"]),
        (["gone"], ["there is no folder gone"]),
        (["flows", "frames"], ["frames holds no pair", "flow10.flo", "flow_occ", "disparity"]),
        (["frames", "--layout", "kitti"], ["frames holds no pair", "flow_occ"]),
        (["flows", "--layout", "sintel"], ["flows holds no pair", "frame_NNNN.flo"]),
        (["flows/Slow/flow10.flo"], ["flow10.flo is a file", "folder of a dataset"]),
        (["flows", "--step", "2"], ["step is 2", "no sequence with poses in flows"]),
        (["flows", "--step", "0"], ["step is 0", "positive whole number"]),
        (["flows", "--focal", "0"], ["focal is 0", "positive"]),
        (["flows", "--center", "3", "4"], ["center is given without focal"]),
        (["flows", "--warps", "0"], ["warps is 0", "at least 1"]),
        (["flows", "--threads", "0"], ["threads is 0", "positive integer"]),
        (["flows", "--arch", "vulkan"], ["Taichi ", "on 'vulkan'"]),
    ],
    ids=lambda value: " ".join(value),
)
def test_wrong_evaluations_are_one_line(tisfm_run, frames, benchmark_folder, arguments, words):
    code, out, err = tisfm_run("eval", *arguments, "-o", "out")
    assert code == 1 and out == ""
    assert_one_line(code, err, *words)
    assert not Path("out").exists()


# The process


def test_a_process_of_its_own(frames):
    """Neither a banner nor a progress bar in what is redirected."""
    done = subprocess.run(
        [*TISFM, "run", "frames", "-o", "out"],
        capture_output=True, text=True, env={**os.environ, "PYTHONIOENCODING": "utf-8"},
    )  # fmt: skip
    assert (done.returncode, done.stdout) == (0, "")
    assert re.fullmatch(r"3 pairs: [^\n]*\n", done.stderr)
    assert set(files("out")) == promised("f0", "f1", "f2")


def test_streams_without_greek_letters():
    done = subprocess.run(
        [*TISFM, "run", "--help"],
        capture_output=True, env={**os.environ, "PYTHONIOENCODING": "ascii"},
    )  # fmt: skip
    assert done.returncode == 0 and b"--smoothness" in done.stdout and done.stderr == b""


@pytest.mark.skipif(os.name == "nt", reason="a pipe that breaks is another matter on Windows")
def test_a_reader_that_leaves_early():
    process = subprocess.Popen(
        [*TISFM, "run", "--help"], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    process.stdout.close()
    assert process.stderr.read() == b""
    assert process.wait(timeout=60) == 141
    process.stderr.close()


def test_version(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out.strip() == tisfm.__version__


def test_what_an_interrupted_run_overwrites_is_not_taken_for_complete(
    tisfm_run, frames, monkeypatch
):
    """Other settings over a finished run, stopped inside the first pair; then the first again."""
    options = ("run", "frames", "-o", "out", "--no-figures")
    assert tisfm_run(*options, "--preset", "fast")[0] == 0
    before = files("out")

    def interrupted(*arguments, **options):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(np, "savez_compressed", interrupted)
        assert tisfm_run(*options, "--preset", "paper")[0] == 130
    assert files("out")["f0_flow.flo"] != before["f0_flow.flo"]
    assert tisfm_run(*options, "--preset", "fast", "--resume")[0] == 0
    assert files("out") == before


def test_a_run_tells_what_to_try(tisfm_run, frames):
    """The advice of every status but "converged", once."""
    code, _, err = tisfm_run(
        "run", "frames", "-o", "out", "--no-figures", "--outer-iterations", "1", "--sweeps", "1"
    )
    lines = err.strip().splitlines()
    assert code == 0
    assert "iteration_limit" in lines[0]
    assert len(lines) == 2
    assert lines[1].startswith("iteration_limit: ")
    assert "raise outer_iterations" in lines[1]
