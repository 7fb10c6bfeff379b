"""Interpretations with one rigid motion, and their errors."""

import tisfm
from tisfm.metrics import pose_errors
from tisfm.rigid import pose_matrix

SIZE = (120, 160)
CAMERA = tisfm.Settings(motion="camera")
FAST = tisfm.Settings.preset("fast", motion="camera")


def interpreted(scene, settings=CAMERA, **options):
    return tisfm.interpret(
        scene.frame0, scene.frame1, camera=scene.camera, settings=settings, **options
    )


def errors(result, scene):
    return pose_errors(pose_matrix(result.motions[0]), pose_matrix(scene.motions[0]))
