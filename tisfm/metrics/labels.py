"""Agreement of the labels of moving objects with their true masks over a sequence."""

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import zip_longest

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tisfm.checks import check_unmasked
from tisfm.errors import InputError, InputTypeError

_LABEL_COUNT = 256  # labels are from 0 to 255


@dataclass(frozen=True, kw_only=True)
class ObjectScores:
    """Scores of one moving object.

    Attributes
    ----------
    object_id : int
        Value of the object in the true masks.
    label : int or None
        Label that is assigned to the object for the whole sequence; None if no label
        overlaps it, or these labels are assigned to other objects.
    iou : float
        Mean over frames of the intersection over union of object and label, in [0, 1]; 0 without a
        label.
    frames : int
        Number of frames in that mean, in which the object or its label has pixels.
    present, followed : int
        Number of frames in which the object has pixels, and number of these in which a label
        follows it.
    switches : int
        Changes of the label that follows the object.

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.metrics import label_scores
    >>> truth = np.zeros((2, 4, 4), np.uint8)
    >>> truth[:, :2] = 1
    >>> (scores,) = label_scores(7 * truth, truth).objects
    >>> scores.object_id, scores.label, scores.followed
    (1, 7, 2)
    """

    object_id: int
    label: int | None
    iou: float
    frames: int
    present: int
    followed: int
    switches: int


@dataclass(frozen=True, kw_only=True)
class LabelScores:
    """Scores of the moving objects of a sequence.

    Attributes
    ----------
    objects : tuple of ObjectScores
        Scores in the order of the object ids.
    frames : int
        Number of frames that were compared.

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.metrics import label_scores
    >>> truth = np.zeros((2, 4, 4), np.uint8)
    >>> truth[:, :2] = 1
    >>> scores = label_scores(truth, truth)
    >>> len(scores.objects), scores.frames
    (1, 2)
    """

    objects: tuple[ObjectScores, ...]
    frames: int

    @property
    def iou(self) -> float:
        """Mean intersection over union of the objects, in [0, 1]."""
        return float(np.mean([scores.iou for scores in self.objects]))

    @property
    def switches(self) -> int:
        """Number of switches of all objects."""
        return sum(scores.switches for scores in self.objects)


def label_scores(
    labels: Iterable[ArrayLike], truth: Iterable[ArrayLike], *, least: float = 0.5
) -> LabelScores:
    """Compare the labels of a sequence with the true masks of moving objects.

    Each object is assigned one label for the whole sequence, and each label at most one object. Of
    all such assignments, the one with the greatest sum of mean intersections over unions is used.
    If the label of an object changes, the frames with the other label count as not labelled.

    Parameters
    ----------
    labels, truth : iterable of array_like, shape (H, W)
        For each frame the label and the true object id of each pixel, integers from 0 to 255, or
        booleans; 0 is the static background. Both are read once, frame by frame.
    least : float, default 0.5
        Intersection over union from which a label follows an object in a frame. Of several such
        labels, possible below 0.5, the label that covers most of the object follows it.

    Returns
    -------
    LabelScores

    Raises
    ------
    TypeError
        If values are not integers or booleans.
    ValueError
        If labels and truth differ in number or size, a value is masked or not from 0 to 255, the
        truth has no object, or `least` is not in (0, 1].

    Notes
    -----
    The mean is over frames in which the object or its label has pixels. Switches are defined as in
    the CLEAR MOT measures: frames in which no label follows the object are skipped, and a different
    label after them is a switch.

    References
    ----------
    Perazzi et al., A benchmark dataset and evaluation methodology for video object segmentation,
    CVPR 2016, doi 10.1109/CVPR.2016.85: the region similarity. Bernardin and Stiefelhagen,
    Evaluating multiple object tracking performance: the CLEAR MOT metrics, EURASIP Journal on
    Image and Video Processing 2008, doi 10.1155/2008/246309: mismatches.

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.metrics import label_scores
    >>> truth = np.zeros((2, 4, 4), np.uint8)
    >>> truth[:, :2] = 1
    >>> labels = 7 * truth  # the same object with another number
    >>> scores = label_scores(labels, truth)
    >>> scores.iou, scores.switches
    (1.0, 0)
    """
    from scipy.optimize import linear_sum_assignment  # slow to import

    if not 0 < least <= 1:
        raise InputError(f"least is {least!r}: expected a number above 0, and 1 at most")
    pairs = _overlaps(labels, truth)
    (ids, id_index), (label_ids, label_index) = (
        np.unique([pair[column] for pair in pairs], return_inverse=True) for column in (1, 2)
    )
    frames = 1 + max((pair[0] for pair in pairs), default=-1)
    shared_pixels = np.zeros((frames, len(ids), len(label_ids)), np.int64)
    shared_pixels[[pair[0] for pair in pairs], id_index, label_index] = [pair[3] for pair in pairs]
    true_pixels, label_pixels = shared_pixels.sum(axis=2), shared_pixels.sum(axis=1)
    # From here on without the background, which is neither an object nor a label.
    is_object, is_label = ids > 0, label_ids > 0
    ids, label_ids = ids[is_object], label_ids[is_label]
    if not len(ids):
        raise InputError(
            f"truth has no object in any of {frames} frames: expected pixels other than 0"
        )
    shared_pixels = shared_pixels[:, is_object][:, :, is_label]
    true_pixels, label_pixels = true_pixels[:, is_object], label_pixels[:, is_label]
    union = true_pixels[:, :, None] + label_pixels[:, None] - shared_pixels
    overlap = shared_pixels / np.maximum(union, 1)
    frame_counts = (union > 0).sum(axis=0)
    mean_overlap = overlap.sum(axis=0) / np.maximum(frame_counts, 1)
    rows, columns = linear_sum_assignment(mean_overlap, maximize=True)
    column_of_row = {
        row: column for row, column in zip(rows, columns, strict=True) if mean_overlap[row, column]
    }
    scores = []
    for row, object_id in enumerate(ids):
        is_present = true_pixels[:, row] > 0
        followers = _followers(shared_pixels[:, row], overlap[:, row], least)
        followers = followers[followers >= 0]
        column = column_of_row.get(row)
        scores.append(
            ObjectScores(
                object_id=int(object_id),
                label=None if column is None else int(label_ids[column]),
                iou=0.0 if column is None else float(mean_overlap[row, column]),
                frames=int(is_present.sum() if column is None else frame_counts[row, column]),
                present=int(is_present.sum()),
                followed=len(followers),
                switches=int(np.count_nonzero(np.diff(followers))),
            )
        )
    return LabelScores(objects=tuple(scores), frames=frames)


