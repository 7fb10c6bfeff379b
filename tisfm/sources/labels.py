"""Given labels: the number of the moving object at each pixel of a frame."""

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from numpy.typing import NDArray

from tisfm.checks import check_unmasked
from tisfm.errors import InputError, InputTypeError
from tisfm.formats.label_picture import has_colour_palette, read_label_picture
from tisfm.sources.frame_reader import is_integer, is_path
from tisfm.sources.paths import list_image_files

VOID = 255
"""Label of pixels that are ignored, as in DAVIS."""

LabelSource = (
    str
    | os.PathLike[str]
    | npt.NDArray[Any]
    | Sequence[str | os.PathLike[str] | npt.ArrayLike | None]
    | Mapping[int, str | os.PathLike[str] | npt.ArrayLike]
    | Mapping[str, str | os.PathLike[str] | npt.ArrayLike]
    | Iterable[npt.ArrayLike | None]
)


class Labels:
    """The labels of a source: 0 for the background at rest, 1 to 254 for objects, 255 for ignored.

    Raises FileNotFoundError if a path does not exist or a pattern matches nothing.

    Raises TypeError if the labels are of another type.

    Raises ValueError if there are labels for frames that do not exist, or not as many labels as
    frames.
    """

    def __init__(
        self,
        # A folder, a glob pattern, or the path of one file: image files, whose grey levels or
        # palette indices are labels. Files and frames are matched by name: ``a.png`` or
        # ``a.jpg.png`` with ``a.jpg``, ``walk_000012.png`` with frame 12 of ``walk.mp4``. Frames
        # without a file have no labels. If no name matches, there must be one file for each frame,
        # in order. Or a sequence, an (N, H, W) array of integers, or an iterable: it has one item
        # for every frame of the source, None for a frame without labels. Or a mapping from frame
        # numbers or frame names to paths or arrays.
        labels: LabelSource,
        *,
        names: Sequence[str] | None = None,  # names of all frames, if known
        frame_files: Sequence[Path] = (),  # files of all frames, if each frame has a file
        prefix: str = "",  # prefix of the names of numbered frames
        count: int | None = None,  # number of frames, if known
    ) -> None:
        self._prefix, self._count = prefix, count
        self._frame_numbers = {name: k for k, name in enumerate(names or ())}
        self._frame_numbers |= {file.name: k for k, file in enumerate(frame_files)}
        self.can_read_ahead = True  # whether labels may be read ahead in a thread
        self._items: Mapping[int, Any] | Iterable[Any]
        if isinstance(labels, (str, os.PathLike)):
            self._items = self._match_files(
                list_image_files(os.fspath(labels), "picture or folder of labels")
            )
        elif isinstance(labels, Mapping):
            self._items = {self._number_of_key(key): item for key, item in labels.items()}
        elif isinstance(labels, np.ndarray) and labels.ndim != 3:
            raise InputError(
                f"labels is {labels.shape}: expected (N, H, W), one (H, W) array for every "
                "frame; for labels of the first frame alone give {0: labels}"
            )
        elif isinstance(labels, (Sequence, np.ndarray)):
            self._check_count(len(labels))
            self._items = dict(enumerate(labels))
        elif isinstance(labels, Iterable):
            self._items, self.can_read_ahead = labels, False
        else:
            raise InputTypeError(
                f"labels is {labels!r}: expected pictures, or an array for every frame"
            )
        label_items = self._items.values() if isinstance(self._items, Mapping) else ()
        # files with labels
        self.files = tuple(Path(os.fspath(item)) for item in label_items if is_path(item))
        for file in self.files:
            if not file.exists():
                raise FileNotFoundError(f"there are no labels {file}: check the path")

    def reader(self) -> "LabelReader":
        """Return a reader that begins at the first frame."""
        return LabelReader(self._items)

    def _match_files(self, files: Sequence[Path]) -> dict[int, Path]:
        """Return the label file of each frame number."""
        files_by_number = {self._frame_number(file.stem): file for file in files}
        files_by_number.pop(None, None)
        if files_by_number:
            return {number: file for number, file in files_by_number.items() if number is not None}
        self._check_count(len(files), "; none of them has the name of a frame")
        return dict(enumerate(files))

    def _number_of_key(self, key: Any) -> int:
        """Return the number of the frame for a key of a mapping."""
        if not is_integer(key) and not isinstance(key, str):
            raise InputTypeError(
                f"labels has the key {key!r}: expected the number or name of a frame"
            )
        number = int(key) if is_integer(key) else self._frame_number(key)
        if number is None or number < 0 or (self._count is not None and number >= self._count):
            raise InputError(f"labels has an entry for frame {key!r}, which does not exist")
        return number

    def _frame_number(self, name: str) -> int | None:
        """Return the number of the frame with this name; None if there is no such frame."""
        if self._frame_numbers:
            return self._frame_numbers.get(name)
        prefix, _, number = name.rpartition("_")
        return int(number) if prefix == self._prefix and number.isdecimal() else None

    def _check_count(self, count: int, detail: str = "") -> None:
        if self._count is not None and count != self._count:
            raise InputError(
                f"labels are of {count} frame{'s' * (count != 1)}, but there are "
                f"{self._count} frames{detail}: expected labels for every frame"
            )


