"""`tisfm.reconstruct`: checks its arguments before it imports slow modules."""

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
from tisfm.camera_file import camera_file_path, read_camera
from tisfm.checks import check_pose_count, refuse_masked
from tisfm.errors import InputError, InputTypeError
from tisfm.reconstruction.path.given_poses import find_frame_poses
from tisfm.reconstruction.result.calibration import Calibrate
from tisfm.reconstruction.result.earlier_labels import find_result_labels
from tisfm.reconstruction.result.folder import CACHE
from tisfm.reconstruction.result.moving_object import check_object_sizes
from tisfm.reconstruction.result.reconstruction import Reconstruction
from tisfm.reconstruction.result.renewal import TemporaryFolder, renewed_folder
from tisfm.reconstruction.stages.progress import DepthOf, Progress, ReportDepth
from tisfm.settings import FixedPixels, Settings, check_fixed_pixels
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
    fixed_pixels: FixedPixels = "mask",
    step: int = 1,
    start: int = 0,
    stop: int | None = None,
    size: int | None = None,
    crop: tuple[int, int, int, int] | None = None,
    bad_frames: BadFrames = "raise",
    folder: str | os.PathLike[str] | None = None,
    progress: Progress | None = None,
    report_depth: ReportDepth | None = None,
) -> Reconstruction:
    """Reconstruct a sequence: the camera path, and the depth of every frame in its scale.

    Frames have to be in the order of their times.

    Parameters
    ----------
    source : path, sequence of paths, or iterable of arrays
        A video, a folder of images, a glob pattern, a list of image files, or any iterable of
        (H, W) or (H, W, 3) frames; or ``"webcam"``, ``"webcam:1"``, … for a camera, with `stop`.
    camera : Camera or path, optional
        The camera of the source's frames, or its file, such as ``camera.json`` in the folder of
        another reconstruction. The frames of that reconstruction may be larger or smaller; its
        statement on the focal length becomes `Reconstruction.calibration`. The distortion of the
        lens and the effect of a rolling shutter are removed: the result belongs to frames as their
        middle rows saw them. If the readout is None, it is estimated; it is 0 if the motion does
        not show it. If poses are given, they are the poses of middle rows, and only a readout that
        the camera states is corrected.
    calibrate : {"nothing", "focal", "radial"}, optional
        The part of the camera that is estimated from the frames. The default is ``"nothing"`` if a
        camera is given, else ``"focal"``: the focal length, with the principal point in the centre.
        ``"radial"`` also finds one coefficient of the lens, k1, and removes its distortion. If a
        camera is given with ``"focal"`` or ``"radial"``, its focal length is a guess. Its
        distortion displaces pixels in the same way with every estimated focal length.
        Without this argument, a zoom (`Reconstruction.focal`) or a distortion that is not given is
        also found and removed, if the tracks show it; with a zoom, a given focal length is that of
        the first frame.
        `Reconstruction.calibration` tells how reliable the estimate is. If poses are given without
        a camera, the focal length is guessed from the first image file or the size of the frames.
    settings : Settings, optional
        By default the preset ``"balanced"`` with ``motion="camera"``: moving objects are outliers,
        and ignored where their motion does not fit the static scene. With ``motion="objects"``,
        moving objects are labelled in every frame, and left out of the camera path and the depth.
        Each object gets a path and a depth of its own, as far as its motion shows them.
        In this mode a readout is corrected if the camera states it, but not estimated.
        ``motion="field"``, the default of `Settings`, is possible for pairs only: ``"camera"``
        replaces it, also in `Reconstruction.settings`.
    poses : (N, 4, 4) array_like or Trajectory, optional
        Known poses, camera to world, of the selected frames; NaN for a frame without a pose. Only
        depth is found then, in the unit of the poses. If a trajectory and all frames have times,
        each frame gets the pose nearest in time, at most half a frame interval away.
    mask : optional
        Pixels that are used, as for `tisfm.sources.FrameSource`: black, zero or False pixels are
        ignored. With ``motion="objects"``, masks with the numbers of several objects count as
        `labels`: pictures with a palette of colours, or arrays of integers with several numbers
        from 1 to 254.
    labels : optional
        With ``motion="objects"``, known moving objects: 0 is static, 1 to 254 is the id of an
        object, and 255 is ignored. Moving objects are not searched for then. One of: a folder or
        pattern of pictures, with labels as values or palette indices, which belong to frames by
        their names, or else in order; the folder of a reconstruction; an (N, H, W) array of
        integers; a list with None for frames without labels; or a mapping from numbers or names of
        frames of the source, such as ``{0: labels}``. Labels have the size of the frames before or
        after crop and reduction. A frame without labels gets the labels of the nearest labelled
        frame, carried along the image motion.
    object_sizes : mapping of int to float, optional
        With ``motion="objects"``, the lengths of objects, by their ids: the longest side of the
        smallest box around each, in the unit of the poses. A length sets the scale of the path and
        the depth of the object, and `MovingObject.scale_from` is ``"size"``. Without given poses,
        the unit is the median depth of the first keyframe.
    depth_of : {"all", "keyframes", "none"}
        The frames whose depth is found: every frame; only keyframes, which takes less time and disk
        space; or none. With none, only the path is found, and its unit is the median depth of
        tracks in the first frame of a piece.
    fixed_pixels : {"mask", "keep"}
        Pixels that show the same picture in all frames while the camera turns: a bonnet, a logo, a
        caption, a border. They are found and masked (`Reconstruction.mask`), or kept.
    step, start, stop, size, crop
        The selected frames and the used part of each, as for `tisfm.interpret_sequence`.
    bad_frames : {"raise", "skip"}
        Damaged frames raise an error, or are left out and listed in `Reconstruction.skipped`.
    folder : path, optional
        Folder for the result; by default a temporary folder, which is deleted with the result.
        `Reconstruction.save` keeps the result.
    progress : callable, optional
        Called as ``progress(stage, done, total)`` with the stage ``"reading"``, ``"path"`` or
        ``"depth"``, and numbers of frames; the total is None if it is not known. If pixels that
        move on their own are searched, the stages ``"path"`` and ``"depth"`` come once more.
    report_depth : callable, optional
        Called as ``report_depth(frame, error)`` after the depth of each frame, with the number of
        the frame in the result and the expected relative error of its depth, before the checks of
        the path, which may enlarge it in `Reconstruction.depth_error`. If pixels that move on their
        own are masked, frames get their depth anew, and are reported once more.

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
        camera file is invalid, or belongs to frames of another shape; if poses are not rigid,
        (N, 4, 4), and as many as frames, or no pose is near a frame in time; if labels or sizes are
        given without ``motion="objects"``; if labels are not numbers from 0 to 255, or have another
        size than the frames; if it is unclear whether masks are labels; if the length of an object
        is not positive, or no moving object has its id.

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

    The path equals the path of the film, except for the unit:

    >>> from tisfm.metrics import absolute_errors
    >>> absolute_errors(result.poses, film.poses).similarity < 0.05  # m, of 0.78
    True
    """
    settings = resolve_settings(settings)
    if calibrate in ("focal", "radial") and poses is not None:
        raise InputError(
            f'poses are given and calibrate="{calibrate}": a camera is estimated with the path only'
        )
    revises_camera = calibrate is None and poses is None and settings.motion == "camera"
    calibrate = resolve_calibrate(calibrate, is_known=camera is not None or poses is not None)
    if depth_of not in get_args(DepthOf):
        raise InputError(f'depth_of is {depth_of!r}: expected "all", "keyframes" or "none"')
    check_fixed_pixels(fixed_pixels)
    if depth_of == "none" and poses is not None:
        raise InputError(
            'poses are given and depth_of="none": nothing is left to compute; leave one of them out'
        )
    trajectory = None if poses is None else as_trajectory(poses)
    mask, labels = _mask_and_labels(mask, labels, settings)
    result_labels = find_result_labels(labels, source)
    lengths = check_object_sizes(object_sizes)
    if lengths and settings.motion != "objects":
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
        labels=labels if result_labels is None else result_labels.files,
        bad_frames=bad_frames,
    )
    warn_notes(frames.notes)
    if trajectory is not None and bad_frames == "skip":
        raise InputError(
            'poses are given and bad_frames="skip": poses would not fit the remaining frames'
        )
    if trajectory is not None and frames.times is not None:  # checked before the long computation
        find_frame_poses(trajectory, frames.times)
    elif trajectory is not None and trajectory.times is None and frames.count is not None:
        check_pose_count(len(trajectory.poses), len(frames) + 1)
    camera, known_camera = resolve_camera(camera)
    if calibrate == "radial" and known_camera is not None and known_camera.distortion is not None:
        raise InputError(
            'the camera has distortion, but calibrate="radial" estimates it: give a camera without '
            'distortion, or use calibrate="focal"'
        )
    if calibrate == "focal" and known_camera is not None and known_camera.is_tilted:
        raise InputError(
            'camera has the distortion of a tilted sensor and calibrate="focal": this distortion '
            "fits one focal length only; leave out the last two coefficients"
        )
    if result_labels is not None:
        result_labels.check(known_camera, calibrate)
    if folder is not None:
        files = [camera_file_path(camera)] if isinstance(camera, Path) else []
        refuse_inputs_inside([*frames.files, *files], Path(folder))
    runtime.start()
    temporary = None
    if folder is None:
        temporary = TemporaryFolder()
        folder = temporary.name
    from tisfm.reconstruction.pipeline import reconstruct_sequence
    from tisfm.reconstruction.stages.job import Job

    try:
        with renewed_folder(folder) as path:
            path = path.absolute()  # so that depth is found after a change of the working folder
            try:
                job = Job(
                    source=frames,
                    camera=camera,
                    calibrate=calibrate,
                    settings=settings,
                    poses=trajectory,
                    folder=path,
                    depth_of=depth_of,
                    fixed_pixels=fixed_pixels,
                    object_sizes=lengths,
                    revises_camera=revises_camera,
                    are_labels_prepared=result_labels is not None
                    and result_labels.camera is not None,
                )
                if progress is not None:
                    job = replace(job, progress=progress)
                if report_depth is not None:
                    job = replace(job, report_depth=report_depth)
                result = reconstruct_sequence(job)
            finally:
                shutil.rmtree(path / CACHE, ignore_errors=True)
    except BaseException:
        if temporary is not None:
            temporary.remove()  # at once, since a stored exception would keep the folder alive
        raise
    return result if temporary is None else replace(result, _temporary=temporary)


