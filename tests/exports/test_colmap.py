"""Models of COLMAP: read by pycolmap, triangulated again, replaced as a whole."""

import json
import os
import shutil
from dataclasses import replace

import cv2
import numpy as np
import pycolmap
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.draws import examples
from tests.exports.exported import contents, errors_of, retriangulated, tracks_per_image
from tests.reconstruction.films import along
from tisfm import Camera
from tisfm.exports import colmap, write_colmap
from tisfm.exports.colmap import check_complete, write_model
from tisfm.exports.tracks import Tracks, measure_tracks
from tisfm.formats import FormatError
from tisfm.reconstruction.result.folder import depth_path, read_depth, write_depth, write_labels


def test_pycolmap_reads_all_images_and_the_camera(found, exported):
    folder, written = exported
    model = pycolmap.Reconstruction(folder / "sparse" / "0")
    assert [image.name for _, image in sorted(model.images.items())] == [
        f"{k:06d}.jpg" for k in range(len(found))
    ]
    (camera,) = model.cameras.values()
    height, width = found.shape
    assert camera.model.name == "PINHOLE" and (camera.width, camera.height) == (width, height)
    cx, cy = found.camera.center_for(height, width)
    focal = found.camera.focal
    assert camera.params.tolist() == [focal, focal, cx + 0.5, cy + 0.5]
    for number, image in model.images.items():
        world = np.vstack([image.cam_from_world().inverse().matrix(), [0, 0, 0, 1]])
        np.testing.assert_allclose(world, found.poses[number - 1], atol=1e-12)
        kept = (folder / "images" / image.name).read_bytes()
        assert kept == (found.folder / "frames" / image.name).read_bytes()
    (one,) = written
    assert (one.name, one.piece, one.images) == ("sparse/0", 0, len(found))
    assert one.points == model.num_points3D() > 300
    assert one.observations == model.compute_num_observations()


def test_every_image_sees_tracks_of_three_frames(exported):
    model = pycolmap.Reconstruction(exported[0] / "sparse" / "0")
    assert min(tracks_per_image(model).values()) > 50
    assert min(p.track.length() for p in model.points3D.values()) >= 3
    for point in model.points3D.values():
        images = [e.image_id for e in point.track.elements]
        assert len(set(images)) == len(images)


def test_triangulation_by_pycolmap_reprojects_to_the_tracks(exported):
    model = pycolmap.Reconstruction(exported[0] / "sparse" / "0")
    errors, lost = retriangulated(model)
    assert lost < 0.05 * model.num_points3D()
    assert np.median(errors) < 0.3 and np.percentile(errors, 95) < 1.5
    assert model.compute_mean_reprojection_error() < 0.5
    assert exported[1][0].error < 0.3


def test_positions_are_those_of_the_frames(film, found):
    errors = errors_of(measure_tracks(found, 0), film)
    assert len(errors) > 1000
    assert np.median(errors) < 0.15 and np.percentile(errors, 90) < 0.8


@pytest.mark.nightly
def test_positions_do_not_follow_a_wrong_depth(film, found, copied):
    """They are measured: projected from points that are off, they would be off by pixels."""
    rows = np.linspace(1.06, 0.94, found.shape[0], dtype=np.float32)[:, None]
    for frame in range(len(copied)):
        inverse_depth, std = read_depth(copied.folder, frame, copied.shape)
        write_depth(copied.folder, frame, inverse_depth * rows, std * rows)
    right, wrong = measure_tracks(found, 0), measure_tracks(copied, 0)
    assert len(wrong) > 0.7 * len(right)
    errors, before = errors_of(wrong, film), errors_of(right, film)
    assert np.median(errors) < np.median(before) + 0.03
    assert np.percentile(errors, 90) < 0.9
    assert np.median(wrong.residual) < 0.3  # and the points are not those of the depth


def test_colours_are_those_of_the_frames(found, exported):
    model = pycolmap.Reconstruction(exported[0] / "sparse" / "0")
    apart = []
    for point in model.points3D.values():
        for element in point.track.elements:
            image = model.images[element.image_id]
            x, y = np.floor(image.points2D[element.point2D_idx].xy).astype(int)
            pixel = found.picture(element.image_id - 1)[y, x]
            apart.append(np.abs(np.int64(pixel) - point.color).mean())
        if len(apart) > 500:
            break
    assert np.median(apart) < 6


def test_text_and_binary_models_are_equal(exported, tmp_path):
    folder = exported[0] / "sparse" / "0"
    assert {"cameras.txt", "images.txt", "points3D.txt"} <= set(os.listdir(folder))
    models = [pycolmap.Reconstruction() for _ in range(2)]
    models[0].read_binary(folder)
    models[1].read_text(folder)
    assert contents(models[0]) == contents(models[1])


