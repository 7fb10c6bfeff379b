"""`tisfm.reconstruct_stream`: it yields frames with poses and depth, and keeps few frames."""

import tempfile
from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest

import tisfm
from tests.draws import nightly_except
from tests.reconstruction.films import depth_error, path_error
from tests.rendered import room_film
from tisfm import Camera, Settings
from tisfm.reconstruction.mapping import models as mapping
from tisfm.reconstruction.streaming import entry as streaming
from tisfm.reconstruction.streaming import stream
from tisfm.reconstruction.streaming.sliding_path import FIXED_VIEWS, MIN_FIXED_VIEWS, SlidingPath
from tisfm.reconstruction.streaming.stream import Stream
from tisfm.sources import FrameSource

FAST = Settings.preset("fast", motion="camera")
COUNT, DELAY = 36, 12


@cache
def swing(count=COUNT, seed=0):
    """Return a small film of a camera that swings sideways while it moves."""
    poses = np.tile(np.eye(4), (count, 1, 1))
    for k in range(count):
        phase = 2 * np.pi * k / 50
        poses[k, :3, :3] = cv2.Rodrigues(np.array([0.0, 0.25 * np.sin(phase), 0.0]))[0]
        poses[k, :3, 3] = 1.2 * np.sin(phase), 0.1 * np.sin(2 * phase), 0.02 * k
    return room_film(poses, 120, 160, samples=2, seed=seed)


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


@pytest.fixture(scope="module")
def streamed():
    """Return the frames of a stream, and how many frames were read when each was yielded."""
    film, read = swing(), []
    source, found = Counted(film.frames), []
    frames = tisfm.reconstruct_stream(source, camera=film.camera, settings=FAST, delay=DELAY)
    for frame in frames:
        found.append(frame)
        read.append(source.read)
    return found, read


@pytest.fixture(scope="module")
def whole():
    film = swing()
    return tisfm.reconstruct(film.frames, camera=film.camera, settings=FAST)


def poses_of(found):
    return np.array([frame.pose for frame in found])


def test_every_frame_is_given_out_once_and_in_order(streamed):
    found, _ = streamed
    assert [frame.index for frame in found] == list(range(COUNT))
    assert [frame.name for frame in found] == [f"frame_{k:06d}" for k in range(COUNT)]
    for frame, image in zip(found, swing().frames, strict=True):
        assert frame.status == "converged" and frame.piece == 0
        assert frame.pose.shape == (4, 4) and frame.pose.dtype == np.float64
        assert frame.inverse_depth.dtype == frame.inverse_depth_std.dtype == np.float32
        assert frame.inverse_depth.shape == frame.inverse_depth_std.shape == image.shape
        assert np.abs(frame.picture.astype(float) - image).mean() < 2  # it is a JPEG
        assert frame.camera == swing().camera
    assert 3 <= sum(frame.keyframe for frame in found) < COUNT / 2
    assert found[0].keyframe


def test_no_frame_waits_for_more_than_the_delay(streamed):
    _, read = streamed
    waited = [count - 1 - k for k, count in enumerate(read)]
    assert max(waited) == DELAY
    assert min(waited[: COUNT - DELAY]) > 0  # some frames are read ahead


def test_the_path_is_nearly_that_of_the_whole(streamed, whole):
    found, _ = streamed
    np.testing.assert_allclose(found[0].pose, np.eye(4), atol=1e-12)
    error = path_error(poses_of(found), swing().poses)
    assert error < 0.01
    assert error < 2 * path_error(whole.poses, swing().poses)


def test_the_scale_stays_from_chunk_to_chunk(streamed, whole):
    found, _ = streamed
    ways = [
        np.linalg.norm(np.diff(p[:, :3, 3], axis=0), axis=1) for p in (poses_of(found), whole.poses)
    ]
    chunks = [np.median(part) for part in np.array_split(ways[0] / ways[1], 4)]
    assert max(chunks) < 1.03 * min(chunks)
    # The unit is the same: the median depth of the first keyframe.
    assert np.nanmedian(found[0].depth) == pytest.approx(1, abs=1e-3)
    ratio = [np.nanmedian(found[k].depth / whole.depth(k)) for k in range(COUNT)]
    np.testing.assert_allclose(ratio, 1, atol=0.05)


def test_depth_is_as_good_as_that_of_the_whole(streamed, whole):
    found, _ = streamed
    true = swing().depth
    scale = np.median([np.nanmedian(true[k] / found[k].depth) for k in range(COUNT)])
    errors = [depth_error(found[k].depth, true[k], scale) for k in range(COUNT)]
    others = [depth_error(whole.depth(k), true[k], scale) for k in range(COUNT)]
    assert np.median(errors) < 1.2 * np.median(others)
    assert max(errors) < 0.35


