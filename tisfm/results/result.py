"""A result as it is looked at: which frames there are, where the camera was, and each frame."""

from pathlib import Path
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from tisfm.reconstruction.result.moving_object import MovingObject
from tisfm.results.frame import ViewFrame
from tisfm.results.fused_scene import Whole, WholeKind
from tisfm.status import Status

Change = Literal["grown", "replaced"]


class Result(Protocol):
    """What is looked at; the folder of a run or of a reconstruction.

    Attributes
    ----------
    folder : Path
    names : list of str
        Of the frames.
    statuses : list of Status
    times : list of float or None
        Seconds.
    poses : (N, 4, 4) float64
        Camera to world, NaN for a frame without one.
    piece : (N,) int32
        Frames of one piece have one scale; −1 without a pose.
    objects : tuple of MovingObject
    unit : str
        Of depth, in words.
    has_one_scale : bool
        Whether depth of all frames of a piece is of one scale.
    quantities : tuple of str
        What points may be coloured by, besides image and depth.
    has_whole : bool
        Whether several frames can be shown together.
    """

    folder: Path
    names: list[str]
    statuses: list[Status]
    times: list[float | None]
    poses: NDArray[np.float64]
    piece: NDArray[np.int32]
    objects: tuple[MovingObject, ...]
    unit: str
    has_one_scale: bool
    quantities: tuple[str, ...]
    has_whole: bool

    def read(self, number: int) -> ViewFrame:
        """Read a frame.

        Raises
        ------
        OSError, ValueError
            If its file is gone, or damaged.
        """
        ...

    def picture(self, number: int) -> NDArray[np.uint8]:
        """Return the picture of a frame alone, (H, W, 3).

        Raises
        ------
        OSError, ValueError
            As `read`.
        """
        ...

    def whole(self, kind: WholeKind, number: int) -> Whole:
        """Return what the frames around one show together, as points or as a surface; it may last.

        Raises
        ------
        ImportError, OSError, ValueError
            If there is nothing of that kind, a library is missing, or a file is damaged.
        """
        ...

    def refresh(self) -> Change | None:
        """Look whether the folder has changed, and take over what it has now.

        Returns
        -------
        {"grown", "replaced"} or None
            Whether the frames that there were are the same, and there are others, between them
            too; or anything else.
        """
        ...


def as_rgb(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return a picture, (H, W) or (H, W, 3), with three channels."""
    return np.repeat(picture[..., None], 3, axis=2) if picture.ndim == 2 else picture
