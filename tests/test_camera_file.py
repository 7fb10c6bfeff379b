"""Cameras as files."""

import json

import pytest

from tisfm import Camera
from tisfm.camera_file import read_camera, write_camera
from tisfm.formats import FormatError

LENS = Camera(focal=(500.0, 520.0), center=(321.5, 238.0), distortion=(-0.3, 0.1, 0.001, 0.0))


@pytest.mark.parametrize("camera", [Camera(focal=500.0), LENS])
def test_written_cameras_are_read(camera, tmp_path):
    write_camera(tmp_path / "c.json", camera, (480, 640))
    assert read_camera(tmp_path / "c.json") == camera
    assert read_camera(tmp_path / "c.json", (480, 640)) == camera


def test_a_folder_has_its_camera(tmp_path):
    write_camera(tmp_path / "camera.json", LENS, (480, 640), {"origin": "estimated", "focal": 1})
    assert read_camera(tmp_path) == LENS
    assert json.loads((tmp_path / "camera.json").read_text())["origin"] == "estimated"


def test_frames_may_be_shrunk_or_enlarged(tmp_path):
    write_camera(tmp_path / "c.json", LENS, (480, 640))
    half = read_camera(tmp_path / "c.json", (240, 320))
    assert half == LENS.scaled(0.5, 480, 640)
    write_camera(tmp_path / "c.json", Camera(focal=500.0), (480, 640))
    assert read_camera(tmp_path / "c.json", (960, 1280)) == Camera(focal=1000.0)
    assert read_camera(tmp_path / "c.json", (241, 320)).focal == 250  # rounded


def test_frames_of_another_shape_are_refused(tmp_path):
    write_camera(tmp_path / "c.json", LENS, (480, 640))
    with pytest.raises(ValueError, match="640×480 px, not of 640×640"):
        read_camera(tmp_path / "c.json", (640, 640))


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        "{}",
        "1" * 5000,
        "[" * 100_000,
        '{"format": 3}',
        '{"format": 2, "height": 0, "width": 1, "focal": 1, "center": null, "distortion": null, '
        '"aspect": 1}',
        '{"format": 2, "height": 4, "width": 4, "focal": -1, "center": null, "distortion": null, '
        '"aspect": 1}',
        '{"format": 2, "height": 4, "width": 4, "focal": 1, "center": 3, "distortion": null, '
        '"aspect": 1}',
    ],
)
def test_damaged_files_are_refused(text, tmp_path):
    (tmp_path / "c.json").write_text(text)
    with pytest.raises(FormatError, match=r"c\.json is not a camera"):
        read_camera(tmp_path / "c.json")


def test_missing_files_are_reported(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"camera\.json"):
        read_camera(tmp_path)


@pytest.mark.parametrize(
    ("camera", "shape", "error"),
    [("600", (4, 4), TypeError), (LENS, (0, 4), ValueError), (LENS, (4, 4, 3), ValueError)],
)
def test_impossible_cameras_are_not_written(camera, shape, error, tmp_path):
    with pytest.raises(error):
        write_camera(tmp_path / "c.json", camera, shape)
    assert not list(tmp_path.iterdir())


def test_a_file_of_an_earlier_format_is_refused_with_advice(tmp_path):
    """Its deviation was in px of shrunk frames."""
    path = tmp_path / "c.json"
    write_camera(path, LENS, (4, 4))
    path.write_text(path.read_text().replace('"format": 2', '"format": 1'))
    with pytest.raises(FormatError, match="of format 1, this version reads 2: make it anew"):
        read_camera(path)
