"""Initial depth: triangulated flow, and a plane sweep for large parallax."""

from dataclasses import replace

import numpy as np
import pytest

import tisfm
from bench import reference
from tests.draws import nightly_except
from tests.pairwise import pairwise
from tests.rendered import static_scene
from tisfm.metrics import depth_errors
from tisfm.motion.settings import DEPTH
from tisfm.rigid import rigid_motion
from tisfm.scenes import STATIC_KINDS, Box, Plane, Scene, Texture

SIZES = [(5, 1), (1, 7), (7, 9), (24, 33)]
TWIST = (0.9, 0.2, 0.4, 0.01, -0.02, 0.03)


def in_vectors(cost, lanes, filler):
    """Return costs (H, W, N) in the layout of a kernel, and a plain view of them."""
    from tisfm.kernels.layout.lanes import aligned_zeros

    height, width, count = cost.shape
    padded = -(-count // lanes) * lanes
    plain = aligned_zeros((height, width, padded))
    plain[...] = filler
    plain[..., :count] = cost
    return plain.reshape(height, width, -1, lanes) if lanes > 1 else plain, plain


# --- Kernels ----------------------------------------------------------------------------------


@pairwise(size=SIZES, lanes=[16, 8, 1], count=[2, 8, 13], short=True)
def test_aggregate(size, lanes, count):
    from tisfm.kernels.rigid.semi_global import UNUSED_COST, aggregate

    rng = np.random.default_rng(0)
    cost, guide = rng.uniform(0, 2, (*size, count)), rng.uniform(0, 5, size)
    laid, _ = in_vectors(cost, lanes, UNUSED_COST)
    out, plain = in_vectors(np.ones_like(cost), lanes, 1.0)  # the kernel overwrites it
    options = {"step": 0.3, "jump": 2.0, "edge": 1.5}
    aggregate(laid, guide.astype(np.float32), out, **options)
    expected = reference.aggregate(cost, guide, **options)
    np.testing.assert_allclose(plain[..., :count], expected, rtol=1e-5, atol=1e-5)
    assert (plain[..., count:] > expected.max()).all()  # padding of the vectors never wins


@pairwise(size=SIZES, count=[2, 5], short=True)
def test_cheapest(size, count):
    from tisfm.kernels.layout.lanes import aligned_zeros
    from tisfm.kernels.rigid.semi_global import best_hypothesis

    rng = np.random.default_rng(2)
    cost = aligned_zeros((*size, 7))  # padding would have the lowest cost
    place = rng.uniform(-0.5, count - 0.5, size)
    cost[..., :count] = 3 + 2 * (np.arange(count) - place[..., None]) ** 2
    out = np.empty(size, np.float32)
    best_hypothesis(cost, out, count=count)
    inner = (np.rint(place) > 0) & (np.rint(place) < count - 1)
    np.testing.assert_allclose(out, np.where(inner, place, np.rint(place)), atol=1e-5)
    cost[...] = 1
    best_hypothesis(cost, out, count=count)
    assert not out.any()
    with pytest.raises(ValueError, match="count is 8: expected 2 to 7"):
        best_hypothesis(cost, out, count=8)


@pairwise(size=SIZES, lanes=[16, 8, 1], short=True)
def test_matching_cost(size, lanes):
    from tisfm.kernels.layout.lanes import aligned_zeros
    from tisfm.kernels.rigid.plane_sweep import matching_cost

    rng = np.random.default_rng(1)
    features = rng.uniform(-0.6, 0.6, (2, 3, *size))
    laid = [aligned_zeros((*size, 4)) for _ in range(2)]
    for array, values in zip(laid, features, strict=True):
        array[..., :3] = np.moveaxis(values, 0, -1)
    guess, weight = rng.uniform(0, 9, size), rng.uniform(0, 1, size)
    camera = tisfm.Camera(focal=40.0, center=(0.4 * size[1], 0.6 * size[0]))
    rotation, translation = rigid_motion(TWIST)
    hypotheses = 0.5 + 1.5 * np.arange(16)
    out, plain = in_vectors(np.zeros((*size, 16)), lanes, 0)
    matching_cost(
        *laid,
        guess.astype(np.float32),
        weight.astype(np.float32),
        np.column_stack([rotation, translation]).astype(np.float32),
        out,
        center=camera.center,
        focal=camera.focal,
        first=0.5,
        step=1.5,
        guess_distance=2.0,
    )
    expected = reference.matching_cost(*features, hypotheses, camera, rotation, translation)
    away = np.abs(hypotheses - guess[..., None])
    expected += weight[..., None] * np.minimum(1, away / 2)
    # At the image border, rounding decides whether a pixel is inside.
    differs = np.abs(plain - expected) > 2e-4
    assert differs.mean() <= 0.01


def test_kernels_refuse_bad_arrays():
    from tisfm.kernels.layout.lanes import aligned_zeros
    from tisfm.kernels.rigid.plane_sweep import matching_cost
    from tisfm.kernels.rigid.semi_global import aggregate

    cost, guide = aligned_zeros((4, 5, 2, 8)), np.zeros((4, 5), np.float32)
    with pytest.raises(ValueError, match="guide"):
        aggregate(cost, guide[1:], cost, step=1, jump=2, edge=1)
    with pytest.raises(TypeError, match="out"):
        aggregate(cost, guide, cost.astype(np.float64), step=1, jump=2, edge=1)
    features, motion = aligned_zeros((4, 5, 4)), np.zeros((3, 4), np.float32)
    options = {"center": (2, 2), "focal": 5, "first": 0, "step": 1, "guess_distance": 1}
    with pytest.raises(ValueError, match=r"out is .*: expected \(4, 5, 1, 8\)"):
        matching_cost(
            features, features, guide, guide, motion, aligned_zeros((5, 4, 1, 8)), **options
        )
    with pytest.raises(ValueError, match="weight"):
        matching_cost(features, features, guide, guide.T, motion, cost, **options)


# --- Triangulation ----------------------------------------------------------------------------


@pytest.mark.parametrize("kind", STATIC_KINDS)
def test_the_exact_flow_gives_the_exact_depth(kind):
    from tisfm.motion.plane_sweep import triangulated_depth

    scene = static_scene(kind, 60, 81)
    rotation, translation = rigid_motion(scene.motions[0])
    depth = triangulated_depth(scene.flow, np.column_stack([rotation, translation]), scene.camera)
    error = np.abs(depth * scene.depth / scene.camera.focal - 1)
    assert np.median(error) < 1e-3  # the surroundings and a median only matter at edges
    assert np.quantile(error, 0.9) < 0.02


def test_near_the_epipole_depth_is_that_of_the_surroundings():
    from tisfm.motion.plane_sweep import triangulated_depth

    camera = tisfm.Camera(focal=100.0, center=(40.0, 30.0))
    motion = np.column_stack([np.eye(3), [0, 0, -0.05]])
    depth = np.full((61, 81), 40.0)
    flow = np.moveaxis(reference.displacement(depth, camera, motion[:, :3], motion[:, 3]), 0, -1)
    rng = np.random.default_rng(0)
    noisy = (flow + rng.normal(scale=0.02, size=flow.shape)).astype(np.float32)
    found = triangulated_depth(noisy, motion, camera)
    assert np.isfinite(found).all()
    assert np.abs(found[25:36, 35:46]).max() < 400


# --- The plane sweep --------------------------------------------------------------------------


@pytest.fixture(scope="module")
def poles():
    """Return a wall, a block, and poles as near as the block and narrower than their motion."""
    paint = [Texture(wavelength=0.1 * scale, seed=k) for k, scale in enumerate((3, 1, 1, 1))]
    camera = tisfm.Camera(focal=400.0)
    still = np.array([-0.5, 0, 0, 0, 0, 0])
    boxes = [
        Box(texture=paint[1 + k], center=(x, y, 4.0), size=(wide, 3.0, 0.1), motion=still)
        for k, (x, y, wide) in enumerate(((-0.4, 0, 0.18), (0.1, 0, 0.18), (1.0, 1.5, 0.9)))
    ]
    wall = Plane(texture=paint[0], point=(0, 0, 10.0), motion=still)
    return Scene(objects=[wall, *boxes], camera=camera, height=240, width=320).render(samples=2)


@pytest.mark.parametrize("preset", nightly_except("balanced", of=["fast", "balanced"]))
def test_objects_narrower_than_their_motion_are_found(poles, preset):
    settings = tisfm.Settings.preset(preset, motion="camera")
    pose = np.eye(4)
    pose[0, 3] = -0.5
    result = tisfm.interpret(
        poles.frame0, poles.frame1, camera=poles.camera, settings=settings, pose=pose
    )
    error = np.abs(result.depth / poles.depth - 1)
    near = (poles.depth < 5) & poles.visible
    assert near.sum() > 2000
    assert np.median(error[near]) < 0.02
    assert (error[near] > 0.2).mean() < 0.1
    assert depth_errors(result.depth, poles.depth, mask=poles.visible).abs_rel < 0.04


def test_they_are_lost_without_the_sweep_and_the_global_search(poles, monkeypatch):
    import tisfm.motion.camera
    import tisfm.motion.plane_sweep

    monkeypatch.setattr(tisfm.motion.camera, "global_depth", lambda *_, **__: None)
    monkeypatch.setattr(tisfm.motion.plane_sweep, "DEPTH", replace(DEPTH, min_sweep_range=np.inf))
    pose = np.eye(4)
    pose[0, 3] = -0.5
    result = tisfm.interpret(
        poles.frame0,
        poles.frame1,
        camera=poles.camera,
        settings=tisfm.Settings.preset("balanced", motion="camera"),
        pose=pose,
    )
    near = (poles.depth < 5) & poles.visible
    missed = ~(np.abs(result.depth / poles.depth - 1)[near] < 0.1)  # NaN where D is negative
    assert missed.mean() > 0.5


def start_of(scene, monkeypatch, entries=2**25):
    import tisfm.motion.plane_sweep
    from tisfm.motion.problems import pyramid_of

    monkeypatch.setattr(tisfm.motion.plane_sweep, "MAX_COSTS", entries)
    frames = [frame.astype(np.float32) for frame in (scene.frame0, scene.frame1)]
    settings = tisfm.Settings(motion="camera")
    pyramid = pyramid_of(*frames, scene.camera, settings)
    rotation, translation = rigid_motion(scene.motions[0])
    motion = np.column_stack([rotation, translation / np.linalg.norm(translation)])
    flow = (scene.flow[::2, ::2] / 2).astype(np.float32)
    trust = np.ones(flow.shape[:2], np.float32)
    return tisfm.motion.plane_sweep.PlaneSweep(pyramid, motion, 1, flow, trust).initial_depth()


def test_little_parallax_needs_no_sweep(monkeypatch):
    level, depth = start_of(static_scene("sideways", 60, 80), monkeypatch)
    assert level == 1 and depth.shape == (30, 40)


def test_memory_limits_the_level_of_the_sweep(poles, monkeypatch):
    level, depth = start_of(poles, monkeypatch)
    assert level == 0 and depth.shape == (240, 320)
    level, depth = start_of(poles, monkeypatch, entries=1)
    assert level == 1 and depth.shape == (120, 160)
    far = np.median(poles.depth)
    expected = poles.camera.focal / far * np.linalg.norm(poles.motions[0][:3]) / 2
    assert np.median(depth) == pytest.approx(expected, rel=0.1)
