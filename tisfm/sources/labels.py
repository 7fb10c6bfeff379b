"""Labels that are given: which thing each pixel of a frame belongs to, with a number for each."""

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from numpy.typing import NDArray

from tisfm.checks import unmasked
from tisfm.errors import InputError, InputTypeError
from tisfm.formats.label_picture import has_palette_of_labels, read_label_picture
from tisfm.sources.frame_reader import is_path, is_whole
from tisfm.sources.paths import several_pictures

VOID = 255  # a label of what belongs to nothing that is known, as DAVIS has it

GivenLabels = (
    str
    | os.PathLike[str]
    | npt.NDArray[Any]
    | Sequence[str | os.PathLike[str] | npt.ArrayLike | None]
    | Mapping[int, str | os.PathLike[str] | npt.ArrayLike]
    | Mapping[str, str | os.PathLike[str] | npt.ArrayLike]
    | Iterable[npt.ArrayLike | None]
)


class Labels:
    """The labels of a source: 0 is at rest, 1 to 254 a thing of this number, 255 is ignored.

    Parameters
    ----------
    labels : path, array, sequence, mapping, or iterable
        Pictures, whose values or indices of a palette are labels: a folder, a glob pattern, or a
        file. They belong to the frames that they are called like: ``a.png`` or ``a.jpg.png`` to
        ``a.jpg``, ``walk_000012.png`` to frame 12 of ``walk.mp4``; others have none. Where none is
        called like a frame, there has to be one for each, in order.
        Or a sequence, an (N, H, W) array of integers, or an iterable, of one for every frame of the
        source, None where a frame has none. Or a mapping from numbers or names of frames.
    names : sequence of str, optional
        Names of all frames, where they are known.
    frame_files : sequence of Path, optional
        Files of all frames, where they have such.
    prefix : str, optional
        What the names of frames begin with, where they are numbered.
    count : int, optional
        Number of frames, where it is known.

    Attributes
    ----------
    ahead : bool
        Whether labels may be read in another thread, before they are asked for.
    files : tuple of Path
        Files that labels are read from.

    Raises
    ------
    FileNotFoundError
        If a path does not exist or a pattern matches nothing.
    TypeError
        If the labels are none of these.
    ValueError
        If they are not of the frames.
    """

    def __init__(
        self,
        labels: GivenLabels,
        *,
        names: Sequence[str] | None = None,
        frame_files: Sequence[Path] = (),
        prefix: str = "",
        count: int | None = None,
    ) -> None:
        self._prefix, self._count = prefix, count
        self._numbers = {name: k for k, name in enumerate(names or ())}
        self._numbers |= {file.name: k for k, file in enumerate(frame_files)}
        self.ahead = True
        self._items: Mapping[int, Any] | Iterable[Any]
        if isinstance(labels, (str, os.PathLike)):
            self._items = self._of_pictures(
                several_pictures(os.fspath(labels), "picture or folder of labels")
            )
        elif isinstance(labels, Mapping):
            self._items = {self._number(key): item for key, item in labels.items()}
        elif isinstance(labels, np.ndarray) and labels.ndim != 3:
            raise InputError(
                f"labels is {labels.shape}: expected (N, H, W), with one for every frame; or, if "
                "the first frame alone has some, {0: labels}"
            )
        elif isinstance(labels, (Sequence, np.ndarray)):
            self._check_count(len(labels))
            self._items = dict(enumerate(labels))
        elif isinstance(labels, Iterable):
            self._items, self.ahead = labels, False
        else:
            raise InputTypeError(
                f"labels is {labels!r}: expected pictures, or an array for every frame"
            )
        known = self._items.values() if isinstance(self._items, Mapping) else ()
        self.files = tuple(Path(os.fspath(item)) for item in known if is_path(item))
        for file in self.files:
            if not file.exists():
                raise FileNotFoundError(f"there are no labels {file}: check the path")

    def in_turn(self) -> "LabelsInTurn":
        """Return what gives the frames their labels, from the first frame on."""
        return LabelsInTurn(self._items)

    def _of_pictures(self, files: Sequence[Path]) -> dict[int, Path]:
        """Return pictures by the numbers of the frames that they belong to."""
        called = {self._number_of(file.stem): file for file in files}
        called.pop(None, None)
        if called:
            return {number: file for number, file in called.items() if number is not None}
        self._check_count(len(files), "; none of them is called like a frame")
        return dict(enumerate(files))

    def _number(self, key: Any) -> int:
        """Return the number of the frame that a key of a mapping names."""
        if not is_whole(key) and not isinstance(key, str):
            raise InputTypeError(
                f"labels has the key {key!r}: expected the number or name of a frame"
            )
        number = int(key) if is_whole(key) else self._number_of(key)
        if number is None or number < 0 or (self._count is not None and number >= self._count):
            raise InputError(f"labels has some of frame {key!r}, but there is no such frame")
        return number

    def _number_of(self, name: str) -> int | None:
        """Return the number of the frame that is called so; None if there is none."""
        if self._numbers:
            return self._numbers.get(name)
        beginning, _, number = name.rpartition("_")
        return int(number) if beginning == self._prefix and number.isdecimal() else None

    def _check_count(self, count: int, more: str = "") -> None:
        if self._count is not None and count != self._count:
            raise InputError(
                f"labels has those of {count} frame{'s' * (count != 1)}, but there are "
                f"{self._count} frames{more}: expected one for every frame"
            )


