"""The interface of results: frames with depth, poses, motion and labels, read on demand."""

from collections import Counter, OrderedDict
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from tisfm.grade import Grade, GradeSummary
from tisfm.reconstruction.result.moving_object import MovingObject
from tisfm.results.frame import ResultFrame
from tisfm.results.fused_scene import FusedKind, FusedScene
from tisfm.status import Status

Change = Literal["grown", "replaced"]


class ResultFrames(Protocol):
    """The frames of a result."""

    folder: Path
    names: Sequence[str]  # names of the frames in the source
    times: Sequence[float | None]  # s
    statuses: Sequence[Status]
    grades: Sequence[Grade]
    depth_errors: Sequence[float]  # expected relative errors of depth; NaN where unknown
    poses: NDArray[np.float64]  # (N, 4, 4) float64: camera to world, NaN for a frame without a pose
    piece: NDArray[np.int32]  # (N,) int32: frames of one piece have one scale; −1 without a pose
    objects: tuple[MovingObject, ...]
    unit: str  # unit of depth, in words
    # Whether depth of all frames of a piece has the unit of the poses. Otherwise the depth of each
    # frame has its own unit.
    has_one_scale: bool
    quantities: tuple[
        str, ...
    ]  # quantities that points can be coloured by, besides image and depth
    can_fuse: bool  # whether several frames can be fused
    unit_advice: str  # how to get depth in another unit

    def __len__(self) -> int:
        """Return the number of frames."""

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width of the frames, px."""

    @property
    def grade_summary(self) -> GradeSummary:
        """The grades of the frames, the median and the worst.

        Frames without requested depth do not count.
        """

    @property
    def focal_note(self) -> str:
        """As `tisfm.Reconstruction.focal_note`; "" for pairs, whose statuses say it."""

    @property
    def depth_advice(self) -> str:
        """How to get depth for frames without depth."""

    def read(self, number: int) -> ResultFrame:
        """Read everything about a frame.

        Raises OSError, ValueError if its file is missing or damaged.
        """

    def picture(self, number: int) -> NDArray[np.uint8]:
        """Read the picture of a frame, (H, W) or (H, W, 3) RGB."""

    def inverse_depth(self, number: int) -> NDArray[np.float32]:
        """Read the inverse depth of a frame, (H, W); values that are not above 0 are unknown."""

    def has_depth(self, number: int) -> bool:
        """Return whether a frame has usable depth."""

    def scale(self, number: int) -> tuple[int, float]:
        """Return the group of frames with the same scale, and the scale of inverse depth in it."""

    def flow(self, number: int) -> NDArray[np.float32]:
        """Read the image motion to the next frame, (H, W, 2) px.

        Raises ValueError if the result does not keep image motion.
        """

    def masks(self, number: int) -> dict[str, NDArray[np.bool_]]:
        """Return the masks of a frame, (H, W), by name.

        Raises ValueError if the result has no labels.
        """

    def fused(self, kind: FusedKind, number: int) -> FusedScene:
        """Return the fused points or surface of the piece of a frame; this can take long.

        Raises ImportError, OSError, ValueError if there is nothing to fuse, a package is missing,
        or a file is damaged.
        """

    def refresh(self) -> Change | None:
        """Read the record of the folder again if it has changed.

        Returns "grown" if all earlier frames are still the same; None if nothing has changed.
        """


def file_names(names: Sequence[str]) -> tuple[str, ...]:
    """Return names for files, one for each frame: the base names if they differ, else numbers.

    Names that differ only in upper and lower case count as equal, as some file systems do.
    """
    base_names = [Path(name).name for name in names]
    count = Counter(name.casefold() for name in base_names)
    if all(base_names) and max(count.values(), default=1) == 1:
        return tuple(base_names)
    return tuple(f"{number:06d}" for number in range(len(names)))


def as_rgb(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return a picture, (H, W) or (H, W, 3), with three channels."""
    return np.repeat(picture[..., None], 3, axis=2) if picture.ndim == 2 else picture


MAX_CACHE_BYTES = 256 * 2**20  # bytes of the frames in a cache; set by hand


class FrameCache:
    """Frames of a result; the least recently used frames are dropped."""

    def __init__(
        self,
        result: ResultFrames,
        # bytes of all frames in the cache; the latest frame is kept whatever its size
        max_bytes: int = MAX_CACHE_BYTES,
    ) -> None:
        self._result, self._max_bytes = result, max_bytes
        self._frames: OrderedDict[str, ResultFrame] = OrderedDict()

    def __len__(self) -> int:
        return len(self._frames)

    @property
    def nbytes(self) -> int:
        """Bytes of the frames in the cache."""
        return sum(frame.nbytes for frame in self._frames.values())

    def __getitem__(self, number: int) -> ResultFrame:
        """Return a frame; read it if it is not in the cache.

        Raises OSError, ValueError if it cannot be read.
        """
        name = self._result.names[number]
        frame = self._frames.pop(name, None)
        if frame is None:
            frame = self._result.read(number)
        elif frame.number != number:  # a growing result has new frames before this one
            frame = replace(frame, number=number)
        self._frames[name] = frame
        while len(self._frames) > 1 and self.nbytes > self._max_bytes:
            self._frames.popitem(last=False)
        return frame

    def clear(self) -> None:
        """Drop all frames."""
        self._frames.clear()
