"""motion="objects" with camera turns so large that a flow field alone fails."""

import numpy as np
import pytest

import tisfm
from tests.draws import nightly_except
from tests.motion.one_motion import OBJECTS as SETTINGS
from tests.motion.one_motion import interpreted
from tests.rendered import two_blocks
from tisfm.metrics import pose_errors
from tisfm.motion.first_motion import first_motion
from tisfm.motion.objects import estimation
from tisfm.motion.problems import pyramid_of
from tisfm.rigid import pose_matrix

SIZE = (240, 320)
AT_REST = np.zeros((2, 6))


def turning(turn, *, sideways=0.3, **options):
    """Return two blocks and a camera that turns by `turn` degrees."""
    camera_motion = (sideways, 0, 0, 0, np.deg2rad(turn), 0)
    return two_blocks(*SIZE, camera_motion=camera_motion, **options)


@pytest.fixture(scope="module")
def scene():
    """Return two blocks in front of a background that moves by 89 px."""
    return turning(11.5)


@pytest.mark.parametrize("turn", nightly_except(15, of=[11.5, 15, 18]))
def test_a_background_that_moves_far(turn):
    scene = turning(turn)
    frames = (np.asarray(frame, np.float32) for frame in (scene.frame0, scene.frame1))
    pyramid = pyramid_of(*frames, scene.camera, SETTINGS)
    assert first_motion(pyramid, SETTINGS).status == "unrelated"
    result = interpreted(scene, SETTINGS)
    assert result.status == "converged"
    errors = pose_errors(pose_matrix(result.motions[0]), pose_matrix(scene.motions[0]))
    assert errors.direction < 0.5 and errors.rotation < 0.05  # degrees
    off = np.linalg.norm(result.flow - scene.flow, axis=-1)
    assert np.median(off[scene.visible]) < 0.1
    smaller = scene.labels == 3
    found = result.labels == np.bincount(result.labels[smaller]).argmax()
    assert not (found & (result.labels == 0)).any()
    assert (found & smaller).sum() > 0.95 * (found | smaller).sum()


@pytest.mark.parametrize(
    ("turn", "blocks"),
    [
        pytest.param(15, AT_REST, marks=pytest.mark.nightly),
        (30, None),
        pytest.param(15, None, marks=pytest.mark.nightly),
        pytest.param(30, AT_REST, marks=pytest.mark.nightly),
    ],
)
def test_a_camera_that_only_turned_far_sees_no_depth(turn, blocks):
    """Pixels that leave the image do not affect the motion of the camera."""
    scene = turning(turn, sideways=0, block_motions=blocks)
    result = interpreted(scene, SETTINGS)
    assert result.status == "pure_rotation"
    assert not result.inverse_depth.any() and not result.labels.any()
    errors = pose_errors(pose_matrix(result.motions[0]), pose_matrix(scene.motions[0]))
    assert errors.rotation < 0.05  # degrees
    off = np.linalg.norm(result.flow - scene.flow, axis=-1)
    assert np.median(off[scene.visible & (scene.labels < 2)]) < 0.1


def test_points_are_matched_only_where_a_flow_field_fails(monkeypatch):
    def never(*_):
        raise AssertionError("points were matched")

    monkeypatch.setattr(estimation, "wide_baseline_motion", never)
    assert interpreted(two_blocks(60, 80, seed=2), SETTINGS).status != "unrelated"


def test_frames_with_nothing_in_common_stay_unrelated(scene):
    other = two_blocks(*SIZE, seed=9)
    result = tisfm.interpret(
        scene.frame0, other.frame1[::-1].copy(), camera=scene.camera, settings=SETTINGS
    )
    assert result.status == "unrelated"
