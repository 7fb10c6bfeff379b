"""`tisfm reconstruct`: the folder it writes, and what it tells."""

import re
import signal
import sys
import threading
import warnings
from importlib.util import find_spec

import cv2
import numpy as np
import pytest

import tisfm
from tests.cli.command_line import assert_one_line
from tests.reconstruction.films import along, depth_error, walk
from tisfm import Reconstruction
from tisfm.camera_file import read_camera, write_camera
from tisfm.folders.result_folder import FolderInUseError, locked_folder
from tisfm.trajectory import read_kitti, read_tum, write_kitti, write_tum

COUNT = 7  # frames
HEIGHT, WIDTH = 120, 160


@pytest.fixture
def film(work_folder):
    """The film of a walk; the folder `film` has its frames."""
    film = walk(COUNT, HEIGHT, WIDTH)
    (work_folder / "film").mkdir()
    for k in range(COUNT):
        cv2.imwrite(str(work_folder / "film" / f"f{k}.png"), film.frames[k])
    return film


NO_DEPTH = ("--depth-of", "none")


def options(film, *more):
    return ("-o", "out", "--preset", "fast", "--focal", str(film.camera.focal), *more)


@pytest.fixture
def fusing(work_folder, monkeypatch):
    """Return a list that tells for each fusion whether the folder was locked meanwhile."""
    locked, original = [], Reconstruction.points

    def lock():
        try:
            with locked_folder(work_folder / "out"):
                locked.append(False)
        except FolderInUseError:
            locked.append(True)

    def points(result, **options):
        thread = threading.Thread(target=lock)
        thread.start()
        thread.join()
        return original(result, **options)

    monkeypatch.setattr(Reconstruction, "points", points)
    return locked


def test_the_folder_holds_the_promised_files(tisfm_run, film, work_folder, fusing):
    """Another command cannot take the folder while points are fused."""
    mesh = ["--mesh", "glb"] if find_spec("skimage") else []
    code, out, err = tisfm_run("reconstruct", "film", *options(film, "--ply", *mesh))
    assert code == 0 and out == ""
    told = re.fullmatch(
        rf"{COUNT} of {COUNT} frames have a pose, in 1 piece; (\d+) keyframes\. Grade [^\n]+ "
        r"\(worst\)\. Results in out\.\n"
        r"(the result depends on the stated focal length[^\n]+\n)?"
        r"median deviations of the poses: position ±[^\n]+ in the unit of the poses, "
        r"rotation ±[^\n]+°\n",
        err,
    )
    assert told
    assert sorted(path.name for path in (work_folder / "out").iterdir()) == [
        "asked.json", "camera.json", "depth", "frames", *(["mesh.glb"] if mesh else []), "path.npz",
        "points.ply", "poses.txt", "reconstruction.json", "timings.csv", "trajectory.txt",
    ]  # fmt: skip
    assert fusing and all(fusing)
    if mesh:
        assert (work_folder / "out" / "mesh.glb").read_bytes()[:4] == b"glTF"
    result = Reconstruction.load("out")
    assert len(result) == COUNT and len(result.keyframes) == int(told[1])
    np.testing.assert_allclose(read_kitti("out/poses.txt").poses, result.poses, atol=1e-9)
    tum = read_tum("out/trajectory.txt")
    np.testing.assert_allclose(tum.poses, result.poses, atol=1e-9)
    np.testing.assert_array_equal(tum.times, np.arange(COUNT))


def test_a_new_reconstruction_replaces_the_earlier_one(tisfm_run, film, work_folder):
    run = ("reconstruct", "film", *options(film, "--depth-of"))
    assert tisfm_run(*run, "keyframes", "--ply")[0] == 0
    keyframes = Reconstruction.load("out").keyframes
    depth = sorted(int(path.stem) for path in (work_folder / "out" / "depth").iterdir())
    assert keyframes and depth == list(keyframes)
    assert tisfm_run(*run, "none", "--stop", "6")[0] == 0
    assert len(Reconstruction.load("out")) == len(read_kitti("out/poses.txt").poses) == 6
    assert not list((work_folder / "out" / "depth").iterdir())
    assert not (work_folder / "out" / "points.ply").exists()
    assert np.isfinite(read_kitti("out/poses.txt").poses).all()


