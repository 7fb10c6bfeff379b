"""Labels that are given: numbers of moving objects in every form."""

import numpy as np
import pytest
from PIL import Image

from tests.sources.made import FRAMES, H, W
from tisfm.formats import FormatError, write_png
from tisfm.formats.label_picture import has_colour_palette, write_label_png
from tisfm.sources import FrameSource
from tisfm.sources.labels import are_labels

FIRST = np.zeros((H, W), np.uint8)
FIRST[4:10, 5:15], FIRST[12:20, 20:31] = 1, 7
LABELS = [np.roll(FIRST, k, axis=1) for k in range(6)]
NUMBERS = (1, 2, 9, 10, 11)


def labels_of(source, labels, **options):
    return [frame.labels for frame in FrameSource(source, labels=labels, **options).frames()]


def check(found, labels):
    assert len(found) == len(labels)
    for one, expected in zip(found, labels, strict=True):
        if expected is None:
            assert one is None
        else:
            assert one.dtype == np.uint8
            np.testing.assert_array_equal(one, expected)


@pytest.fixture
def masks(tmp_path):
    """A folder of indexed pictures called like those of `folder`."""
    masks = tmp_path / "masks"
    masks.mkdir()
    for number, labels in zip(NUMBERS, LABELS, strict=False):
        write_label_png(masks / f"frame{number}.png", labels)
    return masks


@pytest.mark.parametrize("kind", [np.uint8, np.int64, np.uint16])
def test_an_array_for_each(kind):
    arrays = [labels.astype(kind) for labels in LABELS]
    for given in (arrays, np.stack(arrays), tuple(arrays), iter(arrays)):
        check(labels_of(FRAMES, given), LABELS)


def test_boolean_masks_are_one_object():
    check(labels_of(FRAMES, [labels > 0 for labels in LABELS]), [labels > 0 for labels in LABELS])


def test_frames_may_have_none():
    some = [LABELS[0], None, None, LABELS[3], None, None]
    for given in (some, iter(some), {0: LABELS[0], 3: LABELS[3]}):
        check(labels_of(FRAMES, given), some)
    check(labels_of(FRAMES, {"frame_000003": LABELS[3]}), [None] * 3 + [LABELS[3]] + [None] * 2)


def test_pictures_belong_to_the_frames_that_they_are_called_like(folder, masks):
    check(labels_of(folder, masks), LABELS[:5])
    (masks / "frame2.png").unlink()
    (masks / "frame9.png").rename(masks / "frame9.png.png")
    check(labels_of(folder, f"{masks}/*.png"), [LABELS[0], None, *LABELS[2:5]])
    check(labels_of(folder, masks / "frame10.png"), [None] * 3 + [LABELS[3], None])
    check(labels_of(folder, masks, step=2), LABELS[:5:2])


def test_pictures_of_numbered_frames(masks):
    (masks / "frame10.png").rename(masks / "frame_000003.png")
    for source in (FRAMES, iter(FRAMES)):
        found = labels_of(source, masks / "frame_000003.png")
        check(found, [None] * 3 + [LABELS[3]] + [None] * 2)


def test_pictures_of_other_names_go_by_their_order(folder, masks):
    check(labels_of(FRAMES[:5], masks), LABELS[:5])
    check(labels_of(folder, [masks / f"frame{k}.png" for k in (11, 10, 9, 2, 1)]), LABELS[4::-1])


def test_grey_pictures_are_numbers(folder, masks):
    for number, labels in zip(NUMBERS, LABELS, strict=False):
        write_png(masks / f"frame{number}.png", labels)
    check(labels_of(folder, masks), LABELS[:5])


def test_255_is_ignored():
    void = FIRST.copy()
    void[:2] = 255
    mask = np.ones((H, W), bool)
    mask[:, :3] = False
    frames = list(FrameSource(FRAMES, labels=[void] * 6, mask=mask).frames())
    for frame in frames:
        np.testing.assert_array_equal(frame.labels, FIRST * (void < 255))
        np.testing.assert_array_equal(frame.ignored, (void == 255) | ~mask)
    assert all(frame.ignored is None for frame in FrameSource(FRAMES, labels=LABELS).frames())


def test_labels_are_cropped_and_shrunk_with_their_frames():
    view = {"crop": (4, 2, 32, 20), "size": 16}
    small = [labels[2:22, 4:36][::2, ::2] for labels in LABELS]  # blocks of 2 × 2 of one label
    even = [np.repeat(np.repeat(labels, 2, axis=0), 2, axis=1) for labels in small]
    whole = []
    for labels in even:
        whole.append(np.zeros((H, W), np.uint8))
        whole[-1][2:22, 4:36] = labels
    check(labels_of(FRAMES, whole, **view), small)
    check(labels_of(FRAMES, small, **view), small)  # or of the size of the frames as they are used


def test_files_of_labels_are_files_of_the_source(folder, masks):
    assert set(masks.iterdir()) < set(FrameSource(folder, labels=masks).files)


# Errors