def _followers(shared_pixels: NDArray, overlap: NDArray, min_overlap: float) -> NDArray[np.intp]:
    """Return the index of the label that follows an object in each frame, -1 without one.

    `shared_pixels` and `overlap`, intersections over unions, are (N frames, labels).
    """
    if not shared_pixels.shape[1]:
        return np.full(len(shared_pixels), -1)
    overlapping_pixels = np.where(overlap >= min_overlap, shared_pixels, 0)
    return np.where(overlapping_pixels.any(axis=1), overlapping_pixels.argmax(axis=1), -1)


def _overlaps(
    labels: Iterable[ArrayLike], truth: Iterable[ArrayLike]
) -> list[tuple[int, int, int, int]]:
    """Return (frame, object id, label, number of pixels) for each combination with pixels."""
    overlaps = []
    end = object()
    for number, (frame_labels, frame_truth) in enumerate(zip_longest(labels, truth, fillvalue=end)):
        if frame_labels is end or frame_truth is end:
            shorter, longer = ("labels", "truth") if frame_labels is end else ("truth", "labels")
            raise InputError(
                f"{shorter} has {number} frames, and {longer} has more: expected the same number"
            )
        label = _check_labels(frame_labels, f"labels[{number}]")
        ids = _check_labels(frame_truth, f"truth[{number}]")
        if label.shape != ids.shape:
            raise InputError(
                f"labels[{number}] is {label.shape} and truth[{number}] is {ids.shape}: expected "
                "the same size"
            )
        pixels = np.bincount(_LABEL_COUNT * ids.ravel().astype(np.intp) + label.ravel())
        for pair in np.flatnonzero(pixels):
            overlaps.append((number, *divmod(int(pair), _LABEL_COUNT), int(pixels[pair])))
    return overlaps


def _check_labels(values: object, name: str) -> NDArray:
    advice = f"fill them first, for instance by {name}.filled(0)"
    array = check_unmasked(values, name, advice=advice)  # type: ignore[arg-type]
    if array.dtype.kind not in "biu":
        raise InputTypeError(f"{name} is of type {array.dtype}: expected whole numbers")
    if array.ndim != 2:
        raise InputError(f"{name} is {array.shape}: expected (H, W)")
    if array.size and not 0 <= array.min() <= array.max() < _LABEL_COUNT:
        raise InputError(
            f"{name} has values from {array.min()} to {array.max()}: expected 0 to "
            f"{_LABEL_COUNT - 1}"
        )
    return array
