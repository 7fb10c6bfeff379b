"""Interpretations of rendered pairs, and their errors."""

import tisfm
from tests.rendered import shared_interpretation
from tisfm.metrics import pose_errors
from tisfm.rigid import pose_matrix

SIZE = (120, 160)
CAMERA = tisfm.Settings(motion="camera")
FAST = tisfm.Settings.preset("fast", motion="camera")
OBJECTS = tisfm.Settings(motion="objects")
FAST_OBJECTS = tisfm.Settings.preset("fast", motion="objects")


def interpreted(scene, settings=CAMERA, **options):
    return tisfm.interpret(
        scene.frame0, scene.frame1, camera=scene.camera, settings=settings, **options
    )


def shared(scene, settings=CAMERA, **options):
    """Return the same, computed once for all tests: where no test replaces a part of the method."""
    return shared_interpretation(
        scene.frame0, scene.frame1, camera=scene.camera, settings=settings, **options
    )


def errors(result, scene):
    return pose_errors(pose_matrix(result.motions[0]), pose_matrix(scene.motions[0]))