class LabelReader:
    """Reads the labels of frames, in the order of the frames."""

    def __init__(self, items: Mapping[int, Any] | Iterable[Any]) -> None:
        self._items = items if isinstance(items, Mapping) else iter(items)
        self._next_index = 0
        self._has_void = self._has_objects = False

    def read_labels(
        self,
        index: int,
        name: str,  # name of the frame in messages
        # (H, W[, 3]) of the frame before and after cropping and shrinking: labels may have either
        # size
        shapes: Sequence[tuple[int, ...]],
    ) -> np.ndarray | None:
        """Return the labels of frame `index`, (H, W) uint8; None for a frame without labels.

        Raises OSError, tisfm.formats.FormatError if the labels cannot be read.

        Raises TypeError, ValueError if the item is not an array of labels, or has another size.
        """
        item = self._item(index, name)
        if item is None:
            return None
        if is_path(item):
            title, labels = os.fspath(item), read_label_picture(item)
        else:
            title = f"labels of frame {name}"
            labels = check_labels(item, title)
        sizes = list(dict.fromkeys(shape[:2] for shape in shapes))
        if labels.shape not in sizes:
            raise InputError(
                f"{title}: the size is {labels.shape}, but the size of frame {name} is "
                f"{' or '.join(map(str, sizes))}: expected the same size"
            )
        self._has_void |= bool((labels == VOID).any())
        self._has_objects |= bool(((labels > 0) & (labels < VOID)).any())
        return labels

    def check(self) -> None:
        """Raise ValueError if the labels that were read have ignored pixels, but no object."""
        if self._has_void and not self._has_objects:
            raise InputError(
                "labels are 0 or 255 everywhere, and pixels of 255 are ignored: expected numbers "
                "from 1 to 254 for moving objects"
            )

    def _item(self, index: int, name: str) -> Any:
        if isinstance(self._items, Mapping):
            return self._items.get(index)
        skip_count, self._next_index = index - self._next_index, index + 1
        for item in islice(self._items, skip_count, None):
            return item
        raise InputError(
            f"labels ended before frame {name}: expected None for a frame without labels"
        )


def check_labels(values: Any, title: str) -> NDArray[np.uint8]:
    """Return the labels of a frame, (H, W) uint8, or raise TypeError or ValueError."""
    array = check_unmasked(values, title)
    if array.ndim == 3:
        raise InputError(
            f"{title} have the shape {array.shape}, as colours do: expected (H, W) label numbers; "
            "in a picture with a palette they are the palette indices"
        )
    if array.ndim != 2:
        raise InputError(f"{title} have the shape {array.shape}: expected (H, W)")
    if array.dtype.kind not in "biu":
        raise InputTypeError(
            f"{title} are of type {array.dtype}: expected integers, 0 for the background at rest, "
            "and 1 to 254 for moving objects"
        )
    if array.size and (array.min() < 0 or array.max() > VOID):
        raise InputError(
            f"{title} go from {array.min()} to {array.max()}: expected 0 for the background at "
            "rest, 1 to 254 for moving objects, and 255 for ignored pixels"
        )
    return array.astype(np.uint8)


def are_labels(mask: Any) -> bool:
    """Return whether an argument for `tisfm.sources.masks.Masks` holds labels of moving objects.

    The argument holds labels if it has one item for every frame, and the items are images with a
    colour palette, as in DAVIS, or arrays of integers with several numbers from 1 to 254. Otherwise
    it holds masks.

    Raises ValueError if both labels and masks are possible: arrays of integers with a single number
    from 1 to 254.

    Raises tisfm.formats.FormatError if an image is damaged.
    """
    if isinstance(mask, (str, os.PathLike)):
        path = os.fspath(mask)
        return not os.path.isfile(path) and has_colour_palette(list_image_files(path, "mask")[0])
    if isinstance(mask, np.ndarray) and mask.ndim != 3:
        return False
    if not isinstance(mask, (Sequence, np.ndarray)) or not len(mask):
        return False
    if all(map(is_path, mask)):
        return has_colour_palette(mask[0])
    numbers: set[int] = set()
    for item in mask:
        numbers |= _label_numbers(item)
    if len(numbers) == 1:
        raise InputError(
            f"mask has the number {numbers.pop()} at every pixel that is not 0: give booleans "
            "if 0 is to be ignored, or labels= if it is the number of a moving object"
        )
    return bool(numbers)


def refuse_label_values(masks: Iterable[Any]) -> Iterator[Any]:
    """Yield masks from an iterable; `are_labels` cannot check its items before the run.

    Raises ValueError if an item holds labels of moving objects.
    """
    for mask in masks:
        if _label_numbers(mask):
            raise InputError(
                "mask has numbers other than 0 and 255: give them as labels= if they are numbers "
                "of moving objects, or give booleans if 0 is to be ignored"
            )
        yield mask


def _label_numbers(mask: Any) -> set[int]:
    """Return the numbers from 1 to 254 in an (H, W) mask of integers; an empty set for others."""
    if mask is None or is_path(mask):
        return set()
    array = np.asarray(mask)
    if array.ndim != 2 or array.dtype.kind not in "iu":
        return set()
    return set(np.unique(array).tolist()) - {0, VOID}
