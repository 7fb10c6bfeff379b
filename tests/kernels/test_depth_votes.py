"""Inverse depth of one frame as several keyframes show it, merged by votes."""

import numpy as np
import pytest

from bench import reference
from tisfm import Camera
from tisfm.rigid import rigid_motion

CAMERA = Camera(focal=40.0)
STAY = np.eye(4)[:3]
FAR, NEAR = 0.5, 1.0  # inverse depth


def merge(depths, deviations, frame, keys, motions, alike=0.1, decay=30.0, border=2.0):
    from tisfm import runtime

    runtime.start()
    from tisfm.kernels.rigid.depth_votes import merge_depths

    shape = depths.shape[-2:]
    out, spread = (np.full(shape, 7, np.float32) for _ in range(2))
    merge_depths(
        depths, deviations, frame, *keys, np.ascontiguousarray(motions, np.float32), out, spread,
        center=CAMERA.center_for(*shape), focal=CAMERA.focal, max_difference=alike,
        grey_decay=decay, border=border,
    )  # fmt: skip
    return out, spread


def image(value, shape=(9, 11)):
    return np.full(shape, value, np.float32)


def stack(*values):
    """Return constant images, (N, H, W) float32."""
    return np.stack([image(value) for value in values])


def merge_values(candidates, shares, *, surfaces=None, greys=None, motions=None, **options):
    """Return the value that constant images give in the middle; deviations are shares of them."""
    count = len(candidates)
    depths, relative = stack(*candidates), stack(*shares)
    surfaces = depths if surfaces is None else stack(*surfaces)
    keys = surfaces, relative * surfaces, stack(*(greys or [100] * count))
    motions = [STAY] * count if motions is None else motions
    out, spread = merge(depths, relative * depths, image(100), keys, motions, **options)
    return out[4, 5], spread[4, 5]


@pytest.mark.parametrize("size", [(1, 1), (5, 1), (1, 7), (13, 17)], ids=str)
@pytest.mark.parametrize("count", [1, 2, 3, 5])
def test_kernel_is_the_reference(size, count):
    random = np.random.default_rng(count)
    shape = count, *size

    def two_surfaces():
        depth = np.where(random.random(shape) < 0.5, 0.2, 0.5) * (1 + 0.08 * random.random(shape))
        return np.where(random.random(shape) < 0.2, 0, depth).astype(np.float32)

    depths, key_depths = two_surfaces(), two_surfaces()
    deviations, key_deviations = (0.05 * random.random((2, *shape))).astype(np.float32)
    frame = (255 * random.random(size)).astype(np.float32)
    key_frames = (255 * random.random(shape)).astype(np.float32)
    motions = np.array(
        [np.column_stack(rigid_motion(0.1 * random.normal(size=6))) for _ in range(count)]
    )
    arguments = depths, deviations, frame, (key_depths, key_deviations, key_frames), motions
    before = [array.copy() for array in (depths, deviations, frame)]
    out, spread = merge(*arguments)
    expected, its_spread = reference.merge_depths(
        *(array.astype(float) for array in (depths, deviations, frame)),
        *(array.astype(float) for array in (key_depths, key_deviations, key_frames)),
        motions.astype(np.float32).astype(float), CAMERA,
        tolerance=0.1, grey_decay=30.0, border=2.0,
    )  # fmt: skip
    # Rounding decides where a position is on a limit between pixels; elsewhere only sums differ.
    close = np.isclose(out, expected, rtol=1e-3)
    assert close.mean() > 0.99
    np.testing.assert_allclose(spread[close], its_spread[close], rtol=1e-2, atol=1e-6)
    for array, kept in zip((depths, deviations, frame), before, strict=True):
        np.testing.assert_array_equal(array, kept)


def test_agreeing_depths_are_averaged_by_precision():
    out, spread = merge_values([1.0, 1.05], [0.1, 0.05])
    np.testing.assert_allclose(out, (1 + 4 * 1.05) / 5, rtol=1e-5)
    np.testing.assert_allclose(spread, (0.1 + 4 * 0.0525) / 5, rtol=1e-5)


def test_two_that_look_through_a_surface_outvote_one_that_is_as_sure():
    out, _ = merge_values([NEAR, FAR, FAR], [0.1, 0.1, 0.1])
    np.testing.assert_allclose(out, FAR, rtol=1e-6)


def test_one_that_is_much_surer_outvotes_two():
    out, spread = merge_values([NEAR, FAR, FAR], [0.01, 0.1, 0.1])
    np.testing.assert_allclose(out, NEAR, rtol=1e-6)
    np.testing.assert_allclose(spread, 0.01, rtol=1e-5)


def away():
    """Return a motion after which a point of the frame is outside the image."""
    return np.column_stack([np.eye(3), (5.0, 0, 0)])


def test_one_that_cannot_see_the_near_surface_does_not_outvote_it():
    """The second keyframe is ten times as sure of the background."""
    candidates, shares = [NEAR, FAR], [0.1, 0.01]
    assert merge_values(candidates, shares)[0] == FAR  # it looks through the near surface
    hidden = merge_values(candidates, shares, surfaces=[NEAR, 3.0])
    outside = merge_values(candidates, shares, motions=[STAY, away()])
    for out, _ in (hidden, outside):
        np.testing.assert_allclose(out, NEAR, rtol=1e-6)


def test_similar_grey_levels_count():
    candidates, shares = [NEAR, FAR], [0.1, 0.08]
    assert merge_values(candidates, shares)[0] == FAR
    out, _ = merge_values(candidates, shares, greys=[100, 160])
    np.testing.assert_allclose(out, NEAR, rtol=1e-6)
    assert merge_values(candidates, shares, greys=[100, 160], decay=1e6)[0] == FAR


def test_weights_grow_with_the_distance_from_the_border():
    """Two keyframes that agree; the second sees the point near its border."""
    shift = np.column_stack([np.eye(3), (0.1, 0, 0)])  # 4 px to the right, 1 px from the border
    values = [1.0, 1.05], [0.1, 0.1]
    near_border = merge_values(*values, motions=[STAY, shift], border=4.0)[0]
    inside = merge_values(*values, motions=[STAY, shift], border=0.5)[0]
    assert 1.0 < near_border < inside < 1.05


def test_pixels_without_depth_have_no_vote():
    out, spread = merge_values([0.0, 1.0], [0.1, 0.1])
    assert out == 1 and spread == np.float32(0.1)
    out, spread = merge_values([0.0, 0.0], [0.0, 0.0])
    assert out == 0 and spread == 0


def test_how_alike_they_have_to_be_counts():
    values = [1.05, 1.0], [0.05, 0.1]
    assert 1 < merge_values(*values, alike=0.1)[0] < 1.05
    np.testing.assert_allclose(merge_values(*values, alike=0.02)[0], 1.05, rtol=1e-6)


def test_wrong_arguments_are_refused():
    depths, keys = stack(1, 1), (stack(1, 1), stack(1, 1), stack(1, 1))
    with pytest.raises(ValueError, match="deviations"):
        merge(depths, depths[:, 1:], image(1), keys, [STAY] * 2)
    with pytest.raises(ValueError, match="inverse_depths"):
        merge(depths[0], depths[0], image(1), keys, [STAY] * 2)
    with pytest.raises(ValueError, match="motions"):
        merge(depths, depths, image(1), keys, [STAY])
    with pytest.raises(TypeError, match="inverse_depths"):
        merge(depths.astype(float), depths, image(1), keys, [STAY] * 2)
