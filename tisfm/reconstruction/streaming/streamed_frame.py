"""A frame of an endless sequence, with its pose and depth."""

from dataclasses import dataclass, field

import numpy as np

from tisfm.camera import Camera
from tisfm.grade import Grade, grade_depth
from tisfm.reconstruction.result.calibration import GIVEN, Calibration
from tisfm.status import Status


@dataclass(frozen=True, kw_only=True, eq=False)
class StreamedFrame:
    """A frame of a stream, with its camera pose and depth.

    Attributes
    ----------
    index : int
        Number of the frame in the source, from 0; frames that are left out count.
    name : str
    time : float or None
        Time of the frame, s.
    pose : (4, 4) float64
        Camera to world: X right, Y down, Z forward. The first frame of a piece is the identity. NaN
        for a frame without a pose.
    piece : int
        Number of the piece that the frame belongs to; −1 for a frame without a pose. Each piece has
        a scale of its own, in which the median depth of its first keyframe is 1.
    status : Status
        ``"converged"`` if the frame has a pose and depth; ``"uncertain"`` if its depth is expected
        to be off by more than 10 %; ``"contradicted"`` if the image motion contradicts the path;
        with a message.
    keyframe : bool
        Whether its depth was found by matching with several other frames. Otherwise the depth was
        rendered from keyframes.
    inverse_depth, inverse_depth_std : (H, W) float32
        Inverse depth, 1/unit of the poses, and its standard deviation; NaN and infinity where depth
        is unknown. The deviation is infinite at masked pixels too: their depth comes from the
        pixels around them.
    picture : (H, W) or (H, W, 3) uint8
        The frame without distortion, RGB.
    camera : Camera
        The pinhole camera of the frame.
    calibration : Calibration
        Origin of its focal length, as for `Reconstruction`.
    depth_error, depth_share : float
        Expected relative error of its depth, and the share of its pixels that are expected to be
        off by at most 10 %, as for `Reconstruction`; NaN and 0 without depth.

    Examples
    --------
    >>> import tisfm
    >>> from tisfm.scenes import two_blocks
    >>> scene = two_blocks(48, 64)
    >>> stream = tisfm.reconstruct_stream([scene.frame0] * 3, camera=scene.camera)
    >>> for frame in stream:  # a camera at rest shows no path
    ...     print(frame.index, frame.piece, frame.status)
    0 -1 no_motion
    1 -1 no_motion
    2 -1 no_motion
    """

    index: int
    name: str
    time: float | None
    pose: np.ndarray = field(repr=False)
    piece: int
    status: Status
    keyframe: bool
    inverse_depth: np.ndarray = field(repr=False)
    inverse_depth_std: np.ndarray = field(repr=False)
    picture: np.ndarray = field(repr=False)
    camera: Camera = field(repr=False)
    calibration: Calibration = field(repr=False, default=GIVEN)
    depth_error: float = float("nan")
    depth_share: float = field(repr=False, default=0.0)

    @property
    def grade(self) -> Grade:
        """How far its pose and depth can be trusted."""
        return Grade.NO_POSE if self.piece < 0 else grade_depth(self.status, self.depth_error)

    @property
    def depth(self) -> np.ndarray:
        """Depth, (H, W) float32, in the unit of the poses; NaN where it is unknown."""
        depth = np.full_like(self.inverse_depth, np.nan)
        np.divide(1, self.inverse_depth, out=depth, where=self.inverse_depth > 0)
        return depth
