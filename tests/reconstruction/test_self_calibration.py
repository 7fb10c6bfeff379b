"""The estimated focal length of unknown cameras, and the trust in it."""

import json
import math
import re
import warnings
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from PIL import ExifTags, Image

import tisfm
from tests.draws import nightly_except
from tests.reconstruction.films import along, path_error
from tests.rendered import room_film
from tisfm import Camera, Reconstruction, Settings
from tisfm.camera_file import read_camera, write_camera
from tisfm.cli.command_line import main
from tisfm.focal_guess import FocalGuess, GuessedFocalWarning
from tisfm.formats import FormatError
from tisfm.lens import undistort
from tisfm.reconstruction.calibration import self_calibration
from tisfm.reconstruction.calibration.source_camera import make_calibration
from tisfm.reconstruction.mapping.solution import FocalEstimate
from tisfm.reconstruction.result.calibration import GIVEN, Calibration, as_json
from tisfm.rigid import pose_matrix

FAST = Settings.preset("fast", motion="camera")
SIZE = 180, 240
TILTED = Camera(distortion=(0.0,) * 12 + (0.1, 0.0))


@cache
def arc(count=10, size=SIZE, focal=None):
    """Return a film of a camera on an arc around the scene, with tilt and roll."""
    poses = []
    for at in np.linspace(-1, 1, count):
        waving = np.sin(3 * at)
        twist = 0.8 * at, 0.15 * waving, 0.3 * at**2, 0.1 * waving, -0.35 * at, 0.3 * at
        poses.append(pose_matrix(twist))
    return room_film(np.array(poses), *size, samples=2, focal=focal)


@cache
def straight():
    """Return a film of a camera that moves sideways without turning."""
    return room_film(along(8, (0.12, 0, 0, 0, 0, 0)), *SIZE, samples=1)


@cache
def through_a_lens(radial):
    """Return frames of the arc through a lens with one radial coefficient, and the larger film.

    They are cut out of a larger film, because barrel distortion shows more than a pinhole.
    """
    wide = arc(size=(240, 320), focal=144.0)
    height, width = SIZE
    x, y = np.meshgrid(np.arange(width) - (width - 1) / 2, np.arange(height) - (height - 1) / 2)
    places = np.stack([x, y], axis=-1).reshape(-1, 1, 2)
    matrix = np.diag([144.0, 144.0, 1.0])
    straight = cv2.undistortPoints(places, matrix, np.array([radial, 0, 0, 0]), P=matrix)
    u, v = (straight[:, 0].T + np.array([[159.5], [119.5]])).reshape(2, height, width)
    frames = [
        cv2.remap(frame, u.astype(np.float32), v.astype(np.float32), cv2.INTER_CUBIC)
        for frame in wide.frames
    ]
    return np.stack(frames), wide


def few():
    """Return three frames of the arc."""
    return replace(arc(), frames=arc().frames[:3])


def path_of(film, **options):
    return tisfm.reconstruct(film.frames, settings=FAST, depth_of="none", **options)


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # the focal length is determined: no warning is due
        return path_of(arc(), folder=tmp_path_factory.mktemp("found"))


def test_focal_length_is_estimated(found):
    true = arc().camera.focal
    assert abs(found.camera.focal - true) < 0.03 * true
    assert found.calibration.origin == "estimated" and found.calibration.seen
    assert 0 < found.calibration.focal_std < 0.05 * true
    assert abs(found.camera.focal - true) < 3 * found.calibration.focal_std
    assert "estimated from the sequence" in found.calibration.message


def test_path_is_as_good_as_with_the_focal_length_given(found):
    film = arc()
    given = path_of(film, camera=film.camera)
    shape = film.frames[0].shape
    assert given.calibration == replace(GIVEN, focal=film.camera.focal, shape=shape)
    assert (found.piece == 0).all()
    error = path_error(found.poses, film.poses)
    assert error < 1.5 * path_error(given.poses, film.poses) + 0.001


