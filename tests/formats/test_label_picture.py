"""Labels as indexed PNG pictures."""

import numpy as np
import pytest
from PIL import Image

from tisfm.formats import FormatError
from tisfm.formats.label_picture import label_colours, read_label_picture, write_label_png


@pytest.mark.parametrize("shape", [(1, 1), (7, 13), (60, 3)])
def test_labels_survive_a_picture(tmp_path, shape):
    labels = np.random.default_rng(1).integers(0, 256, shape).astype(np.uint8)
    write_label_png(tmp_path / "labels.png", labels)
    np.testing.assert_array_equal(read_label_picture(tmp_path / "labels.png"), labels)


def test_others_see_an_indexed_picture_in_the_usual_colours(tmp_path):
    write_label_png(tmp_path / "labels.png", np.arange(4, dtype=np.uint8)[None])
    with Image.open(tmp_path / "labels.png") as picture:
        assert picture.mode == "P"
        colours = np.array(picture.convert("RGB"))[0]
    expected = [(0, 0, 0), (128, 0, 0), (0, 128, 0), (128, 128, 0)]
    np.testing.assert_array_equal(colours, expected)
    assert len(np.unique(label_colours(), axis=0)) == 256


@pytest.mark.parametrize(
    "labels",
    [np.zeros((2, 3, 4), np.uint8), np.full((2, 2), 256), np.full((2, 2), -1), np.zeros((2, 2))],
)
def test_wrong_labels_are_refused(tmp_path, labels):
    with pytest.raises(ValueError, match="labels"):
        write_label_png(tmp_path / "labels.png", labels)
    assert not list(tmp_path.iterdir())


def test_damaged_and_other_pictures_are_refused(tmp_path):
    path = tmp_path / "labels.png"
    path.write_bytes(b"\x89PNG\r\n\x1a\n but no more")
    with pytest.raises(FormatError, match="labels"):
        read_label_picture(path)
    Image.fromarray(np.uint8([[[1, 2, 3]]])).save(path)
    with pytest.raises(FormatError, match="labels"):
        read_label_picture(path)
    with pytest.raises(FileNotFoundError):
        read_label_picture(tmp_path / "none.png")
