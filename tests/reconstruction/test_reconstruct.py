"""`tisfm.reconstruct`: from a film to a path, depth in one scale, and a folder."""

import gc
import json
import tempfile
import warnings

import cv2
import numpy as np
import pytest

import tisfm
from tests.reconstruction.films import along, depth_error, path_error, walk
from tisfm import Camera, Reconstruction, Settings
from tisfm.formats.npz import write_npz
from tisfm.reconstruction.depth.segment_depth import PieceDepths

FAST = Settings.preset("fast", motion="camera")


@pytest.fixture(scope="module")
def film():
    return walk()


@pytest.fixture(scope="module")
def found(film):
    return tisfm.reconstruct(film.frames, camera=film.camera, settings=FAST)


@pytest.fixture(scope="module")
def path(film):
    """Return the reconstruction with a path and without depth."""
    return tisfm.reconstruct(film.frames, camera=film.camera, settings=FAST, depth_of="none")


def scale_of(found, film):
    ratio = [np.nanmedian(true / found.depth(k)) for k, true in enumerate(film.depth)]
    return np.median(ratio)


def test_every_frame_has_a_pose_and_depth_in_one_scale(film, found):
    assert len(found) == len(film.frames)
    assert found.poses.shape == (len(film.frames), 4, 4) and found.poses.dtype == np.float64
    assert found.piece.dtype == np.int32 and (found.piece == 0).all()
    np.testing.assert_allclose(found.poses[0], np.eye(4), atol=1e-12)
    assert path_error(found.poses, film.poses) < 0.02
    scale = scale_of(found, film)
    errors = [depth_error(found.depth(k), true, scale) for k, true in enumerate(film.depth)]
    assert np.median(errors) < 0.1 and max(errors) < 0.25
    assert all(status == "converged" for status in found.status)
    assert found.keyframes[0] == 0 and set(found.keyframes) <= set(range(len(found)))
    assert found.names == tuple(f"frame_{k:06d}" for k in range(len(found)))
    deviations = np.linalg.norm(found.position_deviation, axis=1)
    assert np.median(deviations) > 1e-4 and deviations.max() < 0.05
    assert ((found.rotation_deviation > 0) & (found.rotation_deviation < 2)).all()


def test_preset_alone_means_the_motion_of_the_camera(film):
    """`Settings.preset("fast")` instead has the motion model of pairs."""
    frames, preset = film.frames[:3], Settings.preset("fast")
    options = {"camera": film.camera, "depth_of": "none"}
    result = tisfm.reconstruct(frames, settings=preset, **options)
    assert result.settings == FAST and preset.motion == "field"
    expected = tisfm.reconstruct(frames, settings=FAST, **options)
    np.testing.assert_array_equal(result.poses, expected.poses)


def test_depth_is_in_the_unit_of_the_poses(found):
    first = found.depth(found.keyframes[0])
    assert np.nanmedian(first) == pytest.approx(1, abs=2e-3)
    inverse = found.inverse_depth(1)
    assert inverse.dtype == np.float32 and inverse.shape == found.shape
    np.testing.assert_allclose(found.depth(1), 1 / inverse, rtol=1e-6)
    assert (found.inverse_depth_std(1) > 0).all()


def test_given_poses_are_kept_and_depth_is_in_their_unit(film):
    """A frame without a pose has no depth."""
    poses = film.poses.copy()
    poses[4] = np.nan
    found = tisfm.reconstruct(film.frames, camera=film.camera, settings=FAST, poses=poses)
    np.testing.assert_allclose(found.poses, poses, atol=1e-12)
    errors = [depth_error(found.depth(k), true) for k, true in enumerate(film.depth) if k != 4]
    assert np.median(errors) < 0.08 and max(errors) < 0.2
    assert found.piece[4] == -1 and np.isnan(found.poses[4]).all()
    for deviation in (found.position_deviation, found.rotation_deviation):
        assert np.isnan(deviation[4]).all() and not np.delete(deviation, 4, axis=0).any()
    assert np.isnan(found.depth(4)).all() and np.isinf(found.inverse_depth_std(4)).all()
    assert found.status[4] == "unrelated" and found.status[4].message


