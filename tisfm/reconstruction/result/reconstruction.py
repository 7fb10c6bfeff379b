"""The result of a whole sequence: one camera path, and the depth of every frame."""

import os
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from tisfm.errors import InputError
from tisfm.reconstruction.result.folder import read_record
from tisfm.reconstruction.result.renewal import TemporaryFolder, copy_folder
from tisfm.reconstruction.result.stored_frames import StoredFrames


@dataclass(frozen=True, kw_only=True, eq=False)
class Reconstruction(StoredFrames):
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
    position_deviation, rotation_deviation : (N, 3) float64
        Standard deviations of the position along X, Y and Z of the camera, in the unit of the
        poses, and of the rotation about these axes, in degrees. They hold after the best alignment
        of the piece with the true path: a similarity for positions, a rotation for rotations. They
        include errors of the tracks, and of the focal length unless it was given. 0 for given
        poses. NaN without a pose, where the camera only turns, where few tracks link frames, and
        where rounding errors hide the variance. In chunks, in a piece with more than 300 frames,
        and where parts without common tracks were joined by their images, they hold after the
        alignment of the part around the frame: errors between parts are not included. If poses are
        adjusted to the images afterwards, the deviations are those before. In front of a single
        plane, every preset does so: errors become a half to a tenth, and the deviations are too
        large. In other scenes, the preset ``accurate`` does. They do not hold for a contradicted
        path. A stream has none.
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
        For every piece, the checks of its path against the image motion; a piece that is joined of
        chunks has the checks of all of them.

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

    _temporary: TemporaryFolder | None = field(repr=False, default=None)

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
        deviation = np.where((self.piece == piece)[:, None], factor, 1) * self.position_deviation
        return replace(self, poses=poses, position_deviation=deviation, unit=unit, objects=objects)

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
