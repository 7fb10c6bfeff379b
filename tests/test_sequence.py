"""Frames in, interpretations out: every kind of source, and what goes wrong with each."""

import gc
import random
import weakref
from dataclasses import replace
from itertools import repeat
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import ExifTags, Image

import tisfm
from tisfm.focal_guess import GuessedFocalWarning
from tisfm.formats import FormatError, write_png
from tisfm.rigid import pose_matrix
from tisfm.sequence import FramePair, FrameSource, _natural, with_poses

H, W = 24, 40
QUICK = tisfm.Settings(warps=1, outer_iterations=1, sweeps=2)


def make_frames(count, height=H, width=W):
    """Frames of a texture that moves by one pixel; they can be told apart."""
    noise = np.random.default_rng(3).uniform(0, 255, (height, width + count)).astype(np.float32)
    texture = cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 1.5), None, 0, 255, cv2.NORM_MINMAX)
    return [texture[:, count - k :][:, :width].astype(np.uint8) for k in range(count)]


FRAMES = make_frames(6)


@pytest.fixture
def folder(tmp_path):
    """A folder of five frames whose natural order is not the alphabetical one."""
    folder = tmp_path / "frames"
    folder.mkdir()
    for number, frame in zip((1, 2, 9, 10, 11), FRAMES, strict=False):
        write_png(folder / f"frame{number}.png", frame)
    return folder


def numbered(folder):
    return [folder / f"frame{number}.png" for number in (1, 2, 9, 10, 11)]


def make_video(path, codec, count=6):
    frames = make_frames(count, 48, 64)
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*codec), 10, (64, 48))
    if not writer.isOpened():
        pytest.skip(f"this build of OpenCV cannot write {codec} video")
    for frame in frames:
        writer.write(cv2.cvtColor(frame, cv2.COLOR_GRAY2BGR))
    writer.release()
    return frames


@pytest.fixture(params=[("video.avi", "MJPG"), ("video.mp4", "mp4v")], ids=["MJPG", "mp4v"])
def video(request, tmp_path):
    name, codec = request.param
    return tmp_path / name, make_video(tmp_path / name, codec)


def check_frames(source, expected, step=1):
    """Check the frames of a source, pair by pair, and return the names of the pairs."""
    pairs = list(FrameSource(source, step=step))
    assert len(pairs) == len(expected) - 1
    for pair, frame0, frame1 in zip(pairs, expected[:-1], expected[1:], strict=True):
        np.testing.assert_array_equal(pair.frame0, frame0)
        np.testing.assert_array_equal(pair.frame1, frame1)
    assert [pair.name1 for pair in pairs[:-1]] == [pair.name0 for pair in pairs[1:]]
    return [pair.name0 for pair in pairs]


# Sources


@pytest.mark.parametrize("as_text", [str, Path])
def test_a_folder_is_read_in_natural_order(folder, as_text):
    names = check_frames(as_text(folder), FRAMES[:5])
    assert names == ["frame1", "frame2", "frame9", "frame10"]


def test_what_is_no_picture_is_left_aside(folder):
    (folder / "notes.txt").write_text("no picture")
    (folder / "._frame1.png").write_bytes(b"what another system leaves behind")
    check_frames(folder, FRAMES[:5])


def test_suffixes_may_be_upper_case(folder):
    (folder / "frame2.png").rename(folder / "frame2.PNG")
    check_frames(folder, FRAMES[:5])


def test_a_pattern_is_read_in_natural_order(folder):
    assert check_frames(str(folder / "frame*.png"), FRAMES[:5])[2:] == ["frame9", "frame10"]
    check_frames(str(folder / "frame1?.png"), FRAMES[3:5])


def test_a_pattern_leaves_folders_aside(folder):
    (folder / "frame5.png").mkdir()
    check_frames(str(folder / "frame*"), FRAMES[:5])


def test_a_path_with_brackets_is_no_pattern(folder):
    odd = folder.rename(folder.with_name("frames [1] *"))
    check_frames(str(odd), FRAMES[:5])


