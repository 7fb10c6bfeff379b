"""The moving camera for Blender and Nuke: points land on the pixels that they are seen at."""

import base64
import json
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import tisfm
from tests.exports.made import SHAPE, made
from tests.trajectory.paths import PATIENT, random_path
from tisfm.exports import write_chan, write_gltf_cameras
from tisfm.exports.camera_path import lens_record
from tisfm.rigid import pose_matrix

H, W = SHAPE


def seen_at(camera, pose, point):
    """Return where a point of the world is seen, px, by the conventions of tisfm."""
    x, y, z = pose[:3, :3].T @ (point - pose[:3, 3])
    cx, cy = camera.center_for(H, W)
    return camera.focal * x / z + cx, camera.focal * y / z + cy


def points_ahead(pose, rng, count=5):
    """Return points before the camera."""
    away = rng.uniform((-0.5, -0.3, 1.0), (0.5, 0.3, 1.0), (count, 3)) * rng.uniform(
        1, 9, (count, 1)
    )
    return away @ pose[:3, :3].T + pose[:3, 3]


def rendered_at(to_world, angle, aspect, point):
    """Return where a renderer with Y up and a camera along −Z draws a point, px.

    By its normalised device coordinates, −1 to 1 from edge to edge, in which pixel (0, 0) is at
    (−1 + 1 / W, 1 − 1 / H).
    """
    up = np.array([point[0], -point[1], -point[2]])  # as in the GLB files
    x, y, z = np.linalg.inv(to_world)[:3] @ [*up, 1]
    assert z < 0
    reach = math.tan(angle / 2)
    right, above = x / (-z * reach * aspect), y / (-z * reach)
    return (right + 1) * W / 2 - 0.5, (1 - above) * H / 2 - 0.5


def arrays_of(document):
    """Return the numbers of every accessor."""
    uri = document["buffers"][0]["uri"]
    data = base64.b64decode(uri.partition(",")[2])
    assert len(data) == document["buffers"][0]["byteLength"]
    found = []
    for accessor in document["accessors"]:
        view = document["bufferViews"][accessor["bufferView"]]
        size = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[accessor["type"]]
        assert (
            accessor["componentType"] == 5126 and view["byteLength"] == 4 * size * accessor["count"]
        )
        values = np.frombuffer(data, "<f4", size * accessor["count"], view["byteOffset"])
        values = values.reshape(-1, size)
        np.testing.assert_array_equal(values.min(axis=0), np.float32(accessor["min"]))
        np.testing.assert_array_equal(values.max(axis=0), np.float32(accessor["max"]))
        found.append(values.astype(float))
    return found


@PATIENT
@given(seed=st.integers(0, 9999), focal=st.floats(10, 500), turn=st.floats(0, 3))
def test_points_land_on_their_pixels(tmp_path_factory, seed, focal, turn):
    place = tmp_path_factory.mktemp("camera")
    rng = np.random.default_rng(seed)
    poses = random_path(rng, 5, turn=turn)
    camera = tisfm.Camera(focal)
    result = made(
        place / "walk", count=5, poses=poses, camera=camera, piece=[0, -1, 0, 0, 0], with_depth=()
    )
    document = json.loads(write_gltf_cameras(result, place, frames_per_second=12)[0].read_bytes())
    times, places, turns = arrays_of(document)
    frames = np.rint(times.ravel() * 12).astype(int)
    assert list(frames) == [0, 2, 3, 4]
    lens = document["cameras"][0]["perspective"]
    lines = write_chan(result, place)[0].read_text().splitlines()
    for k, frame in enumerate(frames):
        number, *words = lines[k].split()
        assert int(number) == frame
        tx, ty, tz, rx, ry, rz, angle = map(float, words)
        about = [Rotation.from_rotvec(np.radians(a) * axis).as_matrix()
                 for a, axis in zip((rx, ry, rz), np.eye(3), strict=True)]  # fmt: skip
        nuke = np.eye(4)
        nuke[:3, :3], nuke[:3, 3] = about[1] @ about[0] @ about[2], (tx, ty, tz)
        blender = np.eye(4)
        blender[:3, :3], blender[:3, 3] = Rotation.from_quat(turns[k]).as_matrix(), places[k]
        for point in points_ahead(poses[frame], rng):
            expected = seen_at(camera, poses[frame], point)
            tight = {"rel": 1e-6, "abs": 1e-6}
            found = rendered_at(nuke, math.radians(angle), W / H, point)
            assert found == pytest.approx(expected, **tight)
            # Positions and turns of the document are of single precision.
            rounding = 1e-5 * focal * (1 + np.abs(poses[frame, :3, 3]).max())
            found = rendered_at(blender, lens["yfov"], lens["aspectRatio"], point)
            assert found == pytest.approx(expected, abs=rounding)


