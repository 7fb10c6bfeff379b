"""``tisfm reconstruct``."""

import math
import shutil
import warnings
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from tyro.conf import OmitArgPrefixes, Positional, arg

from tisfm.camera import Camera
from tisfm.camera_file import read_camera
from tisfm.cli.console import (
    print_source_notes,
    tell,
    tell_device,
    tell_grade,
    watch_interrupt,
)
from tisfm.cli.coverage import chosen_coverage
from tisfm.cli.options import CameraOptions, FrameOptions
from tisfm.cli.progress import (
    LARGE_OUTPUT,
    STAGES,
    RunningErrors,
    StageTimes,
    TimeEstimate,
    progress_bar,
)
from tisfm.cli.report import report_reconstruction
from tisfm.errors import InputError
from tisfm.focal_guess import GuessedFocalWarning
from tisfm.folders.result_folder import locked_folder
from tisfm.fusion.mesh import check_scikit_image
from tisfm.machine.text import as_size
from tisfm.reconstruction.chunks.chunk import DEFAULT_CHUNK
from tisfm.reconstruction.chunks.runs import ChunksRun, ReconstructRun, WholeRun
from tisfm.reconstruction.result.calibration import Calibrate
from tisfm.reconstruction.result.reconstruction import Reconstruction
from tisfm.reconstruction.result.summary import describe_poses
from tisfm.reconstruction.stages.progress import DepthOf, Stage, StopReading
from tisfm.report import check_report
from tisfm.running.pairs import FrameSelection
from tisfm.running.pool import check_workers
from tisfm.runtime import Arch, SoftwareVulkanWarning
from tisfm.settings import FixedPixels, Preset, Settings
from tisfm.sources import Source
from tisfm.sources.webcam import webcam_number
from tisfm.trajectory import Trajectory, read_trajectory, write_kitti, write_tum
from tisfm.trajectory.times import times_or_numbers


