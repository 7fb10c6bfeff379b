"""Arrays as a source of frames."""

from collections.abc import Iterable, Iterator, Sequence
from itertools import count, islice
from pathlib import Path
from typing import Any

import numpy as np

from tisfm.checks import check_unmasked
from tisfm.errors import InputError, InputTypeError
from tisfm.sources.frame_reader import RawFrame, is_path


class Arrays:
    """Frames from an array, a sequence or an iterator. Iterators run in the caller's thread."""

    title = "frames"
    files: tuple[Path, ...] = ()
    names: tuple[str, ...] | None = None
    prefix = "frame"
    stated_count: int | None = None
    times: tuple[float, ...] | None = None
    notes: tuple[str, ...] = ()
    can_read_ahead = False

    def __init__(self, items: Iterable[Any]) -> None:
        if isinstance(items, np.ndarray) and items.ndim not in (3, 4):
            raise InputError(
                f"frames is {items.shape}: expected (N, H, W) or (N, H, W, 3), or a list of frames"
            )
        if not isinstance(items, Iterable):
            raise InputTypeError(
                f"source is {items!r}: expected a path, a list of paths, or an iterable of arrays"
            )
        self._items = items
        has_length = isinstance(items, (Sequence, np.ndarray))
        self.count: int | None = len(items) if has_length else None  # type: ignore[arg-type]

    def read(self, selection: slice) -> Iterator[RawFrame]:
        """Yield the frames whose numbers the slice contains."""
        numbers = count(selection.start, selection.step)
        items = islice(self._items, selection.start, selection.stop, selection.step)
        for index, item in zip(numbers, items, strict=False):
            if is_path(item):
                raise InputTypeError(
                    f"the source yields {item!r}: expected arrays; give paths as a list, in "
                    "the order of the frames"
                )
            name = f"{self.prefix}_{index:06d}"
            # `interpret` refuses masked values of a pair, and names the frame.
            frame = item if isinstance(item, np.ma.MaskedArray) else check_unmasked(item, name)
            yield RawFrame(index=index, name=name, image=frame)
