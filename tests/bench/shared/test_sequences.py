"""Pairs with true flow."""

import cv2
import numpy as np
import pytest

from bench.shared.sequences import data_folder, find_pairs


def test_all_pairs_are_found(shared_data):
    found, missing = find_pairs(shared_data)
    assert not missing
    assert len(found) == 12
    for pair in found:
        assert pair.frame0.shape[:2] == pair.frame1.shape[:2] == pair.size
        assert pair.frame0.dtype == pair.frame1.dtype == np.uint8
        known = (np.abs(pair.truth) < 1e9).all(axis=-1)
        x, y = np.meshgrid(*map(np.arange, pair.size[::-1]))
        place = (np.dstack([x, y]) + np.where(known[..., None], pair.truth, 0)).astype(np.float32)
        first, second = pair.frame0.astype(np.float32), pair.frame1.astype(np.float32)
        moved = cv2.remap(second, place, None, cv2.INTER_LINEAR)
        assert np.abs(moved - first)[known].mean() < 0.8 * np.abs(second - first)[known].mean()


def test_missing_pairs_are_named(tmp_path):
    found, missing = find_pairs(tmp_path)
    assert not found
    assert "frame10.png" in missing["Grove2"]
    with pytest.raises(NotADirectoryError, match="expected one with real sequences"):
        data_folder(tmp_path / "none")
