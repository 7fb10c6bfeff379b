"""`tisfm reconstruct`: the folder it writes, and what it tells."""

import re
import signal
import sys
import threading
import warnings

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

COUNT = 9


@pytest.fixture
def film(place):
    """The folder `film` with images of a walk, and the film."""
    film = walk()
    (place / "film").mkdir()
    for k in range(COUNT):
        cv2.imwrite(str(place / "film" / f"f{k}.png"), film.frames[k])
    return film


def options(film, *more):
    return ("-o", "out", "--preset", "fast", "--focal", str(film.camera.focal), *more)


def test_the_folder_holds_what_is_promised(tisfm_run, film, place):
    code, out, err = tisfm_run("reconstruct", "film", *options(film, "--ply"))
    assert code == 0 and out == ""
    told = re.fullmatch(
        rf"{COUNT} of {COUNT} frames have a pose, in 1 piece; (\d+) keyframes\. Results in out\.\n",
        err,
    )
    assert told
    assert sorted(path.name for path in (place / "out").iterdir()) == [
        "asked.json", "camera.json", "depth", "frames", "path.npz", "points.ply", "poses.txt",
        "reconstruction.json", "timings.csv", "trajectory.txt",
    ]  # fmt: skip
    result = tisfm.Reconstruction.load("out")
    assert len(result) == COUNT and len(result.keyframes) == int(told[1])
    np.testing.assert_allclose(read_kitti("out/poses.txt").poses, result.poses, atol=1e-9)
    tum = read_tum("out/trajectory.txt")
    np.testing.assert_allclose(tum.poses, result.poses, atol=1e-9)
    np.testing.assert_array_equal(tum.times, np.arange(COUNT))


def test_depth_of_keyframes_or_none(tisfm_run, film, place):
    assert tisfm_run("reconstruct", "film", *options(film, "--depth-of", "keyframes"))[0] == 0
    keyframes = tisfm.Reconstruction.load("out").keyframes
    depth = sorted(int(path.stem) for path in (place / "out" / "depth").iterdir())
    assert keyframes and depth == list(keyframes)
    assert tisfm_run("reconstruct", "film", *options(film, "--depth-of", "none"))[0] == 0
    assert not list((place / "out" / "depth").iterdir())
    assert np.isfinite(read_kitti("out/poses.txt").poses).all()


def test_nothing_is_fused_without_depth(tisfm_run, film, place):
    code, _, err = tisfm_run("reconstruct", "film", *options(film, "--depth-of", "none", "--ply"))
    assert_one_line(code, err, "estimates no depth, which --ply and --mesh need")
    assert not (place / "out").exists()


def test_the_focal_length_is_found_and_handed_on(tisfm_run, film, place):
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # nine frames hardly show it: a line says so, once
        code, _, err = tisfm_run("reconstruct", "film", "-o", "out", "--preset", "fast")
    result = tisfm.Reconstruction.load("out")
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
        "reconstruct", "film", "-o", "two", "--camera", "out/camera.json", "--depth-of", "none"
    )
    assert code == 0 and err.splitlines()[1] == result.calibration.message, err
    assert err.count("focal length is") == 1
    again = tisfm.Reconstruction.load("two")
    assert again.camera.focal == focal
    assert again.calibration == result.calibration  # it is not "given"
    assert result.calibration.readout == 0  # rows were read at once


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (("--camera", "lens.json", "--focal", "100"), "lens.json states the camera"),
        (("--camera", "lens.json", "--aspect", "1.1"), "lens.json states the camera"),
        (("--camera", "lens.json", "--readout", "0"), "lens.json states the camera"),
        (("--readout", "0.5"), "give --focal as well"),
        (("--focal", "100", "--readout", "2"), "readout is 2: expected -1 to 1"),
        (("--camera", "none.json"), "none.json"),
        (("--camera", "f0.png"), "is not a camera"),
        (("--camera", "lens.json"), "of frames of 10×10 px, not of 240×180"),
        (("--center", "100", "80"), "give --focal as well"),
        (("--focal", "guess", "--calibrate", "focal"), "--focal guess"),
    ],
)
def test_cameras_that_do_not_fit_are_refused(tisfm_run, film, place, options, text):
    write_camera("lens.json", tisfm.Camera(focal=10.0), (10, 10))
    (place / "f0.png").write_bytes((place / "film" / "f0.png").read_bytes())
    code, _, err = tisfm_run("reconstruct", "film", "-o", "out", *options)
    assert_one_line(code, err, text)
    assert not (place / "out").exists()


def test_a_guess_is_taken_where_it_is_asked_for(tisfm_run, film, place):
    code, _, err = tisfm_run(
        "reconstruct", "film", "-o", "out", "--focal", "guess", "--depth-of", "none"
    )
    assert code == 0 and "\nthe focal length is a guess, 288 px (at 240×180), 1.2 times" in err
    assert read_camera("out").focal == 1.2 * 240


