"""Masks as black and white pictures."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from tests.exports.made import SHAPE, made
from tests.trajectory.paths import PATIENT
from tisfm.exports import SequenceFrames, write_masks
from tisfm.reconstruction.result.folder import write_labels


def test_moving_objects_are_black_and_white_in_their_own_masks(tmp_path):
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


@PATIENT
@given(labels=arrays(np.uint8, SHAPE, elements=st.integers(0, 2)))
def test_labels_survive_their_files(tmp_path_factory, labels):
    place = tmp_path_factory.mktemp("masks")
    result = made(place / "walk", count=2, labelled=True, with_depth=())
    write_labels(result.folder, 1, np.where(labels == 1, np.uint8(0), labels))  # thing 2 alone
    (place / "out").mkdir()
    for file in write_masks(SequenceFrames(result), place / "out", chosen=(1,)):
        found = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
        is_thing = file.parent.name == "object-2"
        np.testing.assert_array_equal(found, np.where((labels == 2) == is_thing, 255, 0))


def test_results_without_labels_have_no_masks(tmp_path):
    frames = SequenceFrames(made(tmp_path / "walk"))
    with pytest.raises(ValueError, match="reconstruct with --motion objects"):
        write_masks(frames, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["walk"]
