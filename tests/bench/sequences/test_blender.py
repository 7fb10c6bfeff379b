"""How far Blender is from a reconstruction, where it is known."""

import numpy as np
import pytest

from bench.sequences.blender import BARS, differences, report
from tests.view.results import write_reconstruction
from tisfm.formats.srgb import linear_from_srgb
from tisfm.reconstruction.result.reconstruction import Reconstruction

FRAMES = (0, 2)


@pytest.fixture
def result(tmp_path):
    write_reconstruction(tmp_path / "r", 3, changes={"keyframes": (0, 1, 2)})
    return Reconstruction.load(tmp_path / "r")


def as_in_blender(result):
    """Return what Blender would have of a reconstruction: Z up, cameras that look along −Z."""
    cloud = result.points()
    height, width = result.shape
    focal, (cx, cy) = result.camera.focal, result.camera.center_for(height, width)
    poses, places = [], []
    for pose in result.poses[list(FRAMES)]:
        (right, down, ahead), center = pose[:3, :3].T, pose[:3, 3]
        axes = [(x, z, -y) for x, y, z in (right, -down, -ahead, center)]
        poses.append(np.vstack([np.transpose(axes), (0, 0, 0, 1)]))
        x, y, z = ((cloud.positions - center) @ pose[:3, :3]).T
        across, down = (focal * x / z + cx + 0.5) / width, (focal * y / z + cy + 0.5) / height
        places.append(np.stack([across, 1 - down, z], axis=1))
    light = linear_from_srgb()[cloud.colors]
    return {
        "points": np.arange(len(cloud)),
        "poses": np.array(poses),
        "positions": np.array(places),
        "colors": np.column_stack([light, np.ones(len(cloud))]),
        "angle": np.array(2 * np.arctan(height / 2 / focal)),
    }


def test_equal_models_have_no_difference(result):
    found = differences(result, as_in_blender(result), FRAMES)
    assert list(found) == list(BARS) and max(found.values()) < 1e-4


@pytest.mark.parametrize(
    ("name", "change", "quantity", "expected"),
    [
        ("positions", lambda seen: seen + np.array((1 / 61, 0, 0)), "of points, px", 1.0),
        ("positions", lambda seen: seen - np.array((0, 2 / 45, 0)), "of points, px", 2.0),
        ("positions", lambda seen: seen * (1, 1, -1), "of points, px", np.inf),
        ("poses", lambda seen: seen @ turned(0.3), "of its rotation, deg", 0.3),
        ("poses", lambda seen: seen @ turned(180), "of its rotation, deg", 180.0),
        ("angle", lambda seen: seen + np.radians(0.5), "of its vertical angle, deg", 0.5),
    ],
)
def test_each_difference_is_measured(result, name, change, quantity, expected):
    seen = as_in_blender(result)
    seen[name] = change(seen[name])
    assert differences(result, seen, FRAMES)[quantity] == pytest.approx(expected, rel=1e-3)


def test_positions_are_measured_over_the_extent_of_the_path(result):
    seen = as_in_blender(result)
    extent = np.linalg.norm(np.ptp(result.poses[list(FRAMES), :3, 3], axis=0))
    seen["poses"][1, 2, 3] += 0.1 * extent
    found = differences(result, seen, FRAMES)
    assert found["of the camera's position, share of the path's extent"] == pytest.approx(0.1)


def test_colours_are_compared_as_codes(result):
    seen = as_in_blender(result)
    seen["colors"][:, :3] = linear_from_srgb()[result.points().colors - 1]  # none of them is 0
    found = differences(result, seen, FRAMES)
    assert found["of their colours, of 255"] == pytest.approx(1, abs=1e-3)


def test_the_table_has_all_cases_and_bars():
    found = dict.fromkeys(BARS, 0.5)
    text = report({"one": found, "two": found}, {"Blender": "5.0"})
    assert "- Blender: 5.0" in text and "| | one | two | bar |" in text
    assert text.count("| 0.5 | 0.5 |") == len(BARS)


def turned(degrees):
    """Return a rotation about an axis that is no axis of the camera, (4, 4)."""
    from scipy.spatial.transform import Rotation

    matrix = np.eye(4)
    axis = np.array((0.6, 0.8, 0))
    matrix[:3, :3] = Rotation.from_rotvec(np.radians(degrees) * axis).as_matrix()
    return matrix