def refuse_inputs_inside(files: Iterable[Path], folder: Path) -> None:
    """Refuse an output folder that contains an input file, which might be overwritten."""
    resolved_folder = folder.resolve()
    for file in files:
        if resolved_folder in file.resolve().parents:
            raise InputError(f"{file} lies in {folder}, the output folder: give another folder")


def _mask_and_labels(
    mask: Mask | None, labels: LabelSource | None, settings: Settings
) -> tuple[Mask | None, LabelSource | None]:
    """Return the mask and the labels; a mask with labels of objects becomes the labels."""
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
                "mask has numbers of moving objects, but labels are given too: give the numbers "
                "as labels, and booleans as the mask"
            )
        return None, mask
    return mask, labels


def resolve_camera(
    camera: Camera | str | os.PathLike[str] | None,
) -> tuple[Camera | Path | None, Camera | None]:
    """Return the camera or the path of its file, and the camera itself."""
    if isinstance(camera, (str, os.PathLike)):
        return Path(camera), read_camera(camera)
    checked = None if camera is None else check_camera(camera)
    return checked, checked


def resolve_calibrate(calibrate: Calibrate | None, *, is_known: bool) -> Calibrate:
    """Return the part of the camera to estimate: by default the focal length if it is unknown."""
    if calibrate is None:
        return "nothing" if is_known else "focal"
    if calibrate not in get_args(Calibrate):
        raise InputError(f'calibrate is {calibrate!r}: expected "nothing", "focal" or "radial"')
    return calibrate


def resolve_settings(
    settings: Settings | None, motions: Collection[str] = ("camera", "objects")
) -> Settings:
    """Return settings for sequences; by default the preset ``"balanced"``.

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


def as_trajectory(poses: npt.ArrayLike | Trajectory) -> Trajectory:
    """Return given poses, each rigid or NaN."""
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
        rotation = pose[:3, :3]
        is_rigid = (
            np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-3) and np.linalg.det(rotation) > 0
        )
        if not is_rigid or not np.allclose(pose[3], [0, 0, 0, 1], atol=1e-6):
            raise InputError(
                f"poses[{number}] is {pose.tolist()}: expected a rotation and a translation over "
                "the row (0, 0, 0, 1)"
            )
    return Trajectory(poses=array)
