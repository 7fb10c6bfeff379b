"""`tisfm export`: what it writes, tells and refuses."""

import re
import shutil
from dataclasses import replace

import cv2
import numpy as np
import pytest

import tisfm
from tests.cli.command_line import assert_one_line
from tests.exports.made import made
from tests.exports.runs import run_of
from tisfm.cli import export
from tisfm.exports.formats import FORMATS
from tisfm.reconstruction.result.folder import write_record
from tisfm.status import Status
from tisfm.trajectory import read_tum

LENS = tisfm.Camera(40.0, distortion=(-0.1, 0.0, 0.0, 0.0))
OF_SEQUENCES = {
    "tum", "kitti", "mesh-ply", "mesh-glb", "gltf-camera", "chan", "colmap", "colmap-text",
    "nerfstudio",
}  # fmt: skip


def names(folder):
    """Return the files in a folder and below."""
    return sorted(
        path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()
    )


def test_help_names_every_format(tisfm_run):
    code, out, _ = tisfm_run("export", "--help")
    text = " ".join(out.split())
    assert code == 0 and "[OPTIONS] DIR" in text
    words = set(re.findall(r"[a-z-]+", text))
    assert set(FORMATS) <= words


def test_the_page_names_every_format(request):
    page = (request.config.rootpath / "docs" / "exports.md").read_text(encoding="utf-8")
    rows = [line for line in page.splitlines() if line.startswith("| `")]
    named = {name for row in rows for name in re.findall(r"`([a-z-]+)`", row.split("|")[1])}
    assert set(FORMATS) <= named


def test_a_path_and_its_camera(tisfm_run, work_folder):
    result = made(work_folder / "walk", piece=[0, 0, 0, -1, 1, 1])
    code, out, err = tisfm_run(
        "export", "walk", "--to", "tum", "--to", "kitti,chan", "--to=gltf-camera", "-o", "out"
    )
    assert code == 0 and out == ""
    told = err.splitlines()
    assert told[0] == "tum: out/trajectory.tum, out/trajectory-piece2.tum".replace("/", _slash())
    assert "tum: 1 frame without a pose left out" in told
    assert "tum: 2 pieces (3, 2 frames), each with its own scale and its own file" in told
    assert len([line for line in told if "without a pose" in line]) == 1  # it is said once
    assert names(work_folder / "out") == [
        "camera-piece2.chan", "camera-piece2.gltf", "camera.chan", "camera.gltf", "lens.json",
        "poses-piece2.kitti", "poses-piece2.times", "poses.kitti", "poses.times",
        "trajectory-piece2.tum", "trajectory.tum",
    ]  # fmt: skip
    found = read_tum(work_folder / "out" / "trajectory.tum")
    np.testing.assert_allclose(found.poses, result.poses[:3], atol=1e-12)


def _slash():
    return str(export.Path("a/b"))[1]


def test_frames_and_unit_are_chosen(tisfm_run, work_folder):
    result = made(work_folder / "walk")
    options = ("--start", "1", "--stop", "6", "--step", "2", "--scale", "0", "1", "7")
    code, _, _ = tisfm_run(
        "export", "walk", "--to", "tum,depth-pfm", "-o", "out", "--fps", "5", *options
    )
    assert code == 0
    found = read_tum(work_folder / "out" / "trajectory.tum")
    np.testing.assert_allclose(found.times, [0.2, 0.6, 1.0])
    length = np.linalg.norm(result.poses[1, :3, 3] - result.poses[0, :3, 3])
    expected = result.poses[1::2, :3, 3] * 7 / length
    np.testing.assert_allclose(found.poses[:, :3, 3], expected, rtol=1e-9)
    assert names(work_folder / "out" / "depth-pfm") == ["f1.pfm", "f3.pfm", "f5.pfm"]
    # Depth, frames, and two more files: the export writes nothing into the folder.
    assert len(names(work_folder / "walk")) == 6 + 6 + 2