@pytest.mark.parametrize(
    ("labels", "error", "words"),
    [
        (3, TypeError, "labels is 3: expected pictures"),
        (FIRST, ValueError, r"labels is \(24, 40\): expected \(N, H, W\).*\{0: labels\}"),
        (LABELS[:4], ValueError, "labels are of 4 frames, but there are 6 frames"),
        ({9: FIRST}, ValueError, "entry for frame 9, which does not exist"),
        ({"a": FIRST}, ValueError, "entry for frame 'a'"),
        ({0: "gone.png"}, FileNotFoundError, "no labels gone.png"),
        ("gone", FileNotFoundError, "there is no picture or folder of labels gone"),
    ],
)
def test_wrong_labels_are_refused(labels, error, words):
    with pytest.raises(error, match=words):
        FrameSource(FRAMES, labels=labels)


@pytest.mark.parametrize(
    ("labels", "error", "words"),
    [
        (FIRST.astype(float), TypeError, "type float64: expected integers"),
        (FIRST.astype(int) - 1, ValueError, "go from -1 to 6: expected 0 for"),
        (FIRST.astype(int) * 40, ValueError, "go from 0 to 280"),
        (np.dstack([FIRST] * 3), ValueError, r"\(24, 40, 3\), as colours do"),
        (FIRST[0], ValueError, r"shape \(40,\): expected \(H, W\)"),
        (FIRST[1:], ValueError, r"is \(23, 40\), but the size of frame frame_000000 is \(24, 40\)"),
        (np.ma.array(FIRST, mask=FIRST), ValueError, "masked"),
    ],
)
def test_a_frame_with_wrong_labels_is_named(labels, error, words):
    with pytest.raises(error, match=f"labels of frame frame_000000.*{words}"):
        next(FrameSource(FRAMES, labels={0: labels}).frames())


def test_colour_images_are_refused_as_labels(folder, masks):
    write_png(masks / "frame1.png", np.dstack([FIRST, 2 * FIRST, FIRST]))
    with pytest.raises(FormatError, match=r"frame1\.png is a picture of mode RGB: expected labels"):
        next(FrameSource(folder, labels=masks).frames())


def test_a_wrong_number_of_label_images_is_an_error(masks):
    with pytest.raises(ValueError, match=r"of 5 frames.*6 frames; none of them has"):
        FrameSource(FRAMES, labels=masks)


def test_labels_of_255_are_warned_of():
    void = [np.where(labels > 0, 255, 0) for labels in LABELS]
    with pytest.raises(ValueError, match="0 or 255 everywhere, and pixels of 255 are ignored"):
        list(FrameSource(FRAMES, labels=void).frames())
    assert len(labels_of(FRAMES, [0 * labels for labels in LABELS])) == 6  # nothing moves


@pytest.mark.parametrize("key", [0.5, (1, 2), None])
def test_label_images_without_a_frame_are_an_error(key):
    with pytest.raises(TypeError, match=r"labels has the key .* expected the number or name"):
        FrameSource(FRAMES, labels={key: LABELS[0]})


def test_labels_that_end_early():
    frames = FrameSource(iter(FRAMES), labels=iter(LABELS[:1])).frames()
    next(frames)
    with pytest.raises(ValueError, match="labels ended before frame frame_000001: expected None"):
        next(frames)


# Whether a mask holds labels


@pytest.mark.parametrize(
    "mask",
    [FIRST, FIRST > 0, [labels > 0 for labels in LABELS], [255 * (FIRST > 0)] * 2,
     [FIRST.astype(float)] * 2, iter(LABELS), [], np.zeros((2, H, W), int)],
)  # fmt: skip
def test_the_meaning_of_values_is_stated(mask):
    assert not are_labels(mask)


def test_several_values_are_labels():
    assert are_labels(LABELS)
    assert are_labels([[[0, 1], [1, 7]]])
    assert are_labels(np.stack(LABELS).astype(int))
    assert are_labels([np.where(FIRST == 7, 255, FIRST), np.where(FIRST == 1, 255, FIRST)])


def test_one_value_may_be_a_mask_or_a_label():
    with pytest.raises(ValueError, match=r"number 7 at every pixel .* labels="):
        are_labels([7 * (FIRST > 0)] * 6)


def test_pictures_with_a_palette_of_colours_are_labels(masks, tmp_path):
    assert has_colour_palette(masks / "frame1.png")
    assert are_labels(masks) and are_labels(f"{masks}/*.png")
    assert are_labels(sorted(masks.iterdir()))
    assert not are_labels(masks / "frame1.png")  # one for all frames
    grey = Image.fromarray(np.uint8(FIRST > 0))
    grey.putpalette([0, 0, 0, 255, 255, 255])
    (tmp_path / "grey").mkdir()
    grey.save(tmp_path / "grey" / "a.png")
    write_png(tmp_path / "grey.png", FIRST)
    assert not are_labels(tmp_path / "grey")
    assert not has_colour_palette(tmp_path / "grey.png")
    (tmp_path / "grey" / "a.png").write_bytes(b"damaged")
    with pytest.raises(FormatError, match=r"a\.png cannot be read as a picture"):
        are_labels(tmp_path / "grey")
