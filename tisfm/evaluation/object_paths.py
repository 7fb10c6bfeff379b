"""Paths of moving things of a reconstruction against true ones."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from rich.table import Table

from tisfm.errors import InputError
from tisfm.formats import FormatError
from tisfm.formats.reading import read_json
from tisfm.metrics import ObjectPathErrors, object_path_errors
from tisfm.reconstruction.result.folder import OBJECTS
from tisfm.reconstruction.result.moving_object import MovingObject
from tisfm.reconstruction.result.reconstruction import Reconstruction
from tisfm.trajectory import read_trajectory

POSES = "poses.txt"


def has_true_paths(folder: Path) -> bool:
    """Return whether a folder tells the true paths of things and of the camera."""
    return (folder / OBJECTS).is_file() and (folder / POSES).is_file()


def compare_object_paths(
    result: Path, truth: Path, labels: Mapping[int, int], *, step: int = 1
) -> dict[int, ObjectPathErrors]:
    """Compare the paths of things that a reconstruction found with true ones.

    Parameters
    ----------
    result : Path
        Folder of the reconstruction.
    truth : Path
        Folder with ``objects.json`` of the true things, as a reconstruction writes it, and
        ``poses.txt`` of the camera, rows of (R | t) from camera to world, for every frame.
    labels : mapping of int to int
        The ids of the things that were found, by those of the true ones.
    step : int, default 1
        Every so many frames of the truth were reconstructed.

    Returns
    -------
    dict of int to ObjectPathErrors
        By true things, of those that have a path in three frames and more.

    Raises
    ------
    ValueError
        If there are not as many frames as true ones.
    tisfm.formats.FormatError
        If a file is damaged.
    """
    found = Reconstruction.load(result)
    cameras = read_trajectory(truth / POSES).poses[::step]
    if len(cameras) != len(found):
        raise InputError(
            f"{truth / POSES} has {len(cameras)} frames at a step of {step}, but {result} has "
            f"{len(found)}: expected as many"
        )
    try:
        record = read_json(truth / OBJECTS)
        things = {thing.id: thing for thing in map(MovingObject.of_json, record["objects"])}
    except FormatError:
        raise
    except (ValueError, LookupError, TypeError, AttributeError, ArithmeticError) as error:
        raise FormatError(f"{truth / OBJECTS} is damaged or of another kind: {error}") from error
    own = {thing.id: thing for thing in found.objects}
    errors = {}
    for number, label in labels.items():
        if number not in things or label not in own:
            continue
        both = object_path_errors(
            _by_frame(own[label], len(found)),
            _by_frame(things[number], len(found), step),
            found.poses,
            cameras,
        )
        if both is not None:
            errors[number] = both
    return errors


def object_path_table(name: str, errors: Mapping[int, ObjectPathErrors]) -> Table:
    """Lay out the errors of paths: a row for each thing."""
    table = Table(
        title=f"Paths of the moving things of {name} against the true ones",
        caption="position: root mean square distance from the true path, the world aligned by the "
        "camera's path, the thing's scale and the place of its origin fitted; share: of the true "
        "path's length. rotation: of its axes, degrees.",
    )
    for heading in ("thing", "frames", "position", "share", "rotation"):
        table.add_column(heading, justify="right", no_wrap=True)
    for number, error in errors.items():
        share = "–" if error.share is None else f"{100 * error.share:.2f} %"
        row = (f"{error.position:.4g}", share, f"{error.rotation:.2f}°")
        table.add_row(str(number), str(error.frames), *row)
    return table


def _by_frame(thing: MovingObject, count: int, step: int = 1) -> np.ndarray:
    """Return the poses of a thing in frames, (N, 4, 4), every so many of which are taken."""
    poses = np.full((count, 4, 4), np.nan)
    for frame, pose in zip(thing.frames, thing.poses, strict=True):
        if frame % step == 0 and frame // step < count:
            poses[frame // step] = pose
    return poses