def test_calibration_is_saved(found, tmp_path):
    found.save(tmp_path)
    again = Reconstruction.load(tmp_path)
    assert again.calibration == found.calibration and again.camera == found.camera
    for folder in (found.folder, tmp_path):
        assert read_camera(folder).focal == pytest.approx(found.camera.focal, rel=1e-12)
    about = json.loads((tmp_path / "camera.json").read_text())
    assert (about["height"], about["width"]) == SIZE
    assert about["focal_std"] == found.calibration.focal_std and about["origin"] == "estimated"
    assert about["focal"] == found.calibration.focal and found.calibration.shape == SIZE


def test_record_may_have_unknown_fields_but_needs_a_calibration(found, tmp_path):
    found.save(tmp_path)
    record = json.loads((tmp_path / "reconstruction.json").read_text())
    record["calibration"]["later"] = "something"
    (tmp_path / "reconstruction.json").write_text(json.dumps(record))
    assert Reconstruction.load(tmp_path).calibration == found.calibration
    del record["calibration"]
    (tmp_path / "reconstruction.json").write_text(json.dumps(record))
    with pytest.raises(FormatError, match="calibration"):
        Reconstruction.load(tmp_path)


@pytest.mark.nightly  # test_reconstruct.py does the same with a given camera
def test_same_focal_length_every_time(found):
    again = path_of(arc())
    np.testing.assert_array_equal(again.poses, found.poses)
    assert again.calibration == found.calibration


@pytest.mark.nightly
@pytest.mark.parametrize("times", nightly_except(2.0, of=[0.5, 2.0]))
def test_given_focal_length_may_be_a_guess(times):
    film = arc()
    guess = Camera(focal=times * film.camera.focal, center=film.camera.center)
    result = path_of(film, camera=guess, calibrate="focal")
    assert result.camera.focal == pytest.approx(film.camera.focal, rel=0.03)


@pytest.mark.nightly
def test_printed_focal_length_can_be_copied_back(tmp_path, capsys):
    """It refers to the frames of the source, also if frames are shrunk."""
    film, command = arc(), ["reconstruct", str(tmp_path / "film"), "--preset", "fast"]
    command += ["--size", "192", "--depth-of", "none", "-o"]
    (tmp_path / "film").mkdir()
    for k, frame in enumerate(film.frames):
        cv2.imwrite(str(tmp_path / "film" / f"{k:02d}.png"), frame)
    assert main([*command, str(tmp_path / "found")]) == 0
    told = re.search(
        r"focal length: (\S+) ± (\S+) px \(at 240×180\), estimated", capsys.readouterr().err
    )
    printed, deviation = map(float, told.groups())
    found = Reconstruction.load(tmp_path / "found")
    assert printed == pytest.approx(film.camera.focal, rel=0.03)
    assert printed == pytest.approx(found.camera.focal / 0.8, rel=1e-3)
    written = read_camera(tmp_path / "found", SIZE)
    assert written.focal == pytest.approx(found.camera.focal / 0.8, rel=1e-9)
    # Files, messages and the result have the same unit.
    about = json.loads((tmp_path / "found" / "camera.json").read_text())
    record = json.loads((tmp_path / "found" / "reconstruction.json").read_text())
    for stated in (about, record["calibration"], vars(found.calibration)):
        assert stated["focal"] == pytest.approx(printed, rel=1e-3)
        assert stated["focal_std"] == pytest.approx(deviation, rel=0.5)
        assert stated["focal_std"] == found.calibration.focal_std
        assert f"{told[1]} ± {told[2]} px (at 240×180)" in stated["message"]
    assert (about["height"], about["width"]) == found.calibration.shape == SIZE
    assert main([*command, str(tmp_path / "given"), "--focal", told[1]]) == 0
    given = Reconstruction.load(tmp_path / "given")
    assert given.camera.focal == pytest.approx(found.camera.focal, rel=1e-3)
    assert path_error(given.poses, found.poses) < 3e-3  # measured: 0.002, from two rounded paths
    # The report has the same numbers.
    assert main(["report", str(tmp_path / "found")]) == 0
    page = (tmp_path / "found" / "report.html").read_text(encoding="utf-8")
    assert f"{told[1]} ± {told[2]} px (at 240×180), estimated" in page


