"""motion="objects" repairs labels and pixels whose solution diverges, so the pair converges."""

from dataclasses import replace

import numpy as np
import pytest

import tisfm
from tests.draws import nightly_except
from tests.rendered import two_blocks
from tisfm.formats import read_image
from tisfm.motion.estimate import make_estimate
from tisfm.motion.frame_agreement import diverged_status
from tisfm.motion.objects import depth as object_depth
from tisfm.motion.objects.depth import restore_diverged_depth
from tisfm.motion.objects.settings import OBJECTS
from tisfm.motion.problems import pyramid_of
from tisfm.motion.rigid_depth import rigid_depth
from tisfm.rigid import pose_matrix, rigid_motion
from tisfm.settings import Settings
from tisfm.visibility.confidence import confidence
from tisfm.visibility.occlusion import leaves_image

SIZE = (90, 120)
SETTINGS = Settings.preset("fast", motion="objects")
SPIN = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])  # by 90°: out of the image


@pytest.fixture(scope="module")
def scene():
    return two_blocks(*SIZE, seed=3)


@pytest.fixture
def refined(monkeypatch):
    """Change the solution of the refined motions, and record the calls of `rigid_depth`."""
    calls = []

    def install(change):
        def rigid(pyramid, settings, motions, labels, *, refine="motion"):
            calls.append((refine, motions.copy()))
            solution = rigid_depth(pyramid, settings, motions, labels, refine=refine)
            return change(solution) if refine == "motion" else solution

        monkeypatch.setattr(object_depth, "rigid_depth", rigid)
        return calls

    return install


def estimated(scene):
    """Return the estimate from true labels, motions and flow; and these labels and motions."""
    labels = np.maximum(scene.labels - 1, 0).astype(np.int32)
    motions = np.stack([np.column_stack(rigid_motion(scene.motions[label])) for label in (0, 2, 3)])
    frames = (np.asarray(frame, np.float32) for frame in (scene.frame0, scene.frame1))
    pyramid = pyramid_of(*frames, scene.camera, SETTINGS)
    expected = np.moveaxis(scene.flow, -1, 0).astype(np.float32)

    def finish(solution):
        return make_estimate(solution, labels, scene.camera, SETTINGS)

    _, estimate = restore_diverged_depth(pyramid, SETTINGS, motions, labels, expected, finish)
    return estimate, labels, motions


def error(estimate, scene, mask):
    return np.hypot(*(estimate.flow - np.moveaxis(scene.flow, -1, 0)))[mask & scene.visible].mean()


def check(estimate):
    assert diverged_status(estimate.flow, leaves_image(estimate.flow)) is None


def test_objects_inside_the_image_are_left_alone(scene, refined):
    calls = refined(lambda solution: solution)
    estimate, labels, _ = estimated(scene)
    assert [refine for refine, _ in calls] == ["motion"]
    check(estimate)
    assert error(estimate, scene, labels >= 0) < 0.2


def test_a_label_that_runs_away_keeps_motion_and_depth(scene, refined):
    def change(solution):
        motions = solution.motions.copy()
        motions[2, :, :3] = SPIN
        return replace(solution, motions=motions)

    refined(change)
    estimate, labels, motions = estimated(scene)
    own = [pose_matrix(twist)[:3, :3] for twist in estimate.motions]
    np.testing.assert_allclose(own[2], motions[2, :, :3], atol=1e-9)
    assert (own[1] != motions[1, :, :3]).any()  # the other labels have the refined motions
    check(estimate)
    assert error(estimate, scene, labels == 2) < 0.2


def test_the_images_decide_about_the_label_of_each_part(scene, refined):
    """Precision comes from the layer of the label, not from the solution that diverged."""

    def change(solution):
        motions, precision = solution.motions.copy(), solution.precision.copy()
        motions[2, :, :3] = SPIN
        mine = np.maximum(scene.labels - 1, 0) == 2
        precision[:3, mine], precision[3, mine] = 0, 1e6
        return replace(solution, motions=motions, precision=precision)

    refined(lambda solution: solution)
    usual, labels, _ = estimated(scene)
    refined(change)
    estimate, _, _ = estimated(scene)
    mine = labels == 2
    np.testing.assert_array_equal(estimate.precision[:, ~mine], usual.precision[:, ~mine])
    trust, own = (
        confidence(
            each.precision, leaves_image(each.flow), normalized=each.is_normalized, freedom=1
        )[mine]
        for each in (estimate, usual)
    )
    # The depth of this label comes from the true flow, not from the images.
    np.testing.assert_allclose(trust.mean(), own.mean(), rtol=0.1)
    assert np.median(estimate.inverse_depth_std[mine]) < 2 * np.median(
        usual.inverse_depth_std[mine]
    )


