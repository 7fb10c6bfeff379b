"""Points that views agree on."""

import dataclasses
import hashlib

import numpy as np
import pytest

import tisfm
from tests.fusion.rooms import completeness, noisy_views, poses_in_room, relative_error, room_view
from tisfm.fusion import DepthView, fused_points
from tisfm.fusion import points as points_module
from tisfm.fusion.agreement import AgreementRule, DepthNoise, FittedViews, measure_noise
from tisfm.fusion.depth_views import PosedViews
from tisfm.fusion.neighbours import choose_neighbours
from tisfm.rigid import pose_matrix


def wall(offset=0.0, *, depth=2.0, size=(9, 13), std=0.01, **changes):
    """A view of a wall straight ahead, from a place to the right."""
    inverse_depth = np.full(size, 1 / depth, np.float32)
    values = {
        "inverse_depth": inverse_depth,
        "inverse_depth_std": std * inverse_depth,
        "pose": pose_matrix((offset, 0, 0, 0, 0, 0)),
        "frame": np.full((*size, 3), (10, 20, 30), np.uint8),
        "camera": tisfm.Camera(20.0),
        **changes,
    }
    return DepthView(**values)


def walls(count=4, **changes):
    return [wall(0.1 * n, **changes) for n in range(count)]


def bits():
    rendered = [(pose, room_view(pose, 31, 47)) for pose in poses_in_room(6)]
    cloud = fused_points(noisy_views(rendered, outliers=0.05))
    assert len(cloud) > 1000
    parts = (cloud.positions, cloud.colors, cloud.confidence)
    return hashlib.sha256(b"".join(part.tobytes() for part in parts)).hexdigest()


@pytest.mark.parametrize("outliers", [0.0, 0.05])
def test_points_of_a_room(rendered, outliers):
    cloud = fused_points(noisy_views(rendered, outliers=outliers))
    error = relative_error(cloud.positions.astype(float), rendered)
    assert np.mean(error < 0.02) > 0.99
    assert np.median(error) < 0.004  # of noise of 0.01
    assert completeness(cloud.positions, rendered) > 0.85
    # The surface is seen by some views everywhere, but kept once.
    assert 0.6 * 90 * 120 < len(cloud) < 2 * 90 * 120


def test_a_point_of_the_surface_is_kept_once():
    cloud = fused_points(walls(6, size=(30, 40)))
    # Six views, each a pixel farther to the right; 41 columns are seen by three. Where points of
    # one view end and those of the next begin, a column may count as shown by both.
    assert 30 * 39 <= len(cloud) <= 30 * 41
    np.testing.assert_allclose(cloud.positions[:, 2], 2, rtol=1e-6)
    assert (cloud.colors == (10, 20, 30)).all()


def test_the_position_is_the_mean_by_precision():
    views = [wall(std=0.02, depth=2.0), wall(std=0.01, depth=2.03), wall(std=0.02, depth=2.0)]
    cloud = fused_points(views)
    inverse_depths, stds = [1 / 2, 1 / 2.03, 1 / 2], np.array([0.02 / 2, 0.01 / 2.03, 0.02 / 2])
    expected = 1 / np.average(inverse_depths, weights=1 / stds**2)
    np.testing.assert_allclose(cloud.positions[:, 2], expected, rtol=1e-5)
    np.testing.assert_allclose(cloud.confidence, 2 / 3)


@pytest.mark.parametrize("agreeing", [1, 2, 3, 4])
def test_the_number_of_agreeing_views_is_a_setting(agreeing):
    """Two agree, a third sees something nearer, so that the point is hidden from it."""
    views = [wall(), wall(), wall(depth=1.5)]
    cloud = fused_points(views, agreeing=agreeing)
    near, far = (np.isclose(cloud.positions[:, 2], z).sum() for z in (1.5, 2))
    assert far == (9 * 13 if agreeing <= 2 else 0)
    # Two views see through the nearer wall.
    assert near == 0


