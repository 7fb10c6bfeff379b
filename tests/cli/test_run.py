"""`tisfm run`: the files it promises, and what they hold."""

import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import ExifTags, Image

import tisfm
from tests.cli.command_line import (
    FRAMES,
    H,
    W,
    assert_one_line,
    files,
    kept,
    load,
    promised,
    record,
)
from tests.draws import nightly_except
from tisfm.formats import read_depth_png, read_flo, read_image, write_png
from tisfm.lens import undistort
from tisfm.rigid import pose_matrix
from tisfm.running import pairs
from tisfm.scenes import Plane, Scene, Texture
from tisfm.settings import Settings
from tisfm.show import depth_grey


@pytest.mark.parametrize(
    "source",
    [["frames/f0.png", "frames/f1.png", "frames/f2.png"], ["frames"], ["frames/f?.png"]],
    ids=["files", "folder", "pattern"],
)  # fmt: skip
def test_run_writes_the_promised_files(tisfm_run, frames, source):
    (frames / "f3.png").unlink()
    more = [] if len(source) == 3 else ["--no-figures"]
    code, out, err = tisfm_run("run", *source, "-o", "out", *more)
    assert code == 0 and out == ""
    assert re.fullmatch(
        r"2 pairs: .*, \d+\.\d\d s each \(median\)\. Grade poor, as field only shows "
        r"near and far\. Results in out, settings and scales in "
        r"out/run\.json\.\n",
        err,
    )
    assert set(files("out")) == promised("f0", "f1", figures=not more)


def test_run_of_two_images(tisfm_run, frames):
    code, _, err = tisfm_run(
        "run", "frames/f2.png", "frames/f0.png", "--output", "deep/er/out", "--no-figures"
    )
    assert code == 0 and err.startswith("1 pair: ")
    assert set(files("deep/er/out")) == promised("f2", figures=False)
    expected = tisfm.interpret(FRAMES[2], FRAMES[0])
    np.testing.assert_array_equal(load("deep/er/out", "f2").flow, kept(expected).flow)


def test_run_of_a_video(tisfm_run, work_folder):
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
    assert tisfm_run("run", "frames", "-o", "out", "--focal", "50", "--flo")[0] == 0
    about = record("out")
    assert about["version"] == tisfm.__version__
    assert about["camera"] == {
        "focal": 50.0,
        "center": None,
        "distortion": None,
        "aspect": 1.0,
        "readout": None,
    }
    assert Settings(**about["settings"]) == Settings()
    assert list(about["pairs"]) == ["f0", "f1", "f2"]
    scale = about["depth16_values_per_unit"]
    for k, name in enumerate(about["pairs"]):
        result = load("out", name)
        expected = tisfm.interpret(FRAMES[k], FRAMES[k + 1], camera=tisfm.Camera(50.0))
        limit = about["depth_range"] * float(expected.inverse_depth.mean(dtype=np.float64))
        for part in ("rho", "flow", "inverse_depth", "confidence", "occlusion", "frame"):
            np.testing.assert_array_equal(getattr(result, part), getattr(kept(expected), part))
        np.testing.assert_array_equal(read_flo(f"out/{name}_flow.flo"), expected.flow)
        result = expected  # what the pictures are drawn of
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
    assert tisfm_run(*arguments, "-o", "out", "--figures", "9")[0] == 0
    assert tisfm_run("run", frames, "-o", "moving", "--no-figures")[0] == 0
    about, moving = record("out"), record("moving")
    assert about["pairs"]["000000_f0"]["status"] == "no_motion"
    for key in ("depth16_values_per_unit", "depth_range", "flow_limit"):
        assert about[key] == moving[key]
    assert not read_image("out/000000_f0_depth16.png").any()
    assert np.isnan(read_depth_png("out/000000_f0_depth16.png")).all()
    assert not read_image("out/000000_f0_depth.png").any()


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_a_diverging_pair_does_not_set_the_ranges(tisfm_run, frames, work_folder):
    for k in range(2):
        cv2.imwrite(f"h{k}.tif", FRAMES[k].astype(np.float32) * 1e30)
    cv2.imwrite("g1.tif", FRAMES[1].astype(np.float32))
    cv2.imwrite("g2.tif", FRAMES[2].astype(np.float32))
    code, _, err = tisfm_run(
        "run", "h0.tif", "h1.tif", "g1.tif", "g2.tif", "-o", "out", "--no-figures"
    )
    assert code == 0 and "2 diverged" in err
    assert set(files("out")) == promised("h0", "h1", "g1", figures=False)
    expected = tisfm.interpret(FRAMES[1], FRAMES[2])
    usual = np.percentile(expected.inverse_depth, 95) / expected.inverse_depth.mean()
    assert record("out")["depth_range"] == pytest.approx(usual, rel=0.02)


