"""Planes matched in several frames at once."""

import numpy as np
import pytest

from bench import reference
from tests.kernels.test_patch_match import NOISE, drawn, texture
from tisfm import Camera

CAMERA = Camera(focal=40.0)
# Without rotation and along the image, where homographies are linear.
POSES = [(np.eye(3), np.array(t)) for t in ((0.9, 0.2, 0.0), (-0.7, 0.1, 0.0), (0.1, -1.1, 0.0))]
MOTIONS = np.array([np.column_stack(pose) for pose in POSES])


def frames(size, count=4):
    return [texture(*size, seed=seed) for seed in range(count)]


def search_in(key, others, motions, *, best=2, stride=1, largest=6.0):
    from tisfm.kernels.rigid.view_search import ViewSearch

    return ViewSearch(
        key, others, motions, frame_count=best, stride=stride, center=CAMERA.center_for(*key.shape),
        focal=CAMERA.focal, noise=NOISE, min_variance=1.8, min_depth=1e-3, max_depth=largest,
    )  # fmt: skip


def costs_of_reference(key, others, planes):
    """Return the cost in every frame of planes (3, H, W), and the variance of their windows."""
    found = [
        reference.plane_cost(key, other, planes, CAMERA, *pose, noise=NOISE**2)
        for other, pose in zip(others, POSES, strict=True)
    ]
    return np.array([cost for cost, _ in found]), found[0][1]


@pytest.mark.parametrize("best", [1, 2, 3])
@pytest.mark.parametrize("size", [(1, 9), (13, 17), (24, 31)])
def test_score_is_the_mean_of_the_best_frames(size, best):
    from tisfm.kernels.rigid.view_search import MISSING_FRAME_COST
    from tisfm.kernels.rigid.windows import UNTEXTURED

    key, *others = frames(size)
    planes = drawn(size, largest=6.0)
    search = search_in(key, others, MOTIONS, best=best)
    search.score(planes)
    expected, variance = costs_of_reference(key, others, np.moveaxis(planes, -1, 0)[:3])
    seen = planes[..., 3] < UNTEXTURED
    np.testing.assert_array_equal(seen, variance > 1.8 * NOISE**2)
    # Where a pixel goes to the border of a frame, rounding decides whether it is seen.
    off = np.abs(
        planes[..., 3] - reference.best_mean(expected, best, missing_cost=MISSING_FRAME_COST)
    )[seen]
    assert (off < 1e-3).mean() > 0.98
    each = np.empty((len(others), *size), np.float32)
    search.write_costs(planes, each)
    assert (np.abs(each - expected) < 1e-3).mean() > 0.98


@pytest.mark.parametrize("stride", [2, 3])
def test_the_cost_of_a_cell_is_that_of_its_first_pixel(stride):
    size = (25, 33)
    key, *others = frames(size)
    search = search_in(key, others, MOTIONS, stride=stride)
    assert search.shape == (size[0] // stride, size[1] // stride)
    planes = drawn(search.shape, largest=6.0)
    each = np.empty((len(others), *search.shape), np.float32)
    search.write_costs(planes, each)
    depth, east, south = np.moveaxis(planes, -1, 0)[:3]
    east, south = east / stride, south / stride
    first = depth - (stride - 1) / 2 * (east + south)
    whole = np.zeros((3, *size))
    rows, columns = (stride * np.arange(count) for count in search.shape)
    whole[:, rows[:, None], columns] = first, east, south
    expected = costs_of_reference(key, others, whole)[0][:, rows[:, None], columns]
    assert (np.abs(each - expected) < 1e-3).mean() > 0.98


@pytest.mark.parametrize(("size", "draws"), [((1, 9), 0), ((13, 17), 2)])
def test_improved_planes_are_those_of_the_reference(size, draws):
    from tisfm.kernels.rigid.view_search import MISSING_FRAME_COST

    key, *others = frames(size)
    search = search_in(key, others, MOTIONS)
    planes = drawn(size, largest=6.0)
    search.score(planes)
    state = np.moveaxis(planes, -1, 0).astype(float)
    search.improve(planes, draws=draws, spread=2.0, tilt=0.05, seed=3)

    def cost(found):
        return reference.best_mean(
            costs_of_reference(key, others, found)[0], 2, missing_cost=MISSING_FRAME_COST
        )

    options = {"spread": 2.0, "tilt": 0.05, "max_slope": 3 / CAMERA.focal, "bounds": (1e-3, 6.0)}
    for color in range(2):
        state = reference.improve_planes(
            state, cost, color=color, draws=draws, seed=6 + color, **options
        )
    off = np.abs(np.moveaxis(planes, -1, 0) - state).max(axis=0)
    # Where rounding decides between two planes, neighbours may take the other one.
    assert (off < 1e-3).mean() > 0.95


def test_no_cost_rises():
    key, *others = frames((24, 31))
    search = search_in(key, others, MOTIONS, stride=2)
    planes = drawn(search.shape, largest=6.0)
    search.score(planes)
    before = planes[..., 3].copy()
    search.improve(planes, draws=2, spread=2.0, tilt=0.05, seed=0)
    assert (planes[..., 3] <= before).all()
    assert (planes[..., 3] < before).mean() > 0.2


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"best": 0}, "frame_count is 0: expected 1 to 3"),
        ({"best": 4}, "frame_count is 4: expected 1 to 3"),
        ({"stride": 0}, "stride is 0"),
        ({"largest": 0.0}, "D is searched from"),
        ({"motions": MOTIONS[:2]}, r"motions is \(2, 3, 4\): expected \(3, 3, 4\)"),
        ({"others": [texture(13, 16)] * 3}, r"others\[0\] is .*expected"),
    ],
)
def test_arguments_are_checked(changes, message):
    key, *others = frames((13, 17))
    arguments = {"others": others, "motions": MOTIONS, **changes}
    with pytest.raises((TypeError, ValueError), match=message):
        search_in(key, arguments.pop("others"), arguments.pop("motions"), **arguments)
