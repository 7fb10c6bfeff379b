"""Masks as black and white pictures."""

import cv2
import numpy as np
import pytest

from tests.exports.made import SHAPE, made
from tisfm.exports import SequenceFrames, write_masks


def test_what_moves_is_black_and_its_own_mask_white(tmp_path):
    frames = SequenceFrames(made(tmp_path / "walk", labelled=True))
    (tmp_path / "out").mkdir()
    files = write_masks(frames, tmp_path / "out", chosen=(1, 3))
    names = {file.relative_to(tmp_path / "out").as_posix() for file in files}
    assert names == {"at-rest/f1.png", "at-rest/f3.png", "object-2/f1.png", "object-2/f3.png"}
    masks = {name: cv2.imread(str(tmp_path / "out" / name), cv2.IMREAD_UNCHANGED) for name in names}
    thing = np.zeros(SHAPE, np.uint8)
    thing[5:12, 4:10] = 255
    np.testing.assert_array_equal(masks["object-2/f1.png"], thing)
    np.testing.assert_array_equal(masks["at-rest/f1.png"], 255 - thing)
    assert (masks["at-rest/f3.png"] == 255).all() and not masks["object-2/f3.png"].any()


def test_none_are_made_up(tmp_path):
    frames = SequenceFrames(made(tmp_path / "walk"))
    with pytest.raises(ValueError, match="reconstruct with --motion objects"):
        write_masks(frames, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["walk"]
