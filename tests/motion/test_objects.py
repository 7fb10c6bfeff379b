"""motion="objects": motions, labels and depth of moving objects."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

import tisfm
from bench.reference import flow as flow_of
from bench.reference import motion_matrix
from tests.draws import nightly_except
from tests.motion.one_motion import FAST_OBJECTS as FAST
from tests.motion.one_motion import OBJECTS, interpreted, shared
from tests.rendered import static_scene, three_blocks, two_blocks
from tisfm.metrics import depth_errors, pose_errors
from tisfm.motion.estimate import Estimate
from tisfm.motion.objects.depth import align_scales
from tisfm.rigid import pose_matrix, rigid_motion

SIZE = (120, 160)


def true_objects(scene):
    """Return the true objects: wall and floor are one, each block is another."""
    return np.maximum(scene.labels - 1, 0)


def overlap(found, true):
    """Intersection over union."""
    return (found & true).sum() / (found | true).sum()


def partners(result, scene):
    """Return the label of the result for each true object, by overlap."""
    true = true_objects(scene)
    return [
        max(range(len(result.motions)), key=lambda k: overlap(result.labels == k, true == body))
        for body in range(true.max() + 1)
    ]


@pytest.fixture(scope="module")
def blocks():
    return two_blocks(240, 320, seed=6)


@pytest.fixture(scope="module")
def result(blocks):
    return shared(blocks, OBJECTS)


@pytest.fixture(scope="module")
def small():
    return two_blocks(*SIZE, seed=2)


@pytest.fixture(scope="module")
def tiny():
    return two_blocks(60, 80, seed=2)


# --- Labels, depth and motions ----------------------------------------------------------------


def check(result, scene, *, least_overlap=0.97, most_error=0.03):
    """Check that labels and true objects match one to one, and that depth in each is right."""
    true, mine = true_objects(scene), partners(result, scene)
    assert len(set(mine)) == len(mine) == len(result.motions)
    for body, label in enumerate(mine):
        assert overlap(result.labels == label, true == body) >= least_overlap
        both = (result.labels == label) & (true == body) & scene.visible
        assert depth_errors(result.depth, scene.depth, mask=both).abs_rel < most_error


def test_two_moving_blocks(result, blocks):
    assert result.status == "converged"
    check(result, blocks, least_overlap=0.985, most_error=0.02)
    assert result.labels.dtype == np.int32 and result.motions.dtype == np.float64
    np.testing.assert_allclose(np.linalg.norm(result.motions[:, :3], axis=1), 1)


def test_the_background_comes_first(result, blocks):
    areas = np.bincount(result.labels.ravel())
    assert np.all(np.diff(areas) <= 0)
    assert partners(result, blocks)[0] == 0


@pytest.mark.parametrize(
    ("seed", "settings"),
    [
        pytest.param(7, OBJECTS, marks=pytest.mark.nightly),
        pytest.param(8, OBJECTS, marks=pytest.mark.nightly),
        pytest.param(9, FAST, marks=pytest.mark.nightly),
    ],
)
def test_three_moving_blocks(seed, settings):
    """In these scenes, the first motion explains two blocks, or parts of the third."""
    scene = three_blocks(240, 320, seed=seed)
    check(interpreted(scene, settings), scene)


def test_motions_are_those_of_the_true_objects(result, blocks):
    true = [blocks.motions[label] for label in (0, 2, 3)]
    for twist, label, limit in zip(true, partners(result, blocks), (1, 6, 12), strict=True):
        found = pose_errors(pose_matrix(result.motions[label]), pose_matrix(twist))
        # A block with 1 px of parallax determines less than the room.
        assert found.direction < limit


def test_rho_is_the_field_of_the_flow(result, blocks):
    matrix = motion_matrix(blocks.camera, *blocks.depth.shape, 6)
    expected = flow_of(matrix, result.rho.astype(float))
    np.testing.assert_allclose(np.moveaxis(result.flow, -1, 0), expected, atol=2e-5)
    spin = result.motions[:, 3:].T[:, result.labels]
    np.testing.assert_allclose(result.omega, spin, atol=1e-7)


def test_one_motion_cannot_explain_it(blocks):
    """One motion has large errors of depth on the blocks."""
    camera = interpreted(blocks, tisfm.Settings(motion="camera"))
    on_blocks = (true_objects(blocks) > 0) & blocks.visible
    assert depth_errors(camera.depth, blocks.depth, mask=on_blocks).abs_rel > 0.1


@pytest.mark.parametrize("kind", nightly_except("sideways", of=["sideways", "forward+rotation"]))
def test_a_static_scene_has_one_label(kind):
    scene = static_scene(kind)
    result = interpreted(scene, OBJECTS)
    assert len(result.motions) == 1 and not result.labels.any()
    assert depth_errors(result.depth, scene.depth, mask=scene.visible).abs_rel < 0.013


def test_a_camera_at_rest():
    """The background has no parallax and gets no depth; the blocks get depth."""
    scene = two_blocks(*SIZE, seed=3, camera_motion=np.zeros(6))
    result = interpreted(scene, FAST)
    true, mine = true_objects(scene), partners(result, scene)
    assert len(result.motions) == 3 and mine[0] == 0
    assert not result.motions[0].any()
    background = result.labels == 0
    assert not result.inverse_depth[background].any()
    assert np.isinf(result.inverse_depth_std[background]).all()
    for body, label in enumerate(mine[1:], start=1):
        both = (result.labels == label) & (true == body) & scene.visible
        assert depth_errors(result.depth, scene.depth, mask=both).abs_rel < 0.03


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("size", "settings"),
    [(SIZE, FAST), pytest.param((180, 240), OBJECTS, marks=pytest.mark.nightly)],
)
def test_noise_and_a_small_picture(size, settings):
    scene = two_blocks(*size, seed=1)
    rng = np.random.default_rng(0)
    frames = [
        np.clip(frame + rng.normal(scale=2, size=size), 0, 255).astype(np.uint8)
        for frame in (scene.frame0, scene.frame1)
    ]
    result = tisfm.interpret(*frames, camera=scene.camera, settings=settings)
    true, mine = true_objects(scene), partners(result, scene)
    for body, label in enumerate(mine):
        assert overlap(result.labels == label, true == body) > 0.8


@pytest.mark.nightly
def test_same_bits_twice(tiny):
    one, again = shared(tiny, FAST), interpreted(tiny, FAST)
    np.testing.assert_array_equal(again.labels, one.labels)
    np.testing.assert_array_equal(again.inverse_depth, one.inverse_depth)


@pytest.mark.parametrize("most", nightly_except(2, of=[1, 2]))
def test_most_objects_is_a_limit(most, tiny):
    result = interpreted(tiny, dataclasses.replace(FAST, max_objects=most))
    assert len(result.motions) == most < len(shared(tiny, FAST).motions)


def test_no_motion_and_no_texture(small):
    result = tisfm.interpret(small.frame0, small.frame0, camera=small.camera, settings=FAST)
    assert result.status == "no_motion"
    assert not result.rho.any() and not result.motions.any() and not result.labels.any()
    uniform = np.full(SIZE, 90, np.uint8)
    result = tisfm.interpret(uniform, uniform, camera=small.camera, settings=FAST)
    assert result.status == "no_texture" and np.isnan(result.depth).all()


def test_a_pose_is_refused(small):
    with pytest.raises(ValueError, match='motion="objects" leaves the motion free'):
        tisfm.interpret(
            small.frame0, small.frame1, camera=small.camera, settings=FAST, pose=np.eye(4)
        )


def test_smoothness_of_depth_is_a_setting(tiny):
    smooth = dataclasses.replace(FAST, depth_smoothness=20.0)
    assert np.any(interpreted(tiny, smooth).depth != shared(tiny, FAST).depth)


def test_saved_and_loaded(result, tmp_path):
    result.save(tmp_path / "pair.npz")
    again = tisfm.Interpretation.load(tmp_path / "pair.npz")
    np.testing.assert_array_equal(again.labels, result.labels)
    np.testing.assert_array_equal(again.motions, result.motions)


# --- Scales -----------------------------------------------------------------------------------


def test_objects_on_a_floor_take_its_scale(result, blocks):
    apart = depth_errors(result.depth, blocks.depth, mask=blocks.visible).abs_rel
    together = interpreted(blocks, dataclasses.replace(OBJECTS, align_scales=True))
    assert depth_errors(together.depth, blocks.depth, mask=blocks.visible).abs_rel < 0.25 * apart
    np.testing.assert_array_equal(together.labels, result.labels)
    # Flow stays the same: T and depth change together.
    expected = together.motions[:, :3].T[:, together.labels] * together.inverse_depth
    before = result.motions[:, :3].T[:, result.labels] * result.inverse_depth
    np.testing.assert_allclose(expected, before, rtol=1e-4, atol=1e-9)


def estimate_of(inverse_depth, labels):
    shape = labels.shape
    nothing = np.zeros(shape, np.float32)
    return Estimate(
        rho=np.zeros((6, *shape), np.float32),
        flow=np.zeros((2, *shape), np.float32),
        inverse_depth=inverse_depth.astype(np.float32),
        inverse_depth_std=nothing + 1,
        precision=np.zeros((7, *shape), np.float32),
        level=0,
        is_normalized=True,
        freedom=1,
        history=[],
        status=tisfm.status.Status("converged"),
        motions=np.array([[1.0, 0, 0, 0, 0, 0], [0, 1, 0, 0, 0, 0]]),
        labels=labels,
    )


def standing(*, floor_below=True):
    """Return a box of inverse depth 4 on a floor of inverse depth 2."""
    labels = np.zeros((40, 40), np.int32)
    labels[10:30, 10:30] = 1
    inverse_depth = np.where(labels == 1, 4.0, 2.0)
    if not floor_below:
        labels[30:, :] = -1
    return inverse_depth, labels


def test_scale_is_that_of_the_contact():
    result = align_scales(estimate_of(*standing()), np.zeros((40, 40), bool))
    np.testing.assert_allclose(result.inverse_depth, 2)
    np.testing.assert_allclose(result.motions[1, :3], (0, 2, 0))
    np.testing.assert_allclose(result.inverse_depth_std[15, 15], 0.5)


def test_without_contact_scales_stay():
    hidden = np.zeros((40, 40), bool)
    hidden[30:, :] = True
    inverse_depth, labels = standing()
    result = align_scales(estimate_of(inverse_depth, labels), hidden)
    np.testing.assert_allclose(result.inverse_depth, inverse_depth)
    labels[25:, :] = np.where(labels[25:, :] == 1, 1, 0)
    labels[30:, 10:30] = 1  # down to the border of the image
    result = align_scales(estimate_of(inverse_depth, labels), np.zeros((40, 40), bool))
    assert result.motions[1, 1] == 1


# --- Parts of the method ----------------------------------------------------------------------


def test_potts_labels_are_smooth_and_cut_at_edges():
    from tisfm.motion.objects.label_optimisation import Potts

    rng = np.random.default_rng(0)
    true = np.zeros((60, 81), bool)
    true[15:45, 20:60] = True
    frame = np.where(true, 180, 60).astype(np.float32)
    wrong = rng.random(true.shape) < 0.2
    costs = np.stack([np.where(true ^ wrong, 4.0, 0.0), np.where(true ^ wrong, 0.0, 4.0)])
    weight = np.full(true.shape, 0.5, np.float32)
    labels = Potts(frame).assign(costs.astype(np.float32), weight)
    assert labels.dtype == np.int32
    assert overlap(labels == 1, true) > 0.98
    # Where the weight of a pixel is low, its neighbours decide, up to the image edge.
    weight[:, 50:70] = 1e-3
    assert overlap(Potts(frame).assign(costs.astype(np.float32), weight) == 1, true) > 0.95
    one = Potts(frame).assign(costs[:1].astype(np.float32), weight)
    assert not one.any()


def test_two_labels_are_those_of_three_of_which_one_costs_too_much():
    from tisfm.motion.objects.label_optimisation import Potts

    rng = np.random.default_rng(1)
    costs = rng.uniform(0, 4, (3, 40, 50)).astype(np.float32)
    costs[2] = 60
    weight = np.full((40, 50), 0.5, np.float32)
    potts = Potts(rng.uniform(0, 255, (40, 50)).astype(np.float32))
    two, three = (potts.assign(costs[:count], weight) for count in (2, 3))
    assert (two == three).mean() > 0.995 and 0.2 < two.mean() < 0.8


def test_boundaries_weigh_less_where_a_frame_is_sampled_less_densely():
    from tisfm.motion.objects.label_optimisation import Potts

    rng = np.random.default_rng(2)
    costs = rng.uniform(0, 4, (2, 40, 50)).astype(np.float32)
    frame, weight = np.zeros((40, 50), np.float32), np.full((40, 50), 0.5, np.float32)
    length = [
        np.count_nonzero(np.diff(Potts(frame, density=density).assign(costs, weight)))
        for density in (1.0, 0.25)
    ]
    assert length[1] > 1.2 * length[0]


def test_a_surface_of_nearly_the_same_pixels_is_fitted_once():
    from tisfm.motion.objects.layers import Layering
    from tisfm.motion.problems import pyramid_of

    pair = two_blocks(60, 80, seed=0)
    frames = [frame.astype(np.float32) for frame in (pair.frame0, pair.frame1)]
    settings = tisfm.Settings.preset("fast", motion="objects")
    pyramid = pyramid_of(*frames, pair.camera, settings)
    layering = Layering(pyramid, settings, frames[0])
    motion = np.column_stack([np.eye(3), [1.0, 0, 0]])
    support = np.ones((60, 80), bool)
    first = layering._fit_surface(motion, support)
    nearly, other = support.copy(), support.copy()
    nearly[:1], other[:30] = False, False
    assert layering._fit_surface(motion, nearly) is first
    assert layering._fit_surface(motion, other) is not first
    assert layering._fit_surface(np.column_stack([np.eye(3), [0, 1.0, 0]]), support) is not first


def test_specks_are_given_to_their_surroundings():
    from tisfm.motion.objects.layers import remove_specks

    labels = np.zeros((30, 40), np.int32)
    labels[:, 20:] = 1
    clean = labels.copy()
    labels[5:8, 5:8], labels[20:22, 30:33], labels[10, 10] = 1, 0, 2
    found = remove_specks(labels, 20)
    clean[10, 10] = 2  # the largest part of a label stays, so that no label is lost
    np.testing.assert_array_equal(found, clean)
    np.testing.assert_array_equal(remove_specks(clean, 1), clean)


def test_median_is_within_labels():
    from tisfm.motion.rigid_level import median_of_labels

    rng = np.random.default_rng(0)
    values = rng.normal(size=(20, 23)).astype(np.float32)
    labels = (np.arange(23) > 11).astype(np.float32) + np.zeros((20, 1), np.float32)
    found = median_of_labels(values + 100 * labels, labels)
    padded = np.pad(values, 2, mode="edge")
    own = np.pad(labels, 2, mode="edge")
    for y in range(20):
        for x in range(23):
            alike = own[y : y + 5, x : x + 5] == labels[y, x]
            expected = np.median(padded[y : y + 5, x : x + 5][alike])
            assert found[y, x] - 100 * labels[y, x] == pytest.approx(expected, abs=1e-4)


def test_candidates_of_an_exact_flow(small):
    from tisfm.motion.objects.candidates import motion_candidates

    true = true_objects(small)
    background = np.column_stack(rigid_motion(small.motions[0]))
    motions, labels = motion_candidates(
        small.flow.astype(np.float32),
        np.ones(SIZE, np.float32),
        small.camera,
        small.frame0.astype(np.float32),
        background,
        0.005,
        max_motions=5,
    )
    assert len(motions) == 3
    for body in range(3):
        assert max(overlap(labels == k, true == body) for k in range(3)) > 0.9


def test_parts_of_a_label_get_motions_of_their_own():
    """A motion fitted to two blocks fits neither, so it is split."""
    from tisfm.motion.objects.candidates import _CandidateSearch

    scene = three_blocks(*SIZE)
    true = np.where(true_objects(scene) < 3, true_objects(scene), 0)
    background, joint = (np.column_stack(rigid_motion(scene.motions[k])) for k in (0, 2))
    search = _CandidateSearch(
        scene.flow.astype(np.float32),
        np.ones(SIZE, np.float32),
        scene.camera,
        scene.frame0.astype(np.float32),
        100.0,  # px: no motion is an outlier
        background,
    )
    search._assign_labels = lambda motions, **options: np.minimum(true, 1)
    found = search._split_labels([background, joint], 5)
    assert len(found) == 3
    for label in (1, 2):
        distances = [np.median(search._distance(motion)[true == label]) for motion in found[1:]]
        assert min(distances) < 0.01 < max(distances)
    assert len(search._split_labels([background, joint], 2)) == 2


def test_surfaces_are_continued_beyond_their_support(small):
    """Outside the support, depth continues the neighbourhood, so residuals separate layers."""
    from tisfm.frames import grey_pair
    from tisfm.motion.problems import pyramid_of
    from tisfm.motion.rigid_depth import motion_residual, rigid_depth

    settings = tisfm.Settings()
    grey0, grey1 = grey_pair(small.frame0, small.frame1)
    pyramid = pyramid_of(grey0, grey1, small.camera, settings)
    background = true_objects(small) == 0
    motion = np.column_stack(rigid_motion(small.motions[0]))
    solution = rigid_depth(
        pyramid, settings, motion[None], np.zeros(SIZE, np.int32),
        refine="none", support=background,
    )  # fmt: skip
    residual, flow = motion_residual(pyramid, settings, solution.motions[0], solution.inverse_depth)
    assert np.median(residual[~background]) > 10 * np.median(residual[background])
    off = np.linalg.norm(np.moveaxis(flow, 0, -1) - small.flow, axis=-1)
    assert np.median(off[background]) < 0.02


def test_the_least_effort_is_that_of_the_documentation(monkeypatch):
    """Fewer warps, iterations and sweeps than documented have no effect."""
    from tisfm.motion.objects import estimation

    class Begun(Exception):
        pass

    def begin(pyramid, settings, **_):
        raise Begun(settings.warps, settings.outer_iterations, settings.sweeps)

    monkeypatch.setattr(estimation, "first_motion", begin)
    frames = np.random.default_rng(0).integers(0, 255, (2, 32, 48)).astype(np.uint8)
    for given, taken in (((1, 1, 1), (2, 10, 8)), ((3, 11, 9), (3, 11, 9))):
        names = ("warps", "outer_iterations", "sweeps")
        settings = tisfm.Settings(motion="objects", **dict(zip(names, given, strict=True)))
        with pytest.raises(Begun) as begun:
            tisfm.interpret(*frames, settings=settings)
        assert begun.value.args == taken
    text = (Path(__file__).parents[2] / "docs/settings.md").read_text(encoding="utf-8")
    for words in ("takes at least 2", "takes at least 10", "takes at least 8"):
        assert f"`objects` {words}." in text
