"""Kernels of fusion against the NumPy reference."""

import numpy as np
import pytest

from bench.reference import fusion as reference
from tisfm import runtime
from tisfm.rigid import pose_matrix

SIZES = [(1, 1), (5, 1), (1, 6), (7, 9), (13, 37)]
each_size = pytest.mark.parametrize("size", SIZES, ids=lambda s: f"{s[0]}x{s[1]}")
TWIST = (0.05, -0.03, 0.1, 0.02, -0.04, 0.05)


@pytest.fixture(autouse=True)
def started():
    runtime.start()


def depth_map(size, seed=0):
    """A slanted plane before another, with noise, single mistakes and holes; σ of 1 %."""
    random = np.random.default_rng(seed)
    rows, columns = np.mgrid[: size[0], : size[1]]
    inverse_depth = 0.8 + 0.004 * columns - 0.006 * rows + 0.3 * (columns > 0.6 * size[1])
    inverse_depth *= 1 + 0.005 * random.normal(size=size)
    inverse_depth[random.uniform(size=size) < 0.1] *= 1.5
    inverse_depth[random.uniform(size=size) < 0.1] = 0
    inverse_depth[0, 0] = 0.8  # also where this is all
    inverse_depth = inverse_depth.astype(np.float32)
    return inverse_depth, np.float32(0.01) * inverse_depth


def intrinsics(size):
    return np.array([[1.2 * size[1] + 3, 0, 0.4 * size[1]], [0, 1.2 * size[1] + 3, 2], [0, 0, 1]])


def to_pixels(size, twist=TWIST):
    return (intrinsics(size) @ pose_matrix(twist)[:3]).astype(np.float32)


def some_points(size, number=400):
    """Points before a view, near its surface and elsewhere; behind it, and beside it."""
    random = np.random.default_rng(3)
    inverse_depth, _ = depth_map(size)
    x = random.uniform(-2, size[1] + 1, number)
    y = random.uniform(-2, size[0] + 1, number)
    column, row = (
        np.clip(np.rint(a), 0, s - 1).astype(int) for a, s in ((x, size[1]), (y, size[0]))
    )
    z = 1 / np.where(inverse_depth > 0, inverse_depth, 0.8)[row, column]
    z *= random.choice([1, 1.01, 0.9, 1.3, -1], number)
    ahead = np.linalg.inv(intrinsics(size)) @ np.stack([x, y, np.ones(number)]) * z
    pose = np.linalg.inv(pose_matrix(TWIST))
    return np.ascontiguousarray((pose[:3, :3] @ ahead + pose[:3, 3:]).T, dtype=np.float32)


@each_size
def test_depth_between_pixels_is_of_one_surface(size):
    """By the mean colour's depth test: `add_colors` says where a point is near the surface."""
    from tisfm.kernels.fusion.agreement import add_colors

    inverse_depth, _ = depth_map(size)
    colors = np.random.default_rng(1).uniform(0, 255, (*size, 3)).astype(np.float32)
    points, projection = some_points(size), to_pixels(size)
    sums = np.zeros((len(points), 4), np.float32)
    add_colors(points, inverse_depth, colors, sums, projection=projection, max_distance=0.03)
    expected = reference.add_colors(
        points.astype(float),
        inverse_depth.astype(float),
        colors,
        projection=projection.astype(float),
        near=0.03,
    )
    assert 0 < np.count_nonzero(expected[:, 3]) < len(points)
    np.testing.assert_allclose(sums, expected, rtol=1e-5)


