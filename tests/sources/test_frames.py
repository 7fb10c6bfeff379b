"""Frames one by one: numbers, times, ranges, what is skipped, and how a source ends."""

import gc
import weakref

import numpy as np
import pytest
from PIL import ExifTags, Image

import tisfm
from tests.sources.made import FRAMES, QUICK, numbered
from tisfm.focal_guess import GuessedFocalWarning
from tisfm.formats import FormatError, write_png
from tisfm.formats.image_names import increasing_times
from tisfm.running.pairs import attach_poses
from tisfm.sources import FrameSource


def indices(source, **options):
    return [frame.index for frame in FrameSource(source, **options).frames()]


# Ranges

RANGES = [
    {},
    {"start": 2},
    {"stop": 3},
    {"start": 1, "stop": 4},
    {"start": 1, "stop": 5, "step": 2},
    {"start": np.int64(2), "stop": np.int64(400), "step": np.int64(2)},
]


@pytest.mark.parametrize("options", RANGES, ids=str)
def test_frames_of_a_range(folder, video, options):
    chosen = slice(options.get("start"), options.get("stop"), options.get("step"))
    expected = list(range(5))[chosen]
    names = [f"frame{number}" for number in (1, 2, 9, 10, 11)]
    for source in (folder, numbered(folder), FRAMES[:5], iter(FRAMES[:5])):
        frames = list(FrameSource(source, **options).frames())
        assert [frame.index for frame in frames] == expected
        for frame in frames:
            np.testing.assert_array_equal(frame.image, FRAMES[frame.index])
            assert frame.name in (names[frame.index], f"frame_{frame.index:06d}")
    assert indices(video[0], **options) == list(range(6))[chosen]


def test_a_range_is_counted_beforehand(folder, video):
    for source, count in ((folder, 5), (FRAMES, 6), (video[0], 6)):
        assert len(FrameSource(source, start=1, stop=4)) == 2
        assert len(FrameSource(source, start=1, step=2)) == len(range(count)[1::2]) - 1
    source = FrameSource(folder, start=1, stop=4)
    assert (source.count, source.selection) == (5, slice(1, 4, 1))
    assert source.names == ("frame2", "frame9", "frame10")
    assert source.first_file.name == "frame2.png"
    assert len(source.files) == 5


def test_a_sequence_of_a_range():
    results = tisfm.interpret_sequence(FRAMES, settings=QUICK, start=1, stop=4)
    for result, frame0, frame1 in zip(results, FRAMES[1:3], FRAMES[2:4], strict=True):
        np.testing.assert_array_equal(
            result.rho, tisfm.interpret(frame0, frame1, settings=QUICK).rho
        )


def test_frames_after_the_range_are_not_read(folder):
    (folder / "frame11.png").write_bytes(b"damaged")
    assert indices(folder, stop=4) == [0, 1, 2, 3]
    frames = iter(FRAMES)
    assert indices(frames, stop=4) == [0, 1, 2, 3]
    assert next(frames) is FRAMES[4]


@pytest.mark.parametrize("start", [-1, 1.0, "2", None, True], ids=repr)
def test_wrong_starts_are_refused(start):
    with pytest.raises(ValueError, match=r"start is .*: expected the number of a frame, from 0"):
        tisfm.interpret_sequence(FRAMES, start=start)


@pytest.mark.parametrize("stop", [-1, 0, 1, 3, 4, 2.0, "5", True], ids=repr)
def test_wrong_stops_are_refused(stop):
    with pytest.raises(ValueError, match=r"stop is .*: expected at least 5, to make a pair"):
        tisfm.interpret_sequence(FRAMES, start=2, stop=stop, step=2)


@pytest.mark.parametrize(
    "options", [{"start": 5}, {"start": 4}, {"start": 2, "step": 3}], ids=str
)  # fmt: skip
def test_a_range_beyond_the_end(folder, options):
    enough = options["start"] + options.get("step", 1) + 1
    for source in (folder, FRAMES[:5]):
        with pytest.raises(ValueError, match=f"has 5 frames: expected at least {enough}"):
            FrameSource(source, **options)
    with pytest.raises(ValueError, match="ended before there was a pair"):
        list(FrameSource(iter(FRAMES[:5]), **options))


# Times


def test_times_of_a_video(video):
    times = [frame.time for frame in FrameSource(video[0], start=1, step=2).frames()]
    assert times == pytest.approx([0.1, 0.3, 0.5], abs=1e-6)


def test_arrays_and_pictures_have_no_times(folder):
    for source in (folder, FRAMES):
        assert {frame.time for frame in FrameSource(source).frames()} == {None}


@pytest.mark.parametrize(
    ("names", "times"),
    [
        (["1305031102.175304", "1305031102.211214"], [1305031102.175304, 1305031102.211214]),
        (["0.5", "12.25"], [0.5, 12.25]),
        (["-1.5", "1.5"], [-1.5, 1.5]),
        (["1403636579763555584", "1403636579813555456"], [1403636579.7635556, 1403636579.8135555]),
    ],
)  # fmt: skip
def test_names_that_are_times(tmp_path, names, times):
    for name, frame in zip(names, FRAMES, strict=False):
        write_png(tmp_path / f"{name}.png", frame)
    found = [frame.time for frame in FrameSource(tmp_path).frames()]
    np.testing.assert_allclose(found, times, rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    "names",
    [["0001", "0002"], ["1.5", "frame"], ["1.5", "1.5"], ["2.5", "1.5"], ["1.5", "2"],
     ["140363657976355558", "140363657976355559"], ["1.5.2", "1.5.3"]],
    ids=str,
)  # fmt: skip
def test_other_names_have_no_times(names):
    assert increasing_times(names) is None


