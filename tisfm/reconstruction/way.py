"""Where the camera was: frames in pieces, through the views and tracks that lead there."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tisfm.camera import Camera
from tisfm.reconstruction.database import View
from tisfm.reconstruction.self_calibration import FocalEstimate
from tisfm.reconstruction.tracks import Seen


@dataclass(frozen=True, kw_only=True)
class Piece:
    """Frames in one coordinate system, of one scale.

    Attributes
    ----------
    poses : dict of int to (4, 4) float64
        Camera to world, by frame, in order.
    views : tuple of int
        Frames that poses and points were adjusted for.
    points : mapping of int to (3,) float64
        Positions of tracks, in the world.
    """

    poses: dict[int, np.ndarray]
    views: tuple[int, ...]
    points: Mapping[int, np.ndarray]


@dataclass(frozen=True, kw_only=True)
class Way:
    """Pieces, and what they were found from.

    Attributes
    ----------
    pieces : list of Piece
    unplaced : list of int
        Frames in none of them.
    views : sequence of View
        As frames show them.
    seen : sequence of Seen
        Tracks in every frame, as the camera's pinhole has them.
    camera : Camera
    focal : FocalEstimate or None
        If it was to be found, and was.
    score : float
        How well the models explain the matches of views: the sum of `Model.score`. Models grown by
        parts, or continued, keep 0.
    """

    pieces: list[Piece]
    unplaced: list[int]
    views: Sequence[View]
    seen: Sequence[Seen]
    camera: Camera
    focal: FocalEstimate | None
    score: float
