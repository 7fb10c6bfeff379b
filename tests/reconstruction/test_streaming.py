"""`tisfm.reconstruct_stream`: it yields frames with poses and depth, and keeps few frames."""

import tempfile
from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest

import tisfm
from tests.draws import nightly_except
from tests.reconstruction.films import depth_error, mirrored, path_error
from tests.rendered import room_film
from tisfm import Camera, Settings
from tisfm.reconstruction.mapping import models as mapping
from tisfm.reconstruction.result.path_check import UNCHECKED
from tisfm.reconstruction.streaming import entry as streaming
from tisfm.reconstruction.streaming import sliding_path, stream, stream_checks
from tisfm.reconstruction.streaming.sliding_path import MIN_FIXED_VIEWS, SlidingPath
from tisfm.reconstruction.streaming.stream import Stream
from tisfm.sources import FrameSource
from tisfm.status import Status

FAST = Settings.preset("fast", motion="camera")
COUNT, DELAY = 20, 8


@cache
def swing(count=COUNT, seed=0):
    """Return a small film of a camera that swings sideways while it moves."""
    poses = np.tile(np.eye(4), (count, 1, 1))
    for k in range(count):
        phase = 2 * np.pi * k / 50
        poses[k, :3, :3] = cv2.Rodrigues(np.array([0.0, 0.25 * np.sin(phase), 0.0]))[0]
        poses[k, :3, 3] = 1.2 * np.sin(phase), 0.1 * np.sin(2 * phase), 0.02 * k
    return room_film(poses, 144, 192, samples=1, seed=seed)


class Counted:
    """A source that counts the frames that were requested."""

    def __init__(self, images):
        self.images, self.read, self.closed = images, 0, False

    def __iter__(self):
        try:
            for image in self.images:
                self.read += 1
                yield image
        finally:
            self.closed = True


