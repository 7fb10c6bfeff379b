"""Masks: black is ignored, whatever they come as."""

import numpy as np
import pytest

import tisfm
from tests.sources.made import FRAMES, H, W
from tisfm.formats import FormatError, write_png
from tisfm.sources import FrameSource

BONNET = np.ones((H, W), bool)  # what counts: all but the lowest rows
BONNET[-6:] = False
MASKS = [np.roll(BONNET, k, axis=0) for k in range(6)]


def ignored(source, mask, **options):
    return [frame.ignored for frame in FrameSource(source, mask=mask, **options).frames()]


def check(found, masks):
    assert len(found) == len(masks)
    for one, mask in zip(found, masks, strict=True):
        assert one.dtype == bool
        np.testing.assert_array_equal(one, ~mask)


@pytest.fixture
def masks(tmp_path):
    """A folder of masks called like the pictures of `folder`."""
    masks = tmp_path / "masks"
    masks.mkdir()
    for number, mask in zip((1, 2, 9, 10, 11), MASKS, strict=False):
        write_png(masks / f"frame{number}.png", mask.astype(np.uint8) * 255)
    return masks


def test_without_a_mask_none_is_ignored():
    assert ignored(FRAMES, None) == [None] * 6


@pytest.mark.parametrize("kind", [bool, np.uint8, np.float32])
def test_one_array_for_all(kind):
    check(ignored(FRAMES, 3 * BONNET.astype(kind)), [BONNET] * 6)


def nested(masks):
    return tuple(tuple(map(tuple, mask.tolist())) for mask in masks)


@pytest.mark.parametrize("kind", [list, tuple, np.stack, iter, nested])
def test_an_array_for_each(kind):
    check(ignored(FRAMES, kind(MASKS)), MASKS)
    check(ignored(iter(FRAMES), kind(MASKS)), MASKS)


def test_one_picture_for_all(tmp_path, folder):
    path = tmp_path / "mask.png"
    write_png(path, BONNET.astype(np.uint8))  # any grey level but black counts
    for source in (folder, FRAMES[:5]):
        check(ignored(source, path), [BONNET] * 5)
    colours = np.dstack([BONNET * 0, BONNET, BONNET * 0]).astype(np.uint8)
    write_png(path, colours)
    check(ignored(folder, str(path)), [BONNET] * 5)


@pytest.mark.parametrize("kind", [str, lambda path: path, lambda path: f"{path}/*.png"])
def test_a_folder_goes_by_its_names(folder, masks, kind):
    check(ignored(folder, kind(masks)), MASKS[:5])
    (folder / "frame2.png").unlink()
    check(ignored(folder, kind(masks)), [MASKS[0], *MASKS[2:5]])


def test_names_with_the_suffix_of_the_picture(folder, masks):
    for mask in list(masks.iterdir()):
        mask.rename(mask.with_name(mask.name + ".png"))
    check(ignored(folder, masks), MASKS[:5])


def test_a_folder_of_other_names_goes_by_its_order(folder, masks):
    for k, name in enumerate(("frame1", "frame2", "frame9", "frame10", "frame11")):
        (masks / f"{name}.png").rename(masks / f"{k}.png")
    check(ignored(folder, masks), MASKS[:5])
    check(ignored(FRAMES[:5], masks), MASKS[:5])
    check(ignored(iter(FRAMES[:5]), masks), MASKS[:5])


def test_a_list_of_files_keeps_its_order(folder, masks):
    files = [masks / f"frame{number}.png" for number in (11, 10, 9, 2, 1)]
    check(ignored(folder, files), MASKS[4::-1])


@pytest.mark.parametrize("options", [{"step": 2}, {"start": 1, "stop": 4}], ids=str)
def test_masks_are_those_of_the_frames_that_are_taken(folder, masks, options):
    chosen = slice(options.get("start", 0), options.get("stop"), options.get("step"))
    expected = MASKS[:5][chosen]
    check(ignored(folder, masks, **options), expected)
    check(ignored(FRAMES[:5], MASKS[:5], **options), expected)
    check(ignored(iter(FRAMES[:5]), iter(MASKS), **options), expected)


def test_masks_of_the_frames_between_are_not_read(folder, masks):
    (masks / "frame2.png").write_bytes(b"damaged")
    check(ignored(folder, masks, step=2), MASKS[:5:2])


def test_masks_are_cropped_with_their_frames():
    check(ignored(FRAMES, BONNET, crop=(3, 10, 20, 12)), [BONNET[10:22, 3:23]] * 6)