def test_a_list_of_paths_keeps_its_order(folder):
    files = numbered(folder)
    for listed in (files[::-1], tuple(map(str, files[::-1]))):
        assert check_frames(listed, FRAMES[:5][::-1])[0] == "frame11"


@pytest.mark.parametrize(
    "source",
    [FRAMES, tuple(FRAMES), np.stack(FRAMES), np.stack([np.dstack([f] * 3) for f in FRAMES])],
    ids=["list", "tuple", "(N, H, W)", "(N, H, W, 3)"],
)
def test_arrays(source):
    assert len(FrameSource(source)) == 5
    assert check_frames(source, list(source))[-1] == "frame_000004"


def test_a_generator():
    assert check_frames((frame for frame in FRAMES), FRAMES)[0] == "frame_000000"
    with pytest.raises(TypeError, match="not known before"):
        len(FrameSource(iter(FRAMES)))


def test_a_source_that_is_not_used_up_can_be_read_again(folder):
    for source in (FrameSource(folder), FrameSource(FRAMES)):
        assert len(list(source)) == len(list(source)) > 1


def test_a_video(video):
    path, frames = video
    source = FrameSource(path)
    pairs = list(source)
    assert len(pairs) == len(source) == 5
    for pair, frame in zip(pairs, frames, strict=False):
        # Compression changes grey levels; another frame would differ by far more.
        assert np.abs(pair.frame0.astype(float) - frame[..., None]).mean() < 8
        assert pair.frame0.shape == (48, 64, 3)
    assert [pair.name0 for pair in pairs][:2] == ["video_000000", "video_000001"]


def test_colours_of_a_video_are_red_green_blue(tmp_path):
    path = str(tmp_path / "red.avi")
    writer = cv2.VideoWriter(path, cv2.VideoWriter_fourcc(*"MJPG"), 10, (64, 48))
    if not writer.isOpened():
        pytest.skip("this build of OpenCV cannot write MJPG video")
    for _ in range(2):
        writer.write(np.full((48, 64, 3), (0, 0, 255), np.uint8))
    writer.release()
    (pair,) = FrameSource(path)
    red, green, blue = pair.frame0.mean((0, 1))
    assert red > 200 and green < 50 and blue < 50


def test_every_pair_is_interpreted(folder):
    camera = tisfm.Camera(50.0)
    results = list(tisfm.interpret_sequence(folder, camera=camera, settings=QUICK))
    assert len(results) == 4
    for result, frame0, frame1 in zip(results, FRAMES, FRAMES[1:], strict=False):
        expected = tisfm.interpret(frame0, frame1, camera=camera, settings=QUICK)
        np.testing.assert_array_equal(result.rho, expected.rho)
        assert result.camera == camera and result.settings == QUICK


# Every n-th frame


@pytest.mark.parametrize("step", [1, 2, 3, 4, np.int64(2)])
def test_step(folder, step):
    expected = FRAMES[:5][::step]
    assert len(FrameSource(folder, step=step)) == len(expected) - 1
    check_frames(folder, expected, step)
    names = check_frames(FRAMES[:5], expected, step)
    assert names == [f"frame_{k:06d}" for k in range(0, 5, step)][:-1]
    check_frames(iter(FRAMES[:5]), expected, step)


def test_step_of_a_video(video):
    path, _ = video
    every = list(FrameSource(path))
    second = list(FrameSource(path, step=2))
    assert [pair.name0 for pair in second] == ["video_000000", "video_000002"]
    assert len(FrameSource(path, step=2)) == 2
    np.testing.assert_array_equal(second[1].frame0, every[2].frame0)
    np.testing.assert_array_equal(second[1].frame1, every[4].frame0)


def test_files_between_are_not_read(folder):
    (folder / "frame2.png").write_bytes(b"damaged")
    check_frames(folder, FRAMES[:5][::2], step=2)


@pytest.mark.parametrize("step", [0, -1, 1.0, "2", True, None], ids=repr)
def test_step_must_be_a_positive_integer(step):
    with pytest.raises(ValueError, match=r"step is .*expected a positive integer"):
        tisfm.interpret_sequence(FRAMES, step=step)