@pytest.fixture
def disk(tmp_path, monkeypatch):
    """Return the folder of temporary files."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


def stream_of(frames, settings=FAST):
    return tisfm.reconstruct_stream(frames, camera=swing().camera, settings=settings, delay=DELAY)


@pytest.fixture(scope="module")
def streamed():
    """Return the frames of a stream, and how many frames were read when each was yielded."""
    found, read = [], []
    source = Counted(swing().frames)
    for frame in stream_of(source):
        found.append(frame)
        read.append(source.read)
    return found, read


@pytest.fixture(scope="module")
def whole():
    film = swing()
    return tisfm.reconstruct(film.frames, camera=film.camera, settings=FAST, depth_of="keyframes")


def poses_of(found):
    return np.array([frame.pose for frame in found])


def test_frames_are_yielded_once_and_in_order(streamed):
    found, _ = streamed
    assert [frame.index for frame in found] == list(range(COUNT))
    assert [frame.name for frame in found] == [f"frame_{k:06d}" for k in range(COUNT)]
    for frame, image in zip(found, swing().frames, strict=True):
        assert frame.status == "converged" and frame.piece == 0
        assert frame.grade.is_green and 0 < frame.depth_error < 0.1 and frame.depth_share > 0.5
        assert frame.pose.shape == (4, 4) and frame.pose.dtype == np.float64
        assert frame.inverse_depth.dtype == frame.inverse_depth_std.dtype == np.float32
        assert frame.inverse_depth.shape == frame.inverse_depth_std.shape == image.shape
        assert np.abs(frame.picture.astype(float) - image).mean() < 2  # it is a JPEG
        assert frame.camera == swing().camera
    assert 3 <= sum(frame.keyframe for frame in found) < 0.6 * COUNT  # measured: 10 of 20
    assert found[0].keyframe


def test_no_frame_waits_for_more_than_the_delay(streamed):
    _, read = streamed
    waited = [count - 1 - k for k, count in enumerate(read)]
    assert max(waited) == DELAY
    assert min(waited[: COUNT - DELAY]) > 0  # some frames are read ahead


def test_path_is_nearly_that_of_the_whole(streamed, whole):
    found, _ = streamed
    np.testing.assert_allclose(found[0].pose, np.eye(4), atol=1e-12)
    error = path_error(poses_of(found), swing().poses)
    assert error < 0.01
    assert error < 2 * path_error(whole.poses, swing().poses)


def test_scale_stays(streamed, whole):
    found, _ = streamed
    steps, steps_of_whole = (
        np.linalg.norm(np.diff(p[:, :3, 3], axis=0), axis=1) for p in (poses_of(found), whole.poses)
    )
    parts = [np.median(part) for part in np.array_split(steps / steps_of_whole, 4)]
    assert max(parts) < 1.03 * min(parts)
    # The unit is the same: the median depth of the first keyframe.
    assert np.nanmedian(found[0].depth) == pytest.approx(1, abs=1e-3)
    ratio = [np.nanmedian(found[k].depth / whole.depth(k)) for k in whole.keyframes]
    np.testing.assert_allclose(ratio, 1, atol=0.05)


def test_depth_is_as_good_as_that_of_the_whole(streamed, whole):
    found, _ = streamed
    true = swing().depth
    scale = np.median([np.nanmedian(true[k] / found[k].depth) for k in range(COUNT)])
    errors = [depth_error(found[k].depth, true[k], scale) for k in range(COUNT)]
    others = [depth_error(whole.depth(k), true[k], scale) for k in whole.keyframes]
    same = [errors[k] for k in whole.keyframes]
    assert np.median(same) < 1.2 * np.median(others)
    assert max(errors) < 0.35


def test_result_is_the_same_if_the_caller_overwrites_its_frames(streamed, disk):
    """The second stream is closed early, and leaves no file."""
    found, _ = streamed
    source = Counted(swing().frames)
    again = stream_of(source)
    assert list(disk.iterdir()) == [] and source.read == 0  # no work before the first request
    for _, one, other in zip(range(4), found, again, strict=False):
        np.testing.assert_array_equal(one.pose, other.pose)
        np.testing.assert_array_equal(one.inverse_depth, other.inverse_depth)
        np.testing.assert_array_equal(one.inverse_depth_std, other.inverse_depth_std)
        for values in (other.pose, other.inverse_depth, other.inverse_depth_std, other.picture):
            values[...] = 0
    assert len(list(disk.iterdir())) == 1
    again.close()
    assert list(disk.iterdir()) == [] and source.closed
    assert source.read < COUNT


def test_poses_of_yielded_frames_stay(monkeypatch):
    film = swing()
    path = SlidingPath(film.camera, max_deviation=0.3)
    for image in film.frames[:10]:
        path.add(image)
    before = path.solve().pieces[0]
    path.fix_poses(7, {0: before})
    for image in film.frames[10:14]:
        path.add(image)
    grown = []

    def grow(database, known, real=mapping.grow_from_poses):
        grown.append((real(database, known), known))
        return grown[-1][0]

    monkeypatch.setattr(mapping, "grow_from_poses", grow)
    solution = path.solve()
    ((model, known),) = grown
    assert len(known) >= MIN_FIXED_VIEWS and model.num_reg_images() > len(known)
    for number, pose in known.items():
        np.testing.assert_allclose(model.frame(number).rig_from_world.matrix(), pose, atol=1e-12)
    piece = solution.pieces[0]
    for frame in range(8):
        np.testing.assert_array_equal(piece.poses[frame], before.poses[frame])
    assert sorted(piece.poses) == list(range(14)) and not solution.missing


def test_memory_disk_and_masks(disk, monkeypatch):
    """Every second frame of the source counts; the pixels at the left do not move."""
    monkeypatch.setattr(stream, "DEPTH", replace(stream.DEPTH, max_frame_distance=4))
    monkeypatch.setattr(sliding_path, "FIXED_VIEWS", 8)
    film = swing()
    kept = np.ones(film.frames[0].shape, bool)
    kept[:, :40] = False
    images = film.frames.repeat(2, axis=0)
    images[:, :, :40] = np.random.default_rng(1).integers(0, 255, (144, 40))
    source = FrameSource(images, mask=kept, step=2)
    running = Stream(source, film.camera, "nothing", FAST, DELAY)
    seen, views, files, points, found = [], [], [], [], []
    for frame in running.frames():
        path = running._path
        found.append(frame)
        seen.append(len(path.observations.frames()))
        views.append(len(path._views.views))
        files.append(sum(item.is_file() for item in disk.rglob("*")))
        points.append(sum(len(poses) for poses in path._fixed_poses.values()))
        assert min(one.points[:, 0].min() for one in path.observations) > 39
    assert [frame.index for frame in found] == list(range(0, 2 * COUNT, 2))
    assert path_error(poses_of(found), film.poses) < 0.04
    # Frames before the delay are kept for comparison; one keyframe may be older.
    most = DELAY + 1 + 4 + 1
    assert most - 4 <= max(seen) <= most
    assert max(files) <= 3 * most  # picture, grey frame and mask
    assert max(views) <= 8 + DELAY + 1 < COUNT
    assert max(points) <= most + 8
    assert list(disk.iterdir()) == []


@pytest.mark.nightly
def test_frames_read_before_an_error_are_yielded(disk):
    film = swing()

    def broken():
        yield from film.frames[:12]
        raise OSError("the plug was pulled")

    found = []
    with pytest.raises(OSError, match="plug"):
        for frame in stream_of(broken()):
            found.append(frame)
    assert [frame.index for frame in found] == list(range(12))
    assert path_error(poses_of(found), film.poses[:12]) < 0.02
    assert list(disk.iterdir()) == []


@pytest.mark.parametrize(
    ("wrong", "error", "told"),
    [
        (lambda image: image * np.float32(np.nan), ValueError, "frame_000008 is NaN"),
        (lambda image: image.astype(np.int64), TypeError, "frame_000008 is of type int64"),
        (
            lambda image: np.ma.masked_array(image, mask=True),
            ValueError,
            "frame_000008 has .* masked",
        ),
        (lambda image: image[:90], ValueError, "frame_000008: .* same size"),
    ],
)
def test_frames_before_an_unusable_one_are_yielded(disk, wrong, error, told):
    still, found = swing().frames[0], []
    with pytest.raises(error, match=told):
        for frame in stream_of([*[still] * 8, wrong(still), still]):
            found.append(frame)
    assert [frame.index for frame in found] == list(range(8))
    assert list(disk.iterdir()) == []


@pytest.mark.parametrize("count", [0, 1])
def test_stream_needs_two_frames(disk, count):
    film = swing()
    with pytest.raises(ValueError, match="expected at least 2"):
        list(tisfm.reconstruct_stream(iter(film.frames[:count]), camera=film.camera))
    assert list(disk.iterdir()) == []


def test_two_equal_frames_have_no_pose():
    found = list(stream_of([swing().frames[0]] * 2))
    assert [frame.status for frame in found] == ["no_motion"] * 2
    assert [frame.piece for frame in found] == [-1, -1]
    assert np.isnan(poses_of(found)).all()
    assert np.isnan(found[0].depth).all() and np.isinf(found[0].inverse_depth_std).all()


def test_blank_frames_and_a_cut():
    """Frames after blank ones are in the same piece; after a cut a new piece begins."""
    film = swing()
    images = [*film.frames[:12], *mirrored(swing(seed=7))[:9]]
    images[4] = images[5] = np.zeros_like(images[0])
    found = list(stream_of(images))
    assert [frame.piece for frame in found] == [0] * 4 + [-1] * 2 + [0] * 6 + [1] * 9
    assert {found[k].status for k in (4, 5)} == {"no_texture"}
    assert "a new piece begins" in found[12].status.message
    np.testing.assert_allclose(found[12].pose, np.eye(4), atol=1e-12)
    assert np.nanmedian(found[12].depth) == pytest.approx(1, abs=1e-3)
    seen = [k for k in range(12) if k not in (4, 5)]
    assert path_error(poses_of(found)[seen], film.poses[seen]) < 0.02


def test_contradicted_frames_name_what_hides_the_motion(monkeypatch):
    """The images of the new frames of each call are measured once."""
    measured = []
    original = SlidingPath.find_image_cause

    def find_image_cause(path, frames):
        assert original(path, frames) is None  # the images of the film are good
        measured.extend(frames)
        return Status("noise", "noise hides the motion")

    wrong = replace(UNCHECKED, fixed_share=0.5, infinity_motion=9.0)
    monkeypatch.setattr(SlidingPath, "find_image_cause", find_image_cause)
    monkeypatch.setattr(stream_checks, "check_with_pairs", lambda *arguments: wrong)
    found = list(stream_of(swing().frames[:12]))
    assert measured == [frame.index for frame in found if frame.status == "contradicted"]
    assert len(measured) > 8
    assert all(
        frame.status.message == f"{wrong.message}. Probable cause: noise hides the motion"
        for frame in found
        if frame.status == "contradicted"
    )


@pytest.mark.parametrize("rests", nightly_except(12, of=[12, 64]))
def test_camera_at_rest_keeps_the_scale(rests):
    """It rests for 64 frames, more than the stream keeps, or for fewer."""
    film = swing()
    random = np.random.default_rng(3)
    rest = film.frames[9] + random.normal(0, 1, (rests, *film.frames[9].shape))
    rest = rest.clip(0, 255).astype(np.uint8)
    found = list(stream_of([*film.frames[:9], *rest, *film.frames[10:15]]))
    true = np.array([*film.poses[:9], *[film.poses[9]] * rests, *film.poses[10:15]])
    assert {frame.piece for frame in found} == {0}
    assert path_error(poses_of(found), true) < 0.02


@pytest.mark.nightly
def test_accurate_adjusts_poses_to_the_images():
    """The path of frames is the same for all presets before this adjustment."""
    film, count = swing(), 8
    accurate = stream_of(film.frames[:count], Settings.preset("accurate", motion="camera"))
    accurate = poses_of(accurate)
    plain = poses_of(stream_of(film.frames[:count]))
    # Rotations do not depend on the unit.
    changed = np.abs(accurate - plain)[:, :3, :3] > 1e-5
    assert changed.any(axis=(1, 2)).sum() > 0.6 * count
    assert path_error(accurate, film.poses[:count]) < 0.01


def test_options_of_the_source_are_used():
    film = swing()
    frames = tisfm.reconstruct_stream(
        film.frames,
        camera=film.camera,
        settings=FAST,
        mask=np.ones(film.frames[0].shape, bool),
        start=4,
        step=3,
        stop=11,
        size=80,
        crop=(8, 0, 120, 120),
    )
    found = list(frames)
    assert [frame.index for frame in found] == [4, 7, 10]
    assert found[0].picture.shape == (80, 80)
    assert found[0].camera.focal == pytest.approx(film.camera.focal * 80 / 120)
    about = found[0].calibration  # in px of the frames of the source
    assert about.focal == pytest.approx(film.camera.focal)
    assert about.shape == film.frames[0].shape


def test_preset_alone_means_the_motion_of_the_camera(monkeypatch):
    taken = []
    monkeypatch.setattr(streaming, "_stream_frames", lambda *given: taken.append(given[3]))
    tisfm.reconstruct_stream(swing().frames, settings=Settings.preset("fast"))
    assert taken == [Settings.preset("fast", motion="camera")]


@pytest.mark.parametrize(
    ("options", "error", "told"),
    [
        ({"delay": 5}, ValueError, "delay is 5"),
        ({"delay": 9.5}, TypeError, "delay is 9.5"),
        ({"settings": Settings.preset("fast", motion="objects")}, ValueError, "motion"),
        ({"step": 0}, ValueError, "step"),
    ],
)
def test_wrong_arguments_are_refused_at_once(options, error, told):
    with pytest.raises(error, match=told):
        tisfm.reconstruct_stream(swing().frames, camera=Camera(focal=100.0), **options)