def test_written_lens_is_the_lens_that_was_removed(tmp_path):
    film = arc()
    lens = (0.02, 0.0, 0.001, 0.0)
    guess = Camera(focal=1.5 * film.camera.focal, distortion=lens)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", GuessedFocalWarning)
        result = path_of(film, camera=guess, calibrate="focal", folder=tmp_path)
    assert result.calibration.origin == "estimated"
    written = read_camera(tmp_path, SIZE)
    assert written.focal == pytest.approx(result.camera.focal, rel=1e-12)
    frame = film.frames[3]
    before, after = (undistort(frame, camera).astype(float) for camera in (guess, written))
    assert np.abs(before - after).max() <= 1  # rounding
    assert written.distortion != lens


def test_motion_that_does_not_show_the_focal_length_gives_a_warning():
    with pytest.warns(GuessedFocalWarning, match="motion") as caught:
        result = path_of(straight())
    assert not result.calibration.seen and len(caught) == 1
    assert result.calibration.focal_std > 0.05 * result.camera.focal
    assert np.isfinite(result.poses).all()


@pytest.mark.parametrize(
    ("name", "answer"),
    [
        ("_find_start_focal", None),
        pytest.param("_calibrate_part", (-100.0, 0.0), marks=pytest.mark.nightly),
    ],
)
def test_guess_stays_if_no_adjustment_succeeds(monkeypatch, name, answer):
    monkeypatch.setattr(self_calibration, name, lambda *_: answer)
    film = arc()
    with pytest.warns(GuessedFocalWarning, match="motion does not show") as caught:
        result = tisfm.reconstruct(film.frames[:6], settings=FAST, depth_of="none")
    assert len(caught) == 1  # and no message about a missing path
    assert result.camera.focal == 1.2 * SIZE[1]
    assert (result.piece == 0).any()


@pytest.mark.parametrize("spread", [0.01, 0.03])
def test_deviation_is_a_share_of_the_spread_of_the_parts(monkeypatch, spread):
    parts = iter([(100 * math.exp(sign * spread), sign * 0.002) for sign in (1, -1) * 3])
    for name, answer in (
        ("_focal_and_radial", lambda model: (100.0, 0.0)),
        ("_split", lambda *_: [None] * 6),
        ("_calibrate_part", lambda *_: next(parts)),
    ):
        monkeypatch.setattr(self_calibration, name, answer)
    found = self_calibration._estimate_focal(None, Camera(), SIZE, "radial")
    share = self_calibration.CALIBRATION.spread_to_deviation
    shared = self_calibration.CALIBRATION.shared_deviation
    assert found.deviation == pytest.approx(100 * math.hypot(share * spread, shared))
    assert found.radial_deviation == pytest.approx(share * 0.002)


@pytest.mark.parametrize(("first", "best"), [(0.4, 0.6), (0.55, 0.55), (0.0, 0.6)])
def test_path_that_explains_little_is_begun_with_another_focal_length(first, best):
    """Focal lengths of 100, 42 and 240 px have scores of 0.45, 0.6 and 0.3."""
    scores = {90.0: first, 100.0: 0.45, 42.0: 0.6, 240.0: 0.3}

    def grown(camera, calibrate):
        score = scores[round(camera.focal, 6)]
        lens = SimpleNamespace(params=[camera.focal, 50.0, 40.0])
        return [SimpleNamespace(cameras={1: lens}, score=score)] if score else []

    shared = SimpleNamespace(grow_models=grown, score=lambda found: sum(one.score for one in found))
    (found,) = self_calibration._grow_models(shared, Camera(focal=100.0), 90.0, "focal")
    assert found.score == best