def test_step_beyond_the_end(folder):
    with pytest.raises(ValueError, match="has 5 frames: expected at least 6"):
        FrameSource(folder, step=5)


# Memory


class Counted:
    """A generator's frames, counted while any part of the program still holds them."""

    def __init__(self, count):
        self.count, self.made, self.alive, self.most = count, 0, 0, 0

    def __iter__(self):
        for k in range(self.count):
            # A new array each time: with a copy kept here, it would be alive for that reason.
            yield self._make(k)

    def _make(self, k):
        frame = FRAMES[k % len(FRAMES)].copy()
        self.made += 1
        self.alive += 1
        self.most = max(self.most, self.alive)
        weakref.finalize(frame, self._gone)
        return frame

    def _gone(self):
        self.alive -= 1


@pytest.mark.parametrize("step", [1, 3])
def test_two_frames_are_alive_at_a_time(step):
    frames = Counted(12)
    gc.disable()  # what only the collector frees would be held in a cycle
    try:
        results = tisfm.interpret_sequence(frames, settings=QUICK, step=step)
        for _ in results:
            pass
    finally:
        gc.enable()
    assert frames.made == 12
    assert frames.most == 2
    assert frames.alive == 0


def test_frames_are_taken_as_they_are_needed():
    frames = Counted(12)
    results = tisfm.interpret_sequence(frames, settings=QUICK)
    assert frames.made == 0
    next(results)
    assert frames.made == 2
    next(results)
    assert frames.made == 3
    results.close()


def test_a_sequence_without_end():
    def forever():
        while True:
            yield from FRAMES

    results = tisfm.interpret_sequence(forever(), settings=QUICK)
    assert [next(results).status for _ in range(3)]


# Errors at once


@pytest.mark.parametrize("interpret", [FrameSource, tisfm.interpret_sequence])
@pytest.mark.parametrize(
    ("source", "words"),
    [
        ("{folder}/gone", "there is no file or folder"),
        ("{folder}/gone.png", "there is no file or folder"),
        ("{folder}/gone.mp4", "there is no file or folder"),
        ("{folder}/gone*.png", "no file matches"),
        ("{empty}", "has no images: expected files ending in"),
        (["{folder}/frame1.png", "{folder}/gone.png"], "there is no file"),
    ],
    ids=str,
)
def test_what_does_not_exist_is_named_at_once(folder, tmp_path, interpret, source, words):
    (tmp_path / "empty").mkdir()
    (tmp_path / "empty" / "readme.txt").write_text("no picture")
    places = {"folder": folder, "empty": tmp_path / "empty"}
    if isinstance(source, str):
        source = source.format(**places)
        named = source
    else:
        source = [item.format(**places) for item in source]
        named = source[-1]
    with pytest.raises(FileNotFoundError, match=words) as caught:
        interpret(source)
    assert named in str(caught.value) and "\n" not in str(caught.value)


def test_a_single_frame_is_no_pair(folder):
    for source in (
        str(folder / "frame1.png"),
        str(folder / "frame1.p*"),
        [folder / "frame1.png"],
        FRAMES[:1],
        np.stack(FRAMES[:1]),
    ):
        with pytest.raises(ValueError, match="has 1 frame: expected at least 2, to make a pair"):
            tisfm.interpret_sequence(source)


@pytest.mark.parametrize("source", [[], (), np.zeros((0, H, W))], ids=repr)
def test_no_frame_is_no_pair(source):
    with pytest.raises(ValueError, match="has 0 frames: expected at least 2"):
        tisfm.interpret_sequence(source)


@pytest.mark.parametrize("count", [0, 1])
def test_a_generator_may_end_too_early(count):
    results = tisfm.interpret_sequence(iter(FRAMES[:count]))
    with pytest.raises(ValueError, match="ended before there was a pair"):
        next(results)


def test_a_folder_of_one_picture(folder):
    for file in numbered(folder)[1:]:
        file.unlink()
    with pytest.raises(ValueError, match="has 1 frame: expected at least 2"):
        tisfm.interpret_sequence(folder)