def test_a_resized_pixel_is_ignored_if_a_part_is():
    mask = np.ones((H, W), bool)
    mask[8, 12] = False
    for one in ignored(FRAMES, mask, size=W // 2):
        assert one.sum() == 1 and one[4, 6]
    for one in ignored(FRAMES, mask, size=W - 3):
        assert one.shape == (round(H * (W - 3) / W), W - 3) and 1 <= one.sum() <= 4


def test_a_source_with_masks_can_be_read_again(folder, masks):
    source = FrameSource(folder, mask=masks)
    assert set(masks.iterdir()) < set(source.files)
    for _ in range(2):
        check([frame.ignored for frame in source.frames()], MASKS[:5])


# Errors


@pytest.mark.parametrize("mask", [3, None.__class__, 2.5], ids=repr)
def test_wrong_masks_are_refused(mask):
    with pytest.raises(TypeError, match=r"mask is .*expected a picture or an array, or one for"):
        FrameSource(FRAMES, mask=mask)


@pytest.mark.parametrize("shape", [(), (W,), (1, 6, H, W)], ids=str)
def test_an_array_of_another_shape_is_refused(shape):
    with pytest.raises(ValueError, match=r"mask is \(.*expected \(H, W\), or \(N, H, W\)"):
        FrameSource(FRAMES, mask=np.ones(shape))


@pytest.mark.parametrize(
    ("mask", "words"),
    [("gone.png", "there is no mask gone.png"), ("gone*.png", "no file matches"),
     (["gone.png"], "there is no mask gone.png")],
)  # fmt: skip
def test_a_mask_that_does_not_exist(mask, words):
    with pytest.raises(FileNotFoundError, match=words):
        FrameSource(FRAMES, mask=mask)


@pytest.mark.parametrize("count", [0, 5, 7])
def test_a_wrong_number_of_masks_is_an_error_at_once(count):
    with pytest.raises(ValueError, match=f"mask has {count} masks, but there are 6 frames"):
        FrameSource(FRAMES, mask=[BONNET] * count)


def test_a_frame_without_a_mask_is_named(folder, masks):
    (masks / "frame9.png").unlink()
    with pytest.raises(ValueError, match=r"no mask for frame9\.png: expected frame9\.png or fr"):
        FrameSource(folder, mask=masks)


def test_masks_that_end_early(folder):
    source = FrameSource(iter(FRAMES), mask=iter(MASKS[:2]))
    frames = source.frames()
    assert next(frames).index == 0 and next(frames).index == 1
    with pytest.raises(ValueError, match="mask ended before frame frame_000002"):
        next(frames)


@pytest.mark.parametrize("mask", [BONNET[:-1], [BONNET.T] * 6, [BONNET[0]] * 6], ids=repr)
def test_a_mask_of_another_size_is_an_error(mask):
    with pytest.raises(ValueError, match=r"mask of frame frame_000000 is \(.*but frame frame_0"):
        next(FrameSource(FRAMES, mask=mask).frames())


def test_a_picture_of_another_size_is_named(tmp_path, folder):
    write_png(tmp_path / "mask.png", BONNET[1:].astype(np.uint8))
    with pytest.raises(ValueError, match=r"mask\.png is \(23, 40\) but frame frame1 is \(24, 40\)"):
        next(FrameSource(folder, mask=tmp_path / "mask.png").frames())


def test_a_mask_that_is_damaged(folder, masks):
    (masks / "frame9.png").write_bytes(b"damaged")
    frames = FrameSource(folder, mask=masks, bad_frames="skip").frames()
    assert next(frames).name == "frame1" and next(frames).name == "frame2"
    with pytest.raises(FormatError, match=r"masks.frame9\.png"):
        next(frames)


def test_a_masked_mask_is_refused():
    mask = np.ma.array(BONNET, mask=BONNET)
    with pytest.raises(ValueError, match="masked"):
        next(FrameSource(FRAMES, mask=mask).frames())


def test_errors_of_a_generator_pass():
    def broken():
        yield BONNET
        raise OSError("no more masks")

    frames = FrameSource(FRAMES, mask=broken()).frames()
    next(frames)
    with pytest.raises(OSError, match="no more masks"):
        next(frames)


def test_pairs_have_frames_alone():
    (pair, *_) = FrameSource(FRAMES, mask=BONNET)
    assert isinstance(pair.interpret(camera=tisfm.Camera(50.0)), tisfm.Interpretation)