@pytest.mark.parametrize("value", [1e4, np.nan, np.inf])
def test_pixels_that_run_away_take_the_depth_of_their_neighbours(scene, refined, value):
    wrong = np.zeros(SIZE, bool)
    wrong[40:44, 30:35] = wrong[70, 90] = True

    def change(solution):
        depth = np.where(wrong, np.float32(value), solution.inverse_depth)
        return replace(solution, inverse_depth=depth)

    calls = refined(change)
    estimate, labels, _ = estimated(scene)
    assert len(calls) == 1
    check(estimate)
    assert np.isfinite(estimate.inverse_depth).all() and np.isfinite(estimate.rho).all()
    assert error(estimate, scene, wrong) < 0.5
    for y, x in zip(*np.nonzero(wrong), strict=True):
        near = (slice(y - 5, y + 6), slice(x - 5, x + 6))
        mine = (labels[near] == labels[y, x]) & ~wrong[near]
        assert estimate.inverse_depth[y, x] in estimate.inverse_depth[near][mine]


def test_a_pair_that_runs_away_does(scene, refined):
    """More outliers than `max_diverged_share` in the largest label are not repaired."""
    rows = round(2 * OBJECTS.max_diverged_share * SIZE[0])

    def change(solution):
        depth = solution.inverse_depth.copy()
        depth[:rows] = 1e4
        return replace(solution, inverse_depth=depth)

    refined(change)
    estimate, _, _ = estimated(scene)
    assert diverged_status(estimate.flow, leaves_image(estimate.flow)) == "diverged"


@pytest.mark.parametrize("known", [True, False])
def test_a_label_without_a_part_inside_the_image(scene, monkeypatch, known):
    """All its pixels diverge: it takes the depth of its layer, or none if that diverged as well."""

    def rigid(pyramid, settings, motions, labels, *, refine="motion"):
        solution = rigid_depth(pyramid, settings, motions, labels, refine=refine)
        tiny = np.zeros(SIZE, bool)
        tiny[20:24, 20:24] = True
        return replace(
            solution, inverse_depth=np.where(tiny, np.float32(1e5), solution.inverse_depth)
        )

    monkeypatch.setattr(object_depth, "rigid_depth", rigid)
    labels = np.zeros(SIZE, np.int32)
    labels[20:24, 20:24] = 1
    expected = np.moveaxis(scene.flow, -1, 0).astype(np.float32)
    if not known:
        expected[:, labels == 1] = np.nan
    motion = np.column_stack(rigid_motion(scene.motions[0]))
    frames = (np.asarray(frame, np.float32) for frame in (scene.frame0, scene.frame1))
    _, estimate = restore_diverged_depth(
        pyramid_of(*frames, scene.camera, SETTINGS),
        SETTINGS,
        np.stack([motion, motion]),
        labels,
        expected,
        lambda solution: make_estimate(solution, labels, scene.camera, SETTINGS),
    )
    check(estimate)
    assert estimate.inverse_depth[labels == 0].any()
    if known:
        assert error(estimate, scene, labels == 1) < 0.01
    else:
        assert not estimate.inverse_depth[labels == 1].any()


@pytest.mark.parametrize("first", nightly_except(14, of=[2, 14]))
def test_who_walks_past_does_not_run_away(shared_data, first):
    """In an earlier version, the flow of the man, or of a part of him, reached 46 and 130 px."""
    files = sorted((shared_data / "statue").iterdir())
    result = tisfm.interpret(
        read_image(files[first]),
        read_image(files[first + 3]),
        camera=tisfm.Camera(focal=600.0),
        settings=Settings.preset("balanced", motion="objects"),
    )
    assert result.status in ("converged", "iteration_limit")
    assert len(result.motions) > 1
    assert np.linalg.norm(result.flow, axis=2).max() < 20