def test_it_is_the_same_every_time_even_if_the_caller_overwrites_its_frames(streamed):
    found, _ = streamed
    film = swing()
    again = tisfm.reconstruct_stream(film.frames, camera=film.camera, settings=FAST, delay=DELAY)
    for _, one, other in zip(range(16), found, again, strict=False):
        np.testing.assert_array_equal(one.pose, other.pose)
        np.testing.assert_array_equal(one.inverse_depth, other.inverse_depth)
        np.testing.assert_array_equal(one.inverse_depth_std, other.inverse_depth_std)
        for values in (other.pose, other.inverse_depth, other.inverse_depth_std, other.picture):
            values[...] = 0
    again.close()


def test_known_poses_stay_as_they_are(monkeypatch):
    film = swing()
    path = SlidingPath(film.camera)
    for image in film.frames[:16]:
        path.add(image)
    begun = path.solve().pieces[0]
    path.fix_poses(10, {0: begun})
    for image in film.frames[16:24]:
        path.add(image)
    seen = []

    def spied(database, known, real=mapping.grow_from_poses):
        seen.append((real(database, known), known))
        return seen[-1][0]

    monkeypatch.setattr(mapping, "grow_from_poses", spied)
    stretch = path.solve()
    ((model, known),) = seen
    assert len(known) >= MIN_FIXED_VIEWS and model.num_reg_images() > len(known)
    for number, pose in known.items():
        np.testing.assert_allclose(model.frame(number).rig_from_world.matrix(), pose, atol=1e-12)
    piece = stretch.pieces[0]
    for frame in range(11):
        np.testing.assert_array_equal(piece.poses[frame], begun.poses[frame])
    assert sorted(piece.poses) == list(range(24)) and not stretch.lost


def test_memory_and_disk_hold_the_last_frames_only(disk, monkeypatch):
    monkeypatch.setattr(stream, "DEPTH", replace(stream.DEPTH, max_frame_distance=8))
    film = swing()
    running = Stream(FrameSource(film.frames), film.camera, "nothing", FAST, DELAY)
    kept, views, files, points = [], [], [], []
    for _ in running.frames():
        path = running._path
        kept.append(len(path.seen.frames()))
        views.append(len(path._views.views))
        files.append(sum(item.is_file() for item in disk.rglob("*")))
        points.append(sum(len(poses) for poses in path._fixed.values()))
    # One keyframe may be older.
    most = DELAY + 1 + 8 + 1
    assert most - 4 <= max(kept) <= most and max(files) <= 2 * most
    assert max(views) <= FIXED_VIEWS + DELAY + 1 < COUNT
    assert max(points) <= most + FIXED_VIEWS
    assert list(disk.iterdir()) == []


def test_closed_early_it_leaves_nothing(disk):
    film = swing()
    source = Counted(film.frames)
    frames = tisfm.reconstruct_stream(source, camera=film.camera, settings=FAST, delay=DELAY)
    assert list(disk.iterdir()) == [] and source.read == 0  # no work before the first request
    next(frames)
    assert len(list(disk.iterdir())) == 1
    frames.close()
    assert list(disk.iterdir()) == [] and source.closed
    assert source.read == DELAY + 1


def test_what_was_read_before_an_error_is_given_out(disk):
    film = swing()

    def broken():
        yield from film.frames[:20]
        raise OSError("the plug was pulled")

    found = []
    with pytest.raises(OSError, match="plug"):
        for frame in tisfm.reconstruct_stream(
            broken(), camera=film.camera, settings=FAST, delay=DELAY
        ):
            found.append(frame)
    assert [frame.index for frame in found] == list(range(20))
    assert path_error(poses_of(found), film.poses[:20]) < 0.02
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
def test_frames_before_one_that_is_none_are_given_out(disk, wrong, error, told):
    film, found = swing(), []
    images = [*film.frames[:8], wrong(film.frames[8]), *film.frames[9:12]]
    with pytest.raises(error, match=told):
        for frame in tisfm.reconstruct_stream(
            images, camera=film.camera, settings=FAST, delay=DELAY
        ):
            found.append(frame)
    assert [frame.index for frame in found] == list(range(8))
    assert list(disk.iterdir()) == []


@pytest.mark.parametrize("count", [0, 1])
def test_a_stream_needs_two_frames(disk, count):
    film = swing()
    with pytest.raises(ValueError, match="expected at least 2"):
        list(tisfm.reconstruct_stream(iter(film.frames[:count]), camera=film.camera))
    assert list(disk.iterdir()) == []