@pytest.mark.parametrize(("scores", "kept"), [([49], True), ([30, 20], False), ([], False)])
def test_models_grown_again_have_to_explain_half_as_much(monkeypatch, scores, kept):
    """The motion hardly determines the focal length, so models are grown again with it.

    Their score is compared with 100. A pure rotation of the camera gives no model.
    """
    again = [SimpleNamespace(score=score) for score in scores]
    models, _ = models_where_the_focal_is_hardly_seen(monkeypatch, again, shows_parallax=True)
    assert models == (["before"] if kept else again)


def test_no_path_if_few_pairs_show_parallax_with_the_focal_length_found(monkeypatch):
    again = [SimpleNamespace(score=100)]
    found = models_where_the_focal_is_hardly_seen(monkeypatch, again, shows_parallax=False)
    assert found == ([], None)


def models_where_the_focal_is_hardly_seen(monkeypatch, again, *, shows_parallax):
    """Return models and focal length; `again` are the models grown again with this focal length."""
    shared = SimpleNamespace(
        make_models=lambda *_: ["before"],
        score=lambda _: 0.5,
        match_count=lambda: 200,
        shows_parallax=lambda _: shows_parallax,
    )
    hardly = FocalEstimate(focal=100.0, deviation=10.0)
    for name, answer in (
        ("ViewGraph", SimpleNamespace(from_views=lambda *_, **__: shared)),
        ("_find_start_focal", lambda *_: 100.0),
        ("_grow_models", lambda *_: ["before"]),
        ("_adjust", lambda *_: None),
        ("_estimate_focal", lambda *_: hardly),
        ("find_models", lambda *_, **__: again),
    ):
        monkeypatch.setattr(self_calibration, name, answer)
    return self_calibration.find_models_and_focal(
        [], {}, Camera(focal=90.0), SIZE, "focal", max_deviation=0.3
    )


def test_warning_of_a_guess_comes_before_depth():
    stages = []
    with warnings.catch_warnings(), pytest.raises(GuessedFocalWarning):
        warnings.simplefilter("error")
        tisfm.reconstruct(
            arc().frames[:6],
            settings=FAST,
            calibrate="nothing",
            progress=lambda stage, done, total: stages.append(stage),
        )
    assert set(stages) == {"reading", "path"}


@pytest.mark.nightly
def test_rotation_alone_gives_no_path():
    turning = room_film(along(6, (0, 0, 0, 0, 0.03, 0)), *SIZE, samples=1)
    with pytest.warns(GuessedFocalWarning):
        result = path_of(turning)
    assert (result.piece == -1).all()


def with_exif(folder):
    """Write the straight film with a focal length in EXIF; return that focal length in px."""
    exif = Image.Exif()
    exif.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.FocalLengthIn35mmFilm] = 26
    for k, frame in enumerate(straight().frames):
        Image.fromarray(frame).save(folder / f"{k:02d}.jpg", quality=98, exif=exif)
    return pytest.approx(26 / np.hypot(36, 24) * np.hypot(*SIZE))


def test_focal_length_of_exif_is_better_than_an_uncertain_estimate(tmp_path):
    stated = with_exif(tmp_path)
    with pytest.warns(GuessedFocalWarning, match="26 mm"):
        result = tisfm.reconstruct(tmp_path, settings=FAST, depth_of="none")
    assert result.calibration.origin == "guessed" and result.camera.focal == stated


@pytest.mark.nightly
def test_stream_takes_the_focal_length_of_exif(tmp_path):
    stated = with_exif(tmp_path)
    with pytest.warns(GuessedFocalWarning, match="26 mm"):
        first = next(tisfm.reconstruct_stream(tmp_path, settings=FAST))
    assert first.calibration.origin == "guessed" and first.camera.focal == stated