@pytest.mark.parametrize("source", [None, 3, 2.5, np.float32(1)], ids=repr)
def test_what_is_no_source(source):
    with pytest.raises(TypeError, match="expected a path, a list of paths, or an iterable"):
        tisfm.interpret_sequence(source)


@pytest.mark.parametrize("shape", [(), (40,), (24, 40), (2, 2, 24, 40, 3)], ids=str)
def test_an_array_of_another_shape_is_no_source(shape):
    with pytest.raises(ValueError, match=r"frames is .*expected \(N, H, W\)"):
        tisfm.interpret_sequence(np.zeros(shape))


@pytest.mark.parametrize("name", ["text.mp4", "text.txt", "text"])
@pytest.mark.parametrize("content", [b"no video\n" * 20, b""], ids=["text", "empty"])
def test_what_is_no_video_is_named_at_once(tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(ValueError, match=r"is not an image or a video that OpenCV can read") as e:
        tisfm.interpret_sequence(tmp_path / name)
    assert str(tmp_path / name) in str(e.value)


def test_a_video_of_one_frame(tmp_path):
    make_video(tmp_path / "short.avi", "MJPG", count=1)
    with pytest.raises(ValueError, match="has 1 frame: expected at least 2"):
        tisfm.interpret_sequence(tmp_path / "short.avi")


# Errors on the way


def results_until_error(source, error):
    """Return how many results came before the error, and its text."""
    results = tisfm.interpret_sequence(source, settings=QUICK)
    count = 0
    with pytest.raises(error) as caught:
        for _ in results:
            count += 1
    assert "\n" not in str(caught.value)
    return count, str(caught.value)


@pytest.mark.parametrize("kept", [0, 20, 0.5, 0.9])
def test_earlier_pairs_come_out_before_a_damaged_picture(folder, kept):
    file = folder / "frame10.png"
    data = file.read_bytes()
    file.write_bytes(data[: int(kept if kept >= 1 else kept * len(data))])
    count, text = results_until_error(folder, FormatError)
    assert count == 2
    assert "frame10.png" in text


def test_a_folder_in_a_list_of_files(folder):
    count, text = results_until_error([*numbered(folder)[:2], folder], IsADirectoryError)
    assert count == 1 and str(folder) in text


def test_a_picture_that_vanishes(folder):
    results = tisfm.interpret_sequence(folder, settings=QUICK)
    next(results)
    (folder / "frame9.png").unlink()
    with pytest.raises(FileNotFoundError, match=r"frame9\.png"):
        next(results)


def test_frames_of_different_sizes_are_both_named(folder):
    write_png(folder / "frame10.png", FRAMES[0][:, :-1])
    count, text = results_until_error(folder, ValueError)
    assert count == 2
    for word in ("frame9", "frame10", "(24, 39)", "(24, 40)"):
        assert word in text


def test_frames_of_different_types_are_both_named(folder):
    write_png(folder / "frame10.png", FRAMES[0].astype(np.uint16))
    count, text = results_until_error(folder, TypeError)
    assert count == 2
    for word in ("frame9", "frame10", "uint16", "uint8"):
        assert word in text


def test_arrays_that_are_no_frames_are_numbered():
    bad = FRAMES[2].astype(float)
    bad[0, 0] = np.nan
    frames = [frame.astype(float) for frame in FRAMES[:2]] + [bad]
    count, text = results_until_error(frames, ValueError)
    assert count == 1
    assert "frames frame_000001 and frame_000002: frame1 is NaN" in text


def test_paths_must_come_as_a_list(folder):
    count, text = results_until_error(folder.glob("*.png"), TypeError)
    assert count == 0
    assert "give paths as a list, in the order of the frames" in text


def test_errors_of_the_generator_pass():
    def broken():
        yield from FRAMES[:3]
        raise OSError("the camera was unplugged")

    count, text = results_until_error(broken(), OSError)
    assert (count, text) == (2, "the camera was unplugged")


def test_a_video_that_is_cut_off(tmp_path):
    path = tmp_path / "video.avi"
    make_video(path, "MJPG", count=12)
    path.write_bytes(path.read_bytes()[: int(0.6 * path.stat().st_size)])
    count, text = results_until_error(path, ValueError)
    assert 1 <= count <= 8
    assert str(path) in text and "of 12 frames" in text and "cut off" in text


def test_a_video_without_its_end(tmp_path):
    path = tmp_path / "video.mp4"
    make_video(path, "mp4v")
    path.write_bytes(path.read_bytes()[: int(0.6 * path.stat().st_size)])
    with pytest.raises(ValueError, match=r"not an image or a video"):  # its index stood at the end
        tisfm.interpret_sequence(path)


# Names


def test_names_that_collide_are_numbered(tmp_path):
    files = []
    for name in ("left/a.png", "right/a.png", "right/b.png"):
        file = tmp_path / name
        file.parent.mkdir(exist_ok=True)
        write_png(file, FRAMES[len(files)])
        files.append(file)
    assert check_frames(files, FRAMES[:3]) == ["000000_a", "000001_a"]
    assert check_frames(files[1:], FRAMES[1:3]) == ["a"]


def test_the_same_file_twice(folder):
    file = folder / "frame1.png"
    assert check_frames([file, file, file], [FRAMES[0]] * 3) == ["000000_frame1", "000001_frame1"]


def test_suffixes_do_not_tell_frames_apart(folder):
    cv2.imwrite(str(folder / "frame1.bmp"), FRAMES[5])
    names = [pair.name0 for pair in FrameSource(folder)]
    assert len(set(names)) == len(names) == 5
    assert all(name.split("_")[0].isdecimal() for name in names)


names = st.lists(st.text("ab1029-_.²٣", min_size=1, max_size=8), min_size=1, max_size=8)


@given(names=names, seed=st.integers(0, 10))
def test_natural_order_does_not_depend_on_the_order_before(names, seed):
    paths = [Path("folder") / name for name in names]
    shuffled = random.Random(seed).sample(paths, len(paths))
    assert sorted(paths, key=_natural) == sorted(shuffled, key=_natural)


@given(numbers=st.lists(st.integers(0, 10**6), min_size=2, unique=True))
def test_natural_order_is_that_of_the_numbers(numbers):
    ordered = sorted((Path(f"x{number}.png") for number in numbers), key=_natural)
    assert ordered == [Path(f"x{number}.png") for number in sorted(numbers)]


def test_natural_order_of_names_with_several_numbers():
    names = ["a2b10", "a10b1", "a2b9", "a02b9", "b1", "a", "2", "10"]
    ordered = [path.name for path in sorted(map(Path, names), key=_natural)]
    assert ordered == ["2", "10", "a", "a02b9", "a2b9", "a2b10", "a10b1", "b1"]


def test_a_pair_is_known_by_its_pixels():
    def digest(frame0, frame1):
        (pair,) = FrameSource([frame0, frame1])
        return pair.digest

    first = digest(FRAMES[0], FRAMES[1])
    assert first == digest(FRAMES[0].copy(), np.asfortranarray(FRAMES[1]))
    changed = FRAMES[1].copy()
    changed[3, 5] += 1
    others = [
        digest(FRAMES[1], FRAMES[0]),
        digest(FRAMES[0], changed),
        digest(FRAMES[0].view(np.int8), FRAMES[1].view(np.int8)),
        digest(FRAMES[0].reshape(W, H), FRAMES[1].reshape(W, H)),
    ]
    assert len({first, *others}) == 5


# Rigid motions


CAMERA_MOTION = tisfm.Settings(motion="camera", warps=1, outer_iterations=1, sweeps=2)
TURNS = [pose_matrix((0, 0, 0, 0, 0.001 * k, 0)) for k in range(5)]


@pytest.fixture
def asked(monkeypatch):
    """The cameras and poses that interpretations are asked for, without the work."""
    from tisfm import pair

    seen = []
    original = pair.interpret

    def interpret(frame0, frame1, *, camera, settings, pose):
        seen.append((camera, pose))
        plain = replace(settings, motion="field")
        camera = camera or tisfm.Camera(1.2 * max(frame0.shape))
        return original(frame0, frame1, camera=camera, settings=plain)

    monkeypatch.setattr(pair, "interpret", interpret)
    return seen


def gradually(items):
    yield from items


@pytest.mark.parametrize("kind", [list, tuple, np.stack, gradually])
@pytest.mark.parametrize("source", [list, gradually])
def test_every_pair_has_its_pose(asked, kind, source):
    camera = tisfm.Camera(50.0)
    poses, frames = kind(TURNS[:4]), source(FRAMES[:5])
    results = tisfm.interpret_sequence(frames, camera=camera, settings=CAMERA_MOTION, poses=poses)
    assert len(list(results)) == 4
    for (given_camera, pose), expected in zip(asked, TURNS, strict=False):
        assert given_camera is camera
        np.testing.assert_array_equal(pose, expected)


def test_a_pose_changes_the_result():
    camera, settings = tisfm.Camera(50.0), CAMERA_MOTION
    poses = [pose_matrix((0.1 * k, 0, 0.1, 0, 0.001, 0)) for k in (1, 2)]
    results = tisfm.interpret_sequence(FRAMES[:3], camera=camera, settings=settings, poses=poses)
    for k, result in enumerate(results):
        expected = tisfm.interpret(
            FRAMES[k], FRAMES[k + 1], camera=camera, settings=settings, pose=poses[k]
        )
        np.testing.assert_array_equal(result.inverse_depth, expected.inverse_depth)
        np.testing.assert_allclose(pose_matrix(result.motions[0])[:3, :3], poses[k][:3, :3])


def test_poses_need_not_end(asked):
    results = tisfm.interpret_sequence(
        FRAMES[:4], camera=tisfm.Camera(), settings=CAMERA_MOTION, poses=repeat(np.eye(3))
    )
    assert len(list(results)) == len(asked) == 3


@pytest.mark.parametrize("number", [0, 1, 3, 5])
def test_another_number_of_poses_is_said_at_once(number):
    with pytest.raises(ValueError, match=rf"poses are {number}, but there are 2 pairs of frames"):
        tisfm.interpret_sequence(FRAMES[:3], settings=CAMERA_MOTION, poses=TURNS[:1] * number)


def test_poses_are_counted_by_steps(asked):
    options = {"camera": tisfm.Camera(), "settings": CAMERA_MOTION, "step": 2}
    assert len(list(tisfm.interpret_sequence(FRAMES[:5], poses=TURNS[:2], **options))) == 2
    with pytest.raises(ValueError, match="poses are 4, but there are 2 pairs"):
        tisfm.interpret_sequence(FRAMES[:5], poses=TURNS[:4], **options)
    with pytest.raises(ValueError, match="but there is 1 pair of frames"):
        tisfm.interpret_sequence(FRAMES[:2], settings=CAMERA_MOTION, poses=TURNS[:2])


@pytest.mark.parametrize("source", [list, gradually])
def test_poses_that_end_early_are_said_when_they_do(asked, source):
    results = tisfm.interpret_sequence(
        source(FRAMES[:4]),
        camera=tisfm.Camera(),
        settings=CAMERA_MOTION,
        poses=gradually(TURNS[:2]),
    )
    assert [next(results).status for _ in range(2)]
    with pytest.raises(
        ValueError, match="poses ended before frames frame_000002 and frame_000003, after 2"
    ):
        next(results)


def test_poses_that_are_left_over_are_said_at_the_end(asked):
    results = tisfm.interpret_sequence(
        gradually(FRAMES[:3]), camera=tisfm.Camera(), settings=CAMERA_MOTION, poses=TURNS[:4]
    )
    assert [next(results).status for _ in range(2)]
    with pytest.raises(ValueError, match="poses are 4, but there are 2 pairs of frames"):
        next(results)


def test_a_video_may_announce_too_many_frames(video, asked):
    """What it announces is not compared with the number of poses; what it holds is."""
    path, frames = video
    source = FrameSource(path)
    assert source.count is None and len(source) == 5
    source._announced += 2
    pairs = list(with_poses(source, TURNS[: len(frames) - 1]))
    assert len(pairs) == 5 and all(pair.pose is not None for pair in pairs)


@pytest.mark.parametrize(
    ("poses", "error", "words"),
    [
        (np.eye(4), ValueError, r"poses is \(4, 4\): expected one for every pair"),
        (3, TypeError, "poses is 3: expected a 4×4 or 3×3 array for every pair"),
    ],
)
def test_what_are_no_poses(poses, error, words):
    with pytest.raises(error, match=words):
        tisfm.interpret_sequence(FRAMES[:2], settings=CAMERA_MOTION, poses=poses)


def test_a_wrong_pose_names_its_frames():
    results = tisfm.interpret_sequence(
        FRAMES[:3], camera=tisfm.Camera(), settings=CAMERA_MOTION, poses=[np.eye(3), np.eye(2)]
    )
    next(results)
    with pytest.raises(ValueError, match="frames frame_000001 and frame_000002: pose has the sha"):
        next(results)


@pytest.mark.parametrize("motion", ["field", "objects"])
def test_poses_are_for_rigid_motions(motion):
    with pytest.raises(ValueError, match=f'poses are given, but motion="{motion}"'):
        tisfm.interpret_sequence(
            FRAMES[:3], settings=tisfm.Settings(motion=motion), poses=TURNS[:2]
        )


def test_a_pair_is_known_by_its_pose_as_well():
    plain, turned, other = (
        FramePair(name0="a", name1="b", frame0=FRAMES[0], frame1=FRAMES[1], pose=pose)
        for pose in (None, TURNS[1], TURNS[2])
    )
    again = replace(plain, pose=TURNS[1].tolist())
    assert len({plain.digest, turned.digest, other.digest}) == 3
    assert again.digest == turned.digest


def test_two_frames_are_alive_at_a_time_with_poses(asked):
    frames = Counted(12)
    gc.disable()
    try:
        for _ in tisfm.interpret_sequence(
            frames, camera=tisfm.Camera(), settings=CAMERA_MOTION, poses=repeat(np.eye(3))
        ):
            pass
    finally:
        gc.enable()
    assert frames.most == 2 and frames.alive == 0


@pytest.mark.parametrize("source", [list, gradually])
def test_the_focal_length_is_guessed_once(source):
    with pytest.warns(GuessedFocalWarning) as caught:
        results = list(tisfm.interpret_sequence(source(FRAMES[:4]), settings=CAMERA_MOTION))
    assert len(caught) == 1 and "48 px" in str(caught[0].message)
    assert {result.camera for result in results} == {tisfm.Camera(1.2 * W)}


def test_the_focal_length_is_guessed_from_the_first_file(folder, recwarn):
    exif = Image.Exif()
    exif[ExifTags.IFD.Exif] = {ExifTags.Base.FocalLengthIn35mmFilm: 50}
    Image.fromarray(FRAMES[0]).save(folder / "frame1.png", exif=exif.tobytes())
    results = list(tisfm.interpret_sequence(folder, settings=CAMERA_MOTION))
    guesses = [w for w in recwarn if w.category is GuessedFocalWarning]
    assert len(results) == 4 and len(guesses) == 1 and "50 mm" in str(guesses[0].message)
    focal = 50 * np.hypot(H, W) / np.hypot(24, 36)
    assert [result.camera.focal for result in results] == pytest.approx([focal] * 4)


@pytest.mark.parametrize(
    ("camera", "motion"), [(tisfm.Camera(50.0), "camera"), (None, "field")], ids=["given", "field"]
)
def test_nothing_is_guessed_needlessly(folder, recwarn, camera, motion):
    settings = replace(CAMERA_MOTION, motion=motion)
    results = list(tisfm.interpret_sequence(folder, camera=camera, settings=settings))
    assert {result.camera for result in results} == {camera or tisfm.Camera()}
    assert not [w for w in recwarn if w.category is GuessedFocalWarning]
