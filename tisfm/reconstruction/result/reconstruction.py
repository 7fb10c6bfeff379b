"""The result of a whole sequence: one camera path, and the depth of every frame."""

import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from operator import index
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tisfm.camera import Camera
from tisfm.errors import InputError, OutOfRangeError
from tisfm.grade import Grade, GradeSummary, grade_depth, summarise_grades, warn_of_grades
from tisfm.point_cloud import PointCloud
from tisfm.reconstruction.result.calibration import GIVEN, Calibration
from tisfm.reconstruction.result.folder import (
    read_depth,
    read_labels,
    read_mask,
    read_picture,
    read_record,
)
from tisfm.reconstruction.result.moving_object import MovingObject
from tisfm.reconstruction.result.path_check import PathCheck
from tisfm.reconstruction.result.renewal import TemporaryFolder, copy_folder
from tisfm.reconstruction.result.summary import summarise
from tisfm.settings import Settings
from tisfm.status import Status

if TYPE_CHECKING:
    from tisfm.fusion import DepthView, Mesh


@dataclass(frozen=True, kw_only=True, eq=False)
class Reconstruction:
    """Poses and depth of the frames of a sequence; depth is on disk, and is read on demand.

    Attributes
    ----------
    poses : (N, 4, 4) float64
        Camera to world: X right, Y down, Z forward. The first pose of a piece is the identity,
        unless poses were given. NaN for a frame without a pose. Where the camera only turns
        (`only_turns`), its position is unknown, and 0.
    piece : (N,) int32
        The piece of each frame; −1 for a frame without a pose. Each piece has its own scale: the
        median depth of its first keyframe is 1. Without depth, this holds for the tracks in its
        first frame. Given poses set the scale instead.
    unit : tuple of float
        For every piece, the factor from depth on disk to depth; 1 unless the piece was rescaled.
    status : tuple of Status
        For every frame, with a message: ``"converged"`` if it has a pose, and depth if depth was
        requested; ``"uncertain"`` if its depth is expected to be off by more than 10 %;
        ``"contradicted"`` if it has a pose, and the image motion contradicts the path;
        ``"pure_rotation"`` if its orientation is known, and its position and depth are not.
    depth_error : (N,) float64
        Expected relative error of the depth of each frame: half of the pixels should have a smaller
        error, apart from the unit of the piece. It follows from the deviations of depth and of the
        focal length, and is at most 1. NaN without depth.
    depth_share : (N,) float64
        Share of the pixels of each frame whose depth is expected to be off by at most 10 %,
        masked pixels left out; 0 without depth.
    keyframes : tuple of int
        Frames whose depth was estimated from neighbour frames. The depth of all other frames is
        rendered from the keyframes; holes are filled up to image edges.
    camera : Camera
        The pinhole camera of `depth` and `picture`: of frames that are cropped, shrunk and without
        distortion.
    calibration : Calibration
        Origin and uncertainty of the focal length: ``origin`` (given, estimated or guessed),
        ``focal``, ``focal_std``, ``shape``, ``seen`` and ``message``. Lengths are px of the frames
        of the source, whose height and width is ``shape``.
    zoom : (N,) float64 or None
        Focal length of each frame of the source, divided by that of the first frame; None if it is
        constant. A zoom is removed: `depth` and `picture` of all frames belong to the focal length
        of the first frame. See `focal`.
    settings : Settings
    names : tuple of str
        Names of the frames.
    times : tuple of float or None
        Times of the frames, s, as in the source. If they repeat or decrease, `notes` has a note.
    skipped : tuple of (int, str)
        Frames of the source that could not be read, and the reasons; they have no number in the
        result.
    notes : tuple of str
        Notes on the reading of the source: frames that were left out or resampled, and the reason
        if paths use the numbers of frames instead of times.
    shape : (int, int)
        Height and width of the frames, px.
    folder : Path
        Folder of the files.
    version : str
        Version of tisfm that made the result.
    objects : tuple of MovingObject
        Moving objects, with ``motion="objects"``, in the order of their labels.
    checks : tuple of PathCheck
        For every piece, the checks of its path against the image motion; empty for chunks.

    Examples
    --------
    >>> import tisfm
    >>> result = tisfm.Reconstruction.load("walk")  # from `save` or ``tisfm reconstruct``
    >>> len(result), result.poses.shape, result.shape
    (9, (9, 4, 4), (180, 240))
    >>> [str(status) for status in result.status[:2]], result.piece[:2].tolist()
    (['converged', 'converged'], [0, 0])
    >>> result.depth(2).shape, result.inverse_depth_std(2).shape, result.picture(2).shape
    ((180, 240), (180, 240), (180, 240))
    >>> bool(result.keyframes)
    True
    """

    poses: np.ndarray = field(repr=False)
    piece: np.ndarray = field(repr=False)
    unit: tuple[float, ...] = field(repr=False)
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
    _temporary: TemporaryFolder | None = field(repr=False, default=None)

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

    def inverse_depth(self, frame: int) -> np.ndarray:
        """Return the inverse depth of a frame, (H, W) float32, 1/unit of the poses.

        NaN where there is no depth. Numbers have 11 significant bits.

        Raises
        ------
        IndexError
            If there is no such frame.
        """
        return self._depth_of(frame)[0]

    def inverse_depth_std(self, frame: int) -> np.ndarray:
        """Return the standard deviation of the inverse depth of a frame, (H, W) float32.

        Infinite where there is no depth, and at masked pixels, whose depth is filled from their
        surroundings.
        """
        return self._depth_of(frame)[1]

    def depth(self, frame: int) -> np.ndarray:
        """Return the depth of a frame, (H, W) float32, in the unit of the poses; NaN for none."""
        inverse_depth = self.inverse_depth(frame)
        depth = np.full_like(inverse_depth, np.nan)
        np.divide(1, inverse_depth, out=depth, where=inverse_depth > 0)
        return depth

    def labels(self, frame: int) -> np.ndarray:
        """Return the object id of each pixel of a frame, (H, W) uint8.

        0 is static; other numbers are the ids of `objects`. The labels fit the frame without
        distortion, as `picture`.

        Examples
        --------
        >>> import tisfm
        >>> result = tisfm.Reconstruction.load("bodies")  # of ``motion="objects"``
        >>> result.labels(0).shape, result.labels(0).dtype
        ((180, 240), dtype('uint8'))
        """
        return read_labels(self.folder, self._number(frame), self.shape)

    @property
    def mask(self) -> np.ndarray | None:
        """Pixels that are fixed on the sensor and were masked, (H, W) bool; None if there are none.

        A bonnet, a logo, a caption or a border, found by ``fixed_pixels="mask"`` of
        `tisfm.reconstruct`. Their depth is filled from the surroundings. If a zoom or a readout
        effect was removed, such pixels lie elsewhere in every frame of the result: these are the
        pixels that are masked in all frames.
        """
        return read_mask(self.folder, self.shape)

    def picture(self, frame: int) -> np.ndarray:
        """Return the frame without distortion, (H, W) or (H, W, 3) RGB uint8."""
        return read_picture(self.folder, self._number(frame))

    def points(
        self,
        frames: Iterable[int] | None = None,
        *,
        agreeing: int = 3,
        max_relative_std: float = 0.05,
        voxel: float | None = None,
    ) -> PointCloud:
        """Return coloured points on which several frames agree, in the axes of the world.

        Parameters
        ----------
        frames : iterable of int, optional
            Frames of one piece; by default the keyframes of the largest piece.
        agreeing : int
            Number of frames, the point's own frame included, that have to agree on a point within
            their deviations; and not more frames may see through the point.
        max_relative_std : float
            Largest relative deviation of inverse depth; less certain pixels are left out.
        voxel : float, optional
            Side of the cubes that keep one point each, in the unit of the poses.

        Returns
        -------
        PointCloud
            The positions are (M, 3) float32, in the unit of the poses.

        Raises
        ------
        IndexError, ValueError
            If a frame does not exist, frames are of several pieces, or an option is out of its
            range.

        Examples
        --------
        >>> import tisfm
        >>> cloud = tisfm.Reconstruction.load("walk").points()
        >>> cloud.positions.shape[1], cloud.colors.shape[1], len(cloud) > 1000
        (3, 3, True)
        >>> cloud.save("scene.ply")
        """
        from tisfm.fusion import fused_points

        views = self._views(frames)
        count = min(agreeing, max(1, len(views)))
        points = fused_points(views, agreeing=count, max_relative_std=max_relative_std, voxel=voxel)
        return replace(points, note=self.warning(views.frames))

    def mesh(
        self,
        frames: Iterable[int] | None = None,
        *,
        agreeing: int = 3,
        max_relative_std: float = 0.03,
        voxel: float | None = None,
        truncation: float | None = None,
    ) -> "Mesh":
        """Return the surface on which several frames agree, as coloured triangles.

        It needs scikit-image: ``pip install 'tisfm[mesh]'``.

        Parameters
        ----------
        frames, agreeing
            As for `points`.
        max_relative_std : float
            Largest relative deviation of depth; less certain depth is left out, such as depth that
            was propagated far over walls without texture.
        voxel : float, optional
            Side of the voxels, in the unit of the poses; by default 2 px at the median depth, or
            half the median deviation of depth if this is larger.
        truncation : float, optional
            Largest distance from a surface at which distances are stored.

        Returns
        -------
        Mesh
            With ``vertices``, ``faces``, ``colors``, and ``save(path)`` for ``.ply`` or ``.glb``.

        Raises
        ------
        ImportError
            If scikit-image is not installed.
        IndexError, ValueError
            As for `points`; or if voxels are too small for the memory (the message names a size).

        Examples
        --------
        >>> import tisfm
        >>> surface = tisfm.Reconstruction.load("walk").mesh()
        >>> surface.save("scene.glb")
        """
        from tisfm.fusion import fused_mesh

        views = self._views(frames)
        count = min(agreeing, max(1, len(views)))
        surface = fused_mesh(
            views,
            agreeing=count,
            max_relative_std=max_relative_std,
            voxel=voxel,
            truncation=truncation,
        )
        return replace(surface, note=self.warning(views.frames))

    def rescaled(self, frame0: int, frame1: int, distance: float) -> "Reconstruction":
        """Return the result in a unit in which the camera moved by `distance` between two frames.

        Parameters
        ----------
        frame0, frame1 : int
            Two frames of one piece; other pieces keep their scales.
        distance : float
            Distance between the camera positions, in the new unit.

        Raises
        ------
        ValueError
            If a frame has no pose, the frames are of two pieces or have one position, or the
            distance is not positive.

        Examples
        --------
        >>> import numpy as np
        >>> import tisfm
        >>> result = tisfm.Reconstruction.load("walk")
        >>> metres = result.rescaled(0, 8, 1.04)  # the camera moved by 1.04 m from frame 0 to 8
        >>> round(float(np.linalg.norm(metres.poses[8, :3, 3] - metres.poses[0, :3, 3])), 6)
        1.04
        """
        number0, number1 = self._number(frame0), self._number(frame1)
        for frame in (number0, number1):
            if self.piece[frame] < 0:
                raise InputError(f"frame {frame} has no pose: give two frames with poses")
        self._require_one_piece([number0, number1])
        if not (np.isfinite(distance) and distance > 0):
            raise InputError(f"distance is {distance}: expected a positive length")
        piece, poses = int(self.piece[number0]), self.poses.copy()
        length = float(np.linalg.norm(poses[number0, :3, 3] - poses[number1, :3, 3]))
        if length == 0:
            raise InputError(
                f"frames {number0} and {number1} have one camera position: give others"
            )
        factor = distance / length
        poses[self.piece == piece, :3, 3] *= factor
        objects = tuple(obj.rescaled(factor, self.piece == piece) for obj in self.objects)
        unit = tuple(u * factor if k == piece else u for k, u in enumerate(self.unit))
        return replace(self, poses=poses, unit=unit, objects=objects)

    def save(self, folder: str | os.PathLike[str]) -> None:
        """Copy the result to a folder, which is complete once it has a ``reconstruction.json``.

        Parameters
        ----------
        folder : path
            A new or empty folder, or a folder with an earlier reconstruction, which is replaced.

        Raises
        ------
        FileExistsError
            If the folder has other files.
        OSError
            If the folder cannot be written to.

        Examples
        --------
        >>> import tisfm
        >>> result = tisfm.Reconstruction.load("walk")
        >>> result.save("copy")
        """
        copy_folder(self, folder)

    @classmethod
    def load(cls, folder: str | os.PathLike[str]) -> "Reconstruction":
        """Open a folder that `save` or ``tisfm reconstruct`` wrote; depth is read on demand.

        Raises
        ------
        FileNotFoundError
            If it is not the folder of a complete reconstruction.
        tisfm.formats.FormatError
            A ValueError: if a file is damaged, or of a format that this version cannot read.

        Examples
        --------
        >>> import tisfm
        >>> result = tisfm.Reconstruction.load("walk")  # depth is read on demand
        >>> result.depth(0).shape
        (180, 240)
        """
        return cls(**read_record(folder), folder=Path(folder).absolute())

    def _depth_of(self, frame: int) -> tuple[np.ndarray, np.ndarray]:
        number = self._number(frame)
        inverse_depth, deviation = read_depth(self.folder, number, self.shape)
        unit = np.float32(self.unit[self.piece[number]] if self.piece[number] >= 0 else 1)
        return inverse_depth / unit, deviation / unit

    def _number(self, frame: int) -> int:
        number = index(frame)
        if not 0 <= number < len(self):
            raise OutOfRangeError(f"frame is {frame}: expected 0 to {len(self) - 1}")
        return number

    def _views(self, frames: Iterable[int] | None) -> "_Views":
        if frames is None:
            largest = self.largest_piece
            return _Views(self, [k for k in self.keyframes if self.piece[k] == largest])
        numbers = [self._number(frame) for frame in frames]
        self._require_one_piece(numbers)
        return _Views(self, [frame for frame in numbers if self.piece[frame] >= 0])

    def _require_one_piece(self, frames: Sequence[int]) -> None:
        pieces = sorted({int(self.piece[frame]) for frame in frames} - {-1})
        if len(pieces) > 1:
            raise InputError(f"frames are in pieces {pieces}: give frames of one piece and scale")


class _Views(Sequence["DepthView"]):
    """Frames for fusion, read on demand."""

    def __init__(self, result: Reconstruction, frames: list[int]) -> None:
        self._result, self.frames = result, frames

    def __len__(self) -> int:
        return len(self.frames)

    def __getitem__(self, index: Any) -> Any:
        from tisfm.fusion import DepthView

        frame, result = self.frames[index], self._result
        inverse_depth, deviation = result._depth_of(frame)
        return DepthView(
            inverse_depth=inverse_depth,
            inverse_depth_std=deviation,
            pose=result.poses[frame],
            frame=result.picture(frame),
            camera=result.camera,
        )