def test_as_many_poses_as_frames_are_needed(film, found, tmp_path):
    """If this is known before frames are read, earlier files in the folder stay."""
    found.save(tmp_path)
    options = {"camera": film.camera, "settings": FAST, "poses": film.poses[:4]}
    with pytest.raises(ValueError, match="poses are 4, but there are 9 frames"):
        tisfm.reconstruct(film.frames, **options, folder=tmp_path)
    assert len(Reconstruction.load(tmp_path)) == 9
    with pytest.raises(ValueError, match="poses are 4, but there are 3 frames"):
        tisfm.reconstruct(iter(film.frames[:3]), **options)


def test_failed_reconstruction_leaves_no_temporary_file(film, tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    there = []

    def broken():
        yield from film.frames[:2]
        there.extend(tmp_path.iterdir())
        raise OSError("the plug was pulled")

    with pytest.raises(OSError, match="plug") as held:
        tisfm.reconstruct(broken(), camera=film.camera, settings=FAST)
    assert len(there) == 1 and list(tmp_path.iterdir()) == []
    assert held.value.__traceback__ is not None  # it refers to all objects of the run


def test_result_without_a_folder_is_deleted_without_a_warning(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    flat = [np.full((8, 9), 90, np.uint8)] * 2
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        result = tisfm.reconstruct(flat, camera=tisfm.Camera(9.0), settings=FAST)
        assert np.isnan(result.depth(0)).all() and result.folder.is_dir()
        del result
        gc.collect()
    assert said == [] and list(tmp_path.iterdir()) == []


def test_depth_of_keyframes_alone(film, found):
    sparse = tisfm.reconstruct(film.frames, camera=film.camera, settings=FAST, depth_of="keyframes")
    np.testing.assert_array_equal(sparse.poses, found.poses)
    assert sparse.keyframes == found.keyframes and sparse.status == found.status
    for frame in range(len(found)):
        if frame in found.keyframes:
            np.testing.assert_array_equal(sparse.depth(frame), found.depth(frame))
        else:
            assert np.isnan(sparse.depth(frame)).all()


def test_path_without_depth(path, found):
    assert path.keyframes == () and np.isnan(path.depth(0)).all()
    assert all(status == "converged" for status in path.status)
    np.testing.assert_allclose(path.poses[:, :3, :3], found.poses[:, :3, :3], atol=1e-12)
    moved, moved_before = (np.linalg.norm(one.poses[-1, :3, 3]) for one in (path, found))
    assert moved == pytest.approx(moved_before, rel=0.5)  # units: one of tracks, one of all pixels


@pytest.mark.nightly
def test_unit_without_any_depth_is_that_of_tracks(film, path, monkeypatch):
    monkeypatch.setattr(PieceDepths, "__iter__", lambda self: iter(()))
    blind = tisfm.reconstruct(film.frames, camera=film.camera, settings=FAST)
    assert {str(status) for status in blind.status} == {"little_parallax"}
    np.testing.assert_array_equal(blind.poses, path.poses)


@pytest.mark.nightly  # test_depth_of_keyframes_alone compares the keyframes of two runs
def test_result_is_the_same_every_time(film, found):
    again = tisfm.reconstruct(film.frames, camera=film.camera, settings=FAST)
    np.testing.assert_array_equal(again.poses, found.poses)
    for frame in (0, 4, 8):
        np.testing.assert_array_equal(again.inverse_depth(frame), found.inverse_depth(frame))


def test_saved_and_loaded(found, tmp_path):
    found.save(tmp_path / "kept")
    loaded = Reconstruction.load(tmp_path / "kept")
    np.testing.assert_array_equal(loaded.poses, found.poses)
    np.testing.assert_array_equal(loaded.piece, found.piece)
    assert loaded.status == found.status and loaded.camera == found.camera
    assert [s.message for s in loaded.status] == [s.message for s in found.status]
    assert loaded.keyframes == found.keyframes and loaded.settings == found.settings
    for frame in range(len(found)):
        np.testing.assert_array_equal(loaded.inverse_depth(frame), found.inverse_depth(frame))
        np.testing.assert_array_equal(loaded.picture(frame), found.picture(frame))
    found.save(tmp_path / "kept")  # it replaces its own folder
    assert Reconstruction.load(tmp_path / "kept").keyframes == found.keyframes


def test_other_files_are_not_overwritten(found, tmp_path):
    (tmp_path / "letter.txt").write_text("dear")
    with pytest.raises(FileExistsError, match=r"letter\.txt"):
        found.save(tmp_path)
    assert (tmp_path / "letter.txt").read_text() == "dear"


def test_foreign_folder_named_frames_stays(found, tmp_path):
    (tmp_path / "frames").mkdir()
    (tmp_path / "frames" / "0.png").write_bytes(b"dear")
    with pytest.raises(FileExistsError, match="frames"):
        found.save(tmp_path)
    assert (tmp_path / "frames" / "0.png").read_bytes() == b"dear"


def test_result_is_not_written_over_its_source(found, film, tmp_path):
    found.save(tmp_path)
    with pytest.raises(ValueError, match="lies in"):
        tisfm.reconstruct(tmp_path / "frames", camera=film.camera, settings=FAST, folder=tmp_path)
    assert len(Reconstruction.load(tmp_path)) == len(found)


def test_incomplete_folders_are_refused(found, tmp_path):
    with pytest.raises(FileNotFoundError, match="has no reconstruction"):
        Reconstruction.load(tmp_path)
    found.save(tmp_path)
    (tmp_path / "reconstruction.json").unlink()
    with pytest.raises(FileNotFoundError, match="not complete"):
        Reconstruction.load(tmp_path)


def test_working_folder_may_change(found, film, tmp_path, monkeypatch):
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path)
    made = tisfm.reconstruct(
        film.frames[:2], camera=film.camera, settings=FAST, poses=film.poses[:2], folder="made"
    )
    found.save("kept")
    loaded = Reconstruction.load("kept")
    monkeypatch.chdir(tmp_path / "elsewhere")
    np.testing.assert_array_equal(loaded.depth(0), found.depth(0))
    assert made.picture(0).shape == made.shape


def test_deleted_files_are_reported(found, tmp_path):
    """Missing depth files are not taken for frames without depth."""
    found.save(tmp_path)
    loaded = Reconstruction.load(tmp_path)
    (tmp_path / "frames" / "000000.jpg").write_bytes(b"")
    with pytest.raises(tisfm.formats.FormatError, match=r"000000\.jpg is empty"):
        loaded.picture(0)
    (tmp_path / "depth").rename(tmp_path / "other")
    with pytest.raises(FileNotFoundError, match="not complete"):
        loaded.depth(0)


@pytest.mark.parametrize("part", [{"keyframes": [0, 99]}, {"status": []}])
def test_inconsistent_records_are_refused(found, tmp_path, part):
    found.save(tmp_path)
    record = tmp_path / "reconstruction.json"
    record.write_text(json.dumps(json.loads(record.read_text()) | part))
    with pytest.raises(tisfm.formats.FormatError, match=r"reconstruction\.json is damaged"):
        Reconstruction.load(tmp_path)


@pytest.mark.parametrize("deviation", [np.zeros((2, 3)), -np.ones((9, 3)), np.ones((9, 3), int)])
def test_wrong_deviations_of_poses_are_refused(found, tmp_path, deviation):
    found.save(tmp_path)
    with np.load(tmp_path / "path.npz") as file:
        arrays = dict(file)
    write_npz(tmp_path / "path.npz", {**arrays, "rotation_deviation": deviation})
    with pytest.raises(tisfm.formats.FormatError, match="rotation_deviation"):
        Reconstruction.load(tmp_path)


@pytest.mark.parametrize("text", ["{}", "not json", '{"format": 99}'])
def test_damaged_records_are_refused(found, tmp_path, text):
    found.save(tmp_path)
    (tmp_path / "reconstruction.json").write_text(text)
    with pytest.raises(tisfm.formats.FormatError, match=r"reconstruction\.json"):
        Reconstruction.load(tmp_path)


def test_scale_from_a_known_distance(found, film, tmp_path):
    moved = np.linalg.norm(film.poses[8, :3, 3] - film.poses[0, :3, 3])
    metric = found.rescaled(0, 8, moved)
    factor = moved / np.linalg.norm(found.poses[8, :3, 3] - found.poses[0, :3, 3])
    np.testing.assert_allclose(metric.depth(3), factor * found.depth(3), rtol=1e-5)
    np.testing.assert_allclose(
        metric.inverse_depth_std(3), found.inverse_depth_std(3) / factor, rtol=1e-5
    )
    assert depth_error(metric.depth(3), film.depth[3]) < 0.2
    metric.save(tmp_path)
    np.testing.assert_allclose(Reconstruction.load(tmp_path).depth(3), metric.depth(3), rtol=1e-6)


@pytest.mark.parametrize(
    ("frame", "error"), [(9, IndexError), (-1, IndexError), (0.5, TypeError), ("0", TypeError)]
)
def test_invalid_frame_numbers_are_refused(found, frame, error):
    with pytest.raises(error):
        found.depth(frame)


@pytest.mark.parametrize(
    ("frames", "text"),
    [
        ((0, 0, 1.0), "one camera position"),
        ((0, 1, -1.0), "positive"),
        ((0, 99, 1.0), "expected 0 to 8"),
    ],
)
def test_invalid_scales_are_refused(found, frames, text):
    with pytest.raises((ValueError, IndexError), match=text):
        found.rescaled(*frames)


def test_points_lie_in_the_world(found, film):
    cloud = found.points(range(len(found)), agreeing=3)
    assert len(cloud) > 1000 and cloud.positions.dtype == np.float32
    one = found.points([0])  # no other view to agree with
    depth = found.depth(0)
    assert one.positions[:, 2].max() <= np.nanmax(depth) * (1 + 1e-3)
    assert len(found.points([0], max_relative_std=0.01)) < len(one)


@pytest.mark.nightly
def test_mesh_of_all_frames(found, tmp_path):
    pytest.importorskip("skimage")
    mesh = found.mesh(range(len(found)))
    assert len(mesh.faces) > 500
    mesh.save(tmp_path / "mesh.ply")
    assert (tmp_path / "mesh.ply").stat().st_size > 1000


def test_frames_of_a_cloud_are_checked(found):
    with pytest.raises(IndexError, match="99"):
        found.points([99])


def test_masked_pixels_are_left_out(film):
    """A cover at a fixed position, nearly half of each frame, is not taken for the scene."""
    seen = np.ones(film.frames[0].shape, bool)
    seen[99:] = False
    mask = np.uint8(255) * seen
    cover = np.random.default_rng(0).integers(0, 255, seen.shape, np.uint8)
    frames = np.where(seen, film.frames, cover)
    options = {"camera": film.camera, "settings": FAST, "mask": mask, "depth_of": "keyframes"}
    found = tisfm.reconstruct(frames, **options)
    assert (found.piece == 0).all()
    assert path_error(found.poses, film.poses) < 0.03
    true = {k: film.depth[k][seen] for k in found.keyframes}
    scale = np.median([np.nanmedian(true[k] / found.depth(k)[seen]) for k in true])
    errors = [depth_error(found.depth(k)[seen], true[k], scale) for k in true]
    assert np.median(errors) < 0.15
    # The result does not depend on the pixels of the cover.
    other = tisfm.reconstruct(film.frames, **options)
    np.testing.assert_array_equal(other.poses, found.poses)
    for key in found.keyframes:
        np.testing.assert_array_equal(other.depth(key), found.depth(key))


@pytest.mark.nightly
def test_cover_is_in_no_point_cloud(film):
    seen = np.ones(film.frames[0].shape, bool)
    seen[:, 100:140] = False
    frames = np.where(seen[..., None], film.frames[..., None], np.uint8([255, 0, 0]))
    found = tisfm.reconstruct(
        frames, camera=film.camera, settings=FAST, mask=seen, depth_of="keyframes"
    )
    for frame in found.keyframes:
        assert np.isfinite(found.depth(frame)).all()
        np.testing.assert_array_equal(np.isinf(found.inverse_depth_std(frame)), ~seen)
    colors = found.points(found.keyframes, agreeing=1).colors.astype(int)
    covering = colors[:, 0] > colors[:, 1] + 128
    # JPEG spreads some of it to neighbouring pixels.
    assert len(colors) > 1000 and covering.mean() < 0.005


def test_distortion_is_removed(film):
    camera = Camera(focal=film.camera.focal, distortion=(-0.05, 0.01, 0.0, 0.0))
    found = tisfm.reconstruct(film.frames[:5], camera=camera, settings=FAST, depth_of="none")
    assert found.camera == camera.pinhole()
    assert (found.piece == 0).all()


def test_folder_of_images_and_folder_of_results(film, tmp_path):
    for k, frame in enumerate(film.frames[:4]):
        cv2.imwrite(str(tmp_path / f"f{k}.png"), frame)
    told = []
    found = tisfm.reconstruct(
        tmp_path / "f*.png",
        camera=film.camera,
        settings=FAST,
        folder=tmp_path / "out",
        progress=lambda *step: told.append(step),
    )
    assert found.names == tuple(f"f{k}" for k in range(4))
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == [
        "camera.json", "depth", "frames", "path.npz", "reconstruction.json",
    ]  # fmt: skip
    assert told[0] == ("reading", 1, 4) and told[-1] == ("depth", 4, 4)
    assert [stage for stage, done, total in told if done == 4].count("reading") == 1


def test_failure_leaves_no_complete_folder(film, tmp_path):
    def broken():
        yield from film.frames[:3]
        raise OSError("the camera is gone")

    options = {"camera": film.camera, "settings": FAST, "folder": tmp_path, "depth_of": "none"}
    with pytest.raises(OSError, match="gone"):
        tisfm.reconstruct(broken(), **options)
    assert not (tmp_path / "reconstruction.json").exists()
    assert not (tmp_path / "cache").exists()
    tisfm.reconstruct(film.frames[:4], **options)
    assert len(Reconstruction.load(tmp_path)) == 4


def test_camera_at_rest_has_status_no_motion(film):
    found = tisfm.reconstruct(np.stack([film.frames[0]] * 4), camera=film.camera, settings=FAST)
    assert (found.piece == -1).all() and not found.keyframes
    assert all(status == "no_motion" and status.message for status in found.status)
    assert np.isnan(found.depth(0)).all()
    assert len(found.points()) == 0


@pytest.mark.parametrize(
    ("changes", "error", "text"),
    [
        ({"settings": "fast"}, TypeError, "settings"),
        ({"camera": 600}, TypeError, "camera"),
        ({"poses": np.eye(4)}, ValueError, "poses is"),
        ({"poses": np.zeros((9, 4, 4))}, ValueError, r"poses\[0\]"),
        ({"poses": along(3)}, ValueError, "poses are 3"),
        ({"poses": along(9), "bad_frames": "skip"}, ValueError, "skip"),
        ({"depth_of": "some"}, ValueError, "'some': expected"),
        ({"poses": along(9), "depth_of": "none"}, ValueError, "nothing is left"),
    ],
)  # fmt: skip
def test_wrong_arguments_are_refused(film, changes, error, text):
    options = {"camera": film.camera, "settings": FAST, **changes}
    with pytest.raises(error, match=text):
        tisfm.reconstruct(film.frames, **options)


def test_one_frame_is_refused(film):
    with pytest.raises(ValueError, match="1 frame"):
        tisfm.reconstruct(film.frames[:1], camera=film.camera)
