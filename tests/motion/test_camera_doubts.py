"""Doubts about the stated camera, from the flow of a pair."""

import numpy as np
import pytest

import tisfm
from tests.rendered import static_scene
from tisfm.metrics import depth_errors
from tisfm.motion import camera_doubts as module
from tisfm.motion.camera_doubts import (
    find_camera_doubt,
    find_misfit_doubt,
    measure_misfit,
)
from tisfm.motion.epipolar_fit import FreeUnknowns, Rays, refine_pose, rotation_alone
from tisfm.rigid import rigid_motion

FOCAL = 200.0
SIDEWAYS = (-0.2, 0.02, -0.05, 0.01, -0.03, 0.01)


def rays_of(twist, *, zoom=0.0, distortion=0.0, focal=1.0, noise=0.02, shift=0.0):
    """Return rays of a scene at random depths, seen by a camera that is not as stated.

    `focal` is the stated focal length divided by the true one; `shift`, px, moves a third of the
    image off its epipolar lines.
    """
    rng = np.random.default_rng(0)
    x, y = (
        values.ravel()
        for values in np.meshgrid(np.linspace(-0.8, 0.8, 60), np.linspace(-0.6, 0.6, 45))
    )
    rotation, translation = rigid_motion(np.array(twist, float))
    points = np.stack([x, y, np.ones_like(x)]) * rng.uniform(3, 9, x.size)
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
    starts = [(np.eye(3), axis) for axis in np.eye(3)]
    fits = [refine_pose(stated, start, unknowns, iterations=30) for start in starts]
    return stated, min(fits, key=lambda fit: fit[2])[:2]


def doubt_of(rays, pose):
    return find_camera_doubt(rays, pose, rotation_alone(rays))


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
    ],
)
def test_zoom_and_lens_are_named(change, text):
    doubt = doubt_of(*rays_of(SIDEWAYS, **change))
    assert doubt == "contradicted" and text in doubt.message


@pytest.mark.parametrize("zoom", [0.001, 0.0015])
def test_the_more_significant_parameter_is_named(zoom, monkeypatch):
    monkeypatch.setattr(module, "_depth_change", lambda *arguments: np.inf)
    assert "a zoom of +" in doubt_of(*rays_of(SIDEWAYS, zoom=zoom)).message


def test_a_zoom_that_hardly_changes_depth_is_no_doubt():
    assert doubt_of(*rays_of(SIDEWAYS, zoom=0.0006)) is None


@pytest.mark.parametrize("focal", [0.6, 1.6])
def test_a_turn_with_a_wrong_focal_length_has_no_depth_to_see(focal):
    doubt = doubt_of(*rays_of((0, 0, 0, 0.02, 0.08, 0.01), focal=focal))
    assert doubt == "contradicted" and "may only have turned" in doubt.message


def test_a_small_parallax_is_no_turn():
    scene = static_scene("sideways", 48, 64)
    settings = tisfm.Settings.preset("fast", motion="camera")
    result = tisfm.interpret(scene.frame0, scene.frame1, camera=scene.camera, settings=settings)
    assert result.status != "contradicted"
    assert depth_errors(result.depth, scene.depth).abs_rel < 0.1


def test_regions_off_their_lines():
    rays, pose = rays_of(SIDEWAYS, shift=4.0)
    doubt = find_misfit_doubt(rays, pose)
    assert doubt == "uncertain" and "regions of the image" in doubt.message
    assert measure_misfit(rays, pose) > 10 * measure_misfit(*rays_of(SIDEWAYS))
