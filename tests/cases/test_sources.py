"""Files that were read wrongly without a note, or refused with the wrong advice."""

import os
import random
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

import tisfm
from tests.cases.inputs import sliding, write_film, write_folder
from tisfm.formats.image_names import increasing_times, parse_times, sort_by_name
from tisfm.sources import FrameSource
from tisfm.sources.frame_reader import SourceWarning

FRAMES = sliding()
BEGIN = 1738133056


@pytest.fixture(params=["av", "opencv"])
def decoder(request, monkeypatch):
    pytest.importorskip("av")  # it writes the films
    if request.param == "opencv":
        monkeypatch.setattr("tisfm.sources.video.has_av", lambda: False)
    return request.param


def read(source):
    """Return the frames, names and times that are read, and the notes."""
    opened = FrameSource(source)
    frames = list(opened.frames())
    return [f.image for f in frames], [f.name for f in frames], [f.time for f in frames], opened


def refused(source, error=ValueError):
    """Return the text of the error for a source, one line."""
    with pytest.raises(error) as info:
        FrameSource(source)
    assert "\n" not in str(info.value)
    return str(info.value)


# Names that are times


def with_names(folder, names):
    """Write frames by these names, in any order of their files."""
    named = list(zip(names, FRAMES, strict=False))
    random.Random(0).shuffle(named)
    names, frames = zip(*named, strict=True)
    return write_folder(folder, frames, [f"{name}.png" for name in names])


def floats(count, step=0.05):
    return [f"{BEGIN + step * (k + 1)}" for k in range(count)]


def seconds_nanoseconds(count, step=50_000_000, begin=0):
    instants = [begin + k * step for k in range(count)]
    return [f"{BEGIN + at // 10**9}.{at % 10**9}" for at in instants]


def check_order(folder, times, reading):
    frames, _, found, opened = read(folder)
    for frame, expected in zip(frames, FRAMES, strict=True):
        np.testing.assert_array_equal(frame, expected)
    np.testing.assert_allclose(found, times, rtol=0, atol=1e-6)
    (note,) = opened.notes
    assert reading in note
    assert opened.times == tuple(found)


def test_names_with_seconds_as_floats(tmp_path):
    folder = with_names(tmp_path / "float_names", floats(6))
    check_order(folder, [BEGIN + 0.05 * (k + 1) for k in range(6)], "seconds with decimals")


def test_names_with_seconds_and_nanoseconds(tmp_path):
    names = seconds_nanoseconds(6)
    folder = with_names(tmp_path / "seconds_nanoseconds", names)
    times = [BEGIN + 0.05 * k for k in range(6)]
    check_order(folder, times, f"{BEGIN}.50000000 is 0.05 s after the full second")


def test_times_in_names_with_a_common_beginning_by_a_pattern(tmp_path):
    folder = with_names(tmp_path / "a", [f"frame_{name}" for name in floats(6)])
    check_order(f"{folder}/*.png", [BEGIN + 0.05 * (k + 1) for k in range(6)], "decimals")


def test_masks_are_in_the_same_order(tmp_path):
    folder = with_names(tmp_path / "masks", floats(6))
    opened = FrameSource(FRAMES, mask=folder)
    assert [file.stem for file in opened.mask_files] == floats(6)


@pytest.mark.parametrize(
    ("names", "reading"),
    [
        (seconds_nanoseconds(40, 33_366_701, 123), "nanoseconds"),
        (seconds_nanoseconds(12, 33_366_701, 980_000_000), "nanoseconds"),
        ([f"{k / 30}" for k in range(40)], "decimals"),
        ([f"{0.25 * k:g}" for k in range(9)], "decimals"),  # 0, 0.25, 0.5: no point in all
        ([f"{BEGIN}.{k:06d}" for k in range(0, 10**6, 10**5)], "decimals"),  # TUM's
        ([f"{BEGIN}{k:09d}" for k in range(0, 10**9, 10**8)], "integers"),  # EuRoC's
        ([f"{scene}.{k}" for scene in (1, 2) for k in range(1, 13)], None),  # numbers
        ([f"t{0.05 * k:g}" for k in range(1, 9)], "decimals"),
        ([f"{0.05 * k:g}" for k in range(-5, 9)], "decimals"),
        ([f"{0.05 * k:.2f}" for k in range(-5, 9)], "decimals"),
        ([f"t{0.05 * k:g}" for k in range(-5, 9)], "decimals"),
        ([str(1e-05), "0.05", "0.1", "0.15"], "decimals"),
        ([f"s01e{k:02d}" for k in range(8, 12)], None),
        ([f"take2.{k}" for k in range(8, 12)], None),
        ([f"1.{k}" for k in range(1, 17, 2)], None),
        ([f"take_2.{k}" for k in (*range(1, 10), 11, 12)], None),
        ([f"take2.{k}" for k in (8, 9, 11, 12)], None),
        ([f"take_2.{k:04d}" for k in range(8, 12)], None),
        ([f"{k}.{k * k}" for k in range(8, 12)], None),
        ([f"1{'0' * 400}.{k}" for k in (5, 25, 125)], None),  # beyond all floats
    ],
    ids=lambda value: value if isinstance(value, str) else value and str(value[:3]),
)  # fmt: skip
def test_reading_of_names(names, reading):
    found = parse_times(names)
    assert (None if found is None else found.notation) == reading
    assert (increasing_times(names) is None) == (reading is None)
    files = [Path(f"{name}.png") for name in reversed(names)]
    assert reading is None or sort_by_name(files) == files[::-1]