def test_numbers_go_on_without_jumps(tmp_path):
    """A camera that turns around and around: neither quaternions nor angles flip."""
    poses = np.array([pose_matrix([0.1 * k, 0, 0, 0.1, 0.4 * k, 0]) for k in range(40)])
    result = made(tmp_path / "walk", count=40, poses=poses, with_depth=())
    document = json.loads(write_gltf_cameras(result, tmp_path)[0].read_bytes())
    _, _, turns = arrays_of(document)
    assert ((turns[1:] * turns[:-1]).sum(axis=1) > 0.9).all()
    rows = np.loadtxt(write_chan(result, tmp_path)[0])
    assert np.abs(np.diff(rows[:, 4:7], axis=0)).max() < 60
    assert np.ptp(rows[:, 5]) > 700


def test_looking_straight_up_is_written(tmp_path, recwarn):
    up = np.array([pose_matrix([0, 0, 0, angle, 0, 0]) for angle in (np.pi / 2, -np.pi / 2)])
    result = made(tmp_path / "walk", count=2, poses=up, with_depth=())
    rows = np.loadtxt(write_chan(result, tmp_path)[0])
    assert np.abs(rows[:, 4]) == pytest.approx([90, 90]) and not recwarn.list


def test_pieces_have_files_of_their_own(tmp_path):
    result = made(tmp_path / "walk", piece=[1, 0, 0, 0, -1, 1], with_depth=())
    names = [path.name for path in write_chan(result, tmp_path)]
    assert names == ["camera.chan", "camera-piece2.chan", "lens.json"]
    assert [line.split()[0] for line in (tmp_path / names[1]).read_text().splitlines()] == [
        "0",
        "5",
    ]
    names = [path.name for path in write_gltf_cameras(result, tmp_path)]
    assert names == ["camera.gltf", "camera-piece2.gltf", "lens.json"]


def test_trimesh_reads_the_document(tmp_path):
    trimesh = pytest.importorskip("trimesh")
    file = write_gltf_cameras(made(tmp_path / "walk", with_depth=()), tmp_path)[0]
    scene = trimesh.load(file, file_type="gltf")
    assert isinstance(scene, trimesh.Scene)


def test_the_lens_in_millimetres():
    """Blender's camera with these numbers sees a point where ours does, also off the middle."""
    camera = tisfm.Camera(50.0, center=(20.0, 18.0))
    lens = lens_record(camera, SHAPE)
    blender = lens["blender"]
    x, y, z = 0.4, -0.3, 2.0
    # What Blender does with the sensor fit HORIZONTAL: shifts are in widths of the frame.
    right = blender["lens"] / blender["sensor_width"] * x / z - blender["shift_x"]
    below = blender["lens"] / blender["sensor_width"] * y / z + blender["shift_y"]
    found = (W / 2 + W * right - 0.5, H / 2 + W * below - 0.5)
    assert found == pytest.approx(seen_at(camera, np.eye(4), np.array([x, y, z])))
    nuke = lens["nuke"]
    assert 2 * math.degrees(math.atan(nuke["vaperture"] / 2 / nuke["focal"])) == pytest.approx(
        lens["vertical_angle"]
    )
    # What Nuke does (nukescripts.snap3d): its film is 2 wide, and moves by the window translate.
    right = 2 * nuke["focal"] / nuke["haperture"] * x / z - nuke["win_translate"][0]
    above = 2 * nuke["focal"] / nuke["haperture"] * -y / z - nuke["win_translate"][1]
    found = ((1 + right) * W / 2 - 0.5, (H - W * above) / 2 - 0.5)
    assert found == pytest.approx(seen_at(camera, np.eye(4), np.array([x, y, z])))
