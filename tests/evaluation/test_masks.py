"""Labels that were saved against true masks."""

import numpy as np
import pytest
from PIL import Image

from tisfm import Camera
from tisfm.camera_file import write_camera
from tisfm.evaluation import compare_masks
from tisfm.formats import FormatError
from tisfm.formats.label_picture import read_label_picture
from tisfm.lens import Undistortion

PALETTE = [0, 0, 0, 128, 0, 0, 0, 128, 0, 128, 128, 0]  # the first colours of DAVIS


def truth(count=4):
    frames = np.zeros((count, 8, 12), np.uint8)
    for k, frame in enumerate(frames):
        frame[2:6, k : k + 4] = 255
    return frames


def save(folder, frames, *, indexed=False, name="{:06d}.png"):
    folder.mkdir(parents=True, exist_ok=True)
    for k, frame in enumerate(frames):
        picture = Image.fromarray(frame)
        if indexed:
            picture.putpalette(PALETTE)
        picture.save(folder / name.format(k))
    return folder


@pytest.fixture
def clip(tmp_path):
    save(tmp_path / "clip" / "masks", truth(), name="{:05d}.png")
    return tmp_path / "clip"


@pytest.fixture
def result(tmp_path):
    """A result whose label is 2, in the third frame 3, and half of the thing in the last."""
    labels = truth() // 255 * 2
    labels[2] = labels[2] // 2 * 3
    labels[3, 4:] = 0
    save(tmp_path / "result" / "masks", labels, indexed=True)
    return tmp_path / "result"


@pytest.mark.parametrize("inner", [True, False])
def test_indices_of_a_palette_are_the_labels(clip, result, inner):
    scores = compare_masks(result, clip / "masks" if inner else clip)
    (thing,) = scores.objects
    assert (thing.object_id, thing.label, thing.frames) == (255, 2, 4)
    assert thing.iou == pytest.approx((1 + 1 + 0 + 0.5) / 4)
    assert thing.switches == 2 and scores.frames == 4


def test_a_step_takes_some_of_the_true_masks(clip, tmp_path):
    save(tmp_path / "half" / "masks", truth()[::2] // 255, indexed=True)
    assert compare_masks(tmp_path / "half", clip, step=2).iou == 1
    with pytest.raises(ValueError, match=r"masks of 2 frames, but there are 4 true masks"):
        compare_masks(tmp_path / "half", clip)
    with pytest.raises(ValueError, match="step is 0"):
        compare_masks(tmp_path / "half", clip, step=0)


def test_missing_masks_are_errors(clip, result, tmp_path):
    (tmp_path / "empty" / "masks").mkdir(parents=True)
    for mine, true, words in (
        (tmp_path / "gone", clip, "there is no folder .*gone"),
        (clip / "masks", clip, "has no folder masks: reconstruct with --motion objects"),
        (tmp_path / "empty", clip, "has no pictures"),
        (result, tmp_path / "gone", "there is no folder .*gone"),
        (result, tmp_path / "empty", "has no pictures"),
    ):
        with pytest.raises(FileNotFoundError, match=words):
            compare_masks(mine, true)


def test_other_pictures_are_refused(clip, result, tmp_path):
    file = result / "masks" / "000001.png"
    Image.fromarray(np.zeros((7, 12), np.uint8)).save(file)
    with pytest.raises(ValueError, match=r"labels\[1\] is \(7, 12\) and truth\[1\] is \(8, 12\)"):
        compare_masks(result, clip)
    Image.fromarray(np.arange(8 * 12 * 3, dtype=np.uint8).reshape(8, 12, 3)).save(file)
    with pytest.raises(FormatError, match=r"000001\.png is a picture of mode RGB"):
        compare_masks(result, clip)
    file.write_bytes(file.read_bytes()[:60])
    with pytest.raises(FormatError, match=r"000001\.png is cut off"):
        compare_masks(result, clip)
    file.write_bytes(b"no picture")
    with pytest.raises(FormatError, match=r"000001\.png cannot be read"):
        compare_masks(result, clip)


def test_kinds_of_pictures(tmp_path):
    labels = np.array([[0, 1, 3], [2, 0, 1]], np.uint8)
    grey = Image.fromarray(labels)
    indexed = Image.fromarray(labels)
    indexed.putpalette(PALETTE)
    coloured = Image.fromarray(np.repeat(labels[..., None], 3, axis=2))
    for picture in (grey, indexed, coloured):
        picture.save(tmp_path / "a.png")
        np.testing.assert_array_equal(read_label_picture(tmp_path / "a.png"), labels)
    Image.fromarray(labels > 0).save(tmp_path / "b.png")
    np.testing.assert_array_equal(read_label_picture(tmp_path / "b.png"), labels > 0)
    Image.fromarray(labels.astype(np.uint16)).save(tmp_path / "c.png")
    with pytest.raises(FormatError, match="indexed or grey of 8 bits"):
        read_label_picture(tmp_path / "c.png")


def test_true_masks_are_seen_through_the_lens_of_the_result(tmp_path):
    true = np.zeros((2, 60, 80), np.uint8)
    true[:, 2:30, 3:40] = 255
    camera = Camera(focal=60.0, distortion=(-0.2, 0, 0, 0))
    lens = Undistortion(camera, 60, 80)
    seen = np.stack([np.nan_to_num(lens.apply_nearest(np.float32(one))) for one in true])
    labels = np.where(lens.valid, seen / 255, 0).astype(np.uint8)
    save(tmp_path / "clip" / "masks", true)
    save(tmp_path / "result" / "masks", labels, indexed=True)
    assert compare_masks(tmp_path / "result", tmp_path / "clip").iou < 0.95
    write_camera(tmp_path / "result" / "camera.json", camera, (60, 80))
    assert compare_masks(tmp_path / "result", tmp_path / "clip").iou == 1