@each_size
def test_compare(size):
    from tisfm.kernels.fusion.agreement import compare

    inverse_depth, deviation = depth_map(size)
    other_size = (size[0] + 2, size[1] + 1)
    other, other_deviation = depth_map(other_size, seed=1)
    other_colors = np.random.default_rng(2).uniform(0, 255, (*other_size, 3)).astype(np.float32)
    turned = pose_matrix((0.01, 0.02, 0.02, 0.01, -0.01, 0.02))
    back = turned[:3, :3] @ np.linalg.inv(intrinsics(size))
    projection = intrinsics(other_size) @ np.column_stack([back, turned[:3, 3]])
    projection = projection.astype(np.float32)
    before = np.random.default_rng(4).uniform(size=(*size, 8)).astype(np.float32)
    sums, colors = before[..., :5].copy(), before[..., 5:].copy()
    compare(
        inverse_depth, deviation, other, other_deviation, other_colors, sums, colors,
        projection=projection, tolerance=3, max_difference=0.02,
    )  # fmt: skip
    added, added_colors = reference.compare(
        *(a.astype(float) for a in (inverse_depth, deviation, other, other_deviation)),
        other_colors,
        projection=projection.astype(float),
        tolerance=3,
        max_difference=0.02,
    )
    if size[0] > 5:
        assert (added[..., 4] > added[..., 2] + added[..., 3]).sum() > 5
        assert (added[..., 2] > 0).sum() > 5 < (added[..., 3] > 0).sum()
    # Differences of depth, near 1, divided by squares of deviations, near 0.01.
    np.testing.assert_allclose(sums, before[..., :5] + added, rtol=1e-4, atol=2e-2)
    np.testing.assert_allclose(colors, before[..., 5:] + added_colors, rtol=1e-6)


@each_size
def test_measure_differences(size):
    from tisfm.kernels.fusion.consistency import measure_differences

    inverse_depth, deviation = depth_map(size)
    other, other_deviation = depth_map(size, seed=1)
    turned = pose_matrix((0.01, 0.02, 0.02, 0.01, -0.01, 0.02))
    back = turned[:3, :3] @ np.linalg.inv(intrinsics(size))
    projection = intrinsics(size) @ np.column_stack([back, turned[:3, 3]])
    projection = projection.astype(np.float32)
    found = np.full((*size, 2), np.nan, np.float32)
    measure_differences(
        inverse_depth, deviation, other, other_deviation, found, projection=projection
    )
    expected = reference.measure_differences(
        *(a.astype(float) for a in (inverse_depth, deviation, other, other_deviation)),
        projection=projection.astype(float),
    )
    if size[0] > 5:
        assert np.isfinite(expected[..., 0]).sum() > 20 and np.isnan(expected[..., 0]).sum() > 5
    # Differences of inverse depths near 1, in float32, divided by deviations near 0.01.
    np.testing.assert_allclose(found[..., 0], expected[..., 0], atol=3e-6)
    np.testing.assert_allclose(found[..., 1], expected[..., 1], atol=3e-4)


@each_size
def test_count_views(size):
    from tisfm.kernels.fusion.consistency import count_views

    inverse_depth, deviation = depth_map(size)
    points, projection = some_points(size), to_pixels(size)
    relative_deviation = np.full(len(points), 0.01, np.float32)
    counts = np.ones((len(points), 2), np.int32)
    count_views(
        points, relative_deviation, inverse_depth, deviation, counts,
        projection=projection, tolerance=3, min_difference=0.06,
    )  # fmt: skip
    expected = reference.count_views(
        *(a.astype(float) for a in (points, relative_deviation, inverse_depth, deviation)),
        projection=projection.astype(float),
        tolerance=3,
        min_difference=0.06,
    )
    if size[0] > 5:
        assert expected.sum(axis=0).min() > 5
    np.testing.assert_array_equal(counts, 1 + expected)


@each_size
def test_mark_shown(size):
    from tisfm.kernels.fusion.agreement import mark_pixels_of_points

    inverse_depth, deviation = depth_map(size)
    points, projection = some_points(size, 60), to_pixels(size)
    relative = np.random.default_rng(5).uniform(0, 0.02, len(points)).astype(np.float32)
    shown = np.zeros(size, np.int32)
    mark_pixels_of_points(
        points, relative, inverse_depth, deviation, shown, projection=projection, tolerance=3
    )
    expected = reference.mark_visible_pixels(
        *(a.astype(float) for a in (points, relative, inverse_depth, deviation)),
        projection=projection.astype(float),
        tolerance=3,
    )
    assert expected.any() and (size[0] * size[1] < 30 or not expected.all())
    np.testing.assert_array_equal(shown, expected)