GIVEN = {
    "--preset paper": Settings.preset("paper"),
    "--preset=fast": Settings.preset("fast"),
    "--preset paper --beta 0.5": Settings.preset("paper", beta=0.5),
    "--beta 0.5 --preset paper": Settings.preset("paper", beta=0.5),
    "--preset fast --preset paper": Settings.preset("paper"),
    "--model translation": Settings(model="translation"),
    "--contrast None": Settings(contrast=None),
    "--no-joint-edges --data-contrast None": Settings(joint_edges=False, data_contrast=None),
    "--stiffness 1 1 0.1 2 2 3": Settings(stiffness=(1, 1, 0.1, 2, 2, 3)),
    "--preset paper --contrast 0.1": Settings.preset("paper", contrast=0.1),
    "--pyramid-levels 1 --solver closed_form": Settings(pyramid_levels=1, solver="closed_form"),
}
SHORT = (
    "--preset=fast",
    "--beta 0.5 --preset paper",
    "--no-joint-edges --data-contrast None",
    "--stiffness 1 1 0.1 2 2 3",
)


@pytest.mark.parametrize("options", nightly_except(*SHORT, of=GIVEN))
def test_options_reach_the_result(tisfm_run, frames, options):
    two = [frames / "f0.png", frames / "f1.png"]
    settings = GIVEN[options]
    assert tisfm_run("run", *two, "-o", "out", "--no-figures", *options.split())[0] == 0
    result = load("out", "f0")
    assert result.settings == settings
    expected = tisfm.interpret(*FRAMES[:2], settings=settings)
    np.testing.assert_array_equal(result.flow, kept(expected).flow)
    assert not np.array_equal(result.flow, tisfm.interpret(*FRAMES[:2]).flow)


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
    assert not np.array_equal(result.flow, tisfm.interpret(*FRAMES[:2]).flow)


@pytest.mark.parametrize(
    "option",
    nightly_except(
        ["--distortion=-0.3, 0.1, 0, 1e-3"],
        of=(["--distortion", "-0.3,0.1,0,1e-3"], ["--distortion=-0.3, 0.1, 0, 1e-3"],
            ["--distortion", "-0.3 0.1 0 1e-3"]),
    ),
    ids=" ".join,
)  # fmt: skip
def test_distortion_is_removed(tisfm_run, frames, option):
    two = [frames / "f0.png", frames / "f1.png"]
    code, _, _ = tisfm_run("run", "-o", "out", "--no-figures", "--focal", "50", *option, *two)
    assert code == 0 and set(files("out")) == promised("f0", figures=False)
    camera = tisfm.Camera(50.0, distortion=(-0.3, 0.1, 0, 1e-3))
    expected = tisfm.interpret(*FRAMES[:2], camera=camera)
    result = load("out", "f0")
    np.testing.assert_array_equal(result.flow, kept(expected).flow)
    np.testing.assert_array_equal(result.frame, undistort(FRAMES[0], camera))
    assert record("out")["camera"]["distortion"] == list(camera.distortion)
    assert result.camera == camera.pinhole()


@pytest.mark.parametrize(
    "lens", nightly_except((-0.3, 0.1, 0.0, 0.0), of=[None, (-0.3, 0.1, 0.0, 0.0)])
)
def test_the_baseline_is_of_the_same_frames(tisfm_run, frames, monkeypatch, lens):
    seen = []

    def baseline(*frames, **options):
        seen.extend(frames)
        return np.zeros((H, W, 2), np.float32)

    monkeypatch.setattr(pairs, "horn_schunck", baseline)
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
    tisfm.interpret(*FRAMES[1:3]).points().save("expected.ply")
    again = load("out", "f1").points()  # the same but for rounding
    np.testing.assert_allclose(again, tisfm.interpret(*FRAMES[1:3]).points(), rtol=2.0**-11)
    assert Path("out/f1.ply").read_bytes() == Path("expected.ply").read_bytes()
    assert b"element vertex 0\n" not in Path("out/f1.ply").read_bytes()
    assert "ply" in record("out")["outputs"]
    Path("out/f1.ply").unlink()
    Path("out/f1.npz").unlink()
    options = ("run", "frames", "-o", "out", "--no-figures", "--resume")
    assert_one_line(*tisfm_run(*options)[::2], "a run with other options")
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


@pytest.mark.parametrize(
    ("command", "film"),
    [("run", 35), ("run", None), pytest.param("figures", 35, marks=pytest.mark.nightly)],
)
def test_the_focal_length_can_be_guessed(tisfm_run, frames, command, film):
    if film:
        with_exif(frames / "f0.png", FRAMES[0], film)
    two = [frames / "f0.png", frames / "f1.png"]
    more = ["--no-figures"] if command == "run" else []
    code, out, err = tisfm_run(command, "--focal", "guess", *two, "-o", "out", *more)
    assert code == 0 and out == ""
    focal = 35 * np.hypot(H, W) / np.hypot(24, 36) if film else 1.2 * W
    line, *others = err.splitlines()
    assert len(others) == 1
    reason = "35 mm in terms of" if film else "1.2 times the longer side"
    assert line.startswith(f"focal length guessed: {focal:.0f} px (at {W}×{H}), ")
    assert reason in line and "give --focal" in line
    if command == "run":
        assert load("out", "f0").camera.focal == pytest.approx(focal)
        assert record("out")["camera"]["focal"] == pytest.approx(focal)


