"""`tisfm.reconstruct`: what it takes, checked, before anything heavy is imported."""

import os
import shutil
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import get_args

import numpy as np
import numpy.typing as npt

from tisfm import runtime
from tisfm.camera import Camera, check_camera
from tisfm.camera_file import file_of, read_camera
from tisfm.checks import check_count, refuse_masked
from tisfm.errors import InputError, InputTypeError
from tisfm.reconstruction.path.given_poses import poses_of_frames
from tisfm.reconstruction.progress import DepthOf, Progress
from tisfm.reconstruction.result.calibration import Calibrate
from tisfm.reconstruction.result.earlier_labels import labels_of_result
from tisfm.reconstruction.result.folder import CACHE
from tisfm.reconstruction.result.object_sizes import checked_object_sizes
from tisfm.reconstruction.result.reconstruction import Reconstruction
from tisfm.reconstruction.result.renewal import renewed_folder
from tisfm.reconstruction.result.temporary_folder import TemporaryFolder
from tisfm.settings import Settings
from tisfm.sources import BadFrames, FrameSource, Source
from tisfm.sources.frame_reader import warn_notes
from tisfm.sources.labels import LabelSource, are_labels, refuse_label_values
from tisfm.sources.masks import Mask
from tisfm.trajectory import Trajectory


