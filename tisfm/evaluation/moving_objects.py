"""Labels and paths of the moving objects of a reconstruction, compared with the truth."""

import os
from collections.abc import Iterator, Mapping, Sequence
from itertools import tee
from pathlib import Path

import numpy as np
from rich.table import Table
from rich.text import Text

from tisfm.camera_file import FILE_NAME as CAMERA
from tisfm.camera_file import read_camera
from tisfm.checks import check_whole_numbers
from tisfm.errors import InputError
from tisfm.formats import IMAGE_SUFFIXES, FormatError
from tisfm.formats.image_names import sort_by_name
from tisfm.formats.label_picture import read_label_picture
from tisfm.formats.reading import read_json
from tisfm.lens import Undistortion
from tisfm.metrics import LabelScores, ObjectPathErrors, label_scores, object_path_errors
from tisfm.reconstruction.result.folder import OBJECTS
from tisfm.reconstruction.result.moving_object import MovingObject
from tisfm.reconstruction.result.reconstruction import Reconstruction
from tisfm.trajectory import read_trajectory

MASK_FOLDER = "masks"
_EMPTY_CELL = "–"  # cell without a value


def compare_masks(
    result: str | os.PathLike[str], truth: str | os.PathLike[str], *, step: int = 1
) -> LabelScores:
    """Compare the labels of a saved reconstruction with the true masks of a sequence.

    Parameters
    ----------
    result : path
        Folder of a reconstruction with moving objects: its ``masks`` has a picture of labels for
        every frame, 0 for the static scene.
    truth : path
        Folder of true masks, or its parent with a folder ``masks``, as in DAVIS: a picture for
        every frame, in the order of names, 0 for the static scene, and a value for each object.
    step : int, default 1
        Step of the reconstructed frames in the true masks.

    Returns
    -------
    LabelScores
        If the frames of the result were undistorted, the true masks are undistorted as well. Pixels
        outside the undistorted image then count as static in both.

    Raises
    ------
    FileNotFoundError
        If a folder does not exist, or has no pictures.
    ValueError
        If numbers or sizes of masks differ, if no true mask has an object, or if `step` is not a
        positive whole number.
    tisfm.formats.FormatError
        If a picture is damaged, or is not a picture of labels.

    See Also
    --------
    tisfm.metrics.label_scores : definition of the scores.

    Examples
    --------
    >>> from tisfm.evaluation import compare_masks
    >>> compare_masks("bodies", "bodies/masks").iou  # with itself
    1.0
    """
    check_whole_numbers(1, step=step)
    true_files = _find_pictures(find_true_masks(truth))[::step]
    folder = Path(result)
    if not folder.is_dir():
        raise FileNotFoundError(f"there is no folder {folder}: check the path")
    if not (folder / MASK_FOLDER).is_dir():
        raise FileNotFoundError(
            f"{folder} has no folder {MASK_FOLDER}: reconstruct with --motion objects, which saves "
            "the labels of every frame there"
        )
    files = _find_pictures(folder / MASK_FOLDER)
    if len(files) != len(true_files):
        raise InputError(
            f"{folder} has masks of {len(files)} frames, but there are {len(true_files)} true "
            f"masks at a step of {step}: expected one for each frame that was reconstructed"
        )
    pairs = _read_label_pairs(folder, files, true_files)
    pairs0, pairs1 = tee(pairs)
    return label_scores(
        (labels for labels, _ in pairs0), (true_labels for _, true_labels in pairs1)
    )