def test_the_focal_length_of_a_video_is_guessed_by_its_size(tisfm_run, work_folder):
    writer = cv2.VideoWriter("clip.avi", cv2.VideoWriter_fourcc(*"MJPG"), 10, (64, 48))
    if not writer.isOpened():
        pytest.skip("this build of OpenCV cannot write MJPG video")
    for frame in FRAMES[:3]:
        writer.write(cv2.resize(cv2.cvtColor(frame, cv2.COLOR_GRAY2BGR), (64, 48)))
    writer.release()
    code, _, err = tisfm_run("run", "clip.avi", "-o", "out", "--no-figures", "--focal", "guess")
    assert code == 0 and err.startswith("focal length guessed: 77 px (at 64×48), ")
    assert load("out", "clip_000000").camera.focal == pytest.approx(1.2 * 64)


def test_the_printed_focal_length_is_that_of_the_source_frames(tisfm_run, frames):
    """Given as --focal, it gives the same result although frames are shrunk; the report's too."""
    options = ["--no-figures", "--size", "32"]
    code, _, err = tisfm_run("run", "frames", "-o", "out", "--focal", "guess", *options)
    assert code == 0 and err.startswith(f"focal length guessed: {1.2 * W:.0f} px (at {W}×{H}), ")
    assert record("out")["source"] == {"focal": 1.2 * W, "width": W, "height": H}
    assert record("out")["camera"]["focal"] == pytest.approx(1.2 * 32)  # of what was written
    code, _, _ = tisfm_run("run", "frames", "-o", "again", "--focal", f"{1.2 * W:.0f}", *options)
    guessed, given = load("out", "f0"), load("again", "f0")
    assert code == 0 and given.camera == guessed.camera
    np.testing.assert_array_equal(given.inverse_depth, guessed.inverse_depth)
    assert given.focal_deviation == 0 and np.isinf(guessed.focal_deviation)
    assert tisfm_run("report", "out")[0] == 0
    assert f"{1.2 * W:g} px (at {W}×{H})" in Path("out", "report.html").read_text(encoding="utf-8")


def test_without_figures(tisfm_run, frames, monkeypatch):
    monkeypatch.setattr(pairs, "horn_schunck", None)  # not needed then
    assert tisfm_run("run", "frames", "-o", "out", "--no-figures")[0] == 0
    assert set(files("out")) == promised("f0", "f1", "f2", figures=False)


def test_step(tisfm_run, frames):
    assert tisfm_run("run", "frames", "-o", "out", "--step", "2", "--no-figures")[0] == 0
    assert set(files("out")) == promised("f0", figures=False)
    expected = tisfm.interpret(FRAMES[0], FRAMES[2])
    np.testing.assert_array_equal(load("out", "f0").flow, kept(expected).flow)


def test_markup_in_names_is_printed(tisfm_run, frames, work_folder):
    for k in range(2):
        (frames / f"f{k}.png").rename(work_folder / f"[red]{k}.png")
    code, _, err = tisfm_run(
        "run", "[red]0.png", "[red]1.png", "-o", "out [bold] x", "--no-figures"
    )
    assert code == 0 and "Results in out [bold] x, settings" in err
    assert set(files("out [bold] x")) == promised("[red]0", figures=False)


def test_a_run_prints_advice(tisfm_run, frames):
    """The advice of every status but "converged", once."""
    code, _, err = tisfm_run(
        "run", "frames", "-o", "out", "--no-figures", "--outer-iterations", "1", "--sweeps", "2"
    )
    lines = err.strip().splitlines()
    assert code == 0
    assert "iteration_limit" in lines[0]
    assert len(lines) == 2
    assert lines[1].startswith("iteration_limit: ")
    assert "raise outer_iterations" in lines[1]


def test_run_counts_pairs_that_depend_on_the_stated_focal_length(tisfm_run, work_folder):
    """A wall aslant, which is approached sideways, does not show the focal length."""
    wall = Plane(texture=Texture(wavelength=0.12), point=(0, 0, 5), normal=(0.2, 0.1, -1))
    scene = Scene(objects=[wall], camera=tisfm.Camera(focal=120.0), height=96, width=128)
    poses = [pose_matrix((0.2 * k, 0.05 * k, 0.1 * k, 0, -0.03 * k, 0)) for k in range(2)]
    Path("wall").mkdir()
    for k, pose in enumerate(poses):
        frame = np.clip(np.rint(scene.render_frame(pose, samples=3)), 0, 255).astype(np.uint8)
        write_png(f"wall/{k}.png", frame)
    options = ["--motion", "camera", "--preset", "fast", "--focal", "120", "--no-figures"]
    code, _, err = tisfm_run("run", "wall", "-o", "out", *options)
    assert code == 0
    (pair,) = record("out")["pairs"].values()
    assert "depends on the stated focal length" in pair["message"]
    if pair["status"] == "converged":
        assert "note: 1 of 1 converged pairs depend on the focal length" in err
    else:
        assert f"{pair['status']}: " in err and "depends on the stated focal length" in err