@dataclass(kw_only=True)
class Reconstruct:
    """Reconstruct a sequence: one path of the camera, and the depth of every frame in its scale.

    SOURCE is a video, a folder of images in order, a quoted glob, or images. DIR receives
    reconstruction.json, path.npz, depth/ and frames/ for tisfm.Reconstruction.load, and the path as
    trajectory.txt (TUM: time tx ty tz qx qy qz qw) and poses.txt (KITTI: rows of (R | t), camera to
    world). Where the path breaks, for instance at a cut, a new piece begins, with its own scale and
    coordinate system: these two files are of the largest piece. With --ply, points.ply is a
    coloured point cloud; with --mesh, mesh.ply or mesh.glb is a surface; both show points on which
    several keyframes agree. With --motion objects, masks/ has the moving object at each pixel, and
    objects.json the paths of the objects.
    """

    source: Annotated[
        Positional[tuple[str, ...]],
        arg(metavar="SOURCE [SOURCE ...]", help_behavior_hint="(required)"),
    ]
    """A video, a folder, a quoted glob, two or more images in order, or a webcam."""
    output: Annotated[Path, arg(aliases=["-o"], metavar="DIR")]
    """Folder for the results: new, empty, or with an earlier reconstruction, which is replaced."""
    preset: Preset = "balanced"
    """fast, balanced or accurate: more accuracy takes more time. paper is the method of Sekkati and
    Mitiche (2007), for motions of up to about one pixel."""
    calibrate: Calibrate | None = None
    """Values of the camera to estimate from the frames. focal: the focal length, starting from
    --focal if given. radial: also one coefficient of the lens distortion, which is then removed.
    nothing: none. By default the focal length, unless --focal or --camera states it."""
    poses: Annotated[Path | None, arg(metavar="FILE")] = None
    """File of known poses in the format of TUM or KITTI; then only depth is estimated. If all
    frames have times, poses of TUM belong to the frames nearest in time; otherwise the file has a
    pose for each used frame, in order."""
    mask: Annotated[str | None, arg(metavar="MASK")] = None
    """A picture, or a folder with a picture for every frame: black pixels are ignored. With
    --motion objects, give a folder of pictures with a palette of colours as --labels instead."""
    labels: Annotated[str | None, arg(metavar="LABELS")] = None
    """With --motion objects: known moving objects, a folder of pictures. Their values, or indices
    of a palette, are 0 for the static scene, 1 to 254 for the object with this id, and 255 for
    ignored pixels. A picture belongs to the frame of the same name; frames without a picture get
    the labels of the nearest labelled frame."""
    motion: Literal["camera", "objects"] = "camera"
    """camera: only the camera moves; pixels that do not move with the static scene are left out.
    objects: moving objects are labelled in masks/ and listed in objects.json, and each gets a path
    and depth of its own."""
    object_sizes: Annotated[tuple[str, ...], arg(metavar="ID=LENGTH [ID=LENGTH ...]")] = ()
    """With --motion objects: lengths of objects by their ids, in the unit of --poses. A length is
    the longest side of the smallest box around the object. It sets the scale of the object."""
    depth_of: DepthOf = "all"
    """Frames that get depth: all, only keyframes, or none, for the path alone."""
    fixed_pixels: FixedPixels = "mask"
    """Pixels that show the same picture in all frames while the camera turns, such as a bonnet, a
    logo or a caption: mask leaves them out; keep uses them."""
    scale: Annotated[tuple[int, int, float] | None, arg(metavar="FRAME FRAME DISTANCE")] = None
    """Two frame numbers, from 0, and the distance between the positions of the camera at these
    frames. It sets the unit of the result."""
    ply: bool = False
    """Write points.ply, a coloured point cloud."""
    mesh: Literal["ply", "glb"] | None = None
    """Write mesh.ply or mesh.glb, a coloured surface; it needs pip install 'tisfm[mesh]'."""
    complete: bool = False
    """With --ply or --mesh: keep uncertain depth too, and what a single keyframe shows."""
    strict: bool = False
    """With --ply or --mesh: keep only what three keyframes agree on precisely."""
    report: bool = False
    """Write report.html, one page for a browser: summary, path, statuses with advice, pictures."""
    workers: int = 1
    """Number of processes. Each reconstructs chunks of frames, which are then joined. Only with
    --motion camera."""
    cluster: Annotated[str | None, arg(metavar="ADDRESS")] = None
    """Address of the scheduler of a Dask cluster whose workers reconstruct the chunks, such as
    tcp://10.0.0.1:8786. They must find SOURCE and DIR under the same paths."""
    chunk: int | None = None
    """Maximum number of frames in a chunk. By default 150 with --workers or --cluster; otherwise
    all frames are one chunk. The result depends on it, but not on the number of workers."""
    resume: bool = False
    """Continue an interrupted command with the same options: complete chunks are kept. A complete
    result stays as it is."""
    arch: Arch | None = None
    """Processor that runs the kernels. By default the environment variable TI_ARCH decides, or else
    it is the CPU."""
    threads: int | None = None
    """Maximum number of CPU threads. By default all cores. Results do not depend on it."""
    frames: OmitArgPrefixes[FrameOptions] = field(default_factory=FrameOptions)
    camera: OmitArgPrefixes[CameraOptions] = field(default_factory=CameraOptions)

    def __call__(self) -> int:
        """Run the command and return the exit code."""
        return reconstruct(self)

    def known_camera(self) -> Camera | Path | None:
        """Return the camera, its file, or None if the focal length is estimated or guessed."""
        options = self.camera
        if not options.guess("camera"):
            return options.camera()
        values = (options.center, options.distortion, options.readout)
        if any(value is not None for value in values) or options.aspect != 1:
            raise InputError(
                "--center, --distortion, --aspect and --readout need a focal length: give --focal; "
                "with --calibrate focal, an approximate value is enough"
            )
        if options.focal == "guess" and self.calibrate not in (None, "nothing"):
            raise InputError("--focal guess excludes --calibrate: leave out one of them")
        return None