def _read_label_pairs(
    folder: Path, files: Sequence[Path], true_files: Sequence[Path]
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield labels and true labels of each frame, (H, W), both without distortion."""
    lens = None
    for file, true_file in zip(files, true_files, strict=True):
        labels, true_labels = read_label_picture(file), read_label_picture(true_file)
        if (folder / CAMERA).is_file() and labels.shape == true_labels.shape:
            camera = read_camera(folder, true_labels.shape)
            if not camera.is_pinhole:
                lens = lens or Undistortion(camera, *true_labels.shape)
                undistorted = np.nan_to_num(lens.apply_nearest(np.float32(true_labels))).astype(
                    true_labels.dtype
                )
                labels, true_labels = (
                    np.where(lens.valid, values, 0) for values in (labels, undistorted)
                )
        yield labels, true_labels


def find_true_masks(folder: str | os.PathLike[str]) -> Path:
    """Return the folder of the masks of a sequence: ``masks`` in a folder, or the folder itself.

    Raises FileNotFoundError if the folder does not exist.
    """
    path = Path(folder)
    if not path.is_dir():
        raise FileNotFoundError(f"there is no folder {path}: check the path")
    return path / MASK_FOLDER if (path / MASK_FOLDER).is_dir() else path


def mask_table(name: str, scores: LabelScores) -> Table:
    """Return a table of the scores of a sequence: a row for each object, and the mean."""
    table = Table(
        title=f"Moving objects of {name} against the true masks",
        caption="IoU: intersection over union with the label matched to the object in all frames, "
        "mean over the frames in which the object or the label is present. followed: frames in "
        "which a label has an IoU of 0.5 or more with the object. switches: changes of that label.",
    )
    table.add_column("object", overflow="fold")
    for heading in ("label", "IoU", "frames", "followed", "switches"):
        table.add_column(heading, justify="right", no_wrap=True)
    for object_scores in scores.objects:
        table.add_row(
            Text(str(object_scores.object_id)),
            _EMPTY_CELL if object_scores.label is None else str(object_scores.label),
            f"{object_scores.iou:.3f}",
            str(object_scores.frames),
            f"{object_scores.followed} of {object_scores.present}",
            str(object_scores.switches),
        )
    if len(scores.objects) > 1:
        present, followed = (
            sum(getattr(object_scores, key) for object_scores in scores.objects)
            for key in ("present", "followed")
        )
        row = (f"{scores.iou:.3f}", "", f"{followed} of {present}", str(scores.switches))
        table.add_row("all", "", *row)
    return table


def _find_pictures(folder: Path) -> Sequence[Path]:
    files = [
        file
        for file in folder.iterdir()
        if file.suffix.lower() in IMAGE_SUFFIXES and not file.name.startswith(".")
    ]
    if not files:
        raise FileNotFoundError(
            f"the folder {folder} has no pictures: expected a mask for every frame"
        )
    return sort_by_name(files)


POSE_FILE = "poses.txt"


def has_true_paths(folder: Path) -> bool:
    """Return whether a folder has the true paths of objects and of the camera."""
    return (folder / OBJECTS).is_file() and (folder / POSE_FILE).is_file()


def compare_object_paths(
    result: Path,  # folder of the reconstruction
    # folder with ``objects.json`` of the true objects, in the format of a reconstruction, and
    # ``poses.txt`` of the camera: rows of (R | t) from camera to world, for every frame
    truth: Path,
    labels: Mapping[int, int],  # ids of the objects of the reconstruction, by true ids
    *,
    step: int = 1,  # step of the reconstructed frames in the truth
) -> dict[int, ObjectPathErrors]:  # by true id, for objects with a path of three frames or more
    """Compare the paths of the moving objects of a reconstruction with the true paths.

    Raises ValueError if the numbers of frames differ.

    Raises tisfm.formats.FormatError if a file is damaged.
    """
    reconstruction = Reconstruction.load(result)
    cameras = read_trajectory(truth / POSE_FILE).poses[::step]
    if len(cameras) != len(reconstruction):
        raise InputError(
            f"{truth / POSE_FILE} has {len(cameras)} frames at a step of {step}, but {result} has "
            f"{len(reconstruction)}: expected the same number"
        )
    try:
        record = read_json(truth / OBJECTS)
        true_objects = {
            moving_object.id: moving_object
            for moving_object in map(MovingObject.from_json, record["objects"])
        }
    except FormatError:
        raise
    except (ValueError, LookupError, TypeError, AttributeError, ArithmeticError) as error:
        raise FormatError(f"{truth / OBJECTS} is damaged or of another kind: {error}") from error
    objects = {moving_object.id: moving_object for moving_object in reconstruction.objects}
    errors = {}
    for true_id, label in labels.items():
        if true_id not in true_objects or label not in objects:
            continue
        object_errors = object_path_errors(
            _poses_by_frame(objects[label], len(reconstruction)),
            _poses_by_frame(true_objects[true_id], len(reconstruction), step),
            reconstruction.poses,
            cameras,
        )
        if object_errors is not None:
            errors[true_id] = object_errors
    return errors


def object_path_table(name: str, errors: Mapping[int, ObjectPathErrors]) -> Table:
    """Return a table of the errors of paths: a row for each object."""
    table = Table(
        title=f"Paths of the moving objects of {name} against the true paths",
        caption="position: root mean square distance from the true path, with the world aligned by "
        "the path of the camera, and scale and origin of the object fitted; share: position over "
        "the length of the true path. rotation: angle between the axes, degrees.",
    )
    for heading in ("object", "frames", "position", "share", "rotation"):
        table.add_column(heading, justify="right", no_wrap=True)
    for true_id, error in errors.items():
        share = "–" if error.share is None else f"{100 * error.share:.2f} %"
        row = (f"{error.position:.4g}", share, f"{error.rotation:.2f}°")
        table.add_row(str(true_id), str(error.frames), *row)
    return table


def _poses_by_frame(moving_object: MovingObject, count: int, step: int = 1) -> np.ndarray:
    """Return the poses of an object in every n-th frame, (N, 4, 4); NaN for no pose."""
    poses = np.full((count, 4, 4), np.nan)
    for frame, pose in zip(moving_object.frames, moving_object.poses, strict=True):
        if frame % step == 0 and frame // step < count:
            poses[frame // step] = pose
    return poses
