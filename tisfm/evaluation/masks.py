"""Labels of a reconstruction against the true masks of moving things."""

import os
from collections.abc import Iterator, Sequence
from itertools import tee
from pathlib import Path

import numpy as np
from rich.table import Table
from rich.text import Text

from tisfm.camera_file import NAME as CAMERA
from tisfm.camera_file import read_camera
from tisfm.checks import whole
from tisfm.errors import InputError
from tisfm.formats import IMAGE_SUFFIXES
from tisfm.formats.image_names import sort_by_name
from tisfm.formats.label_picture import read_label_picture
from tisfm.lens import Undistortion
from tisfm.metrics import LabelScores, label_scores

MASKS = "masks"
_NOTHING = "–"


def compare_masks(
    result: str | os.PathLike[str], truth: str | os.PathLike[str], *, step: int = 1
) -> LabelScores:
    """Compare the labels that a reconstruction saved with the true masks of a sequence.

    Parameters
    ----------
    result : path
        Folder that a reconstruction of moving objects was saved in: its ``masks`` has a picture
        for every frame, whose values are labels, 0 for what rests.
    truth : path
        Folder of true masks, or one with such a folder ``masks``, as DAVIS has it: a picture for
        every frame, in the order of their names, 0 where nothing moves, and a value for each thing.
    step : int, default 1
        Every so many true masks are taken: those of the frames that were reconstructed.

    Returns
    -------
    LabelScores
        Where the result says that its frames had distortion, which it undid, that is done to the
        true masks as well, and what lies outside counts in neither.

    Raises
    ------
    FileNotFoundError
        If a folder does not exist, or has no pictures.
    ValueError
        If there are not as many masks as true ones, sizes differ, nothing moves in any of the true
        ones, or `step` is not a positive whole number.
    tisfm.formats.FormatError
        If a picture is damaged, or has no labels.

    See Also
    --------
    tisfm.metrics.label_scores : what the scores mean.

    Examples
    --------
    >>> from tisfm.evaluation import compare_masks
    >>> compare_masks("bodies", "bodies/masks").iou  # with itself
    1.0
    """
    whole(1, step=step)
    true_files = _pictures(true_masks(truth))[::step]
    folder = Path(result)
    if not folder.is_dir():
        raise FileNotFoundError(f"there is no folder {folder}: check the path")
    if not (folder / MASKS).is_dir():
        raise FileNotFoundError(
            f"{folder} has no folder {MASKS}: reconstruct with --motion objects, and every frame's "
            "labels are saved there"
        )
    files = _pictures(folder / MASKS)
    if len(files) != len(true_files):
        raise InputError(
            f"{folder} has masks of {len(files)} frames, but there are {len(true_files)} true ones "
            f"at a step of {step}: expected one for each frame that was reconstructed"
        )
    pairs = _in_one_grid(folder, files, true_files)
    found, true = tee(pairs)
    return label_scores((one for one, _ in found), (one for _, one in true))


def _in_one_grid(
    folder: Path, files: Sequence[Path], true_files: Sequence[Path]
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield labels and true ones, (H, W) each: where distortion is undone, in both of them."""
    lens = None
    for file, true_file in zip(files, true_files, strict=True):
        labels, true = read_label_picture(file), read_label_picture(true_file)
        if (folder / CAMERA).is_file() and labels.shape == true.shape:
            camera = read_camera(folder, true.shape)
            if not camera.is_pinhole:
                lens = lens or Undistortion(camera, *true.shape)
                seen = np.nan_to_num(lens.nearest(np.float32(true))).astype(true.dtype)
                labels, true = (np.where(lens.valid, one, 0) for one in (labels, seen))
        yield labels, true


def true_masks(folder: str | os.PathLike[str]) -> Path:
    """Return where the masks of a sequence lie: in ``masks`` of a folder, or in itself.

    Raises
    ------
    FileNotFoundError
        If there is no such folder.
    """
    path = Path(folder)
    if not path.is_dir():
        raise FileNotFoundError(f"there is no folder {path}: check the path")
    return path / MASKS if (path / MASKS).is_dir() else path


def mask_table(name: str, scores: LabelScores) -> Table:
    """Lay out the scores of a sequence: a row for each thing, and their mean."""
    table = Table(
        title=f"Moving things of {name} against the true masks",
        caption="IoU: intersection over union with the one label that stands for the thing "
        "throughout, mean over the frames where either is. followed: frames in which some label "
        "has an IoU of 0.5 or more with it. switches: how often that label became another.",
    )
    table.add_column("thing", overflow="fold")
    for heading in ("label", "IoU", "frames", "followed", "switches"):
        table.add_column(heading, justify="right", no_wrap=True)
    for thing in scores.things:
        table.add_row(
            Text(str(thing.thing)),
            _NOTHING if thing.label is None else str(thing.label),
            f"{thing.iou:.3f}",
            str(thing.frames),
            f"{thing.followed} of {thing.there}",
            str(thing.switches),
        )
    if len(scores.things) > 1:
        there, followed = (
            sum(getattr(thing, key) for thing in scores.things) for key in ("there", "followed")
        )
        row = (f"{scores.iou:.3f}", "", f"{followed} of {there}", str(scores.switches))
        table.add_row("all", "", *row)
    return table


def _pictures(folder: Path) -> Sequence[Path]:
    files = [
        file
        for file in folder.iterdir()
        if file.suffix.lower() in IMAGE_SUFFIXES and not file.name.startswith(".")
    ]
    if not files:
        raise FileNotFoundError(f"the folder {folder} has no pictures: expected a mask for a frame")
    return sort_by_name(files)