@each_size
@pytest.mark.parametrize(("stride", "places"), [(1, 3), (2, 5), (3, 2)])
def test_blocks_near(size, stride, places):
    from tisfm.kernels.fusion.distance_field import CORNERS, find_blocks

    inverse_depth, deviation = depth_map(size)
    extent = (9, 7, 23)
    rays = np.column_stack([np.linalg.inv(intrinsics(size)), np.zeros(3)]) / 0.02
    rays[:, 3] = 20.3, 17.1, 3.4
    rays = rays.astype(np.float32)
    options = {"stride": stride, "rays": rays, "truncation": 0.08}
    found = set()
    rows = -(-size[0] // stride)
    for first in range(0, rows, 2):  # some rows at a time
        count = min(2, rows - first)
        out = np.full((count, -(-size[1] // stride), places, CORNERS), -7, np.int32)
        find_blocks(
            inverse_depth, deviation, out, top=first * stride, extent=extent, **options
        )  # fmt: skip
        found |= set(np.unique(out[out >= 0]).tolist())
        assert out.min() >= -1
    options["rays"] = rays.astype(float)
    blocks = reference.blocks_near(
        inverse_depth.astype(float), deviation.astype(float), samples=places, **options
    )
    inside = {b for b in blocks if all(0 <= p < n for p, n in zip(b, extent, strict=True))}
    if size[0] > 7:
        assert 10 < len(inside) < len(blocks)
    assert found == {(x * extent[1] + y) * extent[2] + z for x, y, z in inside}


@each_size
def test_integrate(size):
    from tisfm.kernels.fusion.distance_field import VOXELS, integrate

    inverse_depth, deviation = depth_map(size)
    projection = to_pixels(size).astype(float)
    voxel, truncation, spread = 0.04, 0.12, 0.02
    offsets = np.array([(i, j, k) for i in (-1, 0) for j in (-1, 0) for k in (1, 2, 3)])
    corners = offsets * 8 * voxel @ projection[:, :3].T + projection[:, 3]
    corners = corners.astype(np.float32)
    steps = np.ascontiguousarray(voxel * projection[:, :3].T, dtype=np.float32)
    index = np.random.default_rng(6).permutation(len(corners) + 3)[: len(corners)].astype(np.int32)
    random = np.random.default_rng(7)
    before = random.uniform(-1, 1, (len(corners) + 3, VOXELS)).astype(np.float32)
    weight = random.uniform(0, 2, before.shape).astype(np.float32)
    views = random.integers(0, 5, before.shape, dtype=np.int32)
    distance, total, count = before.copy(), weight.copy(), views.copy()
    options = {"truncation": truncation, "spread": spread}
    integrate(
        inverse_depth, deviation, corners, index, distance, total, count, steps=steps, **options
    )
    new, added, near = reference.integrate(
        inverse_depth.astype(float),
        deviation.astype(float),
        corners.astype(float),
        steps=steps.astype(float),
        **options,
    )
    if size[0] > 5:
        assert 50 < np.count_nonzero(near) < np.count_nonzero(added) < added.size
    expected, expected_total, expected_count = before.astype(float), weight.astype(float), views
    mean = (expected * weight)[index] + new * added
    expected_total[index] += added
    expected[index] = mean / expected_total[index]
    expected_count[index] += near
    np.testing.assert_allclose(distance, expected, atol=2e-5)
    np.testing.assert_allclose(total, expected_total, rtol=1e-4)
    np.testing.assert_array_equal(count, expected_count)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"stride": 0}, "stride is 0"),
        ({"top": 5}, "top is 5"),
        ({"extent": (0, 1, 1)}, "extent is"),
        ({"extent": (2000, 2000, 2000)}, "extent is"),
    ],
)
def test_impossible_blocks_are_refused(change, message):
    from tisfm.kernels.fusion.distance_field import CORNERS, find_blocks

    options = {"top": 0, "stride": 1, "extent": (2, 2, 2), "truncation": 0.1, **change}
    image = np.ones((4, 5), np.float32)
    with pytest.raises(ValueError, match=message):
        find_blocks(
            image, image, np.empty((4, 5, 3, CORNERS), np.int32),
            rays=np.zeros((3, 4), np.float32), **options,
        )  # fmt: skip


def test_blocks_that_there_are_not_are_refused():
    from tisfm.kernels.fusion.distance_field import VOXELS, integrate

    image, arrays = np.ones((4, 5), np.float32), np.zeros((2, VOXELS), np.float32)
    with pytest.raises(ValueError, match=r"index is 0 to 2: expected 0 to 1"):
        integrate(
            image, image, np.zeros((2, 3), np.float32), np.array([0, 2], np.int32),
            arrays, arrays.copy(), np.zeros((2, VOXELS), np.int32),
            steps=np.zeros((3, 3), np.float32), truncation=0.1, spread=0.1,
        )  # fmt: skip