def test_a_mesh_is_written(tisfm_run, film, place):
    pytest.importorskip("skimage")
    assert tisfm_run("reconstruct", "film", *options(film, "--mesh", "glb"))[0] == 0
    assert (place / "out" / "mesh.glb").read_bytes()[:4] == b"glTF"


@pytest.fixture
def webcam(film, monkeypatch):
    """A webcam that plays the film, and presses Ctrl-C as it shows the eighth frame."""

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
            if self.shown == 8:
                signal.raise_signal(signal.SIGINT)
            return True, image

        def release(self):
            pass

    monkeypatch.setattr(cv2, "VideoCapture", Webcam)


def test_a_camera_is_read_until_it_is_interrupted(tisfm_run, film, webcam):
    before = signal.getsignal(signal.SIGINT)
    code, _, err = tisfm_run("reconstruct", "webcam:0", *options(film))
    assert code == 0 and "Ctrl-C" in err
    found = tisfm.Reconstruction.load("out")
    assert found.names == tuple(f"webcam_{k:06d}" for k in range(8))
    assert (found.piece == 0).all()
    assert signal.getsignal(signal.SIGINT) == before


def test_a_camera_file_is_scaled_to_a_webcam(tisfm_run, film, webcam):
    write_camera("lens.json", tisfm.Camera(focal=2 * film.camera.focal), (360, 480))
    options = ("--camera", "lens.json", "--depth-of", "none", "--stop", "3")
    assert tisfm_run("reconstruct", "webcam", "-o", "out", *options)[0] == 0
    assert tisfm.Reconstruction.load("out").camera.focal == film.camera.focal


def test_an_earlier_reconstruction_is_replaced(tisfm_run, film, place):
    assert tisfm_run("reconstruct", "film", *options(film, "--ply"))[0] == 0
    assert tisfm_run("reconstruct", "film", *options(film, "--stop", "8"))[0] == 0
    assert len(tisfm.Reconstruction.load("out")) == 8
    assert len(list((place / "out" / "depth").iterdir())) == 8
    assert not (place / "out" / "points.ply").exists()


def test_poses_are_given_and_depth_is_in_their_unit(tisfm_run, film):
    write_kitti("known.txt", film.poses[:COUNT])
    code, _, _ = tisfm_run("reconstruct", "film", *options(film, "--poses", "known.txt"))
    result = tisfm.Reconstruction.load("out")
    assert code == 0
    np.testing.assert_allclose(result.poses, film.poses[:COUNT], atol=1e-6)
    assert depth_error(result.depth(3), film.depth[3]) < 0.15


def test_poses_with_times_go_to_the_frames_nearest_in_time(tisfm_run, film, place):
    (place / "timed").mkdir()
    stamps = 1305031102.0 + 0.04 * np.arange(COUNT)
    for k, stamp in enumerate(stamps):
        (place / "film" / f"f{k}.png").rename(place / "timed" / f"{stamp:.6f}.png")
    # Twice as many poses as frames, each a little late; none for the last frames.
    between = np.repeat(film.poses[: COUNT - 2], 2, axis=0)[:-1]
    between[1::2, :3, 3] += 1
    write_tum("known.txt", between, stamps[0] + 0.003 + 0.02 * np.arange(len(between)))
    options_ = options(film, "--poses", "known.txt", "--depth-of", "keyframes")
    code, _, err = tisfm_run("reconstruct", "timed", *options_)
    result = tisfm.Reconstruction.load("out")
    assert code == 0
    np.testing.assert_allclose(result.poses[:-2], film.poses[: COUNT - 2], atol=1e-6)
    assert np.isnan(result.poses[-2:]).all()
    assert "unrelated, 2 frames: no pose is given within 0.02 s of it" in err


def test_poses_with_times_of_frames_without_go_by_their_order(tisfm_run, film):
    write_tum("known.txt", film.poses[:COUNT], 5.0 + np.arange(COUNT))
    code, _, _ = tisfm_run("reconstruct", "film", *options(film, "--poses", "known.txt"))
    assert code == 0
    np.testing.assert_allclose(
        tisfm.Reconstruction.load("out").poses, film.poses[:COUNT], atol=1e-6
    )
    write_tum("fewer.txt", film.poses[:4], np.arange(4.0))
    code, _, err = tisfm_run("reconstruct", "film", *options(film, "--poses", "fewer.txt"))
    assert_one_line(code, err, "poses are 4 with times, but the 9 frames have no times")


def test_the_unit_is_chosen(tisfm_run, film):
    code, _, _ = tisfm_run("reconstruct", "film", *options(film, "--scale", "0", "8", "2.5"))
    result = tisfm.Reconstruction.load("out")
    assert code == 0
    moved = np.linalg.norm(result.poses[8, :3, 3] - result.poses[0, :3, 3])
    assert moved == pytest.approx(2.5)


