"""motion="objects" with moving objects in front of a background with little or no parallax."""

import numpy as np
import pytest

from tests.draws import nightly_except
from tests.motion.one_motion import OBJECTS, interpreted
from tests.rendered import two_blocks
from tisfm.motion.first_motion import first_motion
from tisfm.motion.problems import pyramid_of

SIZE = (150, 200)


def moving(sideways, turn, size=SIZE):
    """Return two moving blocks; the camera moves sideways and turns by `turn` degrees."""
    camera_motion = (sideways, 0, 0, 0, np.deg2rad(turn), 0)
    return two_blocks(*size, camera_motion=camera_motion)


def check_depth_is_of_objects_alone(result, scene):
    assert result.status == "converged"
    behind = result.labels == 0
    assert not result.inverse_depth[behind].any()
    assert np.isinf(result.inverse_depth_std[behind]).all()
    for label in (2, 3):
        body = (scene.labels == label) & scene.visible
        found = (result.labels == np.bincount(result.labels[body]).argmax()) & scene.visible
        assert not (found & behind).any()
        assert (found & body).sum() > 0.9 * (found | body).sum()
        assert (result.inverse_depth[found & body] > 0).mean() > 0.9


@pytest.mark.parametrize("turn", nightly_except(11.5, of=[0.5, 11.5]))
def test_without_parallax(turn):
    """At infinite depth, the motion of an object explains the background as well."""
    scene = moving(0, turn)
    check_depth_is_of_objects_alone(interpreted(scene, OBJECTS), scene)


@pytest.mark.nightly
def test_with_little_parallax():
    """Without the objects, the background gets rough depth and the status "uncertain"."""
    scene = moving(0.003, 0.3, size=(240, 320))
    frames = (np.asarray(frame, np.float32) for frame in (scene.frame0, scene.frame1))
    start = first_motion(pyramid_of(*frames, scene.camera, OBJECTS), OBJECTS)
    assert start.status is None and start.doubt == "uncertain"
    check_depth_is_of_objects_alone(interpreted(scene, OBJECTS), scene)