def test_depth_has_the_unit_of_given_poses(tisfm_run, film):
    write_kitti("known.txt", film.poses)
    code, _, _ = tisfm_run("reconstruct", "film", *options(film, "--poses", "known.txt"))
    result = Reconstruction.load("out")
    assert code == 0
    np.testing.assert_allclose(result.poses, film.poses, atol=1e-6)
    assert depth_error(result.depth(3), film.depth[3]) < 0.15


def test_poses_with_times_belong_to_frames_without_times_in_order(tisfm_run, film):
    write_tum("known.txt", film.poses, 5.0 + np.arange(COUNT))
    run = ("reconstruct", "film", *options(film, "--depth-of", "keyframes", "--poses"))
    assert tisfm_run(*run, "known.txt")[0] == 0
    np.testing.assert_allclose(Reconstruction.load("out").poses, film.poses, atol=1e-6)
    write_tum("fewer.txt", film.poses[:4], np.arange(4.0))
    code, _, err = tisfm_run(*run, "fewer.txt")
    assert_one_line(code, err, "poses are 4 with times, but the 7 frames have no times")


def test_scale_and_mask_are_taken(tisfm_run, film):
    mask = np.full(film.frames[0].shape, 255, np.uint8)
    mask[100:] = 0
    cv2.imwrite("mask.png", mask)
    more = ("--scale", "0", "6", "2.5", "--mask", "mask.png", "--depth-of", "keyframes")
    code, _, _ = tisfm_run("reconstruct", "film", *options(film, *more))
    result = Reconstruction.load("out")
    assert code == 0 and len(result) == COUNT
    moved = np.linalg.norm(result.poses[6, :3, 3] - result.poses[0, :3, 3])
    assert moved == pytest.approx(2.5)
    assert np.isinf(result.inverse_depth_std(result.keyframes[0])[100:]).all()


def test_nothing_is_fused_without_depth(tisfm_run, film, work_folder):
    code, _, err = tisfm_run("reconstruct", "film", *options(film, *NO_DEPTH, "--ply"))
    assert_one_line(code, err, "estimates no depth, which --ply and --mesh need")
    code, _, err = tisfm_run("reconstruct", "film", *options(film, "--strict"))
    assert_one_line(code, err, "--strict is for points and surfaces: give --ply or --mesh too")
    code, _, err = tisfm_run("reconstruct", "film", *options(film, "--strict", "--complete"))
    assert_one_line(code, err, "--complete excludes --strict")
    assert not (work_folder / "out").exists()


def test_the_estimated_focal_length_is_passed_on(tisfm_run, film, work_folder):
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # a line states the doubt, once
        code, _, err = tisfm_run("reconstruct", "film", "-o", "out", "--preset", "fast", *NO_DEPTH)
    result = Reconstruction.load("out")
    assert code == 0 and result.calibration.origin in ("estimated", "guessed")
    assert err.splitlines()[1] == result.calibration.message
    assert err.count("the focal length is") == 1
    focal = read_camera("out").focal
    assert focal == result.camera.focal
    pair = [f"film/f{k}.png" for k in (0, 1)]
    options = ("--camera", "out", "--preset", "fast", "--motion", "camera", "--no-figures")
    code, _, err = tisfm_run("run", *pair, "-o", "pair", *options)
    doubt = f"out: {result.calibration.message}\n"
    assert code == 0 and err.startswith(doubt)
    assert tisfm.Interpretation.load("pair/f0.npz").camera.focal == pytest.approx(focal)
    code, _, err = tisfm_run(
        "reconstruct",
        "film",
        "-o",
        "two",
        "--camera",
        "out/camera.json",
        "--preset",
        "fast",
        *NO_DEPTH,
    )
    assert code == 0 and err.splitlines()[1] == result.calibration.message, err
    assert err.count("focal length is") == 1
    again = Reconstruction.load("two")
    assert again.camera.focal == focal
    assert again.calibration == result.calibration  # it is not "given"
    assert result.calibration.readout == 0  # rows were read at once


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (("--camera", "lens.json", "--focal", "100"), "lens.json states the camera"),
        (("--camera", "lens.json", "--aspect", "1.1"), "lens.json states the camera"),
        (("--camera", "lens.json", "--readout", "0"), "lens.json states the camera"),
        (("--readout", "0.5"), "give --focal"),
        (("--focal", "100", "--readout", "2"), "readout is 2: expected -1 to 1"),
        (("--camera", "none.json"), "none.json"),
        (("--camera", "f0.png"), "is not a camera"),
        (("--camera", "lens.json"), "of frames of 10×10 px, not of 160×120"),
        (("--center", "100", "80"), "give --focal"),
        (("--focal", "guess", "--calibrate", "focal"), "--focal guess"),
    ],
)
def test_cameras_that_do_not_fit_are_refused(tisfm_run, film, work_folder, options, text):
    write_camera("lens.json", tisfm.Camera(focal=10.0), (10, 10))
    (work_folder / "f0.png").write_bytes((work_folder / "film" / "f0.png").read_bytes())
    code, _, err = tisfm_run("reconstruct", "film", "-o", "out", *options)
    assert_one_line(code, err, text)
    assert not (work_folder / "out").exists()


