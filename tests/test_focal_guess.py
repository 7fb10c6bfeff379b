"""The guessed focal length: EXIF data of several kinds, and what is done without them."""

import math
import warnings

import cv2
import numpy as np
import pytest
from PIL import ExifTags, Image
from PIL.TiffImagePlugin import IFDRational

import tisfm
from tisfm.focal_guess import GuessedFocalWarning, guess_camera, guess_focal
from tisfm.formats import FormatError, read_image, write_png
from tisfm.rigid import pose_matrix
from tisfm.scenes import room_film

H, W = 24, 36  # of the shape of film, where the diagonal makes no difference
FILM, LENGTH = ExifTags.Base.FocalLengthIn35mmFilm, ExifTags.Base.FocalLength
RESOLUTION, UNIT = ExifTags.Base.FocalPlaneXResolution, ExifTags.Base.FocalPlaneResolutionUnit
WIDTH, HEIGHT = ExifTags.Base.ExifImageWidth, ExifTags.Base.ExifImageHeight


def picture(path, tags, *, height=H, width=W, orientation=None):
    exif = Image.Exif()
    exif[ExifTags.IFD.Exif] = tags
    if orientation is not None:
        exif[ExifTags.Base.Orientation] = orientation
    Image.fromarray(np.zeros((height, width), np.uint8)).save(path, exif=exif.tobytes())
    return path


def test_film_stands_for_the_diagonal(tmp_path):
    guess = guess_focal(picture(tmp_path / "a.jpg", {FILM: 50}, height=30, width=40))
    assert guess.focal == pytest.approx(50 / math.hypot(24, 36) * 50)
    assert guess.origin == "exif" and "50 mm in terms of 35 mm film" in guess.reason


@pytest.mark.parametrize("orientation", [None, 1, 3, 6, 8])
def test_the_size_is_that_of_the_picture_upright(tmp_path, orientation):
    path = picture(tmp_path / "a.jpg", {FILM: 50}, height=30, width=40, orientation=orientation)
    assert guess_focal(path).shape == read_image(path).shape[:2]
    assert guess_focal((30, 40, 3)).shape == (30, 40)


@pytest.mark.parametrize("suffix", ["jpg", "png", "tif", "webp"])
def test_every_format_that_has_exif(tmp_path, suffix):
    assert guess_focal(picture(tmp_path / f"a.{suffix}", {FILM: 28})).focal == pytest.approx(28)
    assert guess_focal(str(tmp_path / f"a.{suffix}")).origin == "exif"


@pytest.mark.parametrize(
    ("unit", "resolution"), [(2, 254), (None, 254), (3, 100), (4, 10), (5, IFDRational(1, 100))]
)
def test_length_and_resolution(tmp_path, unit, resolution):
    """Ten pixels to a millimetre, whatever the unit; inches where none is given."""
    tags = {LENGTH: IFDRational(9, 2), RESOLUTION: resolution} | (
        {} if unit is None else {UNIT: unit}
    )
    guess = guess_focal(picture(tmp_path / "a.jpg", tags))
    assert guess.focal == pytest.approx(45)
    assert guess.origin == "exif" and "4.5 mm, 10 px/mm" in guess.reason


def test_film_comes_first(tmp_path):
    tags = {FILM: 50, LENGTH: 9, RESOLUTION: 254}
    assert guess_focal(picture(tmp_path / "a.jpg", tags)).focal == pytest.approx(50)


@pytest.mark.parametrize(
    "tags", [{FILM: 50}, {LENGTH: 10, RESOLUTION: 50, UNIT: 4}], ids=["film", "resolution"]
)
@pytest.mark.parametrize(
    ("height", "width", "scale"),
    [
        (240, 360, 1.0),
        (120, 180, 0.5),
        (180, 120, 0.5),  # turned upright
        (120, 120, 0.5),  # and cropped
        (240, 300, 1.0),  # cropped alone
        (480, 720, 2.0),
    ],
)
def test_resized_images(tmp_path, tags, height, width, scale):
    """500 px at 360 × 240, by either way."""
    tags = {**tags, WIDTH: 360, HEIGHT: 240}
    guess = guess_focal(picture(tmp_path / "a.jpg", tags, height=height, width=width))
    assert guess.focal == pytest.approx(500 * scale, rel=1e-3)


def test_orientation_makes_no_difference(tmp_path):
    tags = {FILM: 50, WIDTH: 72, HEIGHT: 48}
    path = picture(tmp_path / "a.jpg", tags, orientation=6)
    assert read_image(path).shape == (W, H)
    assert guess_focal(path).focal == pytest.approx(50)


@pytest.mark.parametrize(
    "tags",
    [
        {},
        {FILM: 0},  # unknown, says the standard
        {FILM: 1},  # a slip of the pen
        {FILM: 60000},
        {LENGTH: 4.5},
        {LENGTH: IFDRational(0), RESOLUTION: 254},
        {LENGTH: 4.5, RESOLUTION: 0},
        {LENGTH: 4.5, RESOLUTION: 254, UNIT: 1},  # of no length
        {LENGTH: 4.5, RESOLUTION: 1e6},
    ],
    ids=str,
)
def test_without_usable_exif_the_size_decides(tmp_path, tags):
    guess = guess_focal(picture(tmp_path / "a.jpg", tags, height=30, width=20))
    assert guess.focal == pytest.approx(36) and guess.origin == "size"
    assert "1.2 times the longer side" in guess.reason


