"""Points in space: where they lie, which pixels they are of, and the file that keeps them."""

import dataclasses
import io
import subprocess
import sys

import numpy as np
import pytest
import trimesh

import tisfm
from tests.rendered import static_scene
from tisfm.interpretation import Interpretation
from tisfm.point_cloud import PointCloud, point_cloud

VERTEX = np.dtype([("xyz", "<f4", 3), ("rgb", "u1", 3), ("confidence", "<f4")])


@pytest.fixture(scope="module")
def scene():
    return static_scene("sideways+rotation", 45, 62)


def cloud_of(scene, depth=None, *, camera=None, **options):
    """The cloud of a scene's true depth, all pixels alike unless told otherwise."""
    height, width = scene.depth.shape
    arguments = {
        "frame": scene.frame0,
        "confidence": np.ones((height, width), np.float32),
        "occlusion": np.zeros((height, width), bool),
        "max_depth": None,
    }
    depth = scene.depth.astype(np.float32) if depth is None else depth
    return point_cloud(depth, camera or scene.camera, **{**arguments, **options})


def some_cloud(number=5, seed=0):
    random = np.random.default_rng(seed)
    return PointCloud(
        positions=random.normal(size=(number, 3)).astype(np.float32),
        colors=random.integers(0, 256, (number, 3), dtype=np.uint8),
        confidence=random.uniform(size=number).astype(np.float32),
    )


# Geometry


@pytest.mark.parametrize("center", [None, (-3.5, 70.25)])
def test_points_project_to_their_pixels(scene, center):
    camera = tisfm.Camera(scene.camera.focal, center)
    cloud = cloud_of(scene, camera=camera)
    height, width = scene.depth.shape
    cx, cy = camera.center_for(height, width)
    x, y, z = cloud.positions.astype(float).T
    row, column = np.divmod(np.arange(height * width), width)
    np.testing.assert_allclose(camera.focal * x / z + cx, column, atol=1e-4)
    np.testing.assert_allclose(camera.focal * y / z + cy, row, atol=1e-4)
    np.testing.assert_array_equal(z, scene.depth.astype(np.float32).ravel())


def test_points_move_as_the_scene_does(scene):
    """One motion takes the points of the background to where the true flow has them."""
    cloud = cloud_of(scene)
    rotation, translation = tisfm.scenes.rigid_motion(scene.motions[0])
    moved = cloud.positions.astype(float) @ rotation.T + translation
    on = (scene.labels == 0).ravel()
    height, width = scene.depth.shape
    cx, cy = scene.camera.center_for(height, width)
    row, column = np.divmod(np.arange(height * width), width)
    u = scene.camera.focal * moved[:, 0] / moved[:, 2] + cx - column
    v = scene.camera.focal * moved[:, 1] / moved[:, 2] + cy - row
    np.testing.assert_allclose(np.stack([u, v], 1)[on], scene.flow.reshape(-1, 2)[on], atol=1e-4)


def test_axes_point_right_down_and_forward():
    depth = np.full((3, 5), 2, np.float32)
    confidence, occlusion = np.ones((3, 5), np.float32), np.zeros((3, 5), bool)
    frame = np.zeros((3, 5), np.uint8)
    camera = tisfm.Camera(4.0)
    cloud = point_cloud(depth, camera, frame=frame, confidence=confidence, occlusion=occlusion)
    np.testing.assert_array_equal(cloud[0], (-1, -0.5, 2))
    np.testing.assert_array_equal(cloud[7], (0, 0, 2))
    np.testing.assert_array_equal(cloud[14], (1, 0.5, 2))


@pytest.mark.parametrize("channels", [1, 3])
def test_colours_and_confidence_go_with_their_points(scene, channels):
    random = np.random.default_rng(0)
    shape = scene.depth.shape
    frame = random.integers(0, 256, (*shape, 3)[: 1 + channels], dtype=np.uint8)
    confidence = random.uniform(size=shape).astype(np.float32)
    depth = np.where(random.uniform(size=shape) < 0.3, np.nan, scene.depth).astype(np.float32)
    cloud = cloud_of(scene, depth, frame=frame, confidence=confidence)
    there = np.isfinite(depth)
    expected = frame if channels == 3 else np.dstack([frame] * 3)
    np.testing.assert_array_equal(cloud.colors, expected[there])
    np.testing.assert_array_equal(cloud.confidence, confidence[there])
    np.testing.assert_array_equal(cloud.positions[:, 2], depth[there])


# Which pixels


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, -1.0, 0.0])
def test_pixels_without_a_depth_give_no_point(scene, value):
    depth = scene.depth.astype(np.float32)
    depth[3, 4:9] = value
    cloud = cloud_of(scene, depth, max_depth=10)
    assert len(cloud) == depth.size - 5 and np.isfinite(cloud).all()


@pytest.mark.filterwarnings("error")
def test_depths_near_the_end_of_float32(scene):
    depth = np.full(scene.depth.shape, 3e38, np.float32)
    cloud = cloud_of(scene, depth, camera=tisfm.Camera(10.0), max_depth=10)
    assert 0 < len(cloud) < depth.size and np.isfinite(cloud.positions).all()