def test_the_focal_length_is_guessed_on_request(tisfm_run, film, work_folder):
    code, _, err = tisfm_run(
        "reconstruct", "film", "-o", "out", "--preset", "fast", "--focal", "guess", *NO_DEPTH
    )
    assert code == 0 and "\nthe focal length is a guess, 192 px (at 160×120), 1.2 times" in err
    assert read_camera("out").focal == 1.2 * WIDTH


@pytest.fixture
def webcam(film, monkeypatch):
    """A webcam that plays the film, and presses Ctrl-C as it shows the sixth frame."""

    class Webcam:
        def __init__(self, number):
            self.shown = 0

        def isOpened(self):
            return True

        def get(self, property):
            return 1e6

        def grab(self):
            return True

        def retrieve(self):
            image = cv2.cvtColor(film.frames[self.shown], cv2.COLOR_GRAY2BGR)
            self.shown += 1
            if self.shown == 6:
                signal.raise_signal(signal.SIGINT)
            return True, image

        def release(self):
            pass

    monkeypatch.setattr(cv2, "VideoCapture", Webcam)


def test_a_webcam_is_read_until_ctrl_c(tisfm_run, film, webcam):
    before = signal.getsignal(signal.SIGINT)
    code, _, err = tisfm_run("reconstruct", "webcam:0", *options(film, *NO_DEPTH))
    assert code == 0 and "Ctrl-C" in err
    found = Reconstruction.load("out")
    assert found.names == tuple(f"webcam_{k:06d}" for k in range(6))
    assert (found.piece == 0).all()
    assert signal.getsignal(signal.SIGINT) == before


def test_a_camera_file_is_scaled_to_a_webcam(tisfm_run, film, webcam):
    write_camera("lens.json", tisfm.Camera(focal=2 * film.camera.focal), (2 * HEIGHT, 2 * WIDTH))
    options = ("--camera", "lens.json", "--preset", "fast", *NO_DEPTH, "--stop", "3")
    assert tisfm_run("reconstruct", "webcam", "-o", "out", *options)[0] == 0
    assert Reconstruction.load("out").camera.focal == film.camera.focal


def test_poses_with_times_belong_to_the_nearest_frames(tisfm_run, film, work_folder):
    (work_folder / "timed").mkdir()
    stamps = 1305031102.0 + 0.04 * np.arange(COUNT)
    for k, stamp in enumerate(stamps):
        (work_folder / "film" / f"f{k}.png").rename(work_folder / "timed" / f"{stamp:.6f}.png")
    # Twice as many poses as frames, each a little late; none for the last frames.
    between = np.repeat(film.poses[: COUNT - 2], 2, axis=0)[:-1]
    between[1::2, :3, 3] += 1
    write_tum("known.txt", between, stamps[0] + 0.003 + 0.02 * np.arange(len(between)))
    options_ = options(film, "--poses", "known.txt", "--depth-of", "keyframes")
    code, _, err = tisfm_run("reconstruct", "timed", *options_)
    result = Reconstruction.load("out")
    assert code == 0
    np.testing.assert_allclose(result.poses[:-2], film.poses[: COUNT - 2], atol=1e-6)
    assert np.isnan(result.poses[-2:]).all()
    assert "unrelated, 2 frames: no pose is given within 0.02 s of it" in err


@pytest.mark.parametrize("scale", [("0", "0", "1"), ("-1", "3", "1"), ("0", "6", "0")])
def test_an_impossible_scale_is_refused_at_once(tisfm_run, film, work_folder, scale):
    code, _, err = tisfm_run("reconstruct", "film", *options(film, "--scale", *scale))
    assert_one_line(code, err, "--scale is")
    assert not (work_folder / "out").exists()