def test_a_unit_is_that_of_a_piece(tisfm_run, work_folder):
    result = made(work_folder / "walk", piece=[0, 0, 1, 1, 1, 1], count=6)
    arguments = ("export", "walk", "--to", "tum", "-o", "out")
    code, _, err = tisfm_run(*arguments, "--scale", "2", "3", "7")
    assert code == 0
    assert (
        "--scale sets the unit of the piece of these two frames, which has 4 frames; other pieces"
        in err
    )
    found = read_tum(work_folder / "out" / "trajectory.tum").poses
    assert np.linalg.norm(found[1, :3, 3] - found[0, :3, 3]) == pytest.approx(7)
    other = read_tum(work_folder / "out" / "trajectory-piece2.tum").poses
    np.testing.assert_allclose(other, result.poses[:2], atol=1e-12)
    assert "--scale" not in tisfm_run(*arguments)[2]


def test_all_exports_of_a_reconstruction(tisfm_run, work_folder):
    for package in ("av", "OpenEXR"):
        pytest.importorskip(package)
    made(work_folder / "walk", labelled=True, with_depth=(0, 1, 2, 4))
    tisfm.camera_file.write_camera(work_folder / "walk" / "camera.json", LENS, (62, 90))
    wanted = set(FORMATS) - {"ply", "glb", "mesh-ply", "mesh-glb", "video-flow"}
    code, _, err = tisfm_run("export", "walk", "--to", ",".join(wanted), "-o", "out")
    assert code == 0, err
    found = names(work_folder / "out")
    videos = ["anaglyph.mp4", "depth.mp4", "side-by-side.mp4", "wiggle.mp4"]
    assert set(videos) | {"undistort.exr", "redistort.tiff", "masks/object-2/f1.png"} <= set(found)
    for kind in ("tum", "kitti", "exr", "tiff", "pfm", "dpt"):
        assert len([name for name in found if name.startswith(f"depth-{kind}/")]) == 4
    assert "2 frames without depth left out" in err
    assert "25 per second are assumed" in err
    assert "depth is value / 256, in the unit of the path" in err
    assert not [name for name in found if name.endswith(".tmp")]


def test_options_of_views_change_the_views(tisfm_run, work_folder):
    pytest.importorskip("av")
    made(work_folder / "walk", count=2, shape=(40, 160))
    seen = {}
    for options in ((), ("--disparity", "0.12"), ("--screen", "1"), ("--screen-depth", "1.1")):
        arguments = ("export", "walk", "--to", "video-anaglyph", "-o", "out", *options)
        assert tisfm_run(*arguments)[0] == 0
        found, frame = cv2.VideoCapture(str(work_folder / "out" / "anaglyph.mp4")).read()
        assert found
        seen[options] = frame.astype(int)
    usual = seen.pop(())
    for options, frame in seen.items():
        assert np.abs(frame - usual).mean() > 2, options


def test_all_exports_of_a_run(tisfm_run, work_folder):
    for package in ("av", "OpenEXR"):
        pytest.importorskip(package)
    run_of(work_folder / "pairs", camera=LENS)
    wanted = set(FORMATS) - OF_SEQUENCES
    code, _, err = tisfm_run("export", "pairs", "--to", ",".join(wanted), "-o", "out")
    assert code == 0, err
    found = set(names(work_folder / "out"))
    assert {"flow.mp4", "undistort.exr", "masks/visible/p2.png", "points-glb/p0.glb"} <= found
    for kind in ("depth-kitti/{}.png", "points-ply/{}.ply"):
        assert {kind.format(f"p{k}") for k in range(3)} <= found


def test_a_run_is_exported(tisfm_run, frames, work_folder):
    assert tisfm_run("run", "frames", "-o", "pairs", "--no-figures", "--preset", "fast")[0] == 0
    code, _, err = tisfm_run("export", "pairs", "--to", "depth-tiff,masks", "-o", "out")
    assert code == 0, err
    assert len(names(work_folder / "out" / "masks" / "visible")) == 3
    assert names(work_folder / "out" / "depth-tiff")


def test_a_shutter_is_not_in_the_maps(tisfm_run, work_folder):
    for readout in (0.0, 0.3):
        lens = tisfm.Camera(40.0, distortion=LENS.distortion, readout=readout)
        run_of(work_folder / f"pairs{readout}", camera=lens)
        arguments = ("--to", "undistortion-tiff", "-o", "out")
        code, _, err = tisfm_run("export", f"pairs{readout}", *arguments)
        assert code == 0 and ("rolling shutter" in err) == bool(readout)


