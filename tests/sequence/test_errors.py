"""Sources that are none, or end early: said at once, or after what came before."""

import numpy as np
import pytest

import tisfm
from tests.sources.made import FRAMES, QUICK, H, W, make_video, numbered
from tisfm.formats import FormatError, write_png
from tisfm.sources import FrameSource

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
def test_missing_sources_are_named_at_once(folder, tmp_path, interpret, source, words):
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
def test_other_values_than_sources_are_refused(source):
    with pytest.raises(TypeError, match="expected a path, a list of paths, or an iterable"):
        tisfm.interpret_sequence(source)


@pytest.mark.parametrize("shape", [(), (40,), (24, 40), (2, 2, 24, 40, 3)], ids=str)
def test_an_array_of_another_shape_is_no_source(shape):
    with pytest.raises(ValueError, match=r"frames is .*expected \(N, H, W\)"):
        tisfm.interpret_sequence(np.zeros(shape))


@pytest.mark.parametrize("name", ["text.mp4", "text.txt", "text"])
@pytest.mark.parametrize("content", [b"no video\n" * 20, b""], ids=["text", "empty"])
def test_files_that_are_no_video_are_named_at_once(tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    why = "is not an image or a video that OpenCV can read" if content else r"is empty \(0 bytes\)"
    with pytest.raises(ValueError, match=why) as e:
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
    (folder / "frame11.png").unlink()  # the two before it may have been read ahead
    next(results), next(results)
    with pytest.raises(FileNotFoundError, match=r"frame11\.png"):
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
    with pytest.raises(ValueError, match=r"its table of frames \(the moov atom\) is cut off"):
        tisfm.interpret_sequence(path)


def test_masks_are_not_dropped():
    """What is masked is refused with the names of the frames, as for a pair."""
    masked = [np.ma.array(frame, mask=np.zeros_like(frame, bool)) for frame in FRAMES[:3]]
    assert len(list(tisfm.interpret_sequence(masked, settings=QUICK))) == 2
    masked[2].mask[3, 4] = True
    results = tisfm.interpret_sequence(masked, settings=QUICK)
    next(results)
    with pytest.raises(ValueError, match=r"frames frame_000001 and frame_000002: .* 1 of 960"):
        next(results)