def test_the_scale_of_a_missing_frame_is_refused_at_once(tisfm_run, film, work_folder):
    code, _, err = tisfm_run(
        "reconstruct", "film", *options(film, *NO_DEPTH, "--scale", "0", "7", "1")
    )
    assert_one_line(code, err, "the sequence has 7 frames: expected numbers from 0 to 6")
    assert not (work_folder / "out").exists()


def test_poses_are_written_when_the_scale_turns_out_to_be_wrong(
    tisfm_run, film, work_folder, monkeypatch
):
    monkeypatch.setattr("tisfm.cli.reconstruct._max_frame_count", lambda source, frames: None)
    code, _, err = tisfm_run(
        "reconstruct", "film", *options(film, *NO_DEPTH, "--scale", "0", "7", "1")
    )
    told, *_, last = err.splitlines()  # a note on the focal length may stand between
    assert "7 of 7 frames have a pose" in told
    assert_one_line(code, last + "\n", "frame is 7: expected 0 to 6")
    assert np.isfinite(read_kitti("out/poses.txt").poses).all()


def test_a_mesh_without_its_library_is_refused_at_once(tisfm_run, film, work_folder, monkeypatch):
    monkeypatch.setitem(sys.modules, "skimage", None)
    code, _, err = tisfm_run("reconstruct", "film", *options(film, "--mesh", "ply"))
    assert_one_line(code, err, "scikit-image")
    assert not (work_folder / "out").exists()


def test_frames_without_motion_have_no_pose(tisfm_run, film, work_folder):
    for k in range(COUNT):
        cv2.imwrite(str(work_folder / "film" / f"f{k}.png"), film.frames[0])
    code, _, err = tisfm_run("reconstruct", "film", *options(film))
    assert code == 0
    assert err.startswith(f"0 of {COUNT} frames have a pose")
    assert "no_motion" in err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["gone"], "gone"),
        (["film", "--poses", "gone.txt"], "gone.txt"),
        (["film", "--mask", "gone.png"], "gone.png"),
        (["film", "--stop", "1"], "stop is 1"),
    ],
)
def test_faults_are_one_line(tisfm_run, film, work_folder, arguments, words):
    code, _, err = tisfm_run("reconstruct", *arguments, *options(film))
    assert code == 1
    assert_one_line(code, err, words)
    assert not (work_folder / "out" / "reconstruction.json").exists()


def test_poses_of_another_number_are_refused(tisfm_run, film):
    write_kitti("known.txt", along(3))
    code, _, err = tisfm_run("reconstruct", "film", *options(film, "--poses", "known.txt"))
    assert code == 1
    assert_one_line(code, err, "poses are 3")


def test_files_of_others_are_kept(tisfm_run, film, work_folder):
    (work_folder / "out").mkdir()
    (work_folder / "out" / "letter.txt").write_text("dear")
    code, _, err = tisfm_run("reconstruct", "film", *options(film))
    assert code == 1
    assert_one_line(code, err, "letter.txt")
    assert (work_folder / "out" / "letter.txt").read_text() == "dear"


def test_a_pose_file_in_the_folder_is_kept(tisfm_run, film, work_folder):
    (work_folder / "out").mkdir()
    write_kitti("out/poses.txt", film.poses)
    code, _, err = tisfm_run("reconstruct", "film", *options(film, "--poses", "out/poses.txt"))
    assert code == 1
    assert_one_line(code, err, "lies in out")
    assert len(read_kitti("out/poses.txt").poses) == COUNT


@pytest.mark.parametrize("name", ["out", "out/camera.json"])
def test_a_camera_file_in_the_folder_is_kept(tisfm_run, film, work_folder, name):
    (work_folder / "out").mkdir()
    write_camera("out/camera.json", film.camera, (HEIGHT, WIDTH))
    code, _, err = tisfm_run("reconstruct", "film", "-o", "out", "--camera", name)
    assert_one_line(code, err, "lies in out")
    assert read_camera("out") == film.camera


def test_a_missing_source_is_one_line(tisfm_run):
    code, _, err = tisfm_run("reconstruct", "-o", "out")
    assert code == 1
    assert_one_line(code, err, "SOURCE is missing")
