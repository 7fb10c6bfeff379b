"""A reconstruction as a model of COLMAP, with points and tracks measured in the frames."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from os import PathLike
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from tisfm.errors import InputError
from tisfm.exports.model_folder import (
    IMAGES,
    MASKS,
    MODELS,
    Images,
    check_images,
    has_masks,
    open_export,
    picture_name,
    write_masks,
    write_pictures,
)
from tisfm.exports.tracks import Tracks, count_cells, measure_tracks
from tisfm.formats import atomic_write
from tisfm.reconstruction.mapping.database import PIXEL_CENTRE, colmap_camera, pycolmap
from tisfm.reconstruction.result.reconstruction import Reconstruction

Form = Literal["binary", "text", "both"]
CAMERA_ID = 1  # of the only camera
MIN_FRAMES = 2  # frames of a piece that gets a model


@dataclass(frozen=True, kw_only=True)
class ExportedModel:
    """A summary of the written model of a piece.

    Attributes
    ----------
    name : str
        Path in the folder.
    piece : int
        Piece of the reconstruction.
    images, points, observations : int
    error : float or None
        Median distance between measured and projected points, px; None without points.

    Examples
    --------
    >>> from tisfm.exports import ExportedModel
    >>> model = ExportedModel(
    ...     name="sparse/0", piece=0, images=9, points=812, observations=4060, error=0.4
    ... )
    >>> model.observations / model.points  # frames that see a point
    5.0
    """

    name: str
    piece: int
    images: int
    points: int
    observations: int
    error: float | None


def write_colmap(
    reconstruction: Reconstruction,
    folder: str | PathLike[str],
    *,
    form: Form = "binary",
    images: Images = "copy",
    spacing: float | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[ExportedModel, ...]:
    """Write a project of COLMAP: images, and a model of each piece, with measured tracks.

    ``sparse/0`` is the model of the largest piece, ``sparse/1`` of the next: each has its own
    scale. Frames without a pose, and pieces of a single frame, are left out. A point begins at a
    corner of a keyframe; its positions in other frames are measured in the images, to a fraction of
    a pixel, and the point minimises its distance to all of them. The camera is a ``PINHOLE``,
    because the frames have no distortion; image n + 1 is frame n of the reconstruction.
    With ``motion="objects"``, or with masked pixels that move, ``masks/`` has masks for COLMAP, in
    which what moves is black; it has no points.

    Parameters
    ----------
    reconstruction : Reconstruction
    folder : path
        A new or empty folder, or one with an earlier export, which is replaced at the end.
    form : {"binary", "text", "both"}
        Format of the models.
    images : {"copy", "link", "none"}
        Whether ``images/`` has copies of the frames or hard links to them, or is left out.
    spacing : float, optional
        Distance of new points in a frame, px; by default 1/80 of the longer side.
    progress : callable, optional
        Called with the number of finished frames and of all frames.

    Returns
    -------
    tuple of ExportedModel
        A summary of each model.

    Raises
    ------
    ValueError
        If an option is impossible, or no two frames have poses in one scale.
    FileExistsError
        If the folder holds other files.
    FileNotFoundError, tisfm.formats.FormatError
        If files of the reconstruction are missing or damaged.
    OSError
        If the folder cannot be written to, or another run writes to it.

    References
    ----------
    Schönberger and Frahm, "Structure-from-motion revisited", CVPR 2016,
    doi 10.1109/CVPR.2016.445; the files: https://colmap.github.io/format.html.

    Examples
    --------
    >>> import tisfm
    >>> from tisfm.exports import write_colmap
    >>> (model,) = write_colmap(tisfm.Reconstruction.load("walk"), "colmap", form="text")
    >>> model.images, model.points > 100, model.error < 1  # px
    (9, True, True)
    """
    if form not in get_args(Form):
        raise InputError(f"form is {form!r}: expected 'binary', 'text' or 'both'")
    check_images(images)
    count_cells(reconstruction.shape, spacing)
    pieces = model_frames(reconstruction)
    record: dict[str, Any] = {"kind": "colmap", "version": reconstruction.version}
    with open_export(folder, record) as new_folder:
        models: list[ExportedModel] = []
        total = sum(map(len, pieces.values()))
        for number, (piece, frames) in enumerate(pieces.items()):
            finished_count = sum(model.images for model in models)
            tracks = measure_tracks(
                reconstruction,
                piece,
                spacing=spacing,
                progress=_offset_progress(progress, finished_count, total),
            )
            name = f"{MODELS}/{number}"
            write_model(
                _colmap_reconstruction(reconstruction, frames, tracks),
                new_folder / name,
                form,
                note=reconstruction.warning(frames),
            )
            models.append(model_summary(name, piece, frames, tracks))
        posed_frames = sorted(frame for frames in pieces.values() for frame in frames)
        if images != "none":
            write_pictures(reconstruction, posed_frames, new_folder / IMAGES, images)
        if has_masks(reconstruction):
            write_masks(reconstruction, posed_frames, new_folder / MASKS, ".jpg.png")
        record["models"] = [asdict(model) for model in models]
        record["warning"] = reconstruction.warning(posed_frames)
    return tuple(models)


def model_frames(result: Reconstruction) -> dict[int, list[int]]:
    """Return the frames of every piece of at least two, the largest piece first.

    Pieces in which the camera only turns are left out: their positions are unknown.

    Raises ValueError if there is no such piece.
    """
    frames = {
        k: np.flatnonzero(result.piece == k).tolist()
        for k in range(len(result.unit))
        if not result.only_turns(k)
    }
    large_pieces = {k: numbers for k, numbers in frames.items() if len(numbers) >= MIN_FRAMES}
    if not large_pieces:
        raise InputError(
            f"no two of the {len(result)} frames have positions in one scale: there is nothing to "
            "export; the statuses of the frames say why"
        )
    return dict(sorted(large_pieces.items(), key=lambda item: -len(item[1])))


def model_summary(name: str, piece: int, frames: Sequence[int], tracks: Tracks) -> ExportedModel:
    """Return the summary of the model of a piece."""
    return ExportedModel(
        name=name,
        piece=piece,
        images=len(frames),
        points=len(tracks),
        observations=len(tracks.image_points),
        error=float(np.median(tracks.residual)) if len(tracks) else None,
    )


def _colmap_reconstruction(result: Reconstruction, frames: Sequence[int], tracks: Tracks) -> Any:
    """Return a piece as a reconstruction of pycolmap."""
    pycolmap_module = pycolmap()
    model = pycolmap_module.Reconstruction()
    model.add_camera_with_trivial_rig(colmap_camera(result.camera, result.shape))
    order = np.argsort(tracks.frames, kind="stable")
    bounds = np.searchsorted(tracks.frames[order], [*frames, len(result)])
    number_in_frame = np.empty(len(order), np.int64)
    for frame, (first, last) in zip(frames, pairwise(bounds.tolist()), strict=True):
        in_frame = order[first:last]
        number_in_frame[in_frame] = np.arange(len(in_frame))
        image = pycolmap_module.Image(
            name=picture_name(frame),
            keypoints=tracks.image_points[in_frame] + PIXEL_CENTRE,
            camera_id=CAMERA_ID,
            image_id=frame + 1,
        )
        pose = pycolmap_module.Rigid3d(np.linalg.inv(result.poses[frame])[:3])
        model.add_image_with_trivial_frame(image, pose)
    ends = np.searchsorted(tracks.points, np.arange(len(tracks) + 1))
    images, numbers = (tracks.frames + 1).tolist(), number_in_frame.tolist()
    for point, (first, last) in enumerate(pairwise(ends.tolist())):
        elements = zip(images[first:last], numbers[first:last], strict=True)
        track = pycolmap_module.Track(
            [pycolmap_module.TrackElement(image, number) for image, number in elements]
        )
        model.add_point3D(tracks.positions[point], track, tracks.colors[point])
    model.update_point_3d_errors()
    return model


def _offset_progress(
    progress: Callable[[int, int], None] | None, finished_count: int, total: int
) -> Callable[[int, int], None] | None:
    """Return a function that reports the progress of one piece as progress of all."""
    if progress is None:
        return None
    return lambda done, _: progress(finished_count + done, total)


def write_model(
    model: Any,
    folder: Path,  # this function makes it
    form: Form,
    *,
    note: str = "",  # a text for the comments of text files
) -> None:
    """Write a reconstruction of pycolmap that has one camera, and check that it is complete.

    pycolmap raises no error if the disk is full, and cannot read the incomplete files then.

    Raises OSError if a file is incomplete.
    """
    folder.mkdir(parents=True)
    if form != "text":
        model.write_binary(folder)
    if form != "binary":
        model.write_text(folder)
    check_complete(model, folder, form)
    if note and form != "binary":
        for name in ("images.txt", "points3D.txt"):
            _add_comment(folder / name, note)


def _add_comment(path: Path, note: str) -> None:
    """Write a text as the first line of a text file, as a comment."""
    content = path.read_bytes()
    with atomic_write(path) as file:
        file.write(f"# {' '.join(note.split())}\n".encode() + content)


def check_complete(model: Any, folder: Path, form: Form) -> None:
    """Raise OSError unless the files of a model have all bytes, or all lines."""
    if form != "text":
        for name, size in _file_sizes(model).items():
            _require_complete((folder / name).stat().st_size == size, folder / name)
    if form != "binary":
        for name, count in _line_counts(model).items():
            _require_complete(_count_lines(folder / name) == count, folder / name)


def _require_complete(is_complete: bool, path: Path) -> None:
    if not is_complete:
        raise OSError(f"{path} was not written to its end: is the disk full?")


def _file_sizes(model: Any) -> dict[str, int]:
    """Return the lengths of the binary files, bytes. Each begins with a count of 8 bytes."""
    images = sum(
        4 + 56 + 4 + len(image.name) + 1 + 8 + 24 * image.num_points2D()
        for image in model.images.values()
    )
    points = sum(51 + 8 * point.track.length() for point in model.points3D.values())
    return {
        "cameras.bin": 8 + 24 + 8 * 4,
        "rigs.bin": 8 + 16,
        "frames.bin": 8 + 84 * model.num_images(),
        "images.bin": 8 + images,
        "points3D.bin": 8 + points,
    }


def _line_counts(model: Any) -> dict[str, int]:
    """Return the numbers of lines of the text files, without comments."""
    images = model.num_images()
    return {
        "cameras.txt": 1,
        "rigs.txt": 1,
        "frames.txt": images,
        "images.txt": 2 * images,
        "points3D.txt": model.num_points3D(),
    }


def _count_lines(path: Path) -> int:
    """Return the number of complete lines of a text file, without comments."""
    with path.open("rb") as file:
        return sum(line.endswith(b"\n") and not line.startswith(b"#") for line in file)