@pytest.mark.parametrize("name", sorted(OF_SEQUENCES))
def test_pairs_have_no_path(tisfm_run, work_folder, name):
    run_of(work_folder / "pairs")
    code, _, err = tisfm_run("export", "pairs", "--to", name, "-o", "out")
    assert_one_line(code, err, "pairs have no common scale and no path", "tisfm reconstruct")
    assert not (work_folder / "out").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--to", "obj"], ["--to is 'obj'; expected one of", "video-wiggle"]),
        (["--to", "tum,colmap-txt"], ["--to is 'colmap-txt': did you mean colmap-text?"]),
        ([], ["--to: no format is given"]),
        (["--to", "tum", "--start", "6"], ["leave no frame of 6"]),
        (["--to", "tum", "--step", "0"], ["--step 0"]),
        (["--to", "tum", "--fps", "0"], ["frames_per_second is 0"]),
        (["--to", "video-wiggle", "--disparity", "3"], ["disparity is 3"]),
        (["--to", "video-wiggle", "--screen", "3"], ["screen is 3.0, expected a quantile"]),
        (["--to", "video-wiggle", "--screen-depth", "-3"], ["screen_depth is -3.0"]),
        (
            ["--to", "video-anaglyph", "--screen", "0.5", "--screen-depth", "3"],
            ["give one of them"],
        ),
        (["--to", "tum", "--screen", "0.5"], ["--screen is only for video-anaglyph and"]),
        (["--to", "ply,tum", "--disparity", "0.1"], ["--disparity is only for", "leave it out"]),
        (["--to", "tum", "--strict"], ["--strict is only for points and surfaces", "glb"]),
        (["--to", "ply", "--strict", "--complete"], ["--complete excludes --strict"]),
        (["--to", "tum", "--scale", "0", "0", "1"], ["one camera position"]),
        # What comes last is refused before anything is written.
        (["--to", "tum,masks"], ["--motion objects"]),
        (["--to", "tum", "--to", "video-flow"], ["has no image motion", "tisfm run"]),
        (["--to", "tum,undistortion-tiff"], ["no distortion"]),
        (["--to", "tum,depth-tum", "--scale", "0", "1", "9999"], ["beyond 13.11", "--scale"]),
    ],
)  # fmt: skip
def test_impossible_exports_are_refused_first(tisfm_run, work_folder, arguments, words):
    made(work_folder / "walk")
    tisfm.camera_file.write_camera(
        work_folder / "walk" / "camera.json", tisfm.Camera(40.0), (31, 45)
    )
    code, _, err = tisfm_run("export", "walk", "-o", "out", *arguments)
    assert_one_line(code, err, *words)
    assert not (work_folder / "out").exists()


def test_pairs_with_units_of_their_own_have_no_depth_of_the_screen(tisfm_run, work_folder):
    run_of(work_folder / "pairs")
    code, _, err = tisfm_run(
        "export", "pairs", "-o", "out", "--to", "video-anaglyph", "--screen-depth", "3"
    )
    assert_one_line(code, err, "--screen-depth", "each pair of pairs has its own", "--screen")
    assert not (work_folder / "out").exists()


@pytest.mark.parametrize("option", ["--strict", "--complete"])
def test_points_of_pairs_are_not_fused(tisfm_run, work_folder, option):
    run_of(work_folder / "pairs")
    code, _, err = tisfm_run("export", "pairs", "-o", "out", "--to", "ply", option)
    assert_one_line(code, err, f"{option} is only for reconstructions", "pairs has pairs")
    assert not (work_folder / "out").exists()


@pytest.mark.parametrize("name", ["ply", "mesh-glb", "depth-dpt", "video-depth"])
def test_a_path_alone_has_no_depth(tisfm_run, work_folder, name):
    made(work_folder / "walk", with_depth=())
    code, _, err = tisfm_run("export", "walk", "--to", name, "-o", "out")
    assert_one_line(code, err, "has depth: reconstruct with --depth-of all")


def test_depth_without_a_pose_is_refused(tisfm_run, work_folder):
    result = made(work_folder / "walk", count=2, with_depth=())
    write_record(work_folder / "walk", replace(result, piece=np.full(2, -1, np.int32), unit=()))
    code, _, err = tisfm_run("export", "walk", "--to", "video-depth", "-o", "out")
    assert_one_line(code, err, "no frame has a pose")