# Damaged frames


def test_a_damaged_picture_is_named_with_its_number(folder):
    (folder / "frame9.png").write_bytes(b"damaged")
    frames = FrameSource(folder).frames()
    assert next(frames).index == 0 and next(frames).index == 1
    with pytest.raises(FormatError, match=r"frame 2: .*frame9\.png"):
        next(frames)


def test_damaged_frames_are_skipped_with_a_reason(folder):
    for name in ("frame1.png", "frame9.png"):
        (folder / name).write_bytes(b"damaged")
    source = FrameSource(folder, bad_frames="skip")
    assert source.skipped == []
    for _ in range(2):
        assert [frame.index for frame in source.frames()] == [1, 3, 4]
        assert [index for index, _ in source.skipped] == [0, 2]
        assert "frame9.png" in source.skipped[1][1]
    (first, second) = source
    assert (first.name0, first.name1, second.name1) == ("frame2", "frame10", "frame11")


def test_skipped_frames_are_known_with_the_next_frame(folder):
    (folder / "frame11.png").write_bytes(b"damaged")
    source = FrameSource(folder, bad_frames="skip")
    for frame in source.frames():
        assert source.skipped == [], frame
    assert [index for index, _ in source.skipped] == [4]


def test_a_sequence_warns_of_skipped_frames(folder):
    for name in ("frame2.png", "frame11.png"):
        (folder / name).write_bytes(b"damaged")
    with pytest.warns(UserWarning, match="the frame is skipped") as caught:
        results = list(tisfm.interpret_sequence(folder, settings=QUICK, bad_frames="skip"))
    assert len(results) == 2
    told = [str(warning.message) for warning in caught]
    assert len(told) == 2 and "frame 1: " in told[0] and "frame 4: " in told[1]


@pytest.mark.filterwarnings("ignore:.*skipped")
def test_a_focal_length_is_not_guessed_from_damaged_frames(folder):
    exif = Image.Exif()
    exif[ExifTags.IFD.Exif] = {ExifTags.Base.FocalLengthIn35mmFilm: 50}
    Image.fromarray(FRAMES[1]).save(folder / "frame2.png", exif=exif.tobytes())
    (folder / "frame1.png").write_bytes(b"damaged")
    settings = tisfm.Settings(motion="camera", warps=1, outer_iterations=1, sweeps=2)
    with pytest.warns(GuessedFocalWarning, match="50 mm"):
        next(tisfm.interpret_sequence(folder, settings=settings, bad_frames="skip"))


def test_only_damage_is_skipped(folder):
    """Not a file that is gone, nor a frame of another size."""
    write_png(folder / "frame9.png", FRAMES[0][1:])
    with pytest.raises(ValueError, match="frames frame2 and frame9"):
        indices(folder, bad_frames="skip")
    (folder / "frame9.png").unlink()
    (folder / "frame9.png").mkdir()
    with pytest.raises(IsADirectoryError, match=r"frame9\.png"):
        indices(folder, bad_frames="skip")


def test_a_source_of_damaged_frames_is_an_error(folder):
    for file in numbered(folder)[1:]:
        file.write_bytes(b"damaged")
    with pytest.raises(ValueError, match=r"before there was a pair \(4 were skipped\)"):
        list(FrameSource(folder, bad_frames="skip"))


@pytest.mark.parametrize("choice", ["ignore", None, True, ""], ids=repr)
def test_there_are_two_choices(choice):
    with pytest.raises(ValueError, match=r'bad_frames is .*: expected "raise" or "skip"'):
        tisfm.interpret_sequence(FRAMES, bad_frames=choice)


def test_poses_of_pairs_exclude_skipping():
    source = FrameSource(FRAMES, bad_frames="skip")
    with pytest.raises(ValueError, match="poses are given, one for every pair, and bad frames"):
        attach_poses(source, [np.eye(4)] * 5)
    attach_poses(source, None)


# Ends


def test_frames_of_one_size_alone(folder):
    write_png(folder / "frame10.png", np.dstack([FRAMES[3]] * 3))
    with pytest.raises(ValueError, match=r"frames frame9 and frame10: .*\(24, 40\).*\(24, 40, 3\)"):
        indices(folder)


@pytest.mark.parametrize("how", ["used up", "closed", "range", "failed", "dropped"])
def test_a_generator_is_closed_with_its_source(how):
    closed = []

    def frames():
        try:
            yield from FRAMES
        finally:
            closed.append(True)

    gc.disable()  # what only the collector closes would be held in a cycle
    try:
        stop = 3 if how == "range" else None
        results = tisfm.interpret_sequence(frames(), settings=QUICK, stop=stop)
        next(results)
        if how in ("used up", "range"):
            list(results)
        elif how == "closed":
            results.close()
        elif how == "failed":
            with pytest.raises(ZeroDivisionError):
                results.throw(ZeroDivisionError)
        del results
        assert closed
    finally:
        gc.enable()


def test_a_source_lets_go_of_its_frames(folder):
    frames = FrameSource(folder).frames()
    first = weakref.ref(next(frames).image)
    next(frames)
    gc.collect()
    assert first() is None
    frames.close()