def _object_sizes(words: Sequence[str]) -> dict[int, float]:
    """Return lengths by ids, from words such as 3=4.5."""
    sizes = {}
    for word in words:
        number, _, length = word.partition("=")
        try:
            sizes[int(number)] = float(length)
        except ValueError:
            raise InputError(
                f"--object-sizes has {word!r}: expected ID=LENGTH, such as 3=4.5"
            ) from None
    return sizes


POSES, TRAJECTORY, POINTS = "poses.txt", "trajectory.txt", "points.ply"
_PICTURE_BYTES = 0.2  # per value of a picture, as JPEG; set by hand
_DEPTH_BYTES = 4.0  # per pixel of depth; set by hand


def reconstruct(options: Reconstruct) -> int:
    """Reconstruct a sequence, write its folder, and return the exit code."""
    if not options.source:
        raise InputError(
            "SOURCE is missing: give a video, a folder, a quoted glob or images, as in: "
            "tisfm reconstruct VIDEO -o DIR"
        )
    source: Source = options.source[0] if len(options.source) == 1 else options.source
    output, frames, scale = options.output, options.frames.selection(), options.scale
    camera, object_sizes = options.known_camera(), _object_sizes(options.object_sizes)
    in_chunks = options.workers != 1 or (options.cluster, options.chunk) != (None, None)
    check_workers(options.workers, options.cluster)
    if in_chunks and (options.labels is not None or object_sizes):
        raise InputError(
            "--labels and --object-sizes do not work in chunks: leave out --workers, --cluster and "
            "--chunk"
        )
    poses = None if options.poses is None else read_trajectory(options.poses)
    for file in (options.poses, camera):
        if isinstance(file, Path):
            _refuse_inside(file, output)
    if options.depth_of == "none" and (options.ply or options.mesh is not None):
        raise InputError(
            "--depth-of none estimates no depth, which --ply and --mesh need: leave out one of them"
        )
    coverage = chosen_coverage(options.complete, options.strict)
    if coverage != "normal" and not options.ply and options.mesh is None:
        raise InputError(f"--{coverage} is for points and surfaces: give --ply or --mesh too")
    # Check first whether the last steps are possible: the steps before them take long.
    if scale is not None and object_sizes:
        raise InputError("--scale changes the unit of --object-sizes: give one of them, or --poses")
    if scale is not None:
        _check_scale(*scale, count=_max_frame_count(source, frames))
    if options.mesh is not None:
        check_scikit_image()
    if options.report:
        check_report(output)
    if isinstance(camera, Path):
        _check_camera_file(camera, source, frames)
    run = _prepare_run(options, source, frames, camera, poses, object_sizes, in_chunks)
    if options.resume and run.is_done():
        run.finish()  # remove the leftovers of a killed command
        tell(f"{output} is already complete. Results in {output}.")
        if options.report:
            report_reconstruction(Reconstruction.load(output), output, source=source)
        return 0
    is_endless = (
        isinstance(source, str) and webcam_number(source) is not None and frames.stop is None
    )
    if is_endless:
        tell("Ctrl-C ends the recording; a second Ctrl-C ends the command.")
    else:
        _announce(source, output, frames, options.depth_of)
    tell_device(options.arch)
    stages, errors = StageTimes(), RunningErrors()
    estimates = {stage: TimeEstimate(f"frames, {text}") for stage, text in STAGES.items()}
    with progress_bar() as bar, watch_interrupt(is_endless) as is_interrupted, print_source_notes():
        warnings.simplefilter("ignore", GuessedFocalWarning)  # printed at the end
        warnings.simplefilter("ignore", SoftwareVulkanWarning)  # tell_device printed it
        task = bar.add_task("", total=None)

        def tell_progress(stage: Stage, done: int, total: int | None) -> None:
            stages.enter(stage)
            estimates[stage].update(done, total)
            if stage == "reading" and is_interrupted():
                raise StopReading
            text = f", {errors.text}" if stage == "depth" and errors.text else ""
            bar.update(task, description=STAGES[stage] + text, completed=done, total=total)

        def tell_depth(frame: int, error: float) -> None:
            errors.add(frame, error)
            bar.update(task, description=f"{STAGES['depth']}, {errors.text}")

        result = run.result(resume=options.resume, progress=tell_progress, report_depth=tell_depth)
        stages.end()
    # The result is written and summarised before steps that may fail.
    with locked_folder(output, reentrant=True):  # fusion takes long
        write_trajectories(result, output)
        _tell(result, output)
        if scale is not None:
            result = result.rescaled(*scale)
            result.save(output)
            write_trajectories(result, output)
        if options.ply:
            result.points(coverage=coverage).save(output / POINTS)
        if options.mesh is not None:
            result.mesh(coverage=coverage).save(output / f"mesh.{options.mesh}")
        stages.write(output)
        run.finish()
    if options.report:
        report_reconstruction(result, output, source=source)
    return 0