def test_implausible_tags_are_passed_over(tmp_path):
    tags = {FILM: 60000, LENGTH: 4.5, RESOLUTION: 254}
    assert guess_focal(picture(tmp_path / "a.jpg", tags)).focal == pytest.approx(45)


def test_half_a_size_is_none(tmp_path):
    path = picture(tmp_path / "a.jpg", {FILM: 50, WIDTH: 72})
    assert guess_focal(path).focal == pytest.approx(50)


@pytest.mark.filterwarnings("error")
def test_damaged_exif_is_no_error(tmp_path):
    path = picture(tmp_path / "a.jpg", {FILM: 50, LENGTH: 4.5})
    good = path.read_bytes()
    begin = good.index(b"Exif")
    guesses = []
    for position in range(begin, begin + 60):
        data = bytearray(good)
        data[position] ^= 0xFF
        path.write_bytes(data)
        try:
            read_image(path)
        except FormatError:  # the picture itself is refused
            continue
        guesses.append(guess_focal(path))
        assert 0.1 * W <= guesses[-1].focal <= 100 * W
    assert {guess.origin for guess in guesses} == {"exif", "size"} and len(guesses) > 40


def test_files_without_exif(tmp_path):
    write_png(tmp_path / "a.png", np.zeros((30, 20), np.uint8))
    cv2.imwrite(str(tmp_path / "a.hdr"), np.ones((30, 20, 3), np.float32))  # not known to Pillow
    for name in ("a.png", "a.hdr"):
        guess = guess_focal(tmp_path / name)
        assert guess.focal == pytest.approx(36) and guess.origin == "size"


@pytest.mark.parametrize("shape", [(30, 20), (20, 30, 3), [np.int64(30), 20]])
def test_shapes(shape):
    assert guess_focal(shape).focal == pytest.approx(36)


def test_a_guess_comes_with_a_warning(tmp_path):
    path = picture(tmp_path / "a.jpg", {FILM: 50})
    with pytest.warns(
        GuessedFocalWarning, match=r"a guess, 50 px \(at 36×24\), from .*EXIF.*Camera\("
    ) as record:
        assert guess_camera(path) == tisfm.Camera(guess_focal(path).focal)
    assert record[0].filename == __file__
    with pytest.warns(
        GuessedFocalWarning, match=r"a guess, 43 px \(at 36×24\), 1\.2 times the longer side"
    ):
        assert guess_camera((H, W)) == tisfm.Camera(1.2 * W)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        guess_focal(path)


@pytest.mark.parametrize(
    ("source", "error", "words"),
    [
        (3, TypeError, "source is 3: expected the path"),
        (None, TypeError, "expected the path"),
        ((3,), ValueError, r"expected a shape \(H, W\)"),
        ((0, 5), ValueError, r"expected a shape \(H, W\)"),
        ("gone.png", FileNotFoundError, r"gone\.png does not exist"),
    ],
)
def test_sources_that_are_refused(source, error, words):
    with pytest.raises(error, match=words):
        guess_focal(source)


def test_files_that_are_refused(tmp_path):
    (tmp_path / "text.png").write_text("no picture")
    (tmp_path / "empty.png").write_bytes(b"")
    for name in ("text.png", "empty.png"):
        with pytest.raises(FormatError, match=name):
            guess_focal(tmp_path / name)
    with pytest.raises(IsADirectoryError):
        guess_focal(tmp_path)


@pytest.mark.parametrize("focal", [96.0, 144.0])
def test_a_pair_that_turns_and_moves_forward_shows_its_focal_length(focal):
    path = [np.eye(4), pose_matrix([0.06, 0.02, 0.1, 0.024, -0.08, 0.016])]
    film = room_film(path, 120, 160, focal=focal, textured=True)
    settings = tisfm.Settings.preset("fast", motion="camera")
    with pytest.warns(GuessedFocalWarning):
        result = tisfm.interpret(*film.frames, settings=settings)
    assert result.camera.focal == pytest.approx(focal, rel=0.1)  # the guess is 192 px
    assert "The image motion gave the focal length" in result.status.message
    assert result.focal_deviation == np.inf and result.focal_spread < 0.1 and result.grade.is_green


def test_pairs_of_a_sequence_do_not_take_a_guess_as_stated():
    settings = tisfm.Settings.preset("fast", motion="camera")
    path = [np.eye(4)]
    for _ in range(2):
        path.append(path[-1] @ pose_matrix([0.06, 0.02, 0.1, 0.024, -0.08, 0.016]))
    film = room_film(path, 120, 160, focal=96.0, textured=True)
    with pytest.warns(GuessedFocalWarning):
        results = list(tisfm.interpret_sequence(list(film.frames), settings=settings))
    assert results[0].camera.focal == pytest.approx(96, rel=0.1)  # kept for the second pair
    assert results[1].camera == results[0].camera
    plain = room_film(path[:1] * 2, 24, 32).frames  # the guess stays
    with pytest.warns(GuessedFocalWarning):
        still = list(tisfm.interpret_sequence(list(plain), settings=settings))
    for result in (*results, *still):
        assert np.isinf(result.focal_deviation) and "stated focal" not in result.status.message
