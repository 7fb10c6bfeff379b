"""The formats of `tisfm export` by name: how each is checked and written."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal

from tisfm.errors import InputError
from tisfm.exports import notes
from tisfm.exports.camera_path import write_chan, write_gltf_cameras
from tisfm.exports.chosen_frames import pieces_of
from tisfm.exports.colmap import write_colmap
from tisfm.exports.export_request import ExportRequest, source_camera
from tisfm.exports.float_images import check_exr
from tisfm.exports.folders import refuse_others
from tisfm.exports.frame_maps import (
    VALUES_PER_UNIT,
    DepthKind,
    check_fits,
    frames_with_depth,
    write_depths,
    write_masks,
)
from tisfm.exports.nerfstudio import write_nerfstudio
from tisfm.exports.surfaces import Suffix, save_points, write_meshes, write_points
from tisfm.exports.trajectories import write_kitti_paths, write_tum_paths
from tisfm.exports.undistortion import check_distorts, write_undistortion
from tisfm.exports.video_file import check_video
from tisfm.exports.videos import VideoKind, write_video
from tisfm.fusion.mesh import check_scikit_image
from tisfm.results.result_frames import file_names
from tisfm.results.sequence_frames import SequenceFrames

Progress = Callable[[int, int], None]
Files = list[Path]


def _no_notes(export: ExportRequest) -> list[str]:
    return []


@dataclass(frozen=True, kw_only=True)
class Format:
    """A format of `tisfm export`."""

    # takes an `ExportRequest` and a function for progress; returns the files
    write: Callable[[ExportRequest, Progress], Files]
    # raises errors of `write` that can be known before long work: ImportError if a package is
    # missing, ValueError if the result lacks what the format needs
    check: Callable[[ExportRequest], object]
    # returns notes on the files for the user
    notes: Callable[[ExportRequest], list[str]] = _no_notes
    # upper bound of the size of a frame in the files; 0 for files that do not grow with frames
    bytes_per_pixel: float = 0.0


def _require_poses(export: ExportRequest) -> object:
    return pieces_of(export.sequence, export.chosen)


def _require_depth(export: ExportRequest) -> None:
    frames = export.frames
    if not any(frames.has_depth(frame) for frame in export.chosen):
        frames_with_depth(frames, export.chosen)


def _depth(kind: DepthKind, bytes_per_pixel: float) -> Format:
    def write(export: ExportRequest, progress: Progress) -> Files:
        subfolder = export.subfolder(f"depth-{kind}")
        return write_depths(export.frames, subfolder, kind, chosen=export.chosen, progress=progress)

    def check(export: ExportRequest) -> None:
        if kind == "exr":
            check_exr()
        _require_depth(export)
        if kind in VALUES_PER_UNIT:
            check_fits(export.frames, frames_with_depth(export.frames, export.chosen), kind)

    def describe(export: ExportRequest) -> list[str]:
        scale = notes.note_scale(export, kind) if kind in VALUES_PER_UNIT else []
        return [*scale, *notes.note_depth(export)]

    return Format(write=write, check=check, notes=describe, bytes_per_pixel=bytes_per_pixel)


def _video(kind: VideoKind) -> Format:
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

    def describe(export: ExportRequest) -> list[str]:
        without = [] if kind == "flow" else notes.note_depth(export)
        return [*notes.note_rate(export), *without]

    return Format(write=write, check=check, notes=describe, bytes_per_pixel=0.4)


def _points(suffix: Suffix) -> Format:
    def write(export: ExportRequest, progress: Progress) -> Files:
        if isinstance(export.frames, SequenceFrames):
            return write_points(export.sequence, export.folder, suffix=suffix, frames=export.chosen)
        subfolder, written = export.subfolder(f"points-{suffix}"), []
        names = file_names(export.frames.names)
        for done, frame in enumerate(export.chosen, 1):
            points = export.frames.result(frame).points()
            if len(points):
                written.append(subfolder / f"{names[frame]}.{suffix}")
                save_points(points, written[-1])
            progress(done, len(export.chosen))
        if not written:
            raise InputError(
                f"no pair in {export.frames.folder} shows a point: {export.frames.depth_advice}"
            )
        return written

    def describe(export: ExportRequest) -> list[str]:
        return notes.note_poses(export) if isinstance(export.frames, SequenceFrames) else []

    return Format(write=write, check=_require_depth, notes=describe)


def _mesh(suffix: Suffix) -> Format:
    def write(export: ExportRequest, progress: Progress) -> Files:
        return write_meshes(export.sequence, export.folder, suffix=suffix, frames=export.chosen)

    def check(export: ExportRequest) -> None:
        _require_poses(export)
        check_scikit_image()
        _require_depth(export)

    return Format(write=write, check=check, notes=notes.note_poses)


def _undistortion(suffix: Literal["exr", "tiff"]) -> Format:
    def write(export: ExportRequest, progress: Progress) -> Files:
        return write_undistortion(*source_camera(export), export.folder, suffix=suffix)

    def check(export: ExportRequest) -> None:
        if suffix == "exr":
            check_exr()
        check_distorts(source_camera(export)[0])

    return Format(write=write, check=check, notes=notes.note_shutter)


def _model(
    name: str,
    write: Callable[..., object],
    describe: Callable[[ExportRequest], list[str]] = notes.note_models,
) -> Format:
    """Return a format whose files fill a folder of their own."""

    def written(export: ExportRequest, progress: Progress) -> Files:
        subfolder = export.folder / name
        write(export.sequence, subfolder, progress=progress)
        return [subfolder]

    def check(export: ExportRequest) -> None:
        if max(map(len, pieces_of(export.sequence, export.chosen))) < 2:
            raise InputError(f"{name} needs a piece of two frames or more, but there is none")
        if len(export.chosen) < len(export.frames):
            raise InputError(f"{name} exports all frames: leave out --start, --stop and --step")
        subfolder = export.folder / name
        if subfolder.exists():
            refuse_others(subfolder)

    return Format(write=written, check=check, notes=describe, bytes_per_pixel=0.5)


def _path(
    write: Callable[..., Files],
    describe: Callable[[ExportRequest], list[str]],
) -> Format:
    def written(export: ExportRequest, progress: Progress) -> Files:
        return write(
            export.sequence,
            export.folder,
            frames=export.chosen,
            frames_per_second=export.frames_per_second,
        )

    return Format(
        write=written,
        check=_require_poses,
        notes=lambda export: [*notes.note_poses(export), *describe(export)],
    )


FORMATS = {
    "tum": _path(write_tum_paths, notes.note_times),
    "kitti": _path(write_kitti_paths, notes.note_times),
    "ply": _points("ply"),
    "glb": _points("glb"),
    "mesh-ply": _mesh("ply"),
    "mesh-glb": _mesh("glb"),
    "gltf-camera": _path(
        write_gltf_cameras, lambda export: [*notes.note_rate(export), *notes.note_lens(export)]
    ),
    "chan": Format(
        write=lambda export, progress: write_chan(
            export.sequence, export.folder, frames=export.chosen
        ),
        check=_require_poses,
        notes=lambda export: [*notes.note_poses(export), *notes.note_lens(export)],
    ),
    "colmap": _model("colmap", write_colmap),
    "colmap-text": _model("colmap-text", partial(write_colmap, form="text")),
    "nerfstudio": _model("nerfstudio", write_nerfstudio, notes.note_largest),
    "undistortion": _undistortion("exr"),
    "undistortion-tiff": _undistortion("tiff"),
    "depth-tum": _depth("tum", 2.0),
    "depth-kitti": _depth("kitti", 2.0),
    "depth-exr": _depth("exr", 4.0),
    "depth-tiff": _depth("tiff", 4.0),
    "depth-pfm": _depth("pfm", 4.0),
    "depth-dpt": _depth("dpt", 4.0),
    "masks": Format(
        write=lambda export, progress: write_masks(
            export.frames, export.subfolder("masks"), chosen=export.chosen, progress=progress
        ),
        check=lambda export: export.frames.masks(export.chosen[0]),
        bytes_per_pixel=0.2,
    ),
    "video-depth": _video("depth"),
    "video-flow": _video("flow"),
    "video-side-by-side": _video("side-by-side"),
    "video-anaglyph": _video("anaglyph"),
    "video-wiggle": _video("wiggle"),
}
"""All formats by name; docs/exports.md says what is in each."""