def _prepare_run(
    options: Reconstruct,
    source: Source,
    frames: FrameSelection,
    camera: Camera | Path | None,
    poses: Trajectory | None,
    object_sizes: Mapping[int, float],
    in_chunks: bool,
) -> ReconstructRun:
    """Return the run, whole or in chunks."""
    settings = {
        "camera": camera,
        "calibrate": "nothing" if options.camera.focal == "guess" else options.calibrate,
        "settings": Settings.preset(options.preset, motion=options.motion),
        "poses": poses,
        "mask": options.mask,
        "labels": options.labels,
        "object_sizes": object_sizes,
        "depth_of": options.depth_of,
        "fixed_pixels": options.fixed_pixels,
    }
    shared: dict[str, Any] = {
        "frames": frames,
        "others": {
            "scale": options.scale,
            "ply": options.ply,
            "mesh": options.mesh,
            "complete": options.complete,
            "strict": options.strict,
        },
        "arch": options.arch,
        "threads": options.threads,
    }
    if not in_chunks:
        return WholeRun(source, options.output, settings, **shared)
    return ChunksRun(
        source,
        options.output,
        settings,
        chunk=DEFAULT_CHUNK if options.chunk is None else options.chunk,
        workers=options.workers,
        cluster=options.cluster,
        **shared,
    )


def _is_webcam(source: Source) -> bool:
    return isinstance(source, str) and webcam_number(source) is not None


def _announce(source: Source, output: Path, frames: FrameSelection, depth_of: DepthOf) -> None:
    """Print the expected size of a large result, and whether the disk has space for it."""
    if _is_webcam(source):
        return
    try:
        count = len(frames.open(source)) + 1
    except TypeError:  # the number is known only after reading
        return
    # Read the first frame of a video: decoding up to --start would only show the same size.
    pairs = frames.open(source)
    if pairs.names is None:
        pairs = replace(frames, start=0, stop=None, step=1).open(source)
    output_path = output.resolve()
    folder = next(
        (parent for parent in (output_path, *output_path.parents) if parent.exists()),
        None,
    )
    try:
        with closing(pairs.frames()) as images:
            first_frame = next(images, None)
    except (OSError, ValueError):  # reading the source will report it
        return
    if first_frame is None or folder is None:
        return
    pixels = math.prod(first_frame.image.shape[:2])
    bytes_per_frame = _PICTURE_BYTES * first_frame.image.size + _DEPTH_BYTES * pixels * (
        depth_of == "all"
    )
    expected, free = bytes_per_frame * count, shutil.disk_usage(folder).free
    if expected > free:
        tell(f"about {as_size(expected)} for {count} frames, but {as_size(free)} are free")
    elif expected > LARGE_OUTPUT:
        tell(f"about {as_size(expected)} for {count} frames in {output}")


