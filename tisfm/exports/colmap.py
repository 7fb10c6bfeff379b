"""A reconstruction as a model of COLMAP, with points and tracks measured in the frames."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from os import PathLike
from typing import Any, get_args

import numpy as np

from tisfm.errors import InputError
from tisfm.exports.colmap_files import Form, write_model
from tisfm.exports.folders import IMAGES, MASKS, MODELS, renewed_export
from tisfm.exports.frame_files import (
    Images,
    check_images,
    has_masks,
    name_of,
    write_masks,
    write_pictures,
)
from tisfm.exports.tracks import Tracks, cells_of, measured_tracks
from tisfm.reconstruction.mapping.colmap import pycolmap
from tisfm.reconstruction.mapping.database import PIXEL_CENTRE, colmap_camera
from tisfm.reconstruction.result.reconstruction import Reconstruction

CAMERA = 1  # the number of the one camera
FEWEST_FRAMES = 2  # of a piece that is a model


@dataclass(frozen=True, kw_only=True)
class ExportedModel:
    """What was written of one piece.

    Attributes
    ----------
    name : str
        Where, in the folder.
    piece : int
        Of the reconstruction.
    images, points, observations : int
    error : float or None
        Median distance from where a point was measured to where pose and position say, px; None
        without points.

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

    ``sparse/0`` is the model of the piece of most frames, ``sparse/1`` of the next, as each has a
    scale of its own. Frames without a pose, and pieces of a single frame, have no place in it. A
    point begins at a corner of a keyframe; its positions in other frames are measured in the
    images, to a fraction of a pixel, and it lies nearest to all of them. The camera is a
    ``PINHOLE``, as the frames are without distortion; image n + 1 is frame n of the reconstruction.

    With ``motion="objects"``, ``masks/`` has the masks that COLMAP takes, black where something
    moves on its own, and nothing there has a point.

    Parameters
    ----------
    reconstruction : Reconstruction
    folder : path
        A new or empty folder, or one with an earlier export, which is replaced when all is written.
    form : {"binary", "text", "both"}
        Of the models.
    images : {"copy", "link", "none"}
        Whether ``images/`` has copies of the frames or hard links to them, or is left out.
    spacing : float, optional
        Between points that are begun in a frame, px; by default 1/80 of the longer side.
    progress : callable, optional
        Called with the number of frames that are done, and of those there are.

    Returns
    -------
    tuple of ExportedModel
        What was written.

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
    cells_of(reconstruction.shape, spacing)
    pieces = pieces_of(reconstruction)
    about: dict[str, Any] = {"kind": "colmap", "version": reconstruction.version}
    with renewed_export(folder, about) as new:
        written: list[ExportedModel] = []
        total = sum(map(len, pieces.values()))
        for number, (piece, frames) in enumerate(pieces.items()):
            before = sum(model.images for model in written)
            tracks = measured_tracks(
                reconstruction,
                piece,
                spacing=spacing,
                progress=_shifted(progress, before, total),
            )
            name = f"{MODELS}/{number}"
            write_model(_model(reconstruction, frames, tracks), new / name, form)
            written.append(account(name, piece, frames, tracks))
        posed = sorted(frame for frames in pieces.values() for frame in frames)
        if images != "none":
            write_pictures(reconstruction, posed, new / IMAGES, images)
        if has_masks(reconstruction):
            write_masks(reconstruction, posed, new / MASKS, ".jpg.png")
        about["models"] = [asdict(model) for model in written]
    return tuple(written)


def pieces_of(result: Reconstruction) -> dict[int, list[int]]:
    """Return the frames of every piece that has several, the piece of most frames first.

    Raises
    ------
    ValueError
        If there is none.
    """
    frames = {k: np.flatnonzero(result.piece == k).tolist() for k in range(len(result.unit))}
    several = {k: few for k, few in frames.items() if len(few) >= FEWEST_FRAMES}
    if not several:
        raise InputError(
            f"no two of the {len(result)} frames have poses in one scale: there is nothing to "
            "export; the statuses of the frames say why"
        )
    return dict(sorted(several.items(), key=lambda item: -len(item[1])))


def account(name: str, piece: int, frames: Sequence[int], tracks: Tracks) -> ExportedModel:
    """Return what was written of a piece."""
    return ExportedModel(
        name=name,
        piece=piece,
        images=len(frames),
        points=len(tracks),
        observations=len(tracks.places),
        error=float(np.median(tracks.residual)) if len(tracks) else None,
    )


def _model(result: Reconstruction, frames: Sequence[int], tracks: Tracks) -> Any:
    """Return pycolmap's reconstruction of one piece."""
    colmap = pycolmap()
    model = colmap.Reconstruction()
    model.add_camera_with_trivial_rig(colmap_camera(result.camera, result.shape))
    order = np.argsort(tracks.frames, kind="stable")
    bounds = np.searchsorted(tracks.frames[order], [*frames, len(result)])
    number_in_frame = np.empty(len(order), np.int64)
    for frame, (first, last) in zip(frames, pairwise(bounds.tolist()), strict=True):
        mine = order[first:last]
        number_in_frame[mine] = np.arange(len(mine))
        image = colmap.Image(
            name=name_of(frame),
            keypoints=tracks.places[mine] + PIXEL_CENTRE,
            camera_id=CAMERA,
            image_id=frame + 1,
        )
        pose = colmap.Rigid3d(np.linalg.inv(result.poses[frame])[:3])
        model.add_image_with_trivial_frame(image, pose)
    ends = np.searchsorted(tracks.points, np.arange(len(tracks) + 1))
    images, numbers = (tracks.frames + 1).tolist(), number_in_frame.tolist()
    for point, (first, last) in enumerate(pairwise(ends.tolist())):
        seen = zip(images[first:last], numbers[first:last], strict=True)
        track = colmap.Track([colmap.TrackElement(image, number) for image, number in seen])
        model.add_point3D(tracks.positions[point], track, tracks.colors[point])
    model.update_point_3d_errors()
    return model


def _shifted(
    progress: Callable[[int, int], None] | None, before: int, total: int
) -> Callable[[int, int], None] | None:
    """Return what tells the progress of one piece as that of all."""
    if progress is None:
        return None
    return lambda done, _: progress(before + done, total)