def reconstruct(
    source: Source,
    *,
    camera: Camera | str | os.PathLike[str] | None = None,
    calibrate: Calibrate | None = None,
    settings: Settings | None = None,
    poses: npt.ArrayLike | Trajectory | None = None,
    mask: Mask | None = None,
    labels: LabelSource | None = None,
    object_sizes: Mapping[int, float] | None = None,
    depth_of: DepthOf = "all",
    step: int = 1,
    start: int = 0,
    stop: int | None = None,
    size: int | None = None,
    crop: tuple[int, int, int, int] | None = None,
    bad_frames: BadFrames = "raise",
    folder: str | os.PathLike[str] | None = None,
    progress: Progress | None = None,
) -> Reconstruction:
    """Reconstruct a sequence: one path of the camera, and the depth of every frame in its scale.

    Frames have to come in order, as those of a video do.

    Parameters
    ----------
    source : path, sequence of paths, or iterable of arrays
        A video, a folder of images, a glob pattern, a list of image files, or any iterable of
        (H, W) or (H, W, 3) frames; or ``"webcam"``, ``"webcam:1"``, … for a camera, with `stop`.
    camera : Camera or path, optional
        Of the frames as they come, or its file, as ``camera.json`` in the folder of another
        reconstruction, which may be of larger or smaller frames: what it says of the focal length
        is kept then, as `Reconstruction.calibration`. Distortion is removed, and what the rows of a
        rolling shutter move, which are read one after the other: the result belongs to frames as
        their middle rows saw them. If its readout is None, it is found, and taken for 0 if the
        motion does not show it. Where poses are given, a readout is undone that the camera states;
        they are those of middle rows.
    calibrate : {"nothing", "focal", "radial"}, optional
        What of the camera is found from the frames: by default nothing, if a camera is given; or
        else the focal length, with the principal point in the centre. ``"radial"`` finds one
        coefficient of the lens as well, k1, and removes its distortion. With a camera and
        ``"focal"`` or ``"radial"``, its focal length is a guess, and distortion that it has moves
        pixels as it does with that guess. `Reconstruction.calibration` says how far to trust what
        is found. Where poses are given, and no camera, the focal length is guessed from the first
        image file or the size of the frames.
    settings : Settings, optional
        By default the preset ``"balanced"`` with ``motion="camera"``: what moves on its own takes
        part in nothing, as far as it does not fit the rest. With ``motion="objects"`` it is found
        first, labelled in every frame, and left out of path and depth; each thing gets a path and
        a depth of its own, as far as its motion shows them. A readout is undone then
        if the camera states it, but not found. ``motion="field"``, the default of `Settings`, is
        possible for pairs only: ``"camera"`` replaces it, also in `Reconstruction.settings`.
    poses : (N, 4, 4) array_like or Trajectory, optional
        Known poses, camera to world, of the frames that are taken; NaN for one without. Depth
        alone is found then, in their unit. Where a trajectory and all frames have times, each frame
        gets the pose nearest in time, within half the time from a frame to the next.
    mask : optional
        Pixels that count, as for `tisfm.sources.FrameSource`: black, zero or False are ignored.
        With ``motion="objects"``, masks of every frame that hold the numbers of several things are
        `labels` instead: pictures with a palette of colours, or arrays of integers in which there
        are several numbers from 1 to 254.
    labels : optional
        With ``motion="objects"``, what moves on its own, if that is known: 0 is at rest, 1 to 254
        is the thing with this id, and 255 is ignored. Nothing is searched for then. A folder or
        pattern of pictures, whose values or indices of a palette count, which belong to the frames
        that they are called like, or else to all in order; the folder of a reconstruction; an
        (N, H, W) array of integers; a list with None for frames without; or a mapping from numbers
        or names of frames of the source, as ``{0: labels}``. They have the size of frames before
        these are cropped and shrunk, or after. To frames without labels, those of the nearest frame
        that has some are carried along the image motion.
    object_sizes : mapping of int to float, optional
        With ``motion="objects"``, how long things are, by their ids: the longest side of the
        smallest box around each, in the unit of the poses. It sets the scale of their path and
        depth, and `MovingObject.scale_from` is ``"size"``. Where poses are given, that is their
        unit; or else one in which the median depth of the first keyframe is 1.
    depth_of : {"all", "keyframes", "none"}
        The frames that depth is found of: every frame; keyframes alone, which takes less time and
        room; or none, for the path alone, whose unit is then the median depth of tracks in the
        first frame of a piece.
    step, start, stop, size, crop
        Which frames are taken and what part of them, as for `tisfm.interpret_sequence`.
    bad_frames : {"raise", "skip"}
        What becomes of frames that are damaged: an error, or they are left out, and
        `Reconstruction.skipped` says which.
    folder : path, optional
        Where the result is to lie; by default in a temporary folder, which is deleted with the
        result: `Reconstruction.save` keeps it.
    progress : callable, optional
        Called as ``progress(stage, done, total)`` with the stage ``"reading"``, ``"path"`` or
        ``"depth"``, and frames; the total is None where it is not known.

    Returns
    -------
    Reconstruction

    Warns
    -----
    GuessedFocalWarning
        If the focal length is a guess, or the motion hardly shows it.
    UserWarning
        For each note on how the source is read (`Reconstruction.notes`).

    Raises
    ------
    FileNotFoundError, FileExistsError, OSError, TypeError, ValueError
        If the source does not exist, has fewer than two frames, or a frame cannot be read; if a
        file is no camera, or one of frames of another shape; if poses are not (N, 4, 4), rigid, and
        as many as frames, or none is near to a frame in time; if labels or sizes are given without
        ``motion="objects"``; if labels are not numbers from 0 to 255 of the size of the frames, or
        masks may be labels or not; if sizes are not positive, or of what does not move.

    Examples
    --------
    >>> import numpy as np
    >>> import tisfm
    >>> from tisfm.scenes import room_film
    >>> path = [tisfm.rigid.pose_matrix([0.12 * k, 0, 0.05 * k, 0, 0.012 * k, 0]) for k in range(7)]
    >>> film = room_film(path, 180, 240, samples=2)  # or a folder, a video, "webcam:0"
    >>> settings = tisfm.Settings.preset("fast", motion="camera")
    >>> result = tisfm.reconstruct(film.frames, camera=film.camera, settings=settings)
    >>> result.poses.shape, result.depth(3).shape
    ((7, 4, 4), (180, 240))
    >>> result.save("room")

    The path is that of the film, but for its unit:

    >>> from tisfm.metrics import absolute_errors
    >>> absolute_errors(result.poses, film.poses).similarity < 0.05  # m, of 0.78
    True
    """
    settings = checked_settings(settings)
    if calibrate in ("focal", "radial") and poses is not None:
        raise InputError(
            f'poses are given and calibrate="{calibrate}": that is found with the path alone'
        )
    calibrate = checked_calibrate(calibrate, is_known=camera is not None or poses is not None)
    if depth_of not in get_args(DepthOf):
        raise InputError(f'depth_of is {depth_of!r}: expected "all", "keyframes" or "none"')
    if depth_of == "none" and poses is not None:
        raise InputError('poses are given and depth_of="none": there is nothing to find')
    given = None if poses is None else checked_poses(poses)
    mask, labels = _mask_and_labels(mask, labels, settings)
    of_result = labels_of_result(labels, source)
    sizes = checked_object_sizes(object_sizes)
    if sizes and settings.motion != "objects":
        raise InputError(
            f'object_sizes are given and motion is "{settings.motion}": expected motion="objects"'
        )
    frames = FrameSource(
        source,
        step=step,
        start=start,
        stop=stop,
        size=size,
        crop=crop,
        mask=mask,
        labels=labels if of_result is None else of_result.files,
        bad_frames=bad_frames,
    )
    warn_notes(frames.notes)
    if given is not None and bad_frames == "skip":
        raise InputError('poses are given and bad_frames="skip": they would not fit what is left')
    if given is not None and frames.times is not None:  # before the long computation
        poses_of_frames(given, frames.times)
    elif given is not None and given.times is None and frames.count is not None:
        check_count(len(given.poses), len(frames) + 1)
    camera, stated = checked_camera(camera)
    if calibrate == "radial" and stated is not None and stated.distortion is not None:
        raise InputError('the camera has distortion, which calibrate="radial" is to find: drop it')
    if calibrate == "focal" and stated is not None and stated.is_tilted:
        raise InputError(
            'camera has the distortion of a tilted sensor and calibrate="focal": it fits no other '
            "focal length; leave out the last two coefficients"
        )
    if of_result is not None:
        of_result.check(stated, calibrate)
    if folder is not None:
        files = [file_of(camera)] if isinstance(camera, Path) else []
        refuse_inside([*frames.files, *files], Path(folder))
    runtime.start()
    temporary = None
    if folder is None:
        temporary = TemporaryFolder()
        folder = temporary.name
    from tisfm.reconstruction.pipeline import Job, reconstruct_sequence

    try:
        with renewed_folder(folder) as path:
            path = path.absolute()  # or depth would be lost with another working folder
            try:
                job = Job(
                    source=frames,
                    camera=camera,
                    calibrate=calibrate,
                    settings=settings,
                    poses=given,
                    folder=path,
                    depth_of=depth_of,
                    object_sizes=sizes,
                    labels_stay=of_result is not None and of_result.camera is not None,
                )
                if progress is not None:
                    job = replace(job, progress=progress)
                result = reconstruct_sequence(job)
            finally:
                shutil.rmtree(path / CACHE, ignore_errors=True)
    except BaseException:
        if temporary is not None:
            temporary.remove()  # what was raised may be kept for long, and this with it
        raise
    return result if temporary is None else replace(result, _temporary=temporary)