def _check_camera_file(file: Path, source: Source, frames: FrameSelection) -> None:
    """Raise an error unless a file has a camera that fits the frames of a source."""
    read_camera(file)  # before the source is read
    with closing(frames.open(source).frames()) as images:
        first_frame = next(images, None)
    if first_frame is not None:
        read_camera(file, first_frame.full_shape or first_frame.image.shape[:2])


def _refuse_inside(file: Path, output: Path) -> None:
    """Raise InputError for a file in the output folder, whose contents are replaced."""
    output_path = output.resolve()
    if output_path in (file.resolve(), *file.resolve().parents):
        raise InputError(f"{file} lies in {output}, whose files are replaced: give another folder")


def _max_frame_count(source: Source, frames: FrameSelection) -> int | None:
    """Return the largest possible number of frames; None if it is unknown before reading."""
    if _is_webcam(source):
        chosen = slice(frames.start, frames.stop, frames.step)
        return None if frames.stop is None else len(range(frames.stop)[chosen])
    pairs = frames.open(source)
    return None if pairs.names is None else len(pairs.names)


def _check_scale(frame0: int, frame1: int, distance: float, *, count: int | None) -> None:
    if min(frame0, frame1) < 0 or frame0 == frame1 or not 0 < distance < np.inf:
        raise InputError(
            f"--scale is {frame0} {frame1} {distance:g}: expected the numbers of two frames, from "
            "0, and a positive distance"
        )
    if count is not None and max(frame0, frame1) >= count:
        raise InputError(
            f"--scale is {frame0} {frame1} {distance:g}, but the sequence has {count} frames: "
            f"expected numbers from 0 to {count - 1}"
        )


def write_trajectories(result: Reconstruction, folder: Path) -> None:
    """Write the poses of the largest piece in the formats of TUM and KITTI.

    If the times of frames do not increase, the TUM file has their numbers.
    """
    largest = result.largest_piece
    poses = np.where((result.piece == largest)[:, None, None], result.poses, np.nan)
    if not np.isfinite(poses).any():
        return
    note = result.warning(np.flatnonzero(result.piece == largest).tolist())
    write_tum(folder / TRAJECTORY, poses, times_or_numbers(result.times), note=note)
    write_kitti(folder / POSES, poses)


def _tell(result: Reconstruction, output: Path) -> None:
    tell_grade(
        f"{describe_poses(result.piece, result.has_position)}; {len(result.keyframes)} keyframes. "
        f"Grade {result.grade_summary.text}. "
        f"Results in {output}."
    )
    for moving_object in result.objects:
        pose_count = int(np.isfinite(moving_object.poses[:, 0, 0]).sum())
        text = f"object {moving_object.id}: labelled in {len(moving_object.frames)} frames"
        text += f", with a pose in {pose_count}" if pose_count else ""
        tell(text + (f"; {moving_object.message}" if moving_object.message else ""))
    calibration = result.calibration
    if calibration.message:
        names_focal = calibration.seen and calibration.origin != "given"
        tell(f"focal length: {calibration.message}" if names_focal else calibration.message)
    if result.focal_note:
        tell(result.focal_note)
    if calibration.readout:
        tell(
            f"rolling shutter: the readout takes {calibration.readout:.2f} ± "
            f"{calibration.readout_std:.1g} of the time between two frames; frames and poses are "
            "corrected for it"
        )
    if result.pose_deviation_text:
        tell(f"median deviations of the poses: {result.pose_deviation_text}")
    counts = Counter(str(status) for status in result.status if status != "converged")
    for code, number in counts.items():
        message = next(status.message for status in result.status if status == code)
        tell(f"{code}, {number} frame{'s' * (number != 1)}: {message}")
    for _, reason in result.skipped:
        tell(f"skipped: {reason}")