def test_confidence_and_occlusion_choose(scene):
    shape = scene.depth.shape
    confidence = np.random.default_rng(0).uniform(size=shape).astype(np.float32)
    occlusion = np.random.default_rng(1).uniform(size=shape) < 0.2
    options = {"confidence": confidence, "occlusion": occlusion}
    assert len(cloud_of(scene, **options)) == (~occlusion).sum()
    assert len(cloud_of(scene, **options, occluded=True)) == occlusion.size
    least = float(confidence[5, 5])
    cloud = cloud_of(scene, **options, min_confidence=least)
    assert len(cloud) == ((confidence >= least) & ~occlusion).sum()
    assert cloud.confidence.min() >= least


def test_far_points_are_left_out(scene):
    depth = np.ones(scene.depth.shape, np.float32)
    depth[2], depth[3], depth[4] = 9, 10, 11
    options = {"occlusion": np.zeros(depth.shape, bool)}
    assert set(cloud_of(scene, depth, **options).positions[:, 2]) == {1, 9, 10, 11}
    assert set(cloud_of(scene, depth, **options, max_depth=10).positions[:, 2]) == {1, 9, 10}
    assert set(cloud_of(scene, depth, **options, max_depth=1).positions[:, 2]) == {1}
    options["occlusion"][depth == 1] = True  # the median is that of what is taken
    assert set(cloud_of(scene, depth, **options, max_depth=10).positions[:, 2]) == {9, 10, 11}


@pytest.mark.parametrize(
    ("options", "error", "words"),
    [
        ({"min_confidence": 1.5}, ValueError, r"min_confidence is 1\.5: expected .* \[0, 1\]"),
        ({"min_confidence": -0.1}, ValueError, r"min_confidence is -0\.1"),
        ({"min_confidence": np.nan}, ValueError, "min_confidence is nan"),
        ({"min_confidence": "0"}, TypeError, "min_confidence is '0': expected a number"),
        ({"max_depth": 0}, ValueError, "max_depth is 0: expected a positive number"),
        ({"max_depth": np.nan}, ValueError, "max_depth is nan"),
        ({"max_depth": True}, TypeError, "max_depth is True"),
        ({"camera": tisfm.Camera(9.0, distortion=(1, 0, 0, 0))}, ValueError, "has distortion"),
    ],
)
def test_options_that_are_refused(scene, options, error, words):
    with pytest.raises(error, match=words):
        cloud_of(scene, **options)


# As an array


def test_a_cloud_is_an_array_of_its_positions():
    cloud = some_cloud()
    assert cloud.shape == np.asarray(cloud).shape == (5, 3) and len(cloud) == 5 and cloud.ndim == 2
    assert cloud.dtype == np.asarray(cloud).dtype == np.float32
    assert np.asarray(cloud) is cloud.positions and np.array(cloud) is not cloud.positions
    assert np.asarray(cloud, dtype=float).dtype == np.float64
    np.testing.assert_array_equal(cloud[1:3, 2], cloud.positions[1:3, 2])
    np.testing.assert_array_equal(list(cloud), list(cloud.positions))
    np.testing.assert_array_equal(np.mean(cloud, axis=0), cloud.positions.mean(axis=0))


def test_a_cloud_calculates_like_an_array():
    cloud, other = some_cloud(), some_cloud(seed=1)
    turn = np.eye(3)[[1, 0, 2]]
    np.testing.assert_array_equal(cloud @ turn.T, cloud.positions @ turn.T)
    np.testing.assert_array_equal(2 * cloud - other, 2 * cloud.positions - other.positions)
    np.testing.assert_array_equal(np.sqrt(cloud**2), np.abs(cloud.positions))
    np.testing.assert_array_equal(cloud == cloud, np.ones((5, 3), bool))
    before = cloud.positions.copy()
    with pytest.raises(TypeError):
        cloud += 1
    np.testing.assert_array_equal(cloud.positions, before)


def test_a_copy_that_is_needed_is_not_refused_in_silence():
    cloud = some_cloud()
    assert cloud.__array__(copy=False) is cloud.positions
    with pytest.raises(ValueError, match="the positions are float32, and float64 needs a copy"):
        cloud.__array__(np.float64, copy=False)


def test_a_cloud_is_frozen_and_its_repr_short():
    cloud = some_cloud()
    assert repr(cloud) == "PointCloud of 5 points"
    with pytest.raises(dataclasses.FrozenInstanceError):
        cloud.positions = None


@pytest.mark.parametrize(
    ("name", "array", "words"),
    [
        ("positions", np.zeros((5, 2), np.float32), r"positions is \(5, 2\) float32: expected"),
        ("positions", np.zeros((5, 3)), r"positions is \(5, 3\) float64: .* float32"),
        ("colors", np.zeros((4, 3), np.uint8), r"colors is \(4, 3\) .* expected \(5, 3\) uint8"),
        ("confidence", np.zeros((5, 1), np.float32), r"confidence is \(5, 1\)"),
    ],
)
def test_arrays_that_do_not_fit(name, array, words):
    with pytest.raises(ValueError, match=words):
        dataclasses.replace(some_cloud(), **{name: array})