def test_two_frames_that_are_the_same_have_no_pose():
    film = swing()
    found = list(tisfm.reconstruct_stream([film.frames[0]] * 2, camera=film.camera, settings=FAST))
    assert [frame.status for frame in found] == ["no_motion"] * 2
    assert [frame.piece for frame in found] == [-1, -1]
    assert np.isnan(poses_of(found)).all()
    assert np.isnan(found[0].depth).all() and np.isinf(found[0].inverse_depth_std).all()


@pytest.mark.slow
def test_after_a_cut_a_new_piece_begins():
    film, other = swing(), swing(seed=7)
    images = [*film.frames[:18], *other.frames[:18, :, ::-1].copy()]
    found = list(tisfm.reconstruct_stream(images, camera=film.camera, settings=FAST, delay=DELAY))
    assert [frame.piece for frame in found] == [0] * 18 + [1] * 18
    assert "a new piece begins" in found[18].status.message
    np.testing.assert_allclose(found[18].pose, np.eye(4), atol=1e-12)
    assert np.nanmedian(found[18].depth) == pytest.approx(1, abs=1e-3)
    assert path_error(poses_of(found[:18]), film.poses[:18]) < 0.02


@pytest.mark.slow
def test_frames_after_blanked_ones_are_in_the_same_piece():
    film = swing()
    images = film.frames.copy()
    images[16:21] = 0
    found = list(tisfm.reconstruct_stream(images, camera=film.camera, settings=FAST, delay=DELAY))
    blank = [frame.index for frame in found if frame.piece < 0]
    assert blank == list(range(16, 21))
    assert {found[k].status for k in blank} == {"no_texture"}
    seen = [k for k in range(COUNT) if k not in blank]
    assert path_error(poses_of(found)[seen], film.poses[seen]) < 0.02


@pytest.mark.slow
@pytest.mark.parametrize("rests", nightly_except(24, of=[24, 64]))
def test_a_camera_that_rests_keeps_its_scale(rests):
    """It rests for 64 frames, more than the stream keeps, or for fewer."""
    film = swing()
    random = np.random.default_rng(3)
    rest = film.frames[17] + random.normal(0, 1, (rests, *film.frames[17].shape))
    rest = rest.clip(0, 255).astype(np.uint8)
    images = [*film.frames[:17], *rest, *film.frames[18:]]
    true = np.array([*film.poses[:17], *[film.poses[17]] * rests, *film.poses[18:]])
    found = list(tisfm.reconstruct_stream(images, camera=film.camera, settings=FAST, delay=DELAY))
    assert {frame.piece for frame in found} == {0}
    assert path_error(poses_of(found), true) < 0.02


@pytest.mark.slow
def test_poses_are_adjusted_to_the_images_in_accurate():
    film = swing()
    found = {}
    for preset in ("balanced", "accurate"):
        settings = Settings.preset(preset, motion="camera")
        frames = tisfm.reconstruct_stream(
            film.frames[:24], camera=film.camera, settings=settings, delay=DELAY
        )
        found[preset] = poses_of(frames)
    turns = [poses[:, :3, :3] for poses in found.values()]  # rotations, for any unit
    assert (np.abs(turns[0] - turns[1]) > 1e-5).any(axis=(1, 2)).sum() > 16
    assert path_error(found["accurate"], film.poses[:24]) < 0.01


def test_masked_pixels_count_for_nothing_and_frames_are_chosen():
    film = swing()
    kept = np.ones(film.frames[0].shape, bool)
    kept[:, :40] = False
    images = film.frames.copy()
    # Pixels that do not move.
    images[:, :, :40] = np.random.default_rng(1).integers(0, 255, (120, 40))
    source = FrameSource(images, mask=kept, step=2, stop=24)
    running = Stream(source, film.camera, "nothing", FAST, 8)
    found = list(running.frames())
    assert [frame.index for frame in found] == list(range(0, 24, 2))
    assert path_error(poses_of(found), film.poses[:24:2]) < 0.04
    tracks = [seen.points for seen in running._path.seen]
    assert len(tracks) == 12 and min(points[:, 0].min() for points in tracks) > 39


def test_options_of_the_source_are_handed_on():
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


def test_a_preset_alone_means_the_motion_of_the_camera(monkeypatch):
    taken = []
    monkeypatch.setattr(streaming, "_streamed", lambda *given: taken.append(given[3]))
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
def test_what_it_cannot_do_is_refused_at_once(options, error, told):
    with pytest.raises(error, match=told):
        tisfm.reconstruct_stream(swing().frames, camera=Camera(focal=100.0), **options)
