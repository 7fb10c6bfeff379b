"""How well the labels of moving things agree with their true masks over a sequence."""

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import zip_longest

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tisfm.checks import unmasked
from tisfm.errors import InputError, InputTypeError

_VALUES = 256  # of labels, from 0


@dataclass(frozen=True, kw_only=True)
class ThingScores:
    """How well one thing was labelled.

    Attributes
    ----------
    thing : int
        Its value in the true masks.
    label : int or None
        The label that is taken for it throughout; None if none is left that ever overlaps it.
    iou : float
        Mean over frames of the intersection over union of both, in [0, 1]; 0 without a label.
    frames : int
        Frames of that mean: where the thing is there, or its label is.
    there, followed : int
        Frames where the thing is there, and those of them where some label overlaps it enough.
    switches : int
        How often the label that overlaps it enough became another one.

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.metrics import label_scores
    >>> truth = np.zeros((2, 4, 4), np.uint8)
    >>> truth[:, :2] = 1
    >>> (thing,) = label_scores(7 * truth, truth).things
    >>> thing.thing, thing.label, thing.followed
    (1, 7, 2)
    """

    thing: int
    label: int | None
    iou: float
    frames: int
    there: int
    followed: int
    switches: int


@dataclass(frozen=True, kw_only=True)
class LabelScores:
    """How well the things of a sequence were labelled.

    Attributes
    ----------
    things : tuple of ThingScores
        In the order of their values.
    frames : int
        Frames that were compared.

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.metrics import label_scores
    >>> truth = np.zeros((2, 4, 4), np.uint8)
    >>> truth[:, :2] = 1
    >>> scores = label_scores(truth, truth)
    >>> len(scores.things), scores.frames
    (1, 2)
    """

    things: tuple[ThingScores, ...]
    frames: int

    @property
    def iou(self) -> float:
        """Mean over the things of their intersection over union, in [0, 1]."""
        return float(np.mean([thing.iou for thing in self.things]))

    @property
    def switches(self) -> int:
        """Switches of all things."""
        return sum(thing.switches for thing in self.things)


def label_scores(
    labels: Iterable[ArrayLike], truth: Iterable[ArrayLike], *, least: float = 0.5
) -> LabelScores:
    """Compare the labels of a sequence with the true masks of moving things.

    Each thing has one label for the whole sequence, and each label one thing at most: of all such
    choices the one with the greatest sum of intersections over unions. What a thing loses when its
    label changes on the way is lost.

    Parameters
    ----------
    labels, truth : iterable of array_like, shape (H, W)
        For each frame the label and the true thing of each pixel, whole numbers from 0 to 255, or
        booleans; 0 is what rests. Both are read once, frame by frame, in step.
    least : float, default 0.5
        Intersection over union from which a label follows a thing in a frame. Of several such
        labels, possible below 0.5, it is the one that covers most of the thing.

    Returns
    -------
    LabelScores

    Raises
    ------
    TypeError
        If values are not whole numbers or booleans.
    ValueError
        If there are not as many of both, sizes differ, a value is masked or not from 0 to 255, no
        frame of the truth has a thing, or `least` is not in (0, 1].

    Notes
    -----
    The mean is over frames in which the thing or its label has pixels: a frame where both are
    missing tells nothing. Switches are those of the CLEAR MOT measures: frames in which nothing
    follows the thing, or in which it is hidden, are passed over, and another label after them than
    before them is a switch.

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
    >>> labels = 7 * truth  # the same thing under another number
    >>> scores = label_scores(labels, truth)
    >>> scores.iou, scores.switches
    (1.0, 0)
    """
    from scipy.optimize import linear_sum_assignment  # takes a while to load

    if not 0 < least <= 1:
        raise InputError(f"least is {least!r}: expected a number above 0, and 1 at most")
    pairs = _overlaps(labels, truth)
    (things, thing_of), (found, label_of) = (
        np.unique([pair[column] for pair in pairs], return_inverse=True) for column in (1, 2)
    )
    frames = 1 + max((pair[0] for pair in pairs), default=-1)
    shared = np.zeros((frames, len(things), len(found)), np.int64)
    shared[[pair[0] for pair in pairs], thing_of, label_of] = [pair[3] for pair in pairs]
    true_pixels, found_pixels = shared.sum(axis=2), shared.sum(axis=1)
    # Now without what rests, on either side: that is no thing and no label.
    is_thing, is_label = things > 0, found > 0
    things, found = things[is_thing], found[is_label]
    if not len(things):
        raise InputError(
            f"truth has no thing in any of {frames} frames: expected pixels other than 0"
        )
    shared = shared[:, is_thing][:, :, is_label]
    true_pixels, found_pixels = true_pixels[:, is_thing], found_pixels[:, is_label]
    union = true_pixels[:, :, None] + found_pixels[:, None] - shared
    overlap = shared / np.maximum(union, 1)
    counted = (union > 0).sum(axis=0)
    mean = overlap.sum(axis=0) / np.maximum(counted, 1)
    rows, columns = linear_sum_assignment(mean, maximize=True)
    of_thing = {row: column for row, column in zip(rows, columns, strict=True) if mean[row, column]}
    scores = []
    for row, thing in enumerate(things):
        there = true_pixels[:, row] > 0
        follows = _following(shared[:, row], overlap[:, row], least)
        kept = follows[follows >= 0]
        column = of_thing.get(row)
        scores.append(
            ThingScores(
                thing=int(thing),
                label=None if column is None else int(found[column]),
                iou=0.0 if column is None else float(mean[row, column]),
                frames=int(there.sum() if column is None else counted[row, column]),
                there=int(there.sum()),
                followed=len(kept),
                switches=int(np.count_nonzero(np.diff(kept))),
            )
        )
    return LabelScores(things=tuple(scores), frames=frames)


