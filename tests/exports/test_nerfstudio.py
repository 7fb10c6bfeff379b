"""``transforms.json``: cameras in the axes of OpenGL, and the sparse points in their world."""

import json
import os
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from tisfm import Camera
from tisfm.exports import nerfstudio, write_colmap, write_nerfstudio
from tisfm.exports.tracks import measure_tracks
from tisfm.reconstruction.result.folder import write_labels
from tisfm.rigid import pose_matrix


@pytest.fixture(scope="module")
def written(found, tmp_path_factory):
    folder = tmp_path_factory.mktemp("nerfstudio")
    return (
        folder,
        write_nerfstudio(found, folder),
        json.loads((folder / "transforms.json").read_text()),
    )


def seen_by(about, shot, world):
    """Return where a camera of the file sees points, (N, 2), px from the frame's upper left corner.

    As OpenGL has it: X right, Y up, Z toward the viewer.
    """
    matrix = np.array(shot["transform_matrix"])
    local = (world - matrix[:3, 3]) @ matrix[:3, :3]
    assert (local[:, 2] < 0).all()
    x = about["cx"] + about["fl_x"] * local[:, 0] / -local[:, 2]
    y = about["cy"] - about["fl_y"] * local[:, 1] / -local[:, 2]
    return np.stack([x, y], axis=1)


def test_intrinsics_are_those_of_the_frames(found, written):
    about = written[2]
    height, width = found.shape
    cx, cy = found.camera.center_for(height, width)
    assert (about["w"], about["h"]) == (width, height)
    assert (about["cx"], about["cy"]) == (cx + 0.5, cy + 0.5)
    assert about["fl_x"] == about["fl_y"] == found.camera.focal
    assert about["camera_model"] == "PINHOLE"
    assert np.tan(about["camera_angle_x"] / 2) * about["fl_x"] == pytest.approx(width / 2)
    assert np.tan(about["camera_angle_y"] / 2) * about["fl_y"] == pytest.approx(height / 2)


def test_every_frame_is_there_and_byte_for_byte(found, written):
    folder, account, about = written
    assert [shot["file_path"] for shot in about["frames"]] == [
        f"images/{k:06d}.jpg" for k in range(len(found))
    ]
    for k, shot in enumerate(about["frames"]):
        source = found.folder / "frames" / f"{k:06d}.jpg"
        assert (folder / shot["file_path"]).read_bytes() == source.read_bytes()
        assert "mask_path" not in shot
    assert (account.piece, account.images) == (0, len(found))


def test_points_are_seen_where_they_were_measured(found, written):
    folder, account, about = written
    cloud = trimesh.load(folder / about["ply_file_path"])
    tracks = measure_tracks(found, 0)
    assert len(cloud.vertices) == len(tracks) == account.points
    np.testing.assert_array_equal(np.asarray(cloud.colors)[:, :3], tracks.colors)
    for frame, shot in enumerate(about["frames"]):
        mine = tracks.frames == frame
        places = seen_by(about, shot, np.asarray(cloud.vertices)[tracks.points[mine]])
        apart = np.linalg.norm(places - tracks.image_points[mine] - 0.5, axis=1)
        np.testing.assert_allclose(apart, tracks.residual[mine], atol=2e-3)


def test_the_world_is_upright_and_its_axes_are_stated(found, written):
    about = written[2]
    first = np.array(about["frames"][0]["transform_matrix"])
    np.testing.assert_allclose(first[:3, 1], (0, 0, 1), atol=1e-9)  # up in the frame is Z
    np.testing.assert_allclose(first[:3, 0], (1, 0, 0), atol=1e-9)
    applied = np.array(about["applied_transform"])
    assert np.linalg.det(applied[:, :3]) == pytest.approx(1)
    places = [np.array(shot["transform_matrix"])[:3, 3] for shot in about["frames"]]
    np.testing.assert_allclose(places, found.poses[:, :3, 3] @ applied[:, :3].T, atol=1e-12)


numbers = st.floats(-1, 1, allow_nan=False)


@given(
    twist=st.tuples(*[numbers] * 6),
    focal=st.floats(10, 5000),
    center=st.one_of(st.none(), st.tuples(st.floats(0, 239), st.floats(0, 179))),
    pixel=st.tuples(st.floats(0, 239), st.floats(0, 179)),
    depth=st.floats(0.1, 100),
)
def test_a_known_point_is_at_its_pixel(found, twist, focal, center, pixel, depth):
    camera, pose = Camera(focal, center), pose_matrix(np.array(twist))
    poses = found.poses.copy()
    poses[2] = pose
    about = nerfstudio._transforms_record(replace(found, camera=camera, poses=poses), [2])
    cx, cy = camera.center_for(*found.shape)
    local = np.array([(pixel[0] - cx) / focal, (pixel[1] - cy) / focal, 1]) * depth
    world = pose[:3, :3] @ local + pose[:3, 3]
    applied = np.array(about["applied_transform"])
    place = seen_by(about, about["frames"][0], (applied[:, :3] @ world)[None])
    np.testing.assert_allclose(place[0] - 0.5, pixel, atol=1e-6)
    assert json.loads(json.dumps(about)) == about


def test_one_piece_by_choice(found, tmp_path):
    piece = np.array([0, 0, 0, 1, 1, 1, 1, 1, -1], np.int32)
    pieces = replace(found, piece=piece, unit=(1.0, 1.0))
    for chosen, frames in ((None, range(3, 8)), (0, range(3))):
        write_nerfstudio(pieces, tmp_path, piece=chosen)
        about = json.loads((tmp_path / "transforms.json").read_text())
        names = [f"{k:06d}.jpg" for k in frames]
        assert [shot["file_path"] for shot in about["frames"]] == [f"images/{n}" for n in names]
        assert sorted(os.listdir(tmp_path / "images")) == names
    with pytest.raises(ValueError, match="piece is 2: expected a piece of several frames, 1, 0"):
        write_nerfstudio(pieces, tmp_path, piece=2)


def test_masks_show_pixels_at_rest(copied, tmp_path):
    labels = np.zeros(copied.shape, np.uint8)
    labels[50:90, 60:100] = 3
    for frame in range(len(copied)):
        write_labels(copied.folder, frame, labels)
    moving = replace(copied, settings=replace(copied.settings, motion="objects"))
    write_nerfstudio(moving, tmp_path / "out", images="link")
    about = json.loads((tmp_path / "out" / "transforms.json").read_text())
    from PIL import Image

    for shot in about["frames"]:
        mask = np.asarray(Image.open(tmp_path / "out" / shot["mask_path"]))
        np.testing.assert_array_equal(mask, np.where(labels == 0, 255, 0))


def test_another_kind_of_export_is_replaced(found, tmp_path):
    write_colmap(found, tmp_path)
    write_nerfstudio(found, tmp_path)
    names = ["export.json", "images", "sparse_points.ply", "transforms.json"]
    assert sorted(os.listdir(tmp_path)) == names
    assert json.loads((tmp_path / "export.json").read_text())["kind"] == "nerfstudio"
    write_colmap(found, tmp_path, images="none")
    assert sorted(os.listdir(tmp_path)) == ["export.json", "sparse"]
