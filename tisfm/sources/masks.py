"""Masks: which pixels of each frame are ignored."""

import os
from collections.abc import Iterable, Iterator, Sequence
from itertools import islice, repeat
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numpy.typing import NDArray

from tisfm.checks import unmasked_mask
from tisfm.errors import InputError, InputTypeError
from tisfm.formats import read_image
from tisfm.sources.frame_reader import is_path
from tisfm.sources.paths import several_pictures

Mask = (
    str
    | os.PathLike[str]
    | npt.NDArray[Any]
    | Sequence[str | os.PathLike[str]]
    | Iterable[npt.ArrayLike]
)


class _Picture(NamedTuple):
    """A mask that was read: its file, and where pixels count."""

    path: str
    counted: NDArray[np.bool_]


class Masks:
    """The masks of a source: one for all of its frames, or one for each.

    Black (zero, False) is what does not count, as in COLMAP and other photogrammetry, and as
    ``mask=`` is in `tisfm.metrics`.

    Parameters
    ----------
    mask : path, array, sequence of paths, or iterable of arrays
        A picture or an (H, W) array for all frames. Or one for each frame of the source, those
        that are left out included: a folder, a glob pattern, a list of files, an (N, H, W) array,
        or any iterable of (H, W) arrays.
    frame_files : sequence of Path, optional
        Files of all frames, where they have such. Masks of a folder or pattern are found by them:
        the mask of ``a.jpg`` is ``a.png`` or ``a.jpg.png``. Where no mask is called like a frame,
        they belong to the frames in their order.
    count : int, optional
        Number of frames, where it is known.

    Attributes
    ----------
    ahead : bool
        Whether masks may be read in another thread, before they are asked for.
    files : tuple of Path
        Files that masks are read from.

    Raises
    ------
    FileNotFoundError
        If a path does not exist or a pattern matches nothing.
    TypeError
        If the mask is none of these.
    ValueError
        If there are not as many masks as frames, or a frame has none.
    """

    def __init__(
        self, mask: Mask, *, frame_files: Sequence[Path] = (), count: int | None = None
    ) -> None:
        self.files: tuple[Path, ...] = ()
        self.ahead = True
        self._items: Iterable[Any]
        number = None
        if isinstance(mask, (str, os.PathLike)):
            path = os.fspath(mask)
            if os.path.isfile(path):
                self.files = (Path(path),)
                self._items = repeat(_Picture(path, _counted(read_image(path))))
            else:
                self.files = _by_name(several_pictures(path, "mask"), frame_files, path)
                self._items, number = self.files, len(self.files)
        elif isinstance(mask, Sequence) and mask and all(map(is_path, mask)):
            self.files = tuple(Path(os.fspath(item)) for item in mask)
            for file in self.files:
                if not file.exists():
                    raise FileNotFoundError(f"there is no mask {file}: check the path")
            self._items, number = self.files, len(self.files)
        elif isinstance(mask, np.ndarray) and mask.ndim == 2:
            self._items = repeat(mask)
        elif isinstance(mask, np.ndarray) and mask.ndim != 3:
            raise InputError(
                f"mask is {mask.shape}: expected (H, W), or (N, H, W) with one for every frame"
            )
        elif isinstance(mask, Iterable):
            self.ahead = False
            self._items = mask
            number = len(mask) if isinstance(mask, (Sequence, np.ndarray)) else None
        else:
            raise InputTypeError(
                f"mask is {mask!r}: expected a picture, an array, or one for every frame"
            )
        if number is not None and count is not None and number != count:
            raise InputError(
                f"mask has {number} mask{'s' * (number != 1)}, but there are {count} frames: "
                "expected one for every frame, or a single one"
            )

    def ignored(self) -> "Ignored":
        """Return what gives the frames their masks, from the first frame on."""
        return Ignored(self._items)


class Ignored:
    """Gives frames their masks, in order."""

    def __init__(self, items: Iterable[Any]) -> None:
        self._items: Iterator[Any] = iter(items)
        self._following = 0

    def of(self, index: int, name: str, shape: tuple[int, ...]) -> NDArray[np.bool_]:
        """Return where a frame of this number and shape (H, W[, 3]) is ignored.

        Raises
        ------
        OSError, tisfm.formats.FormatError
            If its mask cannot be read.
        ValueError
            If there is none, or it is of another size.
        """
        item = next(islice(self._items, index - self._following, None), None)
        self._following = index + 1
        if item is None:
            raise InputError(f"mask ended before frame {name}: expected one for every frame")
        if isinstance(item, _Picture):
            title, counted = item
        elif is_path(item):
            title, counted = os.fspath(item), _counted(read_image(item))
        else:
            title, counted = f"the mask of frame {name}", unmasked_mask(item, "mask")
        if counted.shape != shape[:2]:
            raise InputError(
                f"{title} is {counted.shape} but frame {name} is {shape[:2]}: expected a mask of "
                "the size of the frame as it is read"
            )
        return ~counted


def _counted(picture: np.ndarray) -> NDArray[np.bool_]:
    """Return where a picture, grey or colour, is not black."""
    return (picture if picture.ndim == 2 else picture.max(axis=-1)) != 0


def _by_name(masks: list[Path], frames: Sequence[Path], title: str) -> tuple[Path, ...]:
    """Return the masks in the order of the frames: by their names, where these say so."""
    named = {mask.stem: mask for mask in masks}
    found = [named.get(frame.name, named.get(frame.stem)) for frame in frames]
    if not any(found):
        return tuple(masks)
    for frame, mask in zip(frames, found, strict=True):
        if mask is None:
            raise InputError(
                f"{title} has no mask for {frame.name}: expected {frame.stem}.png or "
                f"{frame.name}.png"
            )
    return tuple(mask for mask in found if mask is not None)