def refuse_inside(files: Iterable[Path], folder: Path) -> None:
    """Refuse a folder that holds what is to be read: what lies there may be replaced."""
    place = folder.resolve()
    for file in files:
        if place in file.resolve().parents:
            raise InputError(f"{file} lies in {folder}, which is written to: give another folder")


def _mask_and_labels(
    mask: Mask | None, labels: LabelSource | None, settings: Settings
) -> tuple[Mask | None, LabelSource | None]:
    """Return what counts, and which things there are, where they are given as either."""
    if settings.motion != "objects":
        if labels is not None:
            raise InputError(
                f'labels are given and motion is "{settings.motion}": expected motion="objects"'
            )
        return mask, None
    if mask is None:
        return None, labels
    if isinstance(mask, Iterable) and not isinstance(mask, (str, Sequence, np.ndarray)):
        return refuse_label_values(mask), labels
    if are_labels(mask):
        if labels is not None:
            raise InputError(
                "mask has numbers of things, and labels are given as well: expected these there, "
                "and booleans in the mask"
            )
        return None, mask
    return mask, labels


def checked_camera(
    camera: Camera | str | os.PathLike[str] | None,
) -> tuple[Camera | Path | None, Camera | None]:
    """Return a camera or the path of its file, and the camera in either."""
    if isinstance(camera, (str, os.PathLike)):
        return Path(camera), read_camera(camera)
    checked = None if camera is None else check_camera(camera)
    return checked, checked


def checked_calibrate(calibrate: Calibrate | None, *, is_known: bool) -> Calibrate:
    """Return what is found from the frames: by default the focal length, unless it is known."""
    if calibrate is None:
        return "nothing" if is_known else "focal"
    if calibrate not in get_args(Calibrate):
        raise InputError(f'calibrate is {calibrate!r}: expected "nothing", "focal" or "radial"')
    return calibrate


def checked_settings(
    settings: Settings | None, motions: Collection[str] = ("camera", "objects")
) -> Settings:
    """Return settings for sequences; by default the preset balanced.

    ``motion="field"`` is possible for pairs only: ``"camera"`` replaces it.
    """
    if settings is None:
        settings = Settings.preset("balanced")
    if not isinstance(settings, Settings):
        raise InputTypeError(f"settings is {settings!r}: expected a tisfm.Settings")
    if settings.motion == "field":
        settings = replace(settings, motion="camera")
    if settings.motion not in motions:
        names = " or ".join(f'motion="{motion}"' for motion in motions)
        raise InputError(
            f'motion is "{settings.motion}": a sequence is reconstructed with {names}, as in '
            'Settings.preset("fast", motion="camera")'
        )
    return settings


def checked_poses(poses: npt.ArrayLike | Trajectory) -> Trajectory:
    """Return poses that are given, each rigid or NaN."""
    if isinstance(poses, Trajectory):
        return poses
    refuse_masked(poses, "poses")
    array = np.array(poses, np.float64)
    if array.ndim != 3 or array.shape[1:] != (4, 4):
        raise InputError(f"poses is {array.shape}: expected (N, 4, 4), camera to world")
    for number, pose in enumerate(array):
        if not np.isfinite(pose).all():
            array[number] = np.nan
            continue
        turn = pose[:3, :3]
        rigid = np.allclose(turn @ turn.T, np.eye(3), atol=1e-3) and np.linalg.det(turn) > 0
        if not rigid or not np.allclose(pose[3], [0, 0, 0, 1], atol=1e-6):
            raise InputError(
                f"poses[{number}] is {pose.tolist()}: expected a rotation and a translation over "
                "the row (0, 0, 0, 1)"
            )
    return Trajectory(poses=array)