@pytest.mark.parametrize("scale", [("0", "0", "1"), ("-1", "3", "1"), ("0", "8", "0")])
def test_a_scale_that_says_nothing_is_refused_at_once(tisfm_run, film, place, scale):
    code, _, err = tisfm_run("reconstruct", "film", *options(film, "--scale", *scale))
    assert_one_line(code, err, "--scale is")
    assert not (place / "out").exists()


def test_the_scale_of_a_frame_that_is_not_there(tisfm_run, film, place):
    code, _, err = tisfm_run("reconstruct", "film", *options(film, "--scale", "0", "9", "1"))
    assert_one_line(code, err, "the sequence has 9 frames: expected numbers from 0 to 8")
    assert not (place / "out").exists()


def test_a_wrong_scale_of_a_source_of_unknown_length_loses_nothing(
    tisfm_run, film, place, monkeypatch
):
    monkeypatch.setattr("tisfm.cli.reconstruct._count", lambda source, frames: None)
    code, _, err = tisfm_run("reconstruct", "film", *options(film, "--scale", "0", "9", "1"))
    told, last = err.splitlines()
    assert "9 of 9 frames have a pose" in told
    assert_one_line(code, last + "\n", "frame is 9: expected 0 to 8")
    assert np.isfinite(read_kitti("out/poses.txt").poses).all()


def test_a_mesh_that_cannot_be_made_is_refused_at_once(tisfm_run, film, place, monkeypatch):
    monkeypatch.setitem(sys.modules, "skimage", None)
    code, _, err = tisfm_run("reconstruct", "film", *options(film, "--mesh", "ply"))
    assert_one_line(code, err, "scikit-image")
    assert not (place / "out").exists()


def test_a_mask_leaves_pixels_out(tisfm_run, film, place):
    mask = np.full(film.frames[0].shape, 255, np.uint8)
    mask[150:] = 0
    cv2.imwrite("mask.png", mask)
    assert tisfm_run("reconstruct", "film", *options(film, "--mask", "mask.png"))[0] == 0
    assert len(tisfm.Reconstruction.load("out")) == COUNT


def test_what_has_no_depth_is_told(tisfm_run, film, place):
    for k in range(COUNT):
        cv2.imwrite(str(place / "film" / f"f{k}.png"), film.frames[0])
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
def test_faults_are_one_line(tisfm_run, film, place, arguments, words):
    code, _, err = tisfm_run("reconstruct", *arguments, *options(film))
    assert code == 1
    assert_one_line(code, err, words)
    assert not (place / "out" / "reconstruction.json").exists()


def test_poses_of_another_number_are_refused(tisfm_run, film):
    write_kitti("known.txt", along(3))
    code, _, err = tisfm_run("reconstruct", "film", *options(film, "--poses", "known.txt"))
    assert code == 1
    assert_one_line(code, err, "poses are 3")


def test_other_files_stay(tisfm_run, film, place):
    (place / "out").mkdir()
    (place / "out" / "letter.txt").write_text("dear")
    code, _, err = tisfm_run("reconstruct", "film", *options(film))
    assert code == 1
    assert_one_line(code, err, "letter.txt")
    assert (place / "out" / "letter.txt").read_text() == "dear"


def test_poses_in_the_folder_stay(tisfm_run, film, place):
    (place / "out").mkdir()
    write_kitti("out/poses.txt", film.poses)
    code, _, err = tisfm_run("reconstruct", "film", *options(film, "--poses", "out/poses.txt"))
    assert code == 1
    assert_one_line(code, err, "lies in out")
    assert len(read_kitti("out/poses.txt").poses) == COUNT


@pytest.mark.parametrize("name", ["out", "out/camera.json"])
def test_a_camera_in_the_folder_stays(tisfm_run, film, place, name):
    (place / "out").mkdir()
    write_camera("out/camera.json", film.camera, (180, 240))
    code, _, err = tisfm_run("reconstruct", "film", "-o", "out", "--camera", name)
    assert_one_line(code, err, "lies in out")
    assert read_camera("out") == film.camera


def test_without_a_source_it_says_what_to_give(tisfm_run):
    code, _, err = tisfm_run("reconstruct", "-o", "out")
    assert code == 1
    assert_one_line(code, err, "SOURCE is missing")


def test_another_command_is_refused_while_points_are_fused(tisfm_run, film, place, monkeypatch):
    """The other one would put aside what is being fused."""
    seen = []

    def points(result):
        def other():
            with pytest.raises(FolderInUseError), locked_folder(place / "out"):
                seen.append("entered")
            seen.append("refused")

        thread = threading.Thread(target=other)
        thread.start()
        thread.join()
        return original(result)

    original = Reconstruction.points
    monkeypatch.setattr(Reconstruction, "points", points)
    code, _, err = tisfm_run("reconstruct", "film", *options(film, "--ply"))
    assert code == 0, err
    assert seen == ["refused"]
    assert not (place / "out" / ".tisfm.lock").exists()
