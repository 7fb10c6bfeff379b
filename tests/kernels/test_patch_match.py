"""Planes matched by the correlation of windows."""

import cv2
import numpy as np
import pytest

from bench import reference
from tisfm import Camera
from tisfm.rigid import rigid_motion

TWIST = (0.9, 0.2, 0.3, 0.004, -0.006, 0.005)
NOISE = 1.5


def texture(height, width, seed=0):
    """Return smooth noise of whole levels, as bytes are."""
    noise = np.random.default_rng(seed).normal(size=(height, width))
    smooth = cv2.GaussianBlur(noise, (0, 0), 1.5)
    return np.rint(np.clip(128 + 45 * smooth / max(smooth.std(), 1e-9), 0, 255)).astype(np.float32)


def search_in(levels0, levels1, camera, motion, largest=30.0):
    from tisfm.kernels.rigid.patch_match import PlaneSearch

    return PlaneSearch(
        levels0, levels1, motion, center=camera.center_for(*levels0.shape), focal=camera.focal,
        noise=NOISE, min_variance=1.8, min_depth=1e-3, max_depth=largest,
    )  # fmt: skip


def drawn(shape, seed=0, largest=30.0):
    planes = np.random.default_rng(seed).random((*shape, 4), np.float32)
    planes[..., 0] = 0.1 + (largest - 1) * planes[..., 0]
    planes[..., 1:3] = 0.2 * (planes[..., 1:3] - 0.5)
    return planes


class Slanted:
    """Frames that show one slanted plane, and what it is."""

    def __init__(self, height=72, width=96, plane=(9.0, 0.05, -0.04)):
        self.camera = Camera(focal=90.0)
        rotation, translation = rigid_motion(TWIST)
        self.motion = np.column_stack([rotation, translation])
        self.plane, focal = plane, self.camera.focal
        cx, cy = self.camera.center_for(height, width)
        slopes = np.array([plane[1], plane[2], plane[0] / focal])  # d = slopes · x̂
        rays = np.array([[1 / focal, 0, -cx / focal], [0, 1 / focal, -cy / focal], [0, 0, 1]])
        homography = np.linalg.inv(rays) @ (rotation + np.outer(translation, slopes)) @ rays
        self.frame1 = texture(height, width)
        # Frame 0 is looked up in frame 1.
        self.frame0 = cv2.warpPerspective(
            self.frame1, homography, (width, height), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        )
        rows, columns = np.mgrid[:height, :width]
        self.depth = plane[0] + plane[1] * (columns - cx) + plane[2] * (rows - cy)
        target = np.stack([columns, rows, np.ones_like(rows)], axis=-1) @ homography.T
        target = target[..., :2] / target[..., 2:]
        margin = 7
        self.seen = ((target > margin) & (target < np.array([width, height]) - margin)).all(axis=-1)

    def found(self, rounds, seed=0):
        search = search_in(self.frame0, self.frame1, self.camera, self.motion)
        planes = drawn(self.frame0.shape, seed)
        search.score(planes)
        for turn in range(rounds):
            search.improve(planes, draws=2, spread=2.0, tilt=0.05, seed=turn)
        return planes


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (12, 1), (13, 17), (24, 31)])
def test_score_is_that_of_the_reference(size):
    camera = Camera(focal=40.0)
    rotation, translation = rigid_motion(TWIST)
    levels0, levels1 = texture(*size), texture(*size, seed=1)
    planes = drawn(size, largest=6.0)
    search = search_in(levels0, levels1, camera, np.column_stack([rotation, translation]))
    search.score(planes)
    from tisfm.kernels.rigid.windows import OUTSIDE_COST, UNTEXTURED

    flow = reference.displacement(planes[..., 0].astype(float), camera, rotation, translation)
    rows, columns = np.mgrid[: size[0], : size[1]]
    place = np.stack([columns + flow[0], rows + flow[1]])
    limits = np.array([size[1], size[0]])[:, None, None] - 0.5
    decided = (np.minimum(np.abs(place + 0.5), np.abs(place - limits)) > 0.01).all(axis=0)
    expected, variance = reference.plane_cost(
        levels0, levels1, np.moveaxis(planes[..., :3], -1, 0).astype(float), camera, rotation,
        translation, noise=NOISE**2,
    )  # fmt: skip
    cost = planes[..., 3]
    seen = cost < UNTEXTURED
    np.testing.assert_array_equal(seen, variance > 1.8 * NOISE**2)
    compared = seen & decided
    # The kernel's homography is linear within the window.
    np.testing.assert_allclose(cost[compared], expected[compared], rtol=0, atol=0.02)
    assert (compared & (cost != OUTSIDE_COST)).mean() > 0.3 or min(size) == 1


