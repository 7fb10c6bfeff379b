"""What is measured of a model of COLMAP, on one whose errors are known."""

import numpy as np
import pycolmap
import pytest

from bench.sequences.colmap_model import bars, figures, report

FOCAL, SIZE = 100.0, 200
NEXT, LATER = np.array([0.5, 0, 0]), np.array([1.0, 0, 0])
ERROR = "median reprojection error, px"


def model(tmp_path, off):
    """Return three cameras beside one another that see 24 points, each place `off` px too low."""
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform(-1, 1, (24, 2)), rng.uniform(4, 6, 24)])
    made = pycolmap.Reconstruction()
    camera = pycolmap.Camera(
        model="PINHOLE", width=SIZE, height=SIZE, params=[FOCAL, FOCAL, SIZE / 2, SIZE / 2],
        camera_id=1,
    )  # fmt: skip
    made.add_camera_with_trivial_rig(camera)
    for number, place in enumerate((np.zeros(3), NEXT, LATER), start=1):
        seen = points - place
        shown = FOCAL * seen[:, :2] / seen[:, 2:] + SIZE / 2
        if number == 2:
            shown[:, 1] += off
        image = pycolmap.Image(name=f"{number}.png", camera_id=1, image_id=number, keypoints=shown)
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(), -place)
        made.add_image_with_trivial_frame(image, pose)
    for index, point in enumerate(points):
        frames = (1, 2, 3) if index % 2 == 0 else (1, 2)
        track = pycolmap.Track([pycolmap.TrackElement(number, index) for number in frames])
        made.add_point3D(point, track)
    made.write(str(tmp_path))
    return pycolmap.Reconstruction(str(tmp_path))


def test_a_model_without_errors(tmp_path):
    found = figures(model(tmp_path, off=0.0))
    assert found["images"] == 3 and found["points"] == 24
    assert found["least tracks of 3 frames in an image"] == 12
    assert found[ERROR] < 1e-3 and found["points that cannot be triangulated again"] == 0


def test_wrong_positions_are_measured(tmp_path):
    found = figures(model(tmp_path, off=1.0))
    # Seen thrice, 1/3 px too low twice and 2/3 once; seen twice, half a pixel twice.
    assert found[ERROR] == pytest.approx(0.42, abs=0.1)


def test_bars_are_held(tmp_path):
    found = figures(model(tmp_path, off=0.0))
    held = bars(found, 3)
    assert [bar.is_met for bar in held] == [False, False, True, True]
    text = report(found, held, {"preset": "fast"})
    assert "- preset: fast" in text and "| points | 24 |" in text
    assert "FAIL  points" in text