def test_a_unit_is_of_frames_with_a_pose(tisfm_run, work_folder):
    made(work_folder / "walk", piece=[0, -1, 0], count=3)
    code, _, err = tisfm_run("export", "walk", "--to", "tum", "-o", "o", "--scale", "0", "1", "2")
    assert_one_line(code, err, "frame 1 has no pose")


def test_missing_depth_is_one_line(tisfm_run, work_folder):
    made(work_folder / "walk")
    shutil.rmtree(work_folder / "walk" / "depth")
    code, _, err = tisfm_run("export", "walk", "--to", "video-depth", "-o", "out")
    assert_one_line(code, err, "its folder depth was removed")


def test_missing_folders_are_errors(tisfm_run, work_folder):
    (work_folder / "empty").mkdir()
    for folder, words in (("nowhere", "there is no folder"), ("empty", "has neither")):
        code, _, err = tisfm_run("export", folder, "--to", "tum", "-o", "out")
        assert_one_line(code, err, words, "tisfm reconstruct")
    made(work_folder / "walk")
    (work_folder / "walk" / "reconstruction.json").unlink()
    code, _, err = tisfm_run("export", "walk", "--to", "tum", "-o", "out")
    assert_one_line(code, err, "is not complete")


@pytest.mark.parametrize("output", ["walk", "walk/out", "link/out"])
def test_exports_into_the_result_are_refused(tisfm_run, work_folder, output):
    made(work_folder / "walk", labelled=True)
    (work_folder / "link").symlink_to(work_folder / "walk")
    before = names(work_folder / "walk")
    code, _, err = tisfm_run("export", "walk", "--to", "masks", "-o", output)
    assert_one_line(code, err, "give another folder with -o")
    assert names(work_folder / "walk") == before


def test_an_earlier_export_is_replaced(tisfm_run, work_folder):
    made(work_folder / "walk")
    arguments = ("export", "walk", "--to", "tum,depth-tiff", "-o", "out")
    assert tisfm_run(*arguments)[0] == 0
    before = {
        name: (work_folder / "out" / name).read_bytes() for name in names(work_folder / "out")
    }
    (work_folder / "out" / "trajectory.tum").write_text("old")
    assert tisfm_run(*arguments)[0] == 0
    assert before == {
        name: (work_folder / "out" / name).read_bytes() for name in names(work_folder / "out")
    }


def test_long_work_is_announced(tisfm_run, work_folder, monkeypatch):
    made(work_folder / "walk")
    monkeypatch.setattr(export, "LARGE_OUTPUT", 1000)
    monkeypatch.setattr(export, "_MIN_PRINTED_TIME", 0)
    monkeypatch.setattr(export, "_MIN_MEASURED_TIME", 0)
    code, _, err = tisfm_run("export", "walk", "--to", "depth-tiff", "-o", "out")
    assert code == 0
    told = err.splitlines()
    assert told[0] == "up to 0 MB for 6 frames of 45×31 px in out"
    assert re.fullmatch(r"depth-tiff: about [\d.]+ s for 4 more frames", told[1])
    assert len(told) == 3
    usage = shutil.disk_usage(work_folder)
    monkeypatch.setattr(shutil, "disk_usage", lambda folder: usage._replace(free=5))
    code, _, err = tisfm_run("export", "walk", "--to", "depth-tiff", "-o", "out")
    assert code == 0 and "but 0 MB are free: choose frames with --start, --stop, --step" in err


def test_an_export_of_a_contradicted_result_warns(tisfm_run, tmp_path):
    result = made(tmp_path / "made", count=3)
    wrong = Status("contradicted", "the zoom changes: give a mask")
    write_record(result.folder, replace(result, status=(wrong,) * 3))
    code, _, err = tisfm_run("export", "made", "--to", "kitti", "-o", "out")
    assert code == 0
    (line,) = (line for line in err.splitlines() if "warning" in line)
    assert "Grade contradicted, 3 of 3 frames" in line and wrong.message in line
    assert names(tmp_path / "out") == ["grade.txt", "poses.kitti", "poses.times"]