@pytest.mark.parametrize(("size", "draws"), [((1, 9), 0), ((13, 17), 2), ((24, 31), 0)])
def test_improved_planes_are_those_of_the_reference(size, draws):
    """Of a motion without rotation and along the image, where homographies are linear."""
    camera, largest = Camera(focal=40.0), 6.0
    pose = np.eye(3), np.array([0.9, 0.2, 0.0])
    levels = texture(*size), texture(*size, seed=1)
    search = search_in(*levels, camera, np.column_stack(pose), largest=largest)
    planes = drawn(size, largest=largest)
    search.score(planes)
    state = np.moveaxis(planes, -1, 0).astype(float)
    search.improve(planes, draws=draws, spread=2.0, tilt=0.05, seed=3)

    def cost(found):
        return reference.plane_cost(*levels, found, camera, *pose, noise=NOISE**2)[0]

    options = {
        "spread": 2.0,
        "tilt": 0.05,
        "max_slope": 3 / camera.focal,
        "bounds": (1e-3, largest),
    }
    for color in range(2):
        before = state
        state = reference.improve_planes(
            state, cost, color=color, draws=draws, seed=6 + color, **options
        )
        assert (state != before).any(axis=0).mean() > 0.1
    off = np.abs(np.moveaxis(planes, -1, 0) - state).max(axis=0)
    # Where rounding decides between two planes, neighbours may take the other one.
    assert (off < 1e-3).mean() > 0.98


def test_windows_without_contrast_are_not_compared():
    from tisfm.kernels.rigid.windows import RADIUS, UNTEXTURED

    frame = texture(40, 60)
    frame[:, 30:] = 77  # bare
    planes = drawn(frame.shape)
    search = search_in(frame, frame, Camera(focal=60.0), np.eye(3, 4))
    search.score(planes)
    bare = planes[:, 30 + RADIUS :, 3]
    assert (bare == UNTEXTURED).all()
    assert (planes[:, :25, 3] < UNTEXTURED).all()
    before = planes[:, 30 + RADIUS :].copy()
    search.improve(planes, draws=2, spread=2.0, tilt=0.05, seed=0)
    np.testing.assert_array_equal(planes[:, 30 + RADIUS :], before)


def test_no_cost_rises_and_costs_are_those_of_the_planes():
    scene = Slanted()
    search = search_in(scene.frame0, scene.frame1, scene.camera, scene.motion)
    planes = drawn(scene.frame0.shape)
    search.score(planes)
    for turn in range(3):
        before = planes[..., 3].copy()
        search.improve(planes, draws=3, spread=2.0, tilt=0.05, seed=turn)
        assert (planes[..., 3] <= before).all()
        assert (planes[..., 3] < before).mean() > 0.2
    kept = planes.copy()
    search.score(planes)
    np.testing.assert_allclose(planes, kept, atol=1e-5)


def test_a_slanted_plane_is_found():
    scene = Slanted()
    planes = scene.found(rounds=5)
    off = np.abs(planes[..., 0] - scene.depth)[scene.seen]
    assert scene.seen.mean() > 0.5
    assert np.median(off) < 0.1
    assert (off < 0.5).mean() > 0.97
    slopes = np.median(planes[scene.seen][:, 1:3], axis=0)
    np.testing.assert_allclose(slopes, scene.plane[1:], atol=0.01)