def _following(shared: NDArray, overlap: NDArray, least: float) -> NDArray[np.intp]:
    """Return which label follows a thing in each frame, -1 where none does; both (N, labels)."""
    if not shared.shape[1]:
        return np.full(len(shared), -1)
    enough = np.where(overlap >= least, shared, 0)
    return np.where(enough.any(axis=1), enough.argmax(axis=1), -1)


def _overlaps(
    labels: Iterable[ArrayLike], truth: Iterable[ArrayLike]
) -> list[tuple[int, int, int, int]]:
    """Return frame, thing, label and number of pixels, for all of which there are any."""
    counts = []
    missing = object()
    for number, (mine, true) in enumerate(zip_longest(labels, truth, fillvalue=missing)):
        if mine is missing or true is missing:
            short, more = ("labels", "truth") if mine is missing else ("truth", "labels")
            raise InputError(f"{short} has {number} frames, and {more} has more: expected as many")
        label = _whole_numbers(mine, f"labels[{number}]")
        thing = _whole_numbers(true, f"truth[{number}]")
        if label.shape != thing.shape:
            raise InputError(
                f"labels[{number}] is {label.shape} and truth[{number}] is {thing.shape}: expected "
                "the same size"
            )
        pixels = np.bincount(_VALUES * thing.ravel().astype(np.intp) + label.ravel())
        for pair in np.flatnonzero(pixels):
            counts.append((number, *divmod(int(pair), _VALUES), int(pixels[pair])))
    return counts


def _whole_numbers(values: object, name: str) -> NDArray:
    array = unmasked(values, name, advice=f"fill them first, for instance by {name}.filled(0)")  # type: ignore[arg-type]
    if array.dtype.kind not in "biu":
        raise InputTypeError(f"{name} is of type {array.dtype}: expected whole numbers")
    if array.ndim != 2:
        raise InputError(f"{name} is {array.shape}: expected (H, W)")
    if array.size and not 0 <= array.min() <= array.max() < _VALUES:
        raise InputError(
            f"{name} has values from {array.min()} to {array.max()}: expected 0 to {_VALUES - 1}"
        )
    return array
