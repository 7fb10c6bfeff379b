"""Solutions of the camera path: focal length, pieces of frames, and the views and tracks used."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from tisfm.camera import Camera
from tisfm.reconstruction.mapping.rival import Rival
from tisfm.reconstruction.mapping.settings import MAPPING
from tisfm.reconstruction.tracks.tracker import Observations
from tisfm.reconstruction.tracks.views import View


@dataclass(frozen=True, kw_only=True)
class FocalEstimate:
    """A focal length, and maybe a radial coefficient, estimated from a sequence."""

    focal: float  # focal length, px
    # standard deviation, px; infinite if the sequence does not show the focal length
    deviation: float
    # radial, radial_deviation: k1 of the lens, and its standard deviation; both 0 if k1 was not
    # estimated
    radial: float = 0.0
    radial_deviation: float = 0.0
    # largest useful standard deviation, as a share of the focal length: beyond it a guess is as
    # good
    max_deviation: float = field(default_factory=lambda: MAPPING.max_useful_deviation)
    # whether the focal length changes clearly when distortion is estimated too
    shows_distortion: bool = False

    def apply_to(self, camera: Camera) -> Camera:
        """Return a camera with this focal length and k1; unchanged if a guess is as good."""
        if not self.is_useful:
            return camera
        distortion = (self.radial, 0.0, 0.0, 0.0) if self.radial else None
        return replace(camera, focal=self.focal, distortion=distortion)

    @property
    def is_certain(self) -> bool:
        """Whether the motion shows the focal length well."""
        return self.deviation <= MAPPING.max_certain_deviation * self.focal

    @property
    def is_useful(self) -> bool:
        """Whether the estimate is better than a guess."""
        return self.deviation <= self.max_deviation * self.focal


@dataclass(frozen=True, kw_only=True)
class Piece:
    """Frames in one coordinate system, with one scale."""

    # by frame, in order: (4, 4) float64, camera to world
    poses: dict[int, np.ndarray]
    views: tuple[int, ...]  # frames whose poses were adjusted together with the points
    # by track number: (3,) float64, position in the world
    points: Mapping[int, np.ndarray]
    # First frames of parts that were joined to the part before them by their images (see
    # `tisfm.reconstruction.joints`). Parts share no tracks.
    joints: tuple[int, ...] = ()
    # Whether the camera only turns. Then its positions are unknown: poses have the position 0, and
    # there are no points.
    only_turns: bool = False
    rival: Rival | None = None  # the motion that lost when the piece was found, if it came near


@dataclass(frozen=True, kw_only=True)
class PathSolution:
    """Pieces of a path, and the views and tracks that they come from."""

    pieces: list[Piece]
    missing_frames: list[int]  # frames that are in no piece
    views: Sequence[View]  # views with points as the frames show them
    # tracks in every frame, as the pinhole camera would see them
    observations: Sequence[Observations]
    camera: Camera
    # the estimate, if the focal length was to be estimated and a path was found
    focal: FocalEstimate | None
    # score of the matches that the models explain: the sum of `Model.score`, which is 0 for
    # models that are joined from submaps or continue an earlier model
    score: float