def test_contradicting_views_leave_no_points():
    assert len(fused_points([wall(depth=z) for z in (1, 1.5, 2, 3)])) == 0


def test_few_views():
    assert len(fused_points([])) == 0
    assert len(fused_points([wall()])) == 9 * 13
    assert len(fused_points([wall(), wall(0.1)])) > 9 * 9


@pytest.mark.parametrize(
    "change",
    [
        {"inverse_depth": np.full((9, 13), np.nan, np.float32)},
        {"inverse_depth": np.zeros((9, 13), np.float32)},
        {"inverse_depth": np.full((9, 13), -np.inf, np.float32)},
        {"inverse_depth_std": np.full((9, 13), np.inf, np.float32)},
        {"inverse_depth_std": np.full((9, 13), np.nan, np.float32)},
        {"pose": np.full((4, 4), np.nan)},
    ],
    ids=["NaN", "0", "−∞", "σ ∞", "σ NaN", "pose"],
)
def test_views_without_depth_are_left_out(change):
    """It neither counts as a view nor changes anything."""
    views = walls()
    expected = fused_points(views)
    assert len(fused_points([dataclasses.replace(views[0], **change)])) == 0
    found = fused_points([dataclasses.replace(views[0], **change), *views])
    np.testing.assert_array_equal(found.positions, expected.positions)
    np.testing.assert_array_equal(found.confidence, expected.confidence)


@pytest.mark.parametrize("size", [(1, 1), (1, 7), (6, 1), (5, 8)])
def test_any_size(size):
    cloud = fused_points([wall(size=size) for _ in range(3)])
    assert len(cloud) == size[0] * size[1]


def test_views_of_different_sizes_and_cameras():
    views = [wall(), wall(size=(19, 27), camera=tisfm.Camera(40.0)), wall()]
    assert 9 * 13 <= len(fused_points(views)) <= 19 * 27


def test_grey_frames():
    views = [wall(frame=np.full((9, 13), 77, np.uint8)) for _ in range(3)]
    assert (fused_points(views).colors == 77).all()


@pytest.mark.parametrize("unit", [1e-6, 1e6])
def test_the_unit_of_length_is_of_no_matter(rendered, unit):
    views = noisy_views(rendered[:5])
    scaled = []
    for view in views:
        pose = view.pose.copy()
        pose[:3, 3] *= unit
        scaled.append(
            dataclasses.replace(
                view,
                pose=pose,
                inverse_depth=view.inverse_depth / np.float32(unit),
                inverse_depth_std=view.inverse_depth_std / np.float32(unit),
            )
        )
    expected, found = fused_points(views), fused_points(scaled)
    # Rounded otherwise, a pixel may count as another, so that a few points come or go.
    assert abs(len(found) - len(expected)) <= 0.01 * len(expected)
    np.testing.assert_allclose(
        np.median(found.positions, axis=0) / unit, np.median(expected.positions, axis=0), rtol=0.01
    )


def test_options_change_the_points(rendered):
    views = noisy_views(rendered[:5], outliers=0.05)
    usual = len(fused_points(views))
    assert len(fused_points(views, agreeing=1)) > usual > len(fused_points(views, agreeing=4))
    strict, complete = (len(fused_points(views, coverage=c)) for c in ("strict", "complete"))
    assert strict < usual < complete
    assert len(fused_points(views, max_relative_std=0.005)) == 0
    farthest = [
        np.linalg.norm(fused_points(views, max_depth=bound).positions, axis=1).max()
        for bound in (1.0, None)
    ]
    assert farthest[0] < farthest[1]


