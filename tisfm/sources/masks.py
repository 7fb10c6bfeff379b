"""Masks, which mark the ignored pixels of each frame."""

import os
from collections.abc import Iterable, Iterator, Sequence
from itertools import islice, repeat
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numpy.typing import NDArray

from tisfm.checks import check_mask
from tisfm.errors import InputError, InputTypeError
from tisfm.formats import read_image
from tisfm.sources.frame_reader import is_path
from tisfm.sources.paths import list_image_files

Mask = (
    str
    | os.PathLike[str]
    | npt.NDArray[Any]
    | Sequence[str | os.PathLike[str]]
    | Iterable[npt.ArrayLike]
)


class _MaskFile(NamedTuple):
    """A mask that was read from a file."""

    path: str
    valid_pixels: NDArray[np.bool_]  # (H, W): false for ignored pixels


class Masks:
    """The masks of a source: one mask for all frames, or one for each frame.

    Black (zero, False) pixels are ignored, as in COLMAP and other photogrammetry software, and for
    ``mask=`` in `tisfm.metrics`.

    Raises FileNotFoundError if a path does not exist or a pattern matches nothing.

    Raises TypeError if the mask is of another type.

    Raises ValueError if there are not as many masks as frames, or a frame has no mask.
    """

    def __init__(
        self,
        # One mask for all frames: an image file or an (H, W) array. Or one mask for each frame of
        # the source, including skipped frames: a folder, a glob pattern, a list of files, an
        # (N, H, W) array, or an iterable of (H, W) arrays.
        mask: Mask,
        *,
        # Files of all frames, if each frame has a file. The masks of a folder or pattern and the
        # frames are matched by name: the mask of ``a.jpg`` is ``a.png`` or ``a.jpg.png``. If no
        # name matches, masks and frames have the same order.
        frame_files: Sequence[Path] = (),
        count: int | None = None,  # number of frames, if known
    ) -> None:
        self.files: tuple[Path, ...] = ()  # files of the masks
        self.can_read_ahead = True  # whether masks may be read ahead in a thread
        self._items: Iterable[Any]
        mask_count = None
        if isinstance(mask, (str, os.PathLike)):
            path = os.fspath(mask)
            if os.path.isfile(path):
                self.files = (Path(path),)
                self._items = repeat(_MaskFile(path, _nonzero(read_image(path))))
            else:
                self.files = _match_by_name(list_image_files(path, "mask"), frame_files, path)
                self._items, mask_count = self.files, len(self.files)
        elif isinstance(mask, Sequence) and mask and all(map(is_path, mask)):
            self.files = tuple(Path(os.fspath(item)) for item in mask)
            for file in self.files:
                if not file.exists():
                    raise FileNotFoundError(f"there is no mask {file}: check the path")
            self._items, mask_count = self.files, len(self.files)
        elif isinstance(mask, np.ndarray) and mask.ndim == 2:
            self._items = repeat(mask)
        elif isinstance(mask, np.ndarray) and mask.ndim != 3:
            raise InputError(
                f"mask is {mask.shape}: expected (H, W), or (N, H, W) with one mask for every frame"
            )
        elif isinstance(mask, Iterable):
            self.can_read_ahead = False
            self._items = mask
            mask_count = len(mask) if isinstance(mask, (Sequence, np.ndarray)) else None
        else:
            raise InputTypeError(
                f"mask is {mask!r}: expected a picture or an array, or one for every frame"
            )
        if mask_count is not None and count is not None and mask_count != count:
            raise InputError(
                f"mask has {mask_count} mask{'s' * (mask_count != 1)}, but there are {count} "
                "frames: expected one mask for every frame, or one mask for all frames"
            )

    def reader(self) -> "MaskReader":
        """Return a reader that begins at the first frame."""
        return MaskReader(self._items)


class MaskReader:
    """Reads the masks of frames, in the order of the frames."""

    def __init__(self, items: Iterable[Any]) -> None:
        self._items: Iterator[Any] = iter(items)
        self._next_index = 0

    def read_ignored(self, index: int, name: str, shape: tuple[int, ...]) -> NDArray[np.bool_]:
        """Return the ignored pixels, (H, W) bool, of a frame with this number and shape.

        Raises OSError, tisfm.formats.FormatError if the mask cannot be read.

        Raises ValueError if there is no mask of this frame, or the mask has another size.
        """
        item = next(islice(self._items, index - self._next_index, None), None)
        self._next_index = index + 1
        if item is None:
            raise InputError(f"mask ended before frame {name}: expected one mask for every frame")
        if isinstance(item, _MaskFile):
            title, valid_pixels = item
        elif is_path(item):
            title, valid_pixels = os.fspath(item), _nonzero(read_image(item))
        else:
            title, valid_pixels = f"the mask of frame {name}", check_mask(item, "mask")
        if valid_pixels.shape != shape[:2]:
            raise InputError(
                f"{title} is {valid_pixels.shape} but frame {name} is {shape[:2]}: expected a mask "
                "of the size of the frame as it is read"
            )
        return ~valid_pixels


def _nonzero(image: np.ndarray) -> NDArray[np.bool_]:
    """Return which pixels of a grey or colour image are not black, (H, W) bool."""
    return (image if image.ndim == 2 else image.max(axis=-1)) != 0


def _match_by_name(masks: list[Path], frames: Sequence[Path], title: str) -> tuple[Path, ...]:
    """Return the masks in the order of the frames, matched by name if any name matches."""
    masks_by_stem = {mask.stem: mask for mask in masks}
    matches = [masks_by_stem.get(frame.name, masks_by_stem.get(frame.stem)) for frame in frames]
    if not any(matches):
        return tuple(masks)
    for frame, mask in zip(frames, matches, strict=True):
        if mask is None:
            raise InputError(
                f"{title} has no mask for {frame.name}: expected {frame.stem}.png or "
                f"{frame.name}.png"
            )
    return tuple(mask for mask in matches if mask is not None)