def test_guess_stays_without_a_path():
    still = np.stack([arc().frames[0]] * 4)
    with pytest.warns(GuessedFocalWarning, match="no path was found"):
        result = tisfm.reconstruct(still, settings=FAST)
    assert result.camera.focal == 1.2 * SIZE[1]
    assert result.calibration.origin == "guessed"
    assert json.loads((result.folder / "camera.json").read_text())["focal_std"] is None


def test_guess_stays_with_given_poses():
    film = arc()
    with pytest.warns(GuessedFocalWarning, match="guess"):
        result = tisfm.reconstruct(
            film.frames[:4], settings=FAST, poses=film.poses[:4], depth_of="keyframes"
        )
    assert result.calibration.origin == "guessed"


@pytest.mark.parametrize("radial", nightly_except(-0.1, of=[-0.1, 0.1]))
def test_radial_coefficient_is_estimated_and_removed(radial, tmp_path):
    frames, wide = through_a_lens(radial)
    result = tisfm.reconstruct(
        frames, settings=FAST, calibrate="radial", depth_of="keyframes", folder=tmp_path
    )
    assert (result.piece == 0).all()
    assert result.camera.focal == pytest.approx(144, rel=0.05) and result.camera.is_pinhole
    assert result.calibration.radial == pytest.approx(radial, abs=0.04)
    assert 0 < result.calibration.radial_std < 0.1
    assert f"k1 = {result.calibration.radial:.3f}" in result.calibration.message
    assert read_camera(tmp_path).distortion == (result.calibration.radial, 0, 0, 0)
    assert path_error(result.poses, wide.poses) < 0.01
    # Pictures are those of a pinhole: the middle of the larger film.
    picture = result.picture(3).astype(float)
    off = np.abs(picture - wide.frames[3, 30:-30, 40:-40])[5:-5, 5:-5]
    distorted = np.abs(frames[3].astype(float) - wide.frames[3, 30:-30, 40:-40])[5:-5, 5:-5]
    assert np.median(off) < 0.6 * np.median(distorted)
    assert np.isfinite(result.depth(result.keyframes[0])).all()


@pytest.mark.parametrize("radial", nightly_except(0.2, of=[-0.2, 0.2]))
def test_distorting_lens_gives_a_warning(radial):
    frames, _ = through_a_lens(radial)
    with pytest.warns(GuessedFocalWarning, match="lens seems to distort"):
        result = tisfm.reconstruct(frames, settings=FAST, calibrate="focal", depth_of="none")
    assert not result.calibration.seen
    assert abs(result.camera.focal - 144) < 3 * result.calibration.focal_std


@pytest.mark.nightly
def test_lens_without_distortion_has_coefficient_zero():
    result = path_of(arc(), calibrate="radial")
    assert abs(result.calibration.radial) < 3 * result.calibration.radial_std + 0.01
    assert result.camera.focal == pytest.approx(arc().camera.focal, rel=0.05)


def test_streams_refuse_to_estimate_distortion():
    with pytest.raises(ValueError, match="whole sequence"):
        tisfm.reconstruct_stream(arc().frames, settings=FAST, calibrate="radial")


def test_stream_estimates_the_focal_length_once():
    frames = list(tisfm.reconstruct_stream(arc().frames, settings=FAST, delay=8))
    focals = {frame.camera.focal for frame in frames}
    assert len(frames) == len(arc().frames) and len(focals) == 1
    assert focals.pop() == pytest.approx(arc().camera.focal, rel=0.05)
    assert all(frame.calibration.origin == "estimated" for frame in frames)


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"calibrate": "lens"}, "calibrate is 'lens'"),
        ({"calibrate": "focal", "poses": along(10)}, "poses are given"),
        ({"calibrate": "radial", "poses": along(10)}, "poses are given"),
        ({"calibrate": "radial", "camera": Camera(distortion=(0.1, 0, 0, 0))}, "has distortion"),
        ({"calibrate": "focal", "camera": TILTED}, "tilted sensor"),
    ],
)
def test_wrong_arguments_are_refused(options, text):
    with pytest.raises(ValueError, match=text):
        tisfm.reconstruct(arc().frames, settings=FAST, **options)


