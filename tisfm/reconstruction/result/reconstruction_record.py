"""Poses, statuses and grades of the frames of a sequence, without their depth maps."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from operator import index
from pathlib import Path

import numpy as np

from tisfm.camera import Camera
from tisfm.errors import InputError, OutOfRangeError
from tisfm.grade import Grade, GradeSummary, grade_depth, summarise_grades, warn_of_grades
from tisfm.reconstruction.result.calibration import GIVEN, Calibration
from tisfm.reconstruction.result.focal_note import find_focal_note
from tisfm.reconstruction.result.moving_object import MovingObject
from tisfm.reconstruction.result.path_check import PathCheck
from tisfm.reconstruction.result.summary import describe_pose_deviations, summarise
from tisfm.settings import Settings
from tisfm.status import Status


@dataclass(frozen=True, kw_only=True, eq=False)
class ReconstructionRecord:
    """The poses, statuses and grades of frames; `Reconstruction` describes the attributes."""

    poses: np.ndarray = field(repr=False)
    piece: np.ndarray = field(repr=False)
    unit: tuple[float, ...] = field(repr=False)
    position_deviation: np.ndarray = field(repr=False)
    rotation_deviation: np.ndarray = field(repr=False)
    status: tuple[Status, ...] = field(repr=False)
    depth_error: np.ndarray = field(repr=False)
    depth_share: np.ndarray = field(repr=False)
    keyframes: tuple[int, ...]
    camera: Camera
    calibration: Calibration = field(repr=False, default=GIVEN)
    zoom: np.ndarray | None = field(repr=False, default=None)
    settings: Settings = field(repr=False)
    names: tuple[str, ...] = field(repr=False)
    times: tuple[float | None, ...] = field(repr=False)
    skipped: tuple[tuple[int, str], ...] = field(repr=False, default=())
    notes: tuple[str, ...] = field(repr=False, default=())
    shape: tuple[int, int]
    folder: Path
    version: str
    objects: tuple[MovingObject, ...] = ()
    checks: tuple[PathCheck, ...] = field(repr=False, default=())

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self.poses)

    @property
    def largest_piece(self) -> int:
        """The piece with the most frames; 0 without pieces.

        A piece with positions comes before a piece in which the camera only turns.
        """
        counts = np.bincount(self.piece[self.piece >= 0], minlength=1)
        weights = [1 if self.only_turns(piece) else 1 + len(self) for piece in range(len(counts))]
        return int(np.argmax(counts * weights))

    def only_turns(self, piece: int) -> bool:
        """Return whether the camera only turns in a piece.

        Its orientations are known. Its positions are unknown, and 0; there is no depth.

        Examples
        --------
        >>> import tisfm
        >>> result = tisfm.Reconstruction.load("walk")
        >>> result.only_turns(0)
        False
        """
        return any(self.status[k] == "pure_rotation" for k in np.flatnonzero(self.piece == piece))

    @property
    def has_position(self) -> np.ndarray:
        """Which frames have a position, (N,) bool: a pose in a piece that does not only turn."""
        turning = [piece for piece in range(len(self.unit)) if self.only_turns(piece)]
        return np.asarray((self.piece >= 0) & ~np.isin(self.piece, turning))

    @property
    def focal(self) -> np.ndarray:
        """Focal length of each frame as it was taken, (N,) float64, px of the frames of the source.

        The unit is that of `calibration.focal`. All are equal unless the camera zooms.

        Examples
        --------
        >>> import tisfm
        >>> result = tisfm.Reconstruction.load("walk")
        >>> result.focal.shape, bool(result.focal[0] == result.calibration.focal)
        ((9,), True)
        """
        focal = self.calibration.focal or self.camera.focal
        return focal * (np.ones(len(self)) if self.zoom is None else self.zoom)

    def grade(self, frame: int) -> Grade:
        """Return the grade of a frame: how far its pose and depth can be trusted.

        Raises
        ------
        IndexError
            If there is no such frame.

        Examples
        --------
        >>> import tisfm
        >>> result = tisfm.Reconstruction.load("walk")
        >>> result.grade(0).is_green  # good or fair: depth is expected to be off by at most 10 %
        True
        """
        number = self._number(frame)
        if self.piece[number] < 0:
            return Grade.NO_POSE
        return grade_depth(self.status[number], float(self.depth_error[number]))

    @property
    def grades(self) -> tuple[Grade, ...]:
        """The grade of each frame."""
        return tuple(self.grade(frame) for frame in range(len(self)))

    @property
    def grade_summary(self) -> GradeSummary:
        """The number of frames of each grade, the median and the worst, as a text and as numbers.

        Frames whose depth was not requested do not count.
        """
        return summarise_grades(self.grades, self.status, self.depth_error.tolist())

    @property
    def median_grade(self) -> Grade:
        """The grade in the middle, in the order from the best to the worst.

        Frames whose depth was not requested do not count.
        """
        return self.grade_summary.median

    @property
    def worst_grade(self) -> Grade:
        """The worst grade. Frames whose depth was not requested do not count."""
        return self.grade_summary.worst

    @property
    def focal_note(self) -> str:
        """What depends on a stated focal length that the image motion does not show; "" if nothing.

        It follows from the origin of the focal length and from `checks`.

        Examples
        --------
        >>> import tisfm
        >>> tisfm.Reconstruction.load("walk").focal_note
        ''
        """
        return find_focal_note(self.calibration, self.checks)

    @property
    def pose_deviation_text(self) -> str:
        """The median deviations of the poses of the largest piece in words; "" if unknown.

        Each is the root of the sum of the squares over the axes, for the position in the unit of
        the poses. Given poses and contradicted paths have none.

        Examples
        --------
        >>> import tisfm
        >>> tisfm.Reconstruction.load("walk").pose_deviation_text[:12]
        'position ±0.'
        """
        members = np.flatnonzero(self.piece == self.largest_piece)
        if any(self.status[frame] == "contradicted" for frame in members):
            return ""
        return describe_pose_deviations(
            self.position_deviation[members], self.rotation_deviation[members]
        )

    def summary(self) -> str:
        """Return one paragraph: poses, pieces, focal length, grades, contradictions and advice.

        Examples
        --------
        >>> import tisfm
        >>> result = tisfm.Reconstruction.load("walk")
        >>> result.summary()[:42]
        '9 of 9 frames have a pose, in 1 piece. The'
        """
        return summarise(
            self.piece,
            self.has_position,
            self.status,
            self.grade_summary,
            self.camera,
            self.calibration,
            self.zoom,
            self.focal_note,
            self.pose_deviation_text,
        )

    def warning(self, frames: Iterable[int] | None = None) -> str:
        """Return a warning of contradicted frames, or else of poor depth; "" without such frames.

        Exports carry it where their format has room for a text.

        Parameters
        ----------
        frames : iterable of int, optional
            By default all frames.

        Examples
        --------
        >>> import tisfm
        >>> tisfm.Reconstruction.load("walk").warning()  # nothing to warn of
        ''
        """
        return warn_of_grades(self.grades, self.status, self.depth_error.tolist(), frames)

    def _number(self, frame: int) -> int:
        number = index(frame)
        if not 0 <= number < len(self):
            raise OutOfRangeError(f"frame is {frame}: expected 0 to {len(self) - 1}")
        return number

    def _require_one_piece(self, frames: Sequence[int]) -> None:
        pieces = sorted({int(self.piece[frame]) for frame in frames} - {-1})
        if len(pieces) > 1:
            raise InputError(f"frames are in pieces {pieces}: give frames of one piece and scale")
