"""Floating parts cannot be at rest: objects that move along the background's epipolar lines."""

import numpy as np
import pytest

import tisfm
from tests.motion.one_motion import OBJECTS, interpreted
from tests.rendered import static_scene, two_blocks
from tisfm.motion.objects.candidates import floating_parts, without_domes
from tisfm.scenes import STATIC_KINDS

SMALLEST = 64


def ground(height=90, width=121):
    """Return a floor, of inverse depth 1 at the horizon and 3 at the lower border, and a wall."""
    rows = np.arange(height, dtype=np.float32)[:, None]
    return np.maximum(1, 1 + 2 * (rows - height // 3) / (height - 1 - height // 3)) * np.ones(
        (1, width), np.float32
    )


def parts(inverse_depth, deviation=0.01):
    noise = np.full(inverse_depth.shape, deviation, np.float32)
    return floating_parts(inverse_depth.astype(np.float32), noise, SMALLEST)


def overlap(found, true):
    """Intersection over union."""
    return (found & true).sum() / (found | true).sum()


def test_without_domes_is_the_best_path_to_the_border():
    rng = np.random.default_rng(0)
    image = rng.random((13, 17)).astype(np.float32)
    expected = np.pad(image, 1, constant_values=np.inf)
    # Bellman's recursion: the value of the best neighbour, limited by the value of the pixel.
    best = np.where(np.isinf(expected), np.inf, -np.inf)
    for _ in range(image.size):
        around = [np.roll(best, (i, j), (0, 1)) for i in (-1, 0, 1) for j in (-1, 0, 1)]
        best[1:-1, 1:-1] = np.minimum(np.max(around, axis=0), expected)[1:-1, 1:-1]
    np.testing.assert_array_equal(without_domes(image), best[1:-1, 1:-1].astype(np.float32))
    monotone = np.cumsum(np.ones((9, 7), np.float32), axis=0)
    np.testing.assert_array_equal(without_domes(monotone), monotone)


def test_parts_with_a_foot_do_not_float_and_others_do():
    scene = ground()
    foot = scene[60, 0]
    scene[20:61, 40:60] = foot
    assert not parts(scene).any()
    scene[20:61, 40:60] = 1.6 * foot
    found = parts(scene)
    true = np.zeros(scene.shape, bool)
    true[20:61, 40:60] = True
    assert found.dtype == np.int32 and found.max() == 1
    assert overlap(found == 1, true) > 0.9


def test_uncertain_parts_do_not_float():
    scene = ground()
    scene[20:61, 40:60] = 1.6 * scene[60, 0]
    assert parts(scene, 0.05).any()
    assert not parts(scene, 0.5).any()
    scene[20:61, 40:60] = 1.2 * ground()[60, 0]
    assert not parts(scene).any()


def test_parts_at_the_border_do_not_float():
    scene = ground()
    scene[20:61, :20] = 4
    assert not parts(scene).any()
    scene = ground()
    scene[:40, 58:63] = 4
    scene[30:50, 45:75] = 4
    assert not parts(scene).any()


def test_a_ground_that_recedes_is_none():
    scene = ground()[::-1].copy()
    scene[20:61, 40:60] = 8
    assert parts(scene[::-1]).any() and not parts(scene).any()


def test_parts_are_numbered_by_size_and_small_ones_left_out():
    scene = ground()
    scene[40:50, 10:24], scene[30:60, 60:90], scene[40:46, 40:46] = 5, 6, 6
    found = parts(scene)
    assert found.max() == 2
    assert found[45, 75] == 1 and found[45, 16] == 2 and found[43, 43] == 0


def test_parts_are_found_in_large_maps_too():
    scene = np.kron(ground(), np.ones((4, 4), np.float32))
    scene[100:220, 160:240] = 6
    found = floating_parts(scene, np.full_like(scene, 0.01), 16 * SMALLEST)
    assert found.shape == scene.shape and overlap(found == 1, scene == 6) > 0.9


def test_a_block_moving_along_epipolar_lines_gets_a_label():
    """The camera moves right; a bump explains the block on the left, which looks nearer."""
    scene = two_blocks(240, 320, seed=1, block_motions=[[-0.02, 0, 0, 0, 0, 0], np.zeros(6)])
    result = interpreted(scene, OBJECTS)
    assert len(result.motions) == 2
    assert overlap(result.labels == 1, scene.labels == 2) > 0.95
    assert result.motions[1] @ result.motions[0] > 0.999
    one = interpreted(scene, tisfm.Settings(motion="objects", max_objects=1))
    assert not one.labels.any()


def test_a_block_that_looks_further_away_counts_as_at_rest():
    """A limit of the method: objects seen through a window look the same."""
    scene = two_blocks(120, 160, seed=1, block_motions=[[0.015, 0, 0, 0, 0, 0], np.zeros(6)])
    assert len(interpreted(scene, OBJECTS).motions) == 1


@pytest.mark.parametrize(("kind", "seed"), list(zip(STATIC_KINDS, (0, 1, 1, 0), strict=True)))
def test_parts_at_rest_do_not_float(kind, seed):
    scene = static_scene(kind, 120, 160, seed=seed)
    result = interpreted(scene, OBJECTS)
    assert len(result.motions) == 1 and not result.labels.any()