@settings(
    max_examples=examples(8, 200), suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(data=st.data())
def test_models_survive_text_and_binary_files(found, data, tmp_path_factory):
    seed = data.draw(st.integers(0, 2**32 - 1))
    random = np.random.default_rng(seed)
    count, points = data.draw(st.integers(2, 5)), data.draw(st.integers(0, 12))
    frames = sorted(random.choice(len(found), count, replace=False).tolist())
    poses = found.poses.copy()
    poses[frames] = along(count, random.normal(size=6))
    result = replace(found, poses=poses, camera=Camera(float(random.uniform(10, 1e4))))
    lengths = random.integers(2, count + 1, points)
    number = np.repeat(np.arange(points), lengths)
    total = len(number)
    tracks = Tracks(
        positions=random.normal(scale=10.0 ** random.uniform(-3, 3), size=(points, 3)),
        colors=random.integers(0, 256, (points, 3)).astype(np.uint8),
        points=number.astype(np.int32),
        frames=np.concatenate(
            [np.zeros(0, int), *(sorted(random.choice(frames, n, replace=False)) for n in lengths)]
        ).astype(np.int32),
        image_points=random.uniform(0, 200, (total, 2)),
        residual=np.zeros(total),
    )
    model = colmap._colmap_reconstruction(result, frames, tracks)
    assert sorted(model.images) == [k + 1 for k in frames]
    seen = {
        (number, image.image_id - 1, *(image.points2D[e.point2D_idx].xy - 0.5))
        for number, point in model.points3D.items()
        for e in point.track.elements
        for image in [model.images[e.image_id]]
    }
    expected = zip(tracks.points + 1, tracks.frames, *tracks.image_points.T, strict=True)
    np.testing.assert_allclose(sorted(seen), sorted(expected), atol=1e-9)
    folder = tmp_path_factory.mktemp("any")
    model.write_binary(folder)
    binary = pycolmap.Reconstruction()
    binary.read_binary(folder)
    assert contents(binary) == contents(model)
    binary.write_text(folder)
    text = pycolmap.Reconstruction()
    text.read_text(folder)
    again = contents(text)
    for number, (xyz, color, _, track) in contents(model)["points"].items():
        np.testing.assert_allclose(again["points"][number][0], xyz, rtol=1e-12)
        assert again["points"][number][1:4:2] == (color, track)


def test_a_second_export_is_the_same_and_tells_its_progress(found, exported, tmp_path):
    told = []
    again = tmp_path / "again"
    write_colmap(found, again, form="both", progress=lambda *count: told.append(count))
    assert told == sorted(told) and told[-1] == (len(found), len(found))
    for path in sorted(exported[0].rglob("*")):
        if path.is_file():
            assert (again / path.relative_to(exported[0])).read_bytes() == path.read_bytes(), path


def test_each_piece_is_a_model_the_largest_first(found, tmp_path):
    piece = np.array([0, 0, 0, 1, 1, 1, 1, 1, 2], np.int32)
    poses = found.poses.copy()
    poses[3:8, :3, 3] *= 2
    pieces = replace(found, piece=piece, poses=poses, unit=(1.0, 2.0, 1.0))
    written = write_colmap(pieces, tmp_path / "out")
    assert [(one.name, one.piece, one.images) for one in written] == [
        ("sparse/0", 1, 5),
        ("sparse/1", 0, 3),
    ]
    for one, frames in zip(written, (range(3, 8), range(3)), strict=True):
        model = pycolmap.Reconstruction(tmp_path / "out" / one.name)
        assert sorted(model.images) == [k + 1 for k in frames]
        assert model.num_points3D() > 20 and np.median(retriangulated(model)[0]) < 0.4
    assert len(list((tmp_path / "out" / "images").iterdir())) == 8
    about = json.loads((tmp_path / "out" / "export.json").read_text())
    assert about["kind"] == "colmap" and [m["piece"] for m in about["models"]] == [1, 0]


def test_frames_without_a_pose_are_left_out(found, tmp_path):
    poses, piece = found.poses.copy(), found.piece.copy()
    poses[4], piece[4] = np.nan, -1
    write_colmap(replace(found, poses=poses, piece=piece), tmp_path / "out")
    model = pycolmap.Reconstruction(tmp_path / "out" / "sparse" / "0")
    assert 5 not in model.images and len(model.images) == len(found) - 1
    assert min(tracks_per_image(model).values()) > 20
    assert not (tmp_path / "out" / "images" / "000004.jpg").exists()


def test_masked_and_moving_pixels_have_no_points(copied, tmp_path):
    half = copied.shape[1] // 2
    for frame in range(len(copied)):
        labels = np.zeros(copied.shape, np.uint8)
        labels[:, :half] = 1
        write_labels(copied.folder, frame, labels)
        inverse_depth, std = read_depth(copied.folder, frame, copied.shape)
        std[:60] = np.inf
        write_depth(copied.folder, frame, inverse_depth, std)
    moving = replace(copied, settings=replace(copied.settings, motion="objects"))
    tracks = measure_tracks(moving, 0)
    assert len(tracks) > 30
    x, y = np.rint(tracks.image_points).T
    assert x.min() >= half and y.min() >= 60
    write_colmap(moving, tmp_path / "out", images="none")
    mask = cv2.imread(str(tmp_path / "out" / "masks" / "000003.jpg.png"), cv2.IMREAD_UNCHANGED)
    assert mask.shape == copied.shape
    assert (mask[:, :half] == 0).all() and (mask[:, half:] == 255).all()
    assert len(list((tmp_path / "out" / "masks").iterdir())) == len(copied)
    assert not (tmp_path / "out" / "images").exists()


def test_depth_of_keyframes_is_enough(found, copied):
    for frame in set(range(len(copied))) - set(copied.keyframes):
        depth_path(copied.folder, frame).unlink()
    tracks = measure_tracks(copied, 0)
    assert np.bincount(tracks.frames, minlength=len(copied)).min() > 20


def test_without_depth_points_follow_the_flow(film, copied, tmp_path):
    """As of ``depth_of="none"``."""
    for frame in range(len(copied)):
        depth_path(copied.folder, frame).unlink(missing_ok=True)
    path = replace(copied, keyframes=())
    told = []
    (written,) = write_colmap(path, tmp_path / "out", progress=lambda *count: told.append(count))
    assert told == [(k + 1, len(copied)) for k in range(len(copied))]  # each frame once
    model = pycolmap.Reconstruction(tmp_path / "out" / "sparse" / "0")
    assert len(model.images) == len(copied) and written.points > 100
    assert min(tracks_per_image(model).values()) > 20
    assert np.median(retriangulated(model)[0]) < 0.4
    errors = errors_of(measure_tracks(path, 0), film)
    assert np.median(errors) < 0.5


def test_frames_without_texture_give_a_model_of_poses(copied, tmp_path):
    blank = np.full(copied.shape, 128, np.uint8)
    for frame in range(len(copied)):
        cv2.imwrite(str(copied.folder / "frames" / f"{frame:06d}.jpg"), blank)
    (written,) = write_colmap(copied, tmp_path / "out", form="both")
    assert (written.images, written.points, written.error) == (len(copied), 0, None)
    model = pycolmap.Reconstruction(tmp_path / "out" / "sparse" / "0")
    assert len(model.images) == len(copied) and model.num_points3D() == 0


@pytest.mark.nightly
def test_more_points_where_they_may_be_nearer(found):
    few, many = (measure_tracks(found, 0, spacing=spacing) for spacing in (24, 6))
    assert 100 < len(few) < 0.6 * len(many)


@pytest.mark.parametrize("form", ["binary", "text"])
def test_truncated_files_are_errors(exported, tmp_path, form):
    """As pycolmap leaves them, silently, where a disk is full."""
    model = pycolmap.Reconstruction(exported[0] / "sparse" / "0")
    write_model(model, tmp_path / "model", form)
    for path in sorted((tmp_path / "model").iterdir()):
        data = path.read_bytes()
        for cut in (1, len(data) // 2, len(data)):
            path.write_bytes(data[:-cut])
            with pytest.raises(OSError, match=rf"{path.name} was not written to its end"):
                check_complete(model, tmp_path / "model", form)
        path.write_bytes(data)
    check_complete(model, tmp_path / "model", form)


def test_pictures_of_another_size_are_refused(copied, tmp_path):
    cv2.imwrite(str(copied.folder / "frames" / "000000.jpg"), np.zeros((7, 9), np.uint8))
    with pytest.raises(FormatError, match=r"frame 0 .* is \(7, 9\): expected \(180, 240\)"):
        write_colmap(copied, tmp_path / "out")


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"form": "csv"}, "form is 'csv': expected 'binary', 'text' or 'both'"),
        ({"images": "move"}, "images is 'move': expected 'copy', 'link' or 'none'"),
        ({"spacing": 0}, "spacing is 0: expected a positive number of px"),
        ({"spacing": float("nan")}, "spacing is nan"),
    ],
)
def test_impossible_options_are_refused_first(found, tmp_path, options, text):
    with pytest.raises(ValueError, match=text):
        write_colmap(found, tmp_path / "out", **options)
    assert not (tmp_path / "out").exists()


def test_without_two_poses_there_is_no_model(found, tmp_path):
    alone = np.full(len(found), -1, np.int32)
    alone[0] = 0
    with pytest.raises(ValueError, match="no two of the 9 frames have positions in one scale"):
        write_colmap(replace(found, piece=alone), tmp_path / "out")
    with pytest.raises(ValueError, match="piece is 3: expected 0 to 0"):
        measure_tracks(found, 3)


def test_a_failed_export_leaves_no_empty_folder(copied, tmp_path):
    (copied.folder / "frames" / "000000.jpg").unlink()
    with pytest.raises(FileNotFoundError, match="not complete"):
        write_colmap(copied, tmp_path / "out")
    assert not (tmp_path / "out").exists()
    (tmp_path / "mine").mkdir()
    with pytest.raises(FileNotFoundError):
        write_colmap(copied, tmp_path / "mine")
    assert (tmp_path / "mine").exists()


def test_a_missing_folder_is_an_error(copied, tmp_path):
    shutil.rmtree(copied.folder / "depth")
    with pytest.raises(FileNotFoundError, match="the folder is not complete"):
        write_colmap(copied, tmp_path / "out")
