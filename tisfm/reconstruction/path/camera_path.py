"""The camera path of a sequence: poses of frames, and the reasons for missing poses."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tisfm.camera import Camera
from tisfm.reconstruction.mapping.solution import FocalEstimate, Piece
from tisfm.reconstruction.tracks.tracker import Observations
from tisfm.shutter import RollingShutterMotion
from tisfm.status import Status

FAR_APART = (
    "the frames are too far apart to check the path: only matched points support it. Give frames "
    "with more overlap"
)
"""What makes a path of photographs doubtful."""


@dataclass(frozen=True, kw_only=True)
class CameraPath:
    """Poses of frames, in pieces, and the reasons for missing poses."""

    # pieces in the order of their first frames; each frame is in at most one piece
    pieces: tuple[Piece, ...]
    missing: Mapping[int, Status]  # reason for each frame that is in no piece
    observations: Sequence[Observations]  # tracks in every frame
    # Camera with the focal length of the path, and with distortion if distortion was estimated.
    # Poses, points and tracks belong to its pinhole, without distortion.
    camera: Camera
    # the estimate, if the focal length was to be estimated and a path was found
    focal: FocalEstimate | None = None
    # With a rolling shutter: the motion during readout. Poses, points and tracks hold at the middle
    # rows.
    rolling: RollingShutterMotion | None = None
    # (N,) float64: focal length of each frame over that of the first frame; None if it is constant.
    # Poses, points and tracks belong to the focal length of the first frame.
    zoom: np.ndarray | None = None
    score: float = 0.0  # as for `PathSolution`
    # why the camera cannot be right, and what to do; "" if nothing says so
    objection: str = ""
    # why the camera is perhaps wrong, and what to do; "" if nothing says so
    doubt: str = ""
    # whether frames are photographs, which are too far apart for the checks
    has_photographs: bool = False

    @property
    def is_plain(self) -> bool:
        """Whether it has neither a lens, a zoom nor a readout."""
        return self.camera.is_pinhole and self.rolling is None and self.zoom is None

    @property
    def doubts(self) -> list[str]:
        """What makes each piece doubtful; "" for a piece without doubts."""
        return [
            "; ".join(filter(None, [piece.rival.message if piece.rival else "", self.doubt]))
            for piece in self.pieces
        ]

    @property
    def pieces_with_positions(self) -> list[Piece]:
        """The pieces in which the camera does more than turn."""
        return [piece for piece in self.pieces if not piece.only_turns]

    @property
    def position_count(self) -> int:
        """The number of frames with a position."""
        return sum(len(piece.poses) for piece in self.pieces_with_positions)