# Files


def vertices(path):
    """Read the vertices of a file with NumPy alone; return them and the header."""
    header, _, data = path.read_bytes().partition(b"end_header\n")
    number = int(header.split(b"element vertex ")[1].split()[0])
    return np.frombuffer(data, VERTEX, number), header.decode().splitlines()


@pytest.mark.parametrize("number", [0, 1, 1000])
def test_a_file_holds_all_of_it(tmp_path, number):
    cloud = some_cloud(number)
    cloud.save(tmp_path / "cloud.ply")
    read, header = vertices(tmp_path / "cloud.ply")
    assert header[:2] == ["ply", "format binary_little_endian 1.0"]
    begin = header.index(f"element vertex {number}") + 1
    assert header[begin : begin + 7] == [
        *(f"property float {name}" for name in "xyz"),
        *(f"property uchar {name}" for name in ("red", "green", "blue")),
        "property float confidence",
    ]
    np.testing.assert_array_equal(read["xyz"], cloud.positions)
    np.testing.assert_array_equal(read["rgb"], cloud.colors)
    np.testing.assert_array_equal(read["confidence"], cloud.confidence)


def test_a_library_reads_the_file(tmp_path):
    cloud = some_cloud(1000)
    cloud.save(str(tmp_path / "cloud"))  # no suffix is added
    data = (tmp_path / "cloud").read_bytes()
    read = trimesh.load(io.BytesIO(data), file_type="ply", process=False)
    np.testing.assert_array_equal(np.asarray(read.vertices, np.float32), cloud.positions)
    np.testing.assert_array_equal(np.asarray(read.colors)[:, :3], cloud.colors)
    raw = read.metadata["_ply_raw"]["vertex"]["data"]["confidence"]
    np.testing.assert_array_equal(np.ravel(raw), cloud.confidence)


def test_saving_twice_gives_the_same_bytes(tmp_path):
    cloud = some_cloud()
    cloud.save(tmp_path / "a.ply")
    (tmp_path / "b.ply").write_bytes(b"old")
    cloud.save(tmp_path / "b.ply")
    assert (tmp_path / "a.ply").read_bytes() == (tmp_path / "b.ply").read_bytes()


def test_paths_that_cannot_be_written(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"cannot write .*gone.* does not exist"):
        some_cloud().save(tmp_path / "gone" / "cloud.ply")
    with pytest.raises(IsADirectoryError, match="is a folder"):
        some_cloud().save(tmp_path)
    assert not list(tmp_path.iterdir())


def test_a_failed_save_leaves_the_file_before(tmp_path, monkeypatch):
    def full(*arguments, **options):
        raise OSError(28, "No space left on device")

    (tmp_path / "cloud.ply").write_bytes(b"old")
    monkeypatch.setattr("trimesh.exchange.ply.export_ply", full)
    with pytest.raises(OSError, match="No space left"):
        some_cloud().save(tmp_path / "cloud.ply")
    assert [path.read_bytes() for path in tmp_path.iterdir()] == [b"old"]


def test_the_library_is_loaded_when_a_file_is_written():
    code = "import sys, tisfm, tisfm.point_cloud; sys.exit('trimesh' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


# Of an interpretation


@pytest.fixture(scope="module")
def result(scene):
    return tisfm.interpret(scene.frame0, scene.frame1, camera=scene.camera)


def test_points_of_a_result(result):
    cloud = result.points()
    assert np.asarray(cloud).shape == cloud.shape == (len(cloud), 3)
    assert cloud.dtype == np.float32 and np.isfinite(cloud).all()
    kept = np.isfinite(result.depth) & (result.depth > 0) & ~result.occlusion
    kept &= result.depth <= 10 * np.median(result.depth[kept])
    assert kept.mean() > 0.5
    np.testing.assert_array_equal(cloud[:, 2], result.depth[kept])
    np.testing.assert_array_equal(cloud.confidence, result.confidence[kept])
    np.testing.assert_array_equal(cloud.colors, np.dstack([result.frame] * 3)[kept])
    assert (cloud[:, 2] > 0).all()


def test_options_of_points(result):
    number = len(result.points())
    assert len(result.points(min_confidence=0.5)) == (result.points().confidence >= 0.5).sum()
    assert len(result.points(max_depth=1.0)) < number <= len(result.points(max_depth=None))
    assert result.occlusion.any() and len(result.points(occluded=True)) > number


def test_points_of_a_loaded_result(result, tmp_path):
    result.save(tmp_path / "result.npz")
    again = Interpretation.load(tmp_path / "result.npz").points()
    np.testing.assert_array_equal(again.positions, result.points().positions)


@pytest.mark.filterwarnings("error")
def test_without_motion_there_are_no_points(scene, tmp_path):
    cloud = tisfm.interpret(scene.frame0, scene.frame0).points()
    assert cloud.shape == (0, 3) and cloud.colors.shape == (0, 3) and cloud.dtype == np.float32
    cloud.save(tmp_path / "empty.ply")
    assert len(vertices(tmp_path / "empty.ply")[0]) == 0