def test_deviations_that_are_too_large_are_reduced(rendered):
    """Views whose stated deviations are three times their differences give the same points."""
    views = noisy_views(rendered[:5], noise=0.004)
    wide = [
        dataclasses.replace(view, inverse_depth_std=3 * view.inverse_depth_std) for view in views
    ]
    read = PosedViews(wide, max_relative_std=1.0, max_depth=None)
    noise = measure_noise(read)
    # Interpolation between pixels, at places of all kinds, averages noise: its variance is 4/9.
    spread = np.sqrt(1 + 4 / 9)
    assert noise.deviation_factor == pytest.approx(spread / np.sqrt(2) / 3, rel=0.1)
    assert noise.max_difference == pytest.approx(2 * 0.6745 * 0.004 * spread, rel=0.1)
    assert len(fused_points(wide)) == pytest.approx(len(fused_points(views)), rel=0.1)


def test_points_that_views_see_through_are_removed():
    """A point half-way to the wall is removed; points on the wall and just before it stay."""
    views = [wall(0.03 * n, size=(30, 40)) for n in range(12)]
    noise = DepthNoise(max_difference=0.01)
    read = PosedViews(views, max_relative_std=1.0, max_depth=None, cached_views=12)
    points = points_module._PointList()
    positions = np.array([[0, 0, 2], [0, 0, 1.5], [0, 0, 1.99]], np.float32)
    points.add(
        positions / np.float32(read.unit),
        np.full(3, 0.01, np.float32),
        np.zeros((3, 3), np.float32),
        np.ones(3, np.float32),
    )
    points.carve(FittedViews(read, noise))
    np.testing.assert_allclose(points.positions[:, 2] * read.unit, [2, 1.99], rtol=1e-6)


def test_a_cube_has_the_mean_of_its_points_by_precision():
    random = np.random.default_rng(0)
    positions = np.concatenate([random.uniform(0.1, 0.9, (4, 3)), random.uniform(1.1, 1.9, (3, 3))])
    deviation = np.array([0.01, 0.02, 0.05, 0.01, 0.03, 0.01, 0.01])
    colors, confidence = random.uniform(0, 255, (7, 3)), random.uniform(0, 1, 7)
    found = points_module._PointList()
    given = (positions, deviation, colors, confidence)
    found.add(*(values.astype(np.float32) for values in given))
    found.thin(1.0)
    for cube, inside in enumerate([slice(0, 4), slice(4, 7)]):
        precision = 1 / deviation[inside] ** 2
        for mean, values in (
            (found.positions, positions),
            (found.colors, colors),
            (found.confidence, confidence),
        ):
            expected = np.average(values[inside], axis=0, weights=precision)
            np.testing.assert_allclose(mean[cube], expected, rtol=1e-5)
        expected = 1 / np.sqrt(precision.sum())
        np.testing.assert_allclose(found.relative_deviation[cube], expected, rtol=1e-5)


def test_the_deviation_of_a_point_is_that_of_the_mean():
    """Its precision is the sum of those of the views, relative to the inverse depth."""
    stds = (0.02, 0.01, 0.03)
    read = PosedViews(
        [wall(std=std) for std in stds], max_relative_std=0.1, max_depth=None, cached_views=3
    )
    view, *others = read
    rule = AgreementRule(agreeing=3, min_share=0.5, max_relative_std=0.1)
    is_candidate = np.ones(view.inverse_depth.shape, bool)
    found = points_module._agreed_points(view, others, is_candidate, rule, DepthNoise())
    _, relative, _, _ = found
    expected = 1 / np.sqrt(sum(1 / std**2 for std in stds))
    np.testing.assert_allclose(relative, expected, rtol=1e-4)


def test_voxels_hold_one_point_each(rendered):
    views = noisy_views(rendered[:5])
    all_of_them, cloud = fused_points(views), fused_points(views, voxel=0.2)
    cubes = np.unique(np.floor(all_of_them.positions / np.float32(0.2)), axis=0)
    assert len(cloud) == pytest.approx(len(cubes), rel=0.02)  # a few lie on the side of a cube
    assert len(np.unique(np.floor(cloud.positions / np.float32(0.2)), axis=0)) > 0.97 * len(cloud)
    assert np.mean(relative_error(cloud.positions.astype(float), rendered) < 0.05) > 0.9


