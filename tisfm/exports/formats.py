"""The formats of `tisfm export`, by name: how each is written, and what is checked before."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal

from tisfm.errors import InputError
from tisfm.exports import notes
from tisfm.exports.camera_path import write_chan, write_gltf_cameras
from tisfm.exports.colmap import write_colmap
from tisfm.exports.depths import (
    VALUES_PER_UNIT,
    DepthKind,
    check_fits,
    frames_with_depth,
    write_depths,
)
from tisfm.exports.export_request import Export, source_camera
from tisfm.exports.float_images import check_exr
from tisfm.exports.folders import refuse_others
from tisfm.exports.masks import write_masks
from tisfm.exports.nerfstudio import write_nerfstudio
from tisfm.exports.pieces import pieces_of
from tisfm.exports.result_frames import SequenceFrames
from tisfm.exports.surfaces import Suffix, save_points, write_meshes, write_points
from tisfm.exports.trajectories import write_kitti_paths, write_tum_paths
from tisfm.exports.undistortion import check_distorts, write_undistortion
from tisfm.exports.video_file import check_video
from tisfm.exports.videos import VideoKind, write_video
from tisfm.fusion.mesh import check_library

Progress = Callable[[int, int], None]
Files = list[Path]


def _nothing(export: Export) -> list[str]:
    return []


@dataclass(frozen=True, kw_only=True)
class Format:
    """What is written under a name.

    Attributes
    ----------
    write : callable
        Takes an `Export` and what is told of progress; returns the files.
    check : callable
        Raises what `write` would, as far as it can be told before long work: ImportError where a
        package is missing, ValueError where the result does not have what is asked for.
    notes : callable
        Returns what is to be said of the files.
    bytes_per_pixel : float
        At most, of every frame; 0 where it does not grow with them.
    """

    write: Callable[[Export, Progress], Files]
    check: Callable[[Export], object]
    notes: Callable[[Export], list[str]] = _nothing
    bytes_per_pixel: float = 0.0


def _has_poses(export: Export) -> object:
    return pieces_of(export.sequence, export.chosen)


def _has_depth(export: Export) -> None:
    frames = export.frames
    if not any(frames.has_depth(frame) for frame in export.chosen):
        frames_with_depth(frames, export.chosen)


def _depth(kind: DepthKind, bytes_per_pixel: float) -> Format:
    def write(export: Export, progress: Progress) -> Files:
        place = export.subfolder(f"depth-{kind}")
        return write_depths(export.frames, place, kind, chosen=export.chosen, progress=progress)

    def check(export: Export) -> None:
        if kind == "exr":
            check_exr()
        _has_depth(export)
        if kind in VALUES_PER_UNIT:
            check_fits(export.frames, frames_with_depth(export.frames, export.chosen), kind)

    def said(export: Export) -> list[str]:
        scale = notes.of_scale(export, kind) if kind in VALUES_PER_UNIT else []
        return [*scale, *notes.of_depth(export)]

    return Format(write=write, check=check, notes=said, bytes_per_pixel=bytes_per_pixel)


def _video(kind: VideoKind) -> Format:
    def write(export: Export, progress: Progress) -> Files:
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

    def check(export: Export) -> None:
        check_video()
        if kind == "flow":
            export.frames.flow(export.chosen[0])
        else:
            _has_depth(export)

    def said(export: Export) -> list[str]:
        without = [] if kind == "flow" else notes.of_depth(export)
        return [*notes.of_rate(export), *without]

    return Format(write=write, check=check, notes=said, bytes_per_pixel=0.4)


def _points(suffix: Suffix) -> Format:
    def write(export: Export, progress: Progress) -> Files:
        if isinstance(export.frames, SequenceFrames):
            return write_points(export.sequence, export.folder, suffix=suffix, frames=export.chosen)
        place, written = export.subfolder(f"points-{suffix}"), []
        for done, frame in enumerate(export.chosen, 1):
            points = export.frames.result(frame).points()
            if len(points):
                written.append(place / f"{export.frames.names[frame]}.{suffix}")
                save_points(points, written[-1])
            progress(done, len(export.chosen))
        if not written:
            raise InputError(
                f"no pair in {export.frames.folder} shows a point: {export.frames.advice}"
            )
        return written

    def said(export: Export) -> list[str]:
        return notes.of_poses(export) if isinstance(export.frames, SequenceFrames) else []

    return Format(write=write, check=_has_depth, notes=said)


def _mesh(suffix: Suffix) -> Format:
    def write(export: Export, progress: Progress) -> Files:
        return write_meshes(export.sequence, export.folder, suffix=suffix, frames=export.chosen)

    def check(export: Export) -> None:
        _has_poses(export)
        check_library()
        _has_depth(export)

    return Format(write=write, check=check, notes=notes.of_poses)


def _undistortion(suffix: Literal["exr", "tiff"]) -> Format:
    def write(export: Export, progress: Progress) -> Files:
        return write_undistortion(*source_camera(export), export.folder, suffix=suffix)

    def check(export: Export) -> None:
        if suffix == "exr":
            check_exr()
        check_distorts(source_camera(export)[0])

    return Format(write=write, check=check, notes=notes.of_shutter)


def _model(
    name: str,
    write: Callable[..., object],
    said: Callable[[Export], list[str]] = notes.of_models,
) -> Format:
    """Return a format that is a folder of its own, made by a function of the reconstruction."""

    def written(export: Export, progress: Progress) -> Files:
        place = export.folder / name
        write(export.sequence, place, progress=progress)
        return [place]

    def check(export: Export) -> None:
        if max(map(len, pieces_of(export.sequence, export.chosen))) < 2:
            raise InputError(f"{name} takes pieces of two frames or more, and there is none")
        if len(export.chosen) < len(export.frames):
            raise InputError(f"{name} takes all frames: leave out --start, --stop and --step")
        place = export.folder / name
        if place.exists():
            refuse_others(place)

    return Format(write=written, check=check, notes=said, bytes_per_pixel=0.5)


def _path(
    write: Callable[..., Files],
    said: Callable[[Export], list[str]],
) -> Format:
    def written(export: Export, progress: Progress) -> Files:
        return write(
            export.sequence,
            export.folder,
            frames=export.chosen,
            frames_per_second=export.frames_per_second,
        )

    return Format(
        write=written,
        check=_has_poses,
        notes=lambda export: [*notes.of_poses(export), *said(export)],
    )


FORMATS = {
    "tum": _path(write_tum_paths, notes.of_times),
    "kitti": _path(write_kitti_paths, notes.of_times),
    "ply": _points("ply"),
    "glb": _points("glb"),
    "mesh-ply": _mesh("ply"),
    "mesh-glb": _mesh("glb"),
    "gltf-camera": _path(
        write_gltf_cameras, lambda export: [*notes.of_rate(export), *notes.of_lens(export)]
    ),
    "chan": Format(
        write=lambda export, progress: write_chan(
            export.sequence, export.folder, frames=export.chosen
        ),
        check=_has_poses,
        notes=lambda export: [*notes.of_poses(export), *notes.of_lens(export)],
    ),
    "colmap": _model("colmap", write_colmap),
    "colmap-text": _model("colmap-text", partial(write_colmap, form="text")),
    "nerfstudio": _model("nerfstudio", write_nerfstudio, notes.of_largest),
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
