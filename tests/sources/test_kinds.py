"""Every kind of source: its frames, their names and their order."""

import random
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import tisfm
from tests.sources.made import FRAMES, H, W, check_frames, numbered
from tisfm.formats import write_png
from tisfm.formats.image_names import natural_sort_key
from tisfm.sources import FrameSource

# Sources


@pytest.mark.parametrize("as_text", [str, Path])
def test_a_folder_is_read_in_natural_order(folder, as_text):
    names = check_frames(as_text(folder), FRAMES[:5])
    assert names == ["frame1", "frame2", "frame9", "frame10"]


def test_other_files_are_ignored(folder):
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


def test_an_existing_path_with_brackets_is_no_pattern(folder):
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
    assert sorted(paths, key=natural_sort_key) == sorted(shuffled, key=natural_sort_key)


@given(numbers=st.lists(st.integers(0, 10**6), min_size=2, unique=True))
def test_natural_order_is_that_of_the_numbers(numbers):
    ordered = sorted((Path(f"x{number}.png") for number in numbers), key=natural_sort_key)
    assert ordered == [Path(f"x{number}.png") for number in sorted(numbers)]


def test_natural_order_of_names_with_several_numbers():
    names = ["a2b10", "a10b1", "a2b9", "a02b9", "b1", "a", "2", "10"]
    ordered = [path.name for path in sorted(map(Path, names), key=natural_sort_key)]
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