class LabelsInTurn:
    """Gives frames their labels, in order."""

    def __init__(self, items: Mapping[int, Any] | Iterable[Any]) -> None:
        self._items = items if isinstance(items, Mapping) else iter(items)
        self._following = 0
        self._has_void = self._has_things = False

    def of(self, index: int, name: str, shapes: Sequence[tuple[int, ...]]) -> np.ndarray | None:
        """Return the labels of a frame of this number, (H, W) uint8; None if it has none.

        Parameters
        ----------
        index : int
        name : str
            What errors call the frame.
        shapes : sequence of tuple of int
            Those that it may have, (H, W[, 3]): of the frame as it is read, and as it is used.

        Raises
        ------
        OSError, tisfm.formats.FormatError
            If they cannot be read.
        TypeError, ValueError
            If they are none, or of another size.
        """
        item = self._item(index, name)
        if item is None:
            return None
        if is_path(item):
            title, labels = os.fspath(item), read_label_picture(item)
        else:
            title = f"labels of frame {name}"
            labels = checked_labels(item, title)
        sizes = list(dict.fromkeys(shape[:2] for shape in shapes))
        if labels.shape not in sizes:
            raise InputError(
                f"{title}: the size is {labels.shape}, but that of frame {name} is "
                f"{' or '.join(map(str, sizes))}: expected the same"
            )
        self._has_void |= bool((labels == VOID).any())
        self._has_things |= bool(((labels > 0) & (labels < VOID)).any())
        return labels

    def check(self) -> None:
        """Raise ValueError if the labels so far have pixels that are ignored, but no thing."""
        if self._has_void and not self._has_things:
            raise InputError(
                "labels are 0 or 255 everywhere, which is ignored: expected numbers from 1 to 254 "
                "for things"
            )

    def _item(self, index: int, name: str) -> Any:
        if isinstance(self._items, Mapping):
            return self._items.get(index)
        skipped, self._following = index - self._following, index + 1
        for item in islice(self._items, skipped, None):
            return item
        raise InputError(f"labels ended before frame {name}: expected None where a frame has none")


def checked_labels(values: Any, title: str) -> NDArray[np.uint8]:
    """Return the labels of a frame, (H, W) uint8, or raise TypeError or ValueError."""
    array = unmasked(values, title)
    if array.ndim == 3:
        raise InputError(
            f"{title} have the shape {array.shape}, as colours do: expected (H, W) of numbers; a "
            "picture with a palette has them as its indices"
        )
    if array.ndim != 2:
        raise InputError(f"{title} have the shape {array.shape}: expected (H, W)")
    if array.dtype.kind not in "biu":
        raise InputTypeError(
            f"{title} are of type {array.dtype}: expected whole numbers, 0 for what is at rest, "
            "and 1 to 254 for things"
        )
    if array.size and (array.min() < 0 or array.max() > VOID):
        raise InputError(
            f"{title} go from {array.min()} to {array.max()}: expected 0 for what is at rest, 1 to "
            "254 for things, and 255 for what is ignored"
        )
    return array.astype(np.uint8)


def holds_labels(mask: Any) -> bool:
    """Return whether a mask, as `tisfm.sources.masks.Masks` takes it, holds labels of things.

    It does if it is one for every frame, and either pictures with a palette of colours, as DAVIS
    has them, or arrays of integers in which there are several numbers from 1 to 254. All else says
    what counts.

    Raises
    ------
    ValueError
        If it can be read both ways: arrays of integers with a single number from 1 to 254.
    tisfm.formats.FormatError
        If a picture is damaged.
    """
    if isinstance(mask, (str, os.PathLike)):
        path = os.fspath(mask)
        return not os.path.isfile(path) and has_palette_of_labels(several_pictures(path, "mask")[0])
    if isinstance(mask, np.ndarray) and mask.ndim != 3:
        return False
    if not isinstance(mask, (Sequence, np.ndarray)) or not len(mask):
        return False
    if all(map(is_path, mask)):
        return has_palette_of_labels(mask[0])
    numbers: set[int] = set()
    for one in mask:
        numbers |= _numbers_in(one)
    if len(numbers) == 1:
        raise InputError(
            f"mask has one number for every pixel that is not 0, {numbers.pop()}: give booleans "
            "if 0 is to be ignored, or labels= if it is the number of a thing that moves"
        )
    return bool(numbers)


def without_labels(masks: Iterable[Any]) -> Iterator[Any]:
    """Yield masks as they come, of which it cannot be told beforehand whether they hold labels.

    Raises
    ------
    ValueError
        If they do.
    """
    for mask in masks:
        if _numbers_in(mask):
            raise InputError(
                "mask has numbers other than 0 and 255: give them as labels= if they are those of "
                "things that move, or booleans if 0 is to be ignored"
            )
        yield mask


def _numbers_in(mask: Any) -> set[int]:
    """Return the numbers from 1 to 254 in a mask of integers, (H, W); none in anything else."""
    if mask is None or is_path(mask):
        return set()
    array = np.asarray(mask)
    if array.ndim != 2 or array.dtype.kind not in "iu":
        return set()
    return set(np.unique(array).tolist()) - {0, VOID}