def test_note_says_that_numbers_are_not_read_as_times(tmp_path):
    (note,) = read(with_names(tmp_path / "a", [f"take2.{k}" for k in range(8, 14)]))[-1].notes
    assert "not read as times" in note and "take2.8 comes first, take2.13 last" in note


@given(
    st.integers(10**6, 2 * 10**9),
    st.integers(20_000_000, 150_000_000),
    st.lists(st.integers(80, 120), min_size=40, max_size=60),
)
def test_ros_clocks_are_read(second, usual, percent):
    """Nanoseconds have more even steps than decimals, if the steps vary by up to 20 %."""
    instants = np.cumsum(np.array(percent) * usual // 100)
    names = [f"{second + at // 10**9}.{at % 10**9}" for at in instants.tolist()]
    times = increasing_times(names)
    assert times is not None
    np.testing.assert_allclose(np.array(times) - second, instants / 1e9, rtol=0, atol=1e-5)


def test_list_in_another_order_than_its_names(tmp_path):
    """A shell gives such a list for a pattern that is not quoted."""
    folder = with_names(tmp_path / "a", seconds_nanoseconds(6))
    files = sorted(map(str, folder.iterdir()))
    (note,) = FrameSource(files).notes
    assert "in the order given" in note and "quote" in note


# Pictures that are left out


def test_pictures_that_cannot_be_read_are_named(tmp_path):
    folder = write_folder(tmp_path / "a", FRAMES[:3])
    for name in ("IMG_1.HEIC", "IMG_2.HEIC", "IMG_10.HEIC", "IMG_11.heic", ".IMG_12.heic"):
        (folder / name).write_bytes(b"no matter")
    (folder / "notes.txt").write_text("no picture")
    opened = FrameSource(folder)
    assert opened.count == 3
    (note,) = opened.notes
    assert "4 pictures" in note and "left out" in note and "convert them to PNG or JPEG" in note
    assert "IMG_1.HEIC, IMG_2.HEIC, IMG_10.HEIC and 1 more" in note


def test_folder_of_unreadable_pictures_alone(tmp_path):
    (tmp_path / "IMG_1.HEIC").write_bytes(b"no matter")
    text = refused(tmp_path, FileNotFoundError)
    assert "has no images" in text and "IMG_1.HEIC" in text and "convert" in text


def test_pictures_of_two_kinds(tmp_path):
    folder = write_folder(tmp_path / "a", FRAMES[:4])
    for k in range(2):
        cv2.imwrite(str(folder / f"f{k:03d}.jpg"), FRAMES[k])
    opened = FrameSource(folder)
    assert opened.count == 6
    (note,) = opened.notes
    assert "4 .png, 2 .jpg" in note and f"{folder}/*.png" in note


def test_pictures_of_one_kind_by_two_names(tmp_path):
    for k, suffix in enumerate((".jpg", ".JPG", ".jpeg")):
        cv2.imwrite(str(tmp_path / f"f{k}{suffix}"), FRAMES[k])
    assert FrameSource(tmp_path).notes == ()


def test_notes_are_warnings_of_python(tmp_path):
    folder = with_names(tmp_path / "float_names", floats(6))
    with pytest.warns(SourceWarning, match="seconds with decimals"):
        tisfm.interpret_sequence(folder)


# Folders, patterns and addresses


def test_brackets_in_a_path(tmp_path):
    folder = write_folder(tmp_path / "set [1]", FRAMES[:3])
    for source in (folder, f"{folder}/*.png", f"{folder}/f00[0-2].png", f"{folder}/f00?.png"):
        frames, *_, opened = read(source)
        np.testing.assert_array_equal(frames, FRAMES[:3])
        assert opened.notes == ()


def test_ambiguous_brackets(tmp_path):
    write_folder(tmp_path / "set [1]", FRAMES[:3])
    write_folder(tmp_path / "set 1", FRAMES[3:])
    frames, *_, opened = read(f"{tmp_path}/set [1]/*.png")
    np.testing.assert_array_equal(frames, FRAMES[3:])
    (note,) = opened.notes
    other = note.rpartition(" write ")[2]
    np.testing.assert_array_equal(read(other)[0], FRAMES[:3])


def test_pattern_with_brackets_that_matches_nothing(tmp_path):
    assert "[[]" in refused(f"{tmp_path}/set [1]*.png", FileNotFoundError)
    assert "there is no folder" in refused(f"{tmp_path}/nowhere/*.png", FileNotFoundError)


def test_folder_of_folders(tmp_path):
    write_folder(tmp_path / "parent" / "rgb", FRAMES[:3])
    text = refused(tmp_path / "parent", FileNotFoundError)
    assert str(tmp_path / "parent" / "rgb") in text
    write_folder(tmp_path / "parent" / "deep" / "er", FRAMES[:3])
    text = refused(tmp_path / "parent", FileNotFoundError)
    assert "parent/rgb" in text and "parent/deep/er" in text


def test_folder_of_videos(tmp_path):
    (tmp_path / "walk.mp4").write_bytes(b"no matter")
    assert "walk.mp4" in refused(tmp_path, FileNotFoundError)
    (tmp_path / "walk.mp4").unlink()
    assert "expected files ending in" in refused(tmp_path, FileNotFoundError)


@pytest.mark.parametrize("name", ["f%03d.png", "f%d.png", "f###.png"])
def test_patterns_of_other_programs(tmp_path, name):
    folder = write_folder(tmp_path / "a", FRAMES[:3])
    text = refused(folder / name, FileNotFoundError)
    assert f"'{folder}/f*.png'" in text
    np.testing.assert_array_equal(read(f"{folder}/f*.png")[0], FRAMES[:3])
    assert "no file matches it" in refused(tmp_path / name, FileNotFoundError)


def test_folder_named_like_an_address(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_folder(tmp_path / "www.site.org", FRAMES[:3])
    assert len(list(FrameSource("www.site.org/*.png").frames())) == 3


def test_encoded_space_is_not_a_frame_number(tmp_path):
    assert "check the path" in refused(f"{tmp_path}/my%20dir/x.png", FileNotFoundError)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes")
def test_pipe_in_a_folder_does_not_block(tmp_path):
    write_folder(tmp_path / "a", FRAMES[:3])
    os.mkfifo(tmp_path / "a" / "pipe.png")
    assert FrameSource(tmp_path / "a").names is not None


def test_further_pictures_in_a_jpeg_are_not_frames(tmp_path):
    """Phones put gain maps and previews there."""
    for k, frame in enumerate(FRAMES[:3]):
        further = [Image.fromarray(255 - frame)]
        path = tmp_path / f"f{k}.jpg"
        Image.fromarray(frame).save(path, format="MPO", save_all=True, append_images=further)
    assert read(tmp_path)[-1].notes == ()


def test_numbered_patterns_of_folders(tmp_path):
    for k in range(3):
        write_folder(tmp_path / f"f{k:03d}", FRAMES[:1], ["x.png"])
    assert f"'{tmp_path}/f*/x.png'" in refused(tmp_path / "f%03d" / "x.png", FileNotFoundError)


@pytest.mark.parametrize("name", ["take#1.mp4", "take#.mp4", "take#1.png"])
def test_single_number_sign_is_part_of_a_name(tmp_path, name):
    assert "check the path" in refused(tmp_path / name, FileNotFoundError)


def test_folder_of_gifs(tmp_path):
    (tmp_path / "a.gif").write_bytes(b"no matter")
    text = refused(tmp_path, FileNotFoundError)
    assert "give the path of one GIF" in text and "cannot read" not in text


def test_note_says_that_only_the_first_frame_of_animations_is_read(tmp_path):
    pictures = [Image.fromarray(frame) for frame in FRAMES]
    for name in ("a", "b"):
        path = tmp_path / f"{name}.webp"
        pictures[0].save(path, save_all=True, append_images=pictures[1:])
    (note,) = FrameSource(tmp_path).notes
    assert "such as a.webp (6), only the first frame is read" in note


def test_pattern_of_one_animated_gif(tmp_path):
    pictures = [Image.fromarray(frame) for frame in FRAMES]
    pictures[0].save(tmp_path / "a.gif", save_all=True, append_images=pictures[1:])
    assert "a GIF of 6 frames, which is read as a video" in refused(f"{tmp_path}/*.gif")
    assert len(read(tmp_path / "a.gif")[0]) == 6


def test_file_with_the_name_of_a_pattern_is_read(tmp_path):
    folder = write_folder(tmp_path / "a", FRAMES[:3], [f"{k}%03d.png" for k in range(3)])
    assert read(f"{folder}/*%03d.png")[1] == ["0%03d", "1%03d", "2%03d"]


def test_numbered_patterns_of_masks(tmp_path):
    folder = write_folder(tmp_path / "masks", FRAMES)
    with pytest.raises(FileNotFoundError, match=r"f\*\.png"):
        FrameSource(FRAMES, mask=folder / "f%03d.png")
    with pytest.raises(ValueError, match="is a URL"):
        FrameSource(FRAMES, mask="https://example.org/mask.png")


@pytest.mark.parametrize(
    ("url", "advice"),
    [
        ("http://example.org/a.mp4?x=*", "download the file"),
        ("https://example.org/[a].mp4", "download the file"),
        ("rtsp://camera/1", "ffmpeg -i rtsp://camera/1"),
        ("www.youtube.com/watch?v=a", "download the file"),
        ("youtu.be/a", "download the file"),
        ("file:///home/my%20film.mp4", "give the path, /home/my film.mp4"),
        ("file:/home/film.mp4", "give the path, /home/film.mp4"),
        ("file://host/film.mp4", "give the path of the file"),
    ],
)  # fmt: skip
def test_addresses(url, advice):
    text = refused(url)
    assert "is a URL" in text and advice in text


@pytest.mark.parametrize("kind", ["png", "webp", "tif"])
def test_pictures_of_several_frames(tmp_path, kind):
    path = tmp_path / f"a.{kind}"
    pictures = [Image.fromarray(frame) for frame in FRAMES]
    pictures[0].save(path, save_all=True, append_images=pictures[1:])
    text = refused(path)
    assert "a picture of 6 frames" in text and "frame%03d.png" in text
    pictures[0].save(path)
    assert "has 1 frame: expected at least 2" in refused(path)


# Videos


@pytest.mark.parametrize(
    ("size", "aspect", "expected"),
    [((48, 32), "2/1", (48, 64)), ((24, 64), "1/2", (48, 64)), ((48, 64), "1/1", (48, 64)),
     ((48, 64), "1000/1", (48, 64)), ((48, 64), "200/201", (48, 64))],
)  # fmt: skip
def test_non_square_pixels(tmp_path, decoder, size, aspect, expected):
    squeezed = [cv2.resize(f, size[::-1], interpolation=cv2.INTER_AREA) for f in FRAMES]
    path = write_film(tmp_path / "a.mp4", squeezed, aspect=aspect)
    frames, *_, opened = read(path)
    assert {frame.shape[:2] for frame in frames} == {expected}
    if size == expected:
        assert opened.notes == ()
        return
    (note,) = opened.notes
    assert "not square" in note and f"to {expected[1]} × {expected[0]} px" in note
    for frame, before in zip(frames, FRAMES, strict=True):
        inner = np.s_[6:-6, 6:-6]
        assert np.corrcoef(frame[inner][..., 0].ravel(), before[inner].ravel())[0, 1] > 0.9


def test_both_decoders_resample_alike(tmp_path, monkeypatch):
    pytest.importorskip("av")
    path = write_film(tmp_path / "a.mkv", [frame[:, ::2] for frame in FRAMES], aspect="2/1")
    ours = read(path)[0]
    monkeypatch.setattr("tisfm.sources.video.has_av", lambda: False)
    for one, other in zip(ours, read(path)[0], strict=True):
        assert np.abs(one.astype(int) - other).max() <= 4


@pytest.mark.parametrize("rotation", [90, 180])
def test_both_decoders_say_the_same_of_a_rotated_video(tmp_path, monkeypatch, rotation):
    pytest.importorskip("av")
    squeezed = [frame[:, ::2] for frame in FRAMES]
    path = write_film(tmp_path / "a.mp4", squeezed, aspect="2/1", rotation=rotation)
    frames, *_, ours = read(path)
    monkeypatch.setattr("tisfm.sources.video.has_av", lambda: False)
    others, *_, other = read(path)
    height, width = frames[0].shape[:2]
    assert others[0].shape[:2] == (height, width) == ((64, 48) if rotation == 90 else (48, 64))
    assert ours.notes == other.notes
    assert f"to {width} × {height} px" in ours.notes[0]


def test_focal_length_is_that_of_the_square_pixels(tmp_path):
    """Given and guessed cameras belong to frames as players show them."""
    pytest.importorskip("av")
    path = write_film(tmp_path / "a.mp4", [frame[:, ::2] for frame in FRAMES], aspect="2/1")
    settings = tisfm.Settings(motion="camera", warps=1, outer_iterations=1, sweeps=2)
    with pytest.warns(UserWarning):
        first = next(tisfm.interpret_sequence(path, settings=settings))
    assert first.flow.shape == (48, 64, 2)
    assert first.camera.focal == pytest.approx(1.2 * 64) and first.camera.aspect == 1


SMALL = np.ascontiguousarray(FRAMES[:, ::2, ::2])


@pytest.mark.parametrize(
    ("streams", "default", "taken"),
    [((SMALL, FRAMES), None, 1), ((FRAMES, SMALL), None, 0), ((FRAMES, SMALL), 1, 1)],
    ids=["larger second", "larger first", "smaller is marked"],
)
def test_two_video_streams(tmp_path, streams, default, taken):
    pytest.importorskip("av")
    path = write_film(tmp_path / "two_streams.mkv", *streams, default=default)
    frames, *_, opened = read(path)
    assert frames[0].shape[:2] == streams[taken][0].shape
    (note,) = opened.notes
    left = streams[1 - taken][0].shape
    assert f"{taken} (" in note and f"left out: {1 - taken} ({left[1]} × {left[0]} px)" in note
    assert ("marked as default" in note) == (default is not None)


@pytest.mark.parametrize("kind", ["mkv", "mp4", "mov", "webm"])
def test_opencv_says_that_it_reads_the_first(tmp_path, monkeypatch, kind):
    pytest.importorskip("av")
    codec = "libvpx" if kind == "webm" else "libx264"
    path = write_film(tmp_path / f"two.{kind}", SMALL, FRAMES, codec=codec)
    one = write_film(tmp_path / f"one.{kind}", FRAMES, codec=codec)
    monkeypatch.setattr("tisfm.sources.video.has_av", lambda: False)
    frames, *_, opened = read(path)
    assert frames[0].shape[:2] == SMALL[0].shape
    (note,) = opened.notes
    assert "2 video streams" in note and "OpenCV reads the first" in note
    assert FrameSource(one).notes == ()


@pytest.mark.parametrize("share", [0.5, 0.97])
def test_unfinished_recording(tmp_path, decoder, share):
    path = write_film(tmp_path / "cut_short.mp4", FRAMES)
    whole = path.read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    text = refused(path)
    assert "moov atom" in text and "convert" not in text
    assert ("not finished" in text) == (share == 0.5)
    path.write_bytes(b"")
    assert "is empty" in refused(path)


@pytest.mark.parametrize("brand", [b"heic", b"avif"])
def test_picture_in_a_video_container_is_not_an_unfinished_recording(tmp_path, brand):
    boxes = [(b"ftyp", brand + bytes(4)), (b"meta", bytes(20)), (b"mdat", bytes(90))]
    path = tmp_path / "picture.heic"
    path.write_bytes(b"".join((8 + len(b)).to_bytes(4, "big") + kind + b for kind, b in boxes))
    assert "recording" not in refused(path)


def test_other_videos_keep_their_message(tmp_path, decoder):
    path = write_film(tmp_path / "a.mkv", FRAMES)
    shutil.copy(path, tmp_path / "b.mp4")  # the contents tell the kind, not the name
    assert FrameSource(tmp_path / "b.mp4").notes == ()
    (tmp_path / "c.mp4").write_bytes(b"no video at all, but long enough to be one")
    assert "not an image or a video" in refused(tmp_path / "c.mp4")
