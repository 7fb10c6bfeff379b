"""The formats of `tisfm export` by name: functions that check, write and describe each."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np

from tisfm.errors import InputError
from tisfm.exports.camera_path import is_centered, write_chan, write_gltf_cameras
from tisfm.exports.colmap import write_colmap
from tisfm.exports.export_request import (
    DEFAULT_FRAME_RATE,
    ExportRequest,
    piece_frames,
    source_camera,
)
from tisfm.exports.float_images import check_exr
from tisfm.exports.frame_maps import (
    MAX_VALUE,
    VALUES_PER_UNIT,
    DepthKind,
    check_depth_range,
    frames_with_depth,
    write_depths,
    write_masks,
)
from tisfm.exports.model_folder import refuse_foreign_files
from tisfm.exports.nerfstudio import write_nerfstudio
from tisfm.exports.surfaces import Suffix, save_points, write_meshes, write_points
from tisfm.exports.trajectories import write_kitti_paths, write_tum_paths
from tisfm.exports.undistortion import require_distortion, write_undistortion
from tisfm.exports.video_file import check_video
from tisfm.exports.videos import VideoKind, write_video
from tisfm.focal_guess import at_size
from tisfm.fusion.mesh import check_scikit_image
from tisfm.results.pair_frames import PairFrames
from tisfm.results.result_frames import file_names
from tisfm.results.sequence_frames import SequenceFrames
from tisfm.status import STATUSES
from tisfm.trajectory.times import are_increasing


def note_poses(export: ExportRequest) -> list[str]:
    """Note frames without a pose, and several pieces."""
    pieces = piece_frames(export.sequence, export.chosen)
    missing_count = len(export.chosen) - sum(map(len, pieces))
    notes = [f"{_count_text(missing_count)} without a pose left out"] if missing_count else []
    if len(pieces) > 1:
        sizes = ", ".join(str(len(piece)) for piece in pieces)
        notes.append(
            f"{len(pieces)} pieces ({sizes} frames), each with its own scale and its own file"
        )
    turning_count = sum(map(len, pieces)) - sum(map(len, _pieces_with_positions(export)))
    if turning_count:
        notes.append(
            f"the camera only turns in {_count_text(turning_count)}: the file has their "
            "orientations; their positions are unknown, and 0 in the file"
        )
    return notes


def _pieces_with_positions(export: ExportRequest) -> list[list[int]]:
    """Return the frames of each piece in which the camera does not only turn."""
    result = export.sequence
    pieces = piece_frames(result, export.chosen)
    return [piece for piece in pieces if not result.only_turns(int(result.piece[piece[0]]))]


def note_models(export: ExportRequest) -> list[str]:
    """Note frames without a model: without a position, or in a piece of one frame."""
    pieces = [piece for piece in _pieces_with_positions(export) if len(piece) > 1]
    notes = []
    if missing_count := len(export.chosen) - sum(map(len, pieces)):
        notes.append(
            f"{_count_text(missing_count)} without a position, or in a piece of one frame, left out"
        )
    if len(pieces) > 1:
        sizes = ", ".join(str(len(piece)) for piece in pieces)
        notes.append(
            f"{len(pieces)} pieces ({sizes} frames), each with its own scale and its own model"
        )
    return notes


def note_largest(export: ExportRequest) -> list[str]:
    """Note frames outside the largest piece."""
    largest = max(map(len, _pieces_with_positions(export)), default=0)
    missing_count = len(export.chosen) - largest
    return (
        [f"only the largest piece; {_count_text(missing_count)} left out"] if missing_count else []
    )


def note_times(export: ExportRequest) -> list[str]:
    """Note that frame numbers replace times."""
    if are_increasing(export.frames.times) or export.frames_per_second is not None:
        return []
    return [
        f"{_missing_times_reason(export)}: frame numbers replace seconds; --fps sets the frames "
        "per second"
    ]


def note_rate(export: ExportRequest) -> list[str]:
    """Note that the frame rate is a guess."""
    has_times = are_increasing([export.frames.times[frame] for frame in export.chosen])
    if (has_times and len(export.chosen) > 1) or export.frames_per_second is not None:
        return []
    return [
        f"{_missing_times_reason(export)}: {DEFAULT_FRAME_RATE:g} per second are assumed; --fps "
        "sets another rate"
    ]


def note_lens(export: ExportRequest) -> list[str]:
    """Note a principal point outside the middle, which the format cannot store."""
    result = export.sequence
    if is_centered(result.camera, result.shape):
        return []
    cx, cy = result.camera.center_for(*result.shape)
    size = at_size(result.shape)
    return [
        f"the principal point is at ({cx:.1f}, {cy:.1f}) px{size}, not in the middle: the file "
        "cannot store it; set the lens shift from lens.json"
    ]


def note_shutter(export: ExportRequest) -> list[str]:
    """Note that the maps do not undo a rolling shutter."""
    if not source_camera(export)[0].readout:
        return []
    return ["the maps do not correct the rolling shutter; the frames of the result are corrected"]


def note_depth(export: ExportRequest) -> list[str]:
    """Note frames without depth, and statuses that this version does not know."""
    numbers = frames_with_depth(export.frames, export.chosen)
    missing_count = len(export.chosen) - len(numbers)
    notes = [f"{_count_text(missing_count)} without depth left out"] if missing_count else []
    statuses = [export.frames.statuses[frame] for frame in numbers]
    codes = [str(status) for status in statuses if status not in STATUSES]
    if codes:
        notes.append(
            f"{_count_text(len(codes))} with a status that this version does not know "
            f"({', '.join(sorted(set(codes)))}): treat their depth as doubtful"
        )
    return notes


def note_scale(export: ExportRequest, kind: DepthKind) -> list[str]:
    """Note the scale of 16-bit depth, and the share of depth beyond its range."""
    scale = VALUES_PER_UNIT[kind]
    share_out_of_range = check_depth_range(
        export.frames, frames_with_depth(export.frames, export.chosen), kind
    )
    unit = "the unit of the path"
    if isinstance(export.frames, PairFrames):
        unit = "the unit of the poses" if export.frames.has_one_scale else "the unit of each pair"
    notes = [f"depth is value / {scale:g}, in {unit}"]
    if share_out_of_range:
        notes.append(
            f"about {np.ceil(1000 * share_out_of_range) / 10:g} % of it is beyond "
            f"{MAX_VALUE / scale:.4g}, and 0 in the files"
        )
    return notes


def _missing_times_reason(export: ExportRequest) -> str:
    """Return why the times of the frames are not used."""
    if any(export.frames.times[frame] is None for frame in export.chosen):
        return "frames have no times"
    return "frames have no times that rise"


def _count_text(count: int) -> str:
    return f"{count} frame{'s' * (count != 1)}"


Progress = Callable[[int, int], None]
Files = list[Path]


def _no_notes(export: ExportRequest) -> list[str]:
    return []


@dataclass(frozen=True, kw_only=True)
class Format:
    """A format of `tisfm export`."""

    # takes an `ExportRequest` and a function for progress; returns the files
    write: Callable[[ExportRequest, Progress], Files]
    # raises the errors of `write` that can be found before long work: ImportError if a package is
    # missing, ValueError if the result lacks poses, depth or flow that the format needs
    check: Callable[[ExportRequest], object]
    # returns notes on the files for the user
    notes: Callable[[ExportRequest], list[str]] = _no_notes
    # upper bound of the size of a frame in the files; 0 for files that do not grow with frames
    bytes_per_pixel: float = 0.0


def _require_poses(export: ExportRequest) -> object:
    return piece_frames(export.sequence, export.chosen)


def _require_depth(export: ExportRequest) -> None:
    frames = export.frames
    if not any(frames.has_depth(frame) for frame in export.chosen):
        frames_with_depth(frames, export.chosen)


def _depth_format(kind: DepthKind, bytes_per_pixel: float) -> Format:
    def write(export: ExportRequest, progress: Progress) -> Files:
        subfolder = export.subfolder(f"depth-{kind}")
        return write_depths(export.frames, subfolder, kind, chosen=export.chosen, progress=progress)

    def check(export: ExportRequest) -> None:
        if kind == "exr":
            check_exr()
        _require_depth(export)
        if kind in VALUES_PER_UNIT:
            check_depth_range(export.frames, frames_with_depth(export.frames, export.chosen), kind)

    def make_notes(export: ExportRequest) -> list[str]:
        scale = note_scale(export, kind) if kind in VALUES_PER_UNIT else []
        return [*scale, *note_depth(export)]

    return Format(write=write, check=check, notes=make_notes, bytes_per_pixel=bytes_per_pixel)


def _video_format(kind: VideoKind) -> Format:
    def write(export: ExportRequest, progress: Progress) -> Files:
        file = write_video(
            export.frames,
            export.folder / f"{kind}.mp4",
            kind,
            chosen=export.chosen,
            frames_per_second=export.frames_per_second,
            disparity=export.disparity,
            screen=export.screen,
            screen_depth=export.screen_depth,
            progress=progress,
        )
        return [file]

    def check(export: ExportRequest) -> None:
        check_video()
        if kind == "flow":
            export.frames.flow(export.chosen[0])
        else:
            _require_depth(export)

    def make_notes(export: ExportRequest) -> list[str]:
        depth_notes = [] if kind == "flow" else note_depth(export)
        return [*note_rate(export), *depth_notes]

    return Format(write=write, check=check, notes=make_notes, bytes_per_pixel=0.4)


def _points_format(suffix: Suffix) -> Format:
    def write(export: ExportRequest, progress: Progress) -> Files:
        if isinstance(export.frames, SequenceFrames):
            return write_points(
                export.sequence,
                export.folder,
                suffix=suffix,
                frames=export.chosen,
                coverage=export.coverage,
            )
        subfolder, written_files = export.subfolder(f"points-{suffix}"), []
        names = file_names(export.frames.names)
        for done, frame in enumerate(export.chosen, 1):
            points = export.frames.result(frame).points()
            if len(points):
                written_files.append(subfolder / f"{names[frame]}.{suffix}")
                save_points(points, written_files[-1])
            progress(done, len(export.chosen))
        if not written_files:
            raise InputError(
                f"no pair in {export.frames.folder} shows a point: {export.frames.depth_advice}"
            )
        return written_files

    def make_notes(export: ExportRequest) -> list[str]:
        return note_poses(export) if isinstance(export.frames, SequenceFrames) else []

    return Format(write=write, check=_require_depth, notes=make_notes)


def _mesh_format(suffix: Suffix) -> Format:
    def write(export: ExportRequest, progress: Progress) -> Files:
        return write_meshes(
            export.sequence,
            export.folder,
            suffix=suffix,
            frames=export.chosen,
            coverage=export.coverage,
        )

    def check(export: ExportRequest) -> None:
        _require_poses(export)
        check_scikit_image()
        _require_depth(export)

    return Format(write=write, check=check, notes=note_poses)


def _undistortion_format(suffix: Literal["exr", "tiff"]) -> Format:
    def write(export: ExportRequest, progress: Progress) -> Files:
        return write_undistortion(*source_camera(export), export.folder, suffix=suffix)

    def check(export: ExportRequest) -> None:
        if suffix == "exr":
            check_exr()
        require_distortion(source_camera(export)[0])

    return Format(write=write, check=check, notes=note_shutter)


def _model_format(
    name: str,
    write: Callable[..., object],
    make_notes: Callable[[ExportRequest], list[str]] = note_models,
) -> Format:
    """Return a format that writes a folder of its own."""

    def write_files(export: ExportRequest, progress: Progress) -> Files:
        subfolder = export.folder / name
        write(export.sequence, subfolder, progress=progress)
        return [subfolder]

    def check(export: ExportRequest) -> None:
        _require_poses(export)
        pieces = _pieces_with_positions(export)
        if not pieces:
            raise InputError(
                f"the camera only turns: {name} needs positions, which are unknown; export the "
                "orientations as tum, kitti, gltf-camera or chan"
            )
        if max(map(len, pieces)) < 2:
            raise InputError(f"{name} needs a piece of two frames or more, but there is none")
        if len(export.chosen) < len(export.frames):
            raise InputError(f"{name} exports all frames: leave out --start, --stop and --step")
        subfolder = export.folder / name
        if subfolder.exists():
            refuse_foreign_files(subfolder)

    return Format(write=write_files, check=check, notes=make_notes, bytes_per_pixel=0.5)


def _path_format(
    write: Callable[..., Files], make_notes: Callable[[ExportRequest], list[str]]
) -> Format:
    def write_files(export: ExportRequest, progress: Progress) -> Files:
        return write(
            export.sequence,
            export.folder,
            frames=export.chosen,
            frames_per_second=export.frames_per_second,
        )

    return Format(
        write=write_files,
        check=_require_poses,
        notes=lambda export: [*note_poses(export), *make_notes(export)],
    )


FORMATS = {
    "tum": _path_format(write_tum_paths, note_times),
    "kitti": _path_format(write_kitti_paths, note_times),
    "ply": _points_format("ply"),
    "glb": _points_format("glb"),
    "mesh-ply": _mesh_format("ply"),
    "mesh-glb": _mesh_format("glb"),
    "gltf-camera": _path_format(
        write_gltf_cameras, lambda export: [*note_rate(export), *note_lens(export)]
    ),
    "chan": Format(
        write=lambda export, progress: write_chan(
            export.sequence, export.folder, frames=export.chosen
        ),
        check=_require_poses,
        notes=lambda export: [*note_poses(export), *note_lens(export)],
    ),
    "colmap": _model_format("colmap", write_colmap),
    "colmap-text": _model_format("colmap-text", partial(write_colmap, form="text")),
    "nerfstudio": _model_format("nerfstudio", write_nerfstudio, note_largest),
    "undistortion": _undistortion_format("exr"),
    "undistortion-tiff": _undistortion_format("tiff"),
    "depth-tum": _depth_format("tum", 2.0),
    "depth-kitti": _depth_format("kitti", 2.0),
    "depth-exr": _depth_format("exr", 4.0),
    "depth-tiff": _depth_format("tiff", 4.0),
    "depth-pfm": _depth_format("pfm", 4.0),
    "depth-dpt": _depth_format("dpt", 4.0),
    "masks": Format(
        write=lambda export, progress: write_masks(
            export.frames, export.subfolder("masks"), chosen=export.chosen, progress=progress
        ),
        check=lambda export: export.frames.masks(export.chosen[0]),
        bytes_per_pixel=0.2,
    ),
    "video-depth": _video_format("depth"),
    "video-flow": _video_format("flow"),
    "video-side-by-side": _video_format("side-by-side"),
    "video-anaglyph": _video_format("anaglyph"),
    "video-wiggle": _video_format("wiggle"),
}
"""All formats by name; docs/exports.md says what is in each."""
