"""Masks of pixels that move on their own, where they contradict the path of a static scene.

With ``motion="camera"`` the scene is taken as static. Vehicles that drive along have a wrong depth
then, or one behind the camera: the checks contradict the path, although its direction is right.
The pixels that move are labelled as for ``motion="objects"`` and ignored, and path and depth are
found again.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tisfm.reconstruction.objects.sequence_labels import SequenceLabels
from tisfm.reconstruction.objects.settings import OBJECTS
from tisfm.reconstruction.path.camera_path import CameraPath
from tisfm.reconstruction.result.folder import depth_path
from tisfm.reconstruction.result.path_check import PathCheck
from tisfm.reconstruction.stages.checks import agrees_with_images
from tisfm.reconstruction.stages.job import Job
from tisfm.reconstruction.stages.path import PathResult, solve_path
from tisfm.reconstruction.stages.reading import ReadingResult

# Objections that moving objects cause while the direction of the path is right.
_CAUSED_BY_OBJECTS = frozenset({"excess", "residual", "rank", "behind"})


@dataclass(frozen=True, kw_only=True)
class MaskedPath:
    """A path without the pixels that move on their own."""

    result: PathResult
    moving_shares: np.ndarray  # (N,): share of the pixels of each frame that are masked


def mask_moving_pixels(
    job: Job, reading: ReadingResult, first: PathResult, checks: Sequence[PathCheck]
) -> MaskedPath | None:
    """Label and ignore the pixels that move on their own, and return the path without them.

    The result is None, and the frames are as before, if nothing suggests such pixels, or if the
    image motion of the other pixels contradicts the new path, too. Otherwise the depth of the first
    path is deleted.
    """
    is_plain = first.path.is_plain and not first.path.objection
    if not (job.revises_camera and is_plain and may_show_objects(checks)):
        return None
    frames = reading.frames
    job.progress("path", 0, frames.count)  # the stage begins again
    camera = frames.camera
    min_positions = first.path.position_count

    def choose(path: CameraPath) -> CameraPath:
        """Return the first path if the labels mend it, and a new path does not fit."""
        is_whole = path.position_count >= min_positions
        is_better = is_whole and agrees_with_images(frames, path)
        return path if is_better or not agrees_with_images(frames, first.path) else first.path

    # The first path has no lens and no readout, so the second search looks for neither.
    frames.camera = replace(reading.camera.used_camera.pinhole(), readout=0.0)
    job = replace(job, revises_camera=False)
    result = solve_path(job, reading, SequenceLabels.of_frames(frames), choose)
    frames.camera = replace(frames.camera, readout=camera.readout)
    shares = np.array([(frames.labels(k) > 0).mean() for k in range(frames.count)])
    is_whole = result.path.position_count >= min_positions
    is_masked = 0 < shares.mean() <= OBJECTS.max_masked_share
    if not (is_masked and is_whole and agrees_with_images(frames, result.path)):
        frames.delete_labels()
        frames.camera = camera
        return None
    for number in range(frames.count):
        depth_path(job.folder, number).unlink(missing_ok=True)
    path = replace(result.path, doubt=first.path.doubt)  # the second search finds no zoom
    result = replace(result, path=path, fixed_pixels=first.fixed_pixels)
    return MaskedPath(result=result, moving_shares=shares)


def may_show_objects(checks: Sequence[PathCheck]) -> bool:
    """Return whether moving objects may be why the checks of its pieces contradict a path."""
    contradicted = [check for check in checks if check.contradicts]
    return bool(contradicted) and all(
        _CAUSED_BY_OBJECTS.issuperset(check.objections) for check in contradicted
    )
