"""Costs beside outlines: small census transforms in the frames that see a surface best."""

import numpy as np
import pytest

import tisfm
from bench import reference
from tests.motion.test_plane_sweep_start import SIZES, TWIST, in_vectors
from tests.pairwise import pairwise
from tisfm.rigid import rigid_motion

GUESS = {"guess_costs": (0.1, 0.5), "guess_distances": (4.0, 1.5)}


@pytest.mark.parametrize("size", SIZES)
def test_census_transform(size):
    from tisfm.kernels.rigid.outline_sweep import NO_CODE, census_transform

    random = np.random.default_rng(0)
    frame = random.integers(0, 4, size).astype(np.float32)  # few levels: many neighbours are equal
    is_used = random.uniform(size=size) < 0.8
    out = np.empty(size, np.int32)
    census_transform(frame, is_used.astype(np.int32), out)
    expected = np.where(is_used, reference.census_transform(frame), NO_CODE)
    np.testing.assert_array_equal(out, expected)


@pairwise(size=SIZES, lanes=[16, 8, 1], count=[1, 4, 5], best_count=[1, 2, 4], short=True)
def test_outline_cost(size, lanes, count, best_count):
    from tisfm.kernels.rigid.outline_sweep import outline_cost

    random = np.random.default_rng(1)
    key = random.integers(0, 2**24, size, dtype=np.int32)
    others = random.integers(0, 2**24, (count, *size), dtype=np.int32)
    others[random.uniform(size=others.shape) < 0.2] = -1  # pixels that are not compared
    camera = tisfm.Camera(focal=40.0, center=(0.4 * size[1], 0.6 * size[0]))
    motions = np.array(
        [
            np.column_stack(rigid_motion((-1.0) ** k * np.array(TWIST) / (k + 1)))
            for k in range(count)
        ]
    )
    guess, is_free = random.uniform(0, 20, size), random.uniform(size=size) < 0.7
    out, plain = in_vectors(np.zeros((*size, 16)), lanes, 0)
    single = [array.astype(np.float32) for array in (motions, guess)]
    outline_cost(
        key, others, *single, is_free.astype(np.int32), out, origin=(0, 0), center=camera.center,
        focal=camera.focal, first=0.5, step=1.5, best_count=best_count, **GUESS,
    )  # fmt: skip
    hypotheses = 0.5 + 1.5 * np.arange(16)
    expected = reference.outline_cost(
        key, others, hypotheses, camera, motions, guess, is_free, best_count=best_count, **GUESS
    )
    is_clear = np.ones(expected.shape, bool)  # targets that are nearest to one pixel
    rows, columns = np.mgrid[: size[0], : size[1]]
    for n, hypothesis in enumerate(hypotheses):
        for motion in motions:
            depth = np.full(size, hypothesis)
            u, v = reference.displacement(depth, camera, motion[:, :3], motion[:, 3])
            fractions = np.stack([columns + u, rows + v]) % 1
            is_clear[..., n] &= (np.abs(fractions - 0.5) > 1e-3).all(axis=0)
    assert is_clear.mean() > 0.9
    np.testing.assert_allclose(plain[is_clear], expected[is_clear], rtol=0, atol=1e-5)


def test_block_is_part_of_the_frame():
    from tisfm.kernels.layout.lanes import aligned_zeros
    from tisfm.kernels.rigid.outline_sweep import outline_cost

    random, size, block = np.random.default_rng(2), (12, 14), (slice(3, 9), slice(4, 12))
    key, other = random.integers(0, 2**24, (2, *size), dtype=np.int32)
    motions = np.eye(3, 4, dtype=np.float32)[None] + np.float32(0.1)
    guess, is_free = np.full(size, 3, np.float32), np.ones(size, np.int32)
    options = {
        "center": (6.0, 5.0), "focal": 20.0, "first": 0.0, "step": 1.0, "best_count": 1, **GUESS
    }  # fmt: skip
    whole, part = aligned_zeros((*size, 16)), aligned_zeros((6, 8, 16))
    others = other[None]
    outline_cost(key, others, motions, guess, is_free, whole, origin=(0, 0), **options)
    cut = [np.ascontiguousarray(array[block]) for array in (guess, is_free)]
    outline_cost(key, others, motions, *cut, part, origin=(3, 4), **options)
    np.testing.assert_array_equal(part, whole[block])
    with pytest.raises(ValueError, match="not inside"):
        outline_cost(key, others, motions, *cut, part, origin=(7, 4), **options)
    with pytest.raises(ValueError, match="best_count"):
        outline_cost(
            key, others, motions, *cut, part, origin=(0, 0), **{**options, "best_count": 5}
        )