def test_views_are_read_one_by_one(rendered):
    class Lazily:
        def __init__(self, views):
            self.views, self.read = views, []

        def __len__(self):
            return len(self.views)

        def __getitem__(self, index):
            self.read.append(index)
            return self.views[index]

    views = noisy_views(rendered)
    lazily = Lazily(views)
    cloud = fused_points(lazily)
    np.testing.assert_array_equal(cloud.positions, fused_points(views).positions)
    assert lazily.read[:12] == list(range(12))


def test_memory_holds_the_given_number_of_views(rendered):
    views = PosedViews(noisy_views(rendered), max_relative_std=0.1, max_depth=None, cached_views=3)
    first = views[0]
    assert views[0] is first
    _ = views[1], views[0], views[2], views[3]
    assert views[0] is first
    assert views._prepare_cached.cache_info().currsize == 3


def test_neighbours_see_the_same(rendered):
    views = PosedViews(noisy_views(rendered), max_relative_std=0.1, max_depth=None)
    for n in range(len(views)):
        found = choose_neighbours(n, views.summaries, 5)
        assert n not in found
        assert len(set(found)) == len(found) == 5
    turned = dataclasses.replace(
        views.summaries[0], pose=views.summaries[0].pose @ pose_matrix((0, 0, 0, 0, np.pi, 0))
    )
    assert choose_neighbours(0, [views.summaries[0], turned], 5) == []


def test_the_same_bits_twice():
    assert bits() == bits()


def test_inputs_are_not_modified():
    views = walls()
    before = [{k: np.copy(v) for k, v in vars(view).items() if k != "camera"} for view in views]
    fused_points(views)
    for view, arrays in zip(views, before, strict=True):
        for name, array in arrays.items():
            np.testing.assert_array_equal(getattr(view, name), array)


# Faults


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"inverse_depth": np.ones(5, np.float32)}, r"inverse_depth is \(5,\)"),
        ({"inverse_depth_std": np.ones((3, 3), np.float32)}, r"inverse_depth_std is \(3, 3\) but"),
        ({"frame": np.zeros((9, 13, 4), np.uint8)}, r"frame is \(9, 13, 4\)"),
        ({"pose": np.eye(3)}, r"pose is \(3, 3\)"),
        ({"pose": 2 * np.eye(4)}, "expected a rotation and a translation"),
        ({"pose": np.diag([1.0, 1, -1, 1])}, "expected a rotation and a translation"),
        ({"inverse_depth": np.ma.masked_all((9, 13))}, "masked"),
        ({"camera": tisfm.Camera(20.0, distortion=(0.1, 0, 0, 0))}, "distortion"),
    ],
)
def test_views_are_checked(change, message):
    with pytest.raises(ValueError, match=message):
        wall(**change)


@pytest.mark.parametrize("change", [{"frame": np.zeros((9, 13))}, {"camera": 20.0}])
def test_kinds_are_checked(change):
    with pytest.raises(TypeError, match=rf"{next(iter(change))} is .*: expected"):
        wall(**change)


@pytest.mark.parametrize(
    ("options", "error"),
    [
        ({"agreeing": 0}, ValueError),
        ({"coverage": "some"}, ValueError),
        ({"agreeing": 2.5}, ValueError),
        ({"max_relative_std": 0}, ValueError),
        ({"max_relative_std": "much"}, TypeError),
        ({"max_depth": np.inf}, ValueError),
        ({"voxel": -1}, ValueError),
        ({"voxel": True}, TypeError),
    ],
)
def test_options_are_checked(options, error):
    with pytest.raises(error, match=f"{next(iter(options))} is .*: expected"):
        fused_points(walls(), **options)


def test_other_values_than_views_are_refused():
    with pytest.raises(TypeError, match="views is a generator: expected a sequence"):
        fused_points(view for view in walls())
    with pytest.raises(TypeError, match=r"views\[0\] is a str: expected a DepthView"):
        fused_points(["view"])