def test_the_same_seed_gives_the_same_planes():
    scene = Slanted(40, 56)
    np.testing.assert_array_equal(scene.found(rounds=2), scene.found(rounds=2))


def test_noise_is_uncorrelated():
    rng = np.random.default_rng(3)
    frames = [128 + rng.normal(0, NOISE, (40, 60)).astype(np.float32) for _ in range(2)]
    planes = drawn((40, 60))
    search = search_in(*frames, Camera(focal=60.0), np.eye(3, 4))
    search.score(planes)
    for turn in range(4):
        search.improve(planes, draws=2, spread=2.0, tilt=0.05, seed=turn)
    assert (planes[..., 3] > 0.35).mean() > 0.999


def test_packed_has_each_pixel_with_three_neighbours():
    from tisfm.kernels.rigid.windows import pack_pixels

    levels = np.array([[1, 2, 3], [4, 5, 255]], np.float32)
    quads = pack_pixels(levels).view(np.uint8).reshape(2, 3, 4)
    assert quads[0].tolist() == [[1, 2, 4, 5], [2, 3, 5, 255], [3, 3, 255, 255]]
    assert quads[1].tolist() == [[4, 5, 4, 5], [5, 255, 5, 255], [255, 255, 255, 255]]


def test_disagreement():
    from tisfm.kernels.rigid.patch_match import UNTEXTURED, plane_disagreement

    scene = Slanted()
    height, width = shape = scene.frame0.shape
    cx, cy = center = scene.camera.center_for(*shape)
    focal = scene.camera.focal
    there = np.zeros((*shape, 4), np.float32)
    there[..., 0], there[..., 1:3] = scene.depth, scene.plane[1:]
    # The same plane, seen by frame 1: n·P₀ = 1 becomes n·R⁻¹(P₁ − t) = 1.
    rotation, translation = scene.motion[:, :3], scene.motion[:, 3]
    normal = np.array([*scene.plane[1:], scene.plane[0] / focal])
    turned = rotation @ normal / (1 + normal @ rotation.T @ translation)
    rows, columns = np.mgrid[:height, :width]
    here = np.zeros((*shape, 4), np.float32)
    here[..., 0] = turned[0] * (columns - cx) + turned[1] * (rows - cy) + turned[2] * focal
    here[..., 1:3] = turned[:2]
    here[:, : width // 2, 0] += 0.7
    here[0] = UNTEXTURED
    apart = np.empty(shape, np.float32)
    plane_disagreement(there, here, scene.motion, apart, center=center, focal=focal)
    known = np.isfinite(apart)
    assert known[scene.seen].all() and not known.all()
    values = apart[known]
    assert ((values < 1e-4) | (np.abs(values - 0.7) < 1e-4)).all()
    assert 0.2 < (values > 0.5).mean() < 0.8
    seen = np.where(here[..., 3] < UNTEXTURED, here[..., 0], np.inf)
    expected = reference.plane_disagreement(
        np.moveaxis(there[..., :3], -1, 0), np.stack([seen, here[..., 1], here[..., 2]]),
        scene.camera, rotation, translation,
    )  # fmt: skip
    # D of about 10, in float32.
    np.testing.assert_allclose(apart, expected, rtol=0, atol=1e-4)


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ({"noise": 0.0}, "noise is 0"),
        ({"max_depth": 0.0}, "from 0.001 to 0"),
        ({"motion": np.eye(3)}, r"motion is \(3, 3\)"),
        ({"grey1": np.zeros((9, 8), np.float32)}, "grey1 is"),
    ],
)
def test_bad_arguments(change, problem):
    from tisfm.kernels.rigid.patch_match import PlaneSearch

    frame = np.zeros((8, 9), np.float32)
    arguments = {
        "grey0": frame, "grey1": frame, "motion": np.eye(3, 4), "center": (4.0, 3.5),
        "focal": 9.0, "noise": 1.0, "min_variance": 1.8, "min_depth": 1e-3, "max_depth": 9.0,
    }  # fmt: skip
    with pytest.raises(ValueError, match=problem):
        PlaneSearch(**{**arguments, **change})
