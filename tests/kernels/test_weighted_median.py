"""Weighted median of values, with weights from grey levels."""

import numpy as np
import pytest

from bench import reference
from tests.pairwise import pairwise

OPTIONS = {"radius": 3, "grey_scale": 5.0, "same_share": 0.02, "max_own_weight": 0.4}
SIZES = [(1, 1), (1, 9), (9, 1), (3, 4), (17, 23)]


@pairwise(size=SIZES, radius=[0, 1, 3], grey_scale=[2.0, 20.0], max_own_weight=[0.3, 1.0])
def test_reference(size, radius, grey_scale, max_own_weight):
    from tisfm.kernels.rigid.weighted_median import HALVINGS, weighted_median

    random = np.random.default_rng(0)
    values, frame = (random.uniform(1, 5, size).astype(np.float32) for _ in range(2))
    is_smoothed, is_used = (random.uniform(size=size) < 0.7 for _ in range(2))
    out = np.empty(size, np.float32)
    options = {
        "radius": radius, "grey_scale": grey_scale, "same_share": 0.1,
        "max_own_weight": max_own_weight,
    }  # fmt: skip
    weighted_median(
        values,
        10 * frame,
        *[part.astype(np.int32) for part in (is_smoothed, is_used)],
        out,
        **options,
    )
    expected = reference.weighted_median(
        values.astype(float),
        10 * frame.astype(float),
        is_smoothed,
        is_used,
        **options,
    )
    np.testing.assert_array_equal(out[~is_smoothed], values[~is_smoothed])
    assert np.isin(out, values).all()
    # The result lies in the last part of the range.
    assert np.abs(out - expected).max() <= 4 / 2**HALVINGS


def test_outline_moves_to_the_edge_of_the_frame():
    from tisfm.kernels.rigid.weighted_median import weighted_median

    frame = np.where(np.arange(24) < 12, 50, 150) * np.ones((20, 1))
    frame += np.random.default_rng(1).normal(0, 2, frame.shape)
    values = np.where(np.arange(24) < 13, 3, 1) * np.ones((20, 1))  # 1 px beside the edge
    arrays = [array.astype(np.float32) for array in (values, frame)]
    out = np.empty_like(arrays[0])
    weighted_median(*arrays, *[np.ones(out.shape, np.int32)] * 2, out, **OPTIONS)
    np.testing.assert_array_equal(out, np.where(np.arange(24) < 12, 3, 1) * np.ones((20, 1)))


@pytest.mark.parametrize("name", ["values", "frame", "is_smoothed", "is_used", "out"])
def test_arrays_fit_together(name):
    from tisfm.kernels.rigid.weighted_median import weighted_median

    arrays = {key: np.zeros((4, 5), np.float32) for key in ("values", "frame", "out")}
    arrays |= {key: np.zeros((4, 5), np.int32) for key in ("is_smoothed", "is_used")}
    arrays[name] = arrays[name][:3]
    with pytest.raises(ValueError, match=name if name != "values" else "frame"):
        weighted_median(**arrays, **OPTIONS)


def test_wrong_arguments_are_refused():
    from tisfm.kernels.rigid.weighted_median import weighted_median

    values, frame, out = (np.ones((4, 5), np.float32) for _ in range(3))
    pixels = np.ones((4, 5), np.int32)
    with pytest.raises(ValueError, match="out is values"):
        weighted_median(values, frame, pixels, pixels, values, **OPTIONS)
    for wrong in ({"radius": -1}, {"grey_scale": 0.0}):
        with pytest.raises(ValueError, match="grey_scale"):
            weighted_median(values, frame, pixels, pixels, out, **OPTIONS | wrong)