CAMERA = Camera(focal=100.0)
GUESS = FocalGuess(focal=200.0, origin="size", reason="by its size", shape=(300, 400))


@pytest.mark.parametrize(
    ("deviation", "origin", "seen", "text"),
    [
        (2.0, "estimated", True, r"^100 ± 4 px \(at 400×300\), estimated"),
        (3.0, "estimated", False, "hardly shows it"),
        (16.0, "guessed", False, r"200 px \(at 400×300\), by its size: the motion does not show"),
    ],
)
def test_message_of_an_estimate(deviation, origin, seen, text):
    """Frames are shrunk to half; focal lengths are in px of the frames of the source."""
    estimate = FocalEstimate(focal=50.0, deviation=deviation)
    camera = estimate.apply_to(CAMERA)
    assert camera.focal == (100 if origin == "guessed" else 50)
    shape, focal = (300, 400), 2 * camera.focal
    told = make_calibration(estimate, GUESS, camera, is_estimated=True, focal=focal, shape=shape)
    assert (told.origin, told.seen) == (origin, seen)
    assert (told.focal, told.shape) == (focal, shape)
    assert told.focal_std == (math.inf if origin == "guessed" else 2 * deviation)
    assert re.search(text, told.message)


@pytest.mark.parametrize(
    "changes",
    [
        {"origin": "known"},
        {"focal_std": -1.0},
        {"focal_std": math.inf},
        {"focal": 0.0},
        {"shape": (0, 4)},
        {"shape": (4, 4, 3)},
    ],
)
def test_impossible_calibrations_are_refused(changes):
    with pytest.raises(ValueError, match=next(iter(changes))):
        Calibration(**{"origin": "estimated", **changes})


def test_camera_file_keeps_its_calibration(found, tmp_path):
    """Three frames suffice, because the focal length is not estimated again."""
    again = path_of(few(), camera=found.folder, folder=tmp_path / "again")
    assert again.calibration == found.calibration and again.camera == found.camera
    assert json.loads((tmp_path / "again" / "camera.json").read_text())["origin"] == "estimated"
    with pytest.raises(ValueError, match="the output folder"):
        path_of(few(), camera=tmp_path / "again", folder=tmp_path / "again")


def test_guess_in_a_camera_file_stays_a_guess(tmp_path):
    height, width = SIZE
    message = "a guess, 9 px (at 480×360)"
    doubt = Calibration(origin="guessed", focal_std=math.inf, seen=False, message=message)
    twice = arc().camera.scaled(2, *SIZE)
    about = as_json(doubt)
    write_camera(tmp_path / "c.json", twice, (2 * height, 2 * width), about=about)
    with pytest.warns(GuessedFocalWarning, match="a guess, 9 px"):
        result = path_of(few(), camera=tmp_path / "c.json")
    focal = arc().camera.focal
    # The message is that of the file.
    assert result.calibration == replace(doubt, focal=focal, shape=SIZE)
    assert result.camera.focal == pytest.approx(focal)
    write_camera(tmp_path / "c.json", arc().camera, SIZE)
    again = path_of(few(), camera=tmp_path / "c.json").calibration
    assert again == replace(GIVEN, focal=focal, shape=SIZE)


def test_invalid_origin_in_a_camera_file_is_refused(tmp_path):
    write_camera(tmp_path / "c.json", arc().camera, SIZE, about={"origin": "a dream"})
    with pytest.raises(FormatError, match="a dream"):
        path_of(few(), camera=tmp_path / "c.json")
