"""Where the camera was: frames in pieces, through the views and tracks that lead there."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tisfm.camera import Camera
from tisfm.reconstruction.tracks.tracker import Observations
from tisfm.reconstruction.tracks.views import View

MAX_SEEN_DEVIATION = (
    0.05  # of the focal length: with a larger deviation, the motion does not show it
)
MAX_USEFUL_DEVIATION = (
    0.3  # with a larger one, a guess is as good: lenses of 0.6 to 2 longer sides are common
)


@dataclass(frozen=True, kw_only=True)
class FocalEstimate:
    """A focal length that was found from a sequence, and maybe a radial coefficient.

    Attributes
    ----------
    focal : float
        px.
    deviation : float
        Standard deviation, px; infinite where the sequence says nothing.
    radial, radial_deviation : float
        k1 of the lens; 0 if it was not sought.
    limit : float
        With a deviation of a larger share of the focal length, a guess is as good.
    bent : bool
        Whether a lens that distorts, if there may be one, leads to another focal length.
    """

    focal: float
    deviation: float
    radial: float = 0.0
    radial_deviation: float = 0.0
    limit: float = MAX_USEFUL_DEVIATION
    bent: bool = False

    def taken(self, camera: Camera) -> Camera:
        """Return a camera with it, or as it is if a guess is as good."""
        if not self.is_of_use:
            return camera
        distortion = (self.radial, 0.0, 0.0, 0.0) if self.radial else None
        return replace(camera, focal=self.focal, distortion=distortion)

    @property
    def is_seen(self) -> bool:
        """Whether the motion shows it."""
        return self.deviation <= MAX_SEEN_DEVIATION * self.focal

    @property
    def is_of_use(self) -> bool:
        """Whether it says more than a guess."""
        return self.deviation <= self.limit * self.focal


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
class PathSolution:
    """Pieces, and what they were found from.

    Attributes
    ----------
    pieces : list of Piece
    unplaced : list of int
        Frames in none of them.
    views : sequence of View
        As frames show them.
    seen : sequence of Observations
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
    seen: Sequence[Observations]
    camera: Camera
    focal: FocalEstimate | None
    score: float
