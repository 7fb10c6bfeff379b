"""Doubts about the stated camera, from the flow of a pair."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import tisfm
from tests.rendered import static_scene
from tisfm.metrics import depth_errors
from tisfm.motion.camera_doubts import examine_camera, find_misfit_doubt, measure_misfit
from tisfm.motion.camera_fit import (
    PARAMETERS,
    Cameras,
    change_cameras,
    find_derivatives,
    find_lines,
    make_turns,
    undistort_points,
)
from tisfm.motion.camera_search import search_cameras
from tisfm.motion.camera_settings import IntrinsicsSettings
from tisfm.motion.epipolar_fit import FreeUnknowns, Rays, refine_pose, rotation_alone
from tisfm.motion.homographies import TWO_MOTIONS, resolve_plane
from tisfm.rigid import rigid_motion
from tisfm.status import Status

FOCAL = 200.0
SIDEWAYS = (-0.2, 0.02, -0.05, 0.01, -0.03, 0.01)
FORWARD = (0.02, 0.01, -0.6, 0.0, 0.002, 0.0)


def rays_of(
    twist, *, zoom=0.0, distortion=0.0, focal=1.0, noise=0.02, shift=0.0, slopes=None, starts=()
):
    """Return rays of a scene at random depths, seen by a camera that is not as stated.

    `focal` is the stated focal length divided by the true one; `shift`, px, moves a third of the
    image off its epipolar lines. With `slopes`, the scene is a plane, Z (1 + slopes · x) = 4.
    """
    rng = np.random.default_rng(0)
    x, y = (
        values.ravel()
        for values in np.meshgrid(np.linspace(-0.8, 0.8, 60), np.linspace(-0.6, 0.6, 45))
    )
    rotation, translation = rigid_motion(np.array(twist, float))
    depth = rng.uniform(3, 9, x.size)
    if slopes is not None:
        depth = 4 / (1 + slopes[0] * x + slopes[1] * y)
    points = np.stack([x, y, np.ones_like(x)]) * depth
    moved = rotation @ points + translation[:, None]
    seen0, seen1 = np.stack([x, y]), moved[:2] / moved[2]
    rays = []
    for seen, scale in ((seen0, 1.0), (seen1, np.exp(zoom))):
        distorted = seen * (1 + distortion * (seen * seen).sum(axis=0)) * scale
        rays.append(distorted / focal + rng.normal(0, noise / FOCAL, seen.shape))
    rays[1][1, x > 0.3] += shift / FOCAL
    stated = Rays(
        rays0=np.vstack([rays[0], np.ones_like(x)]),
        rays1=rays[1],
        trust=np.ones_like(x),
        focal=FOCAL,
    )
    unknowns = FreeUnknowns(count=6, likely_rotation=None)
    starts = starts or [(np.eye(3), axis) for axis in np.eye(3)]
    fits = [refine_pose(stated, start, unknowns, iterations=30) for start in starts]
    return stated, min(fits, key=lambda fit: fit[2])[:2]


def doubt_of(rays, pose):
    return examine_camera(rays, pose, rotation_alone(rays))[0]


def evidence_of(rays, pose):
    return examine_camera(rays, pose, rotation_alone(rays))[1]


def test_the_true_camera_is_not_doubted():
    for noise in (0.02, 0.2):
        rays, pose = rays_of(SIDEWAYS, noise=noise)
        assert doubt_of(rays, pose) is None and find_misfit_doubt(rays, pose) is None


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"zoom": 0.02}, "a zoom of +"),
        ({"zoom": -0.05}, "a zoom of -"),
        ({"distortion": -0.2}, "distortion of k₁ = -0."),
        ({"distortion": 0.15}, "distortion of k₁ = 0."),
        ({"focal": 0.6}, "a focal length that is 1."),
        ({"focal": 1.6}, "a focal length that is 0.6"),
    ],
)
def test_zoom_lens_and_focal_length_are_named(change, text):
    doubt = doubt_of(*rays_of(SIDEWAYS, **change))
    assert doubt == "contradicted" and text in doubt.message


def test_a_zoom_that_hardly_changes_depth_is_no_doubt():
    assert doubt_of(*rays_of(SIDEWAYS, zoom=0.0006)) is None


@pytest.mark.parametrize("focal", [0.6, 1.6])
def test_a_turn_with_a_wrong_focal_length_has_no_depth_to_see(focal):
    doubt = doubt_of(*rays_of((0, 0, 0, 0.02, 0.08, 0.01), focal=focal))
    assert doubt == "contradicted" and "may only have turned" in doubt.message


@pytest.mark.parametrize("true", [0.7, 1.0, 1.4])
def test_the_focal_length_of_a_turning_camera_is_found(true):
    evidence = evidence_of(*rays_of(SIDEWAYS, focal=1 / true))
    error = evidence.value - np.log(true)
    assert abs(error) < max(0.02, 2 * evidence.value_deviation)
    assert evidence.value_deviation < 0.1
    assert evidence.is_significant == (true != 1.0)
    assert np.hypot(np.log(true), evidence.value_deviation) == pytest.approx(
        evidence.spread, abs=0.03
    )


@pytest.mark.parametrize("focal", [0.6, 1.0, 1.6])
def test_a_drive_straight_ahead_needs_no_focal_length(focal):
    rays, pose = rays_of(FORWARD, focal=focal)
    doubt, evidence = examine_camera(rays, pose, rotation_alone(rays))
    assert doubt is None and evidence.value_deviation > 0.15
    assert evidence.depth_effect < 0.1
    status = Status("converged", "as it should")
    assert evidence.add_note(status, "stated") is status


def test_a_plane_depends_on_the_focal_length():
    twist = (-0.3, 0.1, -0.5, 0.03, -0.05, 0.02)
    evidence = evidence_of(*rays_of(twist, slopes=(0.5, -0.3)))
    note = evidence.add_note(Status("converged", "as it should"), "stated")
    assert note == "converged" and note.message.startswith("as it should. The result depends on")
    assert "the stated focal length" in note.message and "direction of motion" in note.message
    guessed = evidence.add_note(Status("converged", "as it should"), "guessed")
    assert guessed == "uncertain" and "the guessed focal length" in guessed.message
    assert guessed.message.startswith("as it should. ")  # other notes stay
    refused = Status("unexplained", "as it is")
    assert evidence.add_note(refused, "guessed") is refused


def test_the_motion_whose_plane_lies_in_front_is_chosen():
    """Of two motions that fit a plane, one has a seventh of the plane behind the camera."""
    twist = (-0.4, 0.05, 0.2, 0, 0.02, 0)
    rays, found = rays_of(twist, slopes=(0.5, -0.3), noise=0.01)
    _, translation = rigid_motion(np.array(twist, float))
    right = translation / np.linalg.norm(translation)
    assert abs(found[1] @ right) < 0.2  # the wrong motion fits the rays by chance
    chosen, status = resolve_plane(rays, found, 0.01)
    assert abs(chosen[1] @ right) > 0.999 and status is None


def test_a_plane_in_front_for_both_motions_leaves_two():
    twist = (-0.4, 0.05, -0.4, 0, 0.02, 0)
    rays, found = rays_of(twist, slopes=(0.5, -0.3), noise=0.01)
    assert resolve_plane(rays, found, 0.01) == (found, TWO_MOTIONS)


def test_a_small_parallax_is_no_turn():
    scene = static_scene("sideways", 48, 64)
    settings = tisfm.Settings.preset("fast", motion="camera")
    result = tisfm.interpret(scene.frame0, scene.frame1, camera=scene.camera, settings=settings)
    assert result.status != "contradicted"
    assert depth_errors(result.depth, scene.depth).abs_rel < 0.1


def test_regions_off_their_lines():
    rays, pose = rays_of(SIDEWAYS, shift=20.0)
    doubt = find_misfit_doubt(rays, pose)
    assert doubt == "uncertain" and "regions of the image" in doubt.message
    assert measure_misfit(rays, pose) > 10 * measure_misfit(*rays_of(SIDEWAYS))


@pytest.mark.parametrize("count", [3, 8, 40])
@pytest.mark.parametrize("kind", ["line", "center", "untrusted"])
def test_rays_that_show_no_homography_are_no_error(kind, count):
    rng = np.random.default_rng(0)
    x = rng.uniform(-0.5, 0.5, count) * (kind != "center")
    y = rng.uniform(-0.5, 0.5, count) * (kind == "untrusted")
    rays = Rays(
        rays0=np.stack([x, y, np.ones(count)]),
        rays1=np.stack([x + 0.01, y]),
        trust=np.full(count, float(kind != "untrusted")),
        focal=FOCAL,
    )
    pose = np.eye(3), np.array([1.0, 0, 0])
    chosen, _ = resolve_plane(rays, pose, 0.1)
    assert np.isfinite(chosen[1]).all()
    if kind != "untrusted":
        _, evidence = examine_camera(rays, pose, np.eye(3))
        assert np.isfinite(evidence.value_deviation)


@pytest.mark.parametrize(("k1", "radius"), [(0.6, 1.0), (0.15, 0.8), (-0.1, 1.0), (-0.3, 0.9)])
def test_a_distortion_is_undone(k1, radius):
    distorted = radius * (1 + k1 * radius**2)
    ((factor,),) = undistort_points(np.array([distorted**2]), np.array([[k1]]))
    assert factor * distorted == pytest.approx(radius, rel=1e-3)


def distances_of(rays, cameras):
    return find_lines(change_cameras(rays, cameras), cameras).distances[0]


@pytest.mark.parametrize("parameter", PARAMETERS)
@pytest.mark.parametrize("unknown", range(7))
def test_derivatives_by_the_camera(parameter, unknown):
    rays, pose = rays_of(SIDEWAYS, noise=0.2)
    around = []
    for step in (-1e-6, 1e-6):
        change = np.eye(7)[unknown] * step
        turn = make_turns(change[None, 3:6])[0]
        translation = turn @ pose[1] + change[:3]
        moved = Cameras.of([parameter], [change[6]], [(turn @ pose[0], translation)])
        around.append(distances_of(rays, moved))
    expected = (around[1] - around[0]) / 2e-6
    stated = Cameras.of([parameter], [0.0], [pose])
    changed = change_cameras(rays, stated)
    lines = find_lines(changed, stated)
    if (parameter, unknown) == ("focal", 6):  # the scale of px does not count
        expected -= lines.distances[0]
    rows = find_derivatives(changed, stated, lines, is_free=True)[0]
    np.testing.assert_allclose(rows[-1] * lines.px[0], lines.distances[0])
    np.testing.assert_allclose(
        rows[unknown] * lines.px[0], expected, atol=1e-4 * np.abs(expected).max()
    )


def test_turns_are_those_of_rotation_vectors():
    vectors = np.random.default_rng(0).normal(0, [[1e-12], [1e-4], [1.0]], (3, 3))
    expected = Rotation.from_rotvec(vectors).as_matrix()
    np.testing.assert_allclose(make_turns(vectors), expected, atol=1e-12)


def test_single_precision_finds_the_same_camera(monkeypatch):
    rays, pose = rays_of(SIDEWAYS, zoom=0.02, noise=0.1)
    turn = rotation_alone(rays)
    singles = search_cameras(rays, pose, turn)
    monkeypatch.setattr(Rays, "as_single", lambda own: own)
    for single, double in zip(singles, search_cameras(rays, pose, turn), strict=True):
        assert single.gain == pytest.approx(double.gain, abs=0.02)
        assert abs(single.best_value - double.best_value) < 0.05 * double.deviation


def test_all_parameters_have_as_many_values():
    with pytest.raises(ValueError, match=r"zoom_values 2 .* the same number"):
        IntrinsicsSettings(zoom_values=(0.01, 0.02))
