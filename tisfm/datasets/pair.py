"""A pair of frames with ground truth: the paths of its files, and their contents."""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from tisfm.camera import Camera
from tisfm.datasets.calibration import (
    COLOUR_CAMERA_OFFSET,
    DEPTH_CAMERA,
    KNOWN_CAMERAS,
    Calibration,
    read_calibration,
    read_camera,
    scale_known_camera,
)
from tisfm.datasets.depth_files import (
    MM_PER_METRE,
    read_depth,
    read_disparity,
    reproject_depth,
)
from tisfm.datasets.pose_files import motion_between, read_pose, read_pose_row
from tisfm.formats import FormatError, read_flo, read_image, read_kitti_flow
from tisfm.metrics.valid_pixels import MAX_KNOWN_VALUE

# Motion of the scene from the left to the right view. The baseline is unknown and has length 1.
_STEREO_TRANSLATION = (-1.0, 0.0, 0.0)

TruthFormat = Literal["flo", "kitti", "disparity"]


@dataclass(frozen=True, kw_only=True, eq=False)
class LoadedPair:
    """The frames and the ground truth of a pair.

    Attributes
    ----------
    frame0, frame1 : (H, W) or (H, W, 3) ndarray
        Grey levels or colours (red, green, blue), as stored.
    flow : (H, W, 2) float32 ndarray or None
        True motion (u, v) from frame 0 to frame 1, px; NaN where unknown. None if the dataset has
        no flow.
    depth : (H, W) float32 ndarray or None
        True depth Z of frame 0, in the unit of the dataset, NaN where unknown; with the distortion
        of the camera, if it has any. None if the dataset has no depth.
    pose : (4, 4) float64 ndarray or None
        True motion (R, t; 0, 1) of the static scene, from the camera axes of frame 0 to the axes
        of frame 1, in the unit of the dataset. None if unknown.
    pose_given : bool
        Whether `pose` is an input of the interpretation, as for a rectified stereo pair.
    occlusion : (H, W) bool ndarray or None
        True where a point of frame 0 with known motion is not visible in frame 1. None if unknown.
    sky : (H, W) bool ndarray or None
        True in the sky, which does not move as the scene does; None if unknown.
    camera : Camera or None
        The camera of frame 0; None if unknown.

    Examples
    --------
    >>> from tisfm.datasets import LoadedPair
    >>> from tisfm.scenes import two_blocks
    >>> scene = two_blocks(48, 64)
    >>> loaded = LoadedPair(frame0=scene.frame0, frame1=scene.frame1, camera=scene.camera)
    >>> loaded.flow is None and loaded.depth is None  # there is no ground truth
    True
    """

    frame0: NDArray[Any]
    frame1: NDArray[Any]
    flow: NDArray[np.float32] | None = None
    depth: NDArray[np.float32] | None = None
    pose: NDArray[np.float64] | None = None
    pose_given: bool = False
    occlusion: NDArray[np.bool_] | None = None
    sky: NDArray[np.bool_] | None = None
    camera: Camera | None = None


@dataclass(frozen=True, kw_only=True)
class DatasetPair:
    """The files of a pair of frames and its ground truth. Nothing is read before `load`.

    Attributes
    ----------
    layout : str
        Name of the layout of the dataset, one of `LAYOUTS`.
    dataset : str
        Name of the dataset, after its folder.
    name : str
        Name of the pair within the dataset.
    frame0, frame1 : Path
        The frames.
    truth : Path, optional
        True motion: a .flo file, a KITTI flow PNG, or a disparity.
    truth_format : {"flo", "kitti", "disparity"}
        Format of `truth`. A disparity d is the flow (-d, 0), the depth 1/d, in units of the
        baseline of the two cameras times the focal length, and a camera that moves to the right.
    depth : Path, optional
        True depth: a map of frame 0, with the scale in the calibration, or else in mm. For layouts
        in `KNOWN_CAMERAS`, the map of the depth camera beside the camera of frame 0.
    pose0, pose1 : Path, optional
        Files of the camera poses of the frames; both may be the same file.
    pose_rows : (int, int), optional
        Rows of the poses, for files with one row for each frame.
    occluded, invalid, sky : Path, optional
        Images that are not 0 where a point is not visible in frame 1, where the true motion is
        invalid, and in the sky.
    visible : Path, optional
        The opposite of `occluded`: an image that is not 0 where a point is visible in frame 1; or a
        KITTI flow PNG, which is valid there.
    calibration : Path, optional
        File of the camera: a Sintel .cam, a KITTI calibration text, or, in the layout "calibrated",
        a heading and a line of numbers.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tisfm.datasets import DatasetPair
    >>> pair = DatasetPair(
    ...     layout="middlebury",
    ...     dataset="mine",
    ...     name="Blocks",
    ...     frame0=Path("frame0.png"),
    ...     frame1=Path("frame1.png"),
    ... )
    >>> pair.knows_flow, pair.knows_depth, pair.knows_pose
    (False, False, False)
    >>> pair.load().frame0.shape
    (48, 64)
    """

    layout: str
    dataset: str
    name: str
    frame0: Path
    frame1: Path
    truth: Path | None = None
    truth_format: TruthFormat = "flo"
    depth: Path | None = None
    pose0: Path | None = None
    pose1: Path | None = None
    pose_rows: tuple[int, int] | None = None
    occluded: Path | None = None
    visible: Path | None = None
    invalid: Path | None = None
    sky: Path | None = None
    calibration: Path | None = None

    @property
    def knows_flow(self) -> bool:
        """Whether there is a true flow."""
        return self.truth is not None

    @property
    def knows_depth(self) -> bool:
        """Whether there is a true depth."""
        return self.depth is not None or self.truth_format == "disparity"

    @property
    def knows_pose(self) -> bool:
        """Whether there is a true pose to compare with; the pose of a stereo pair is an input."""
        return self.pose0 is not None

    def load(self) -> LoadedPair:
        """Read the files of the pair.

        Returns
        -------
        LoadedPair
            Frames, ground truth, and masks if any, all of one size.

        Raises
        ------
        FileNotFoundError, OSError
            If a file is missing or cannot be read; the message names it.
        tisfm.formats.FormatError
            A ValueError: if a file is damaged, incomplete or of another format, the files differ
            in size, or flow or depth are unknown everywhere.
        """
        frame0, frame1 = read_image(self.frame0), read_image(self.frame1)
        size = frame0.shape[:2]
        self._require_size(self.frame1, frame1, size)
        flow = None if self.truth is None else self._read_flow(self.truth, size)
        calibration = self._read_calibration(size)
        return LoadedPair(
            frame0=frame0,
            frame1=frame1,
            flow=flow,
            depth=self._read_depth(flow, size, calibration.depth_scale or MM_PER_METRE),
            pose=self._read_pose(),
            pose_given=self.truth_format == "disparity",
            occlusion=self._read_occlusion(flow, size),
            sky=None if self.sky is None else self._read_mask(self.sky, size),
            camera=calibration.camera,
        )

    def _read_flow(self, path: Path, size: tuple[int, ...]) -> NDArray[np.float32]:
        flow = self._read_flow_file(path)
        self._require_size(path, flow, size)
        if self.invalid is not None:
            flow[self._read_mask(self.invalid, size)] = np.nan
        if not np.isfinite(flow).all(axis=2).any():
            pixels = size[0] * size[1]
            raise FormatError(f"{path} has no known motion at any of its {pixels} pixels")
        return flow

    def _read_flow_file(self, path: Path) -> NDArray[np.float32]:
        if self.truth_format == "kitti":
            return read_kitti_flow(path)
        if self.truth_format == "disparity":
            disparity = read_disparity(path)
            zero_motion = np.where(np.isnan(disparity), disparity, np.float32(0))
            return np.stack([-disparity, zero_motion], axis=2)
        flow = read_flo(path)
        # NaN compares as false, so it counts as unknown.
        is_known = (np.abs(flow) <= MAX_KNOWN_VALUE).all(axis=2)
        flow[~is_known] = np.nan
        return flow

    def _read_depth(
        self, flow: NDArray[np.float32] | None, size: tuple[int, ...], scale: float
    ) -> NDArray[np.float32] | None:
        if self.depth is not None:
            depth = read_depth(self.depth, scale)
            self._require_size(self.depth, depth, size)
            if self.layout in KNOWN_CAMERAS:
                depth_camera = scale_known_camera(DEPTH_CAMERA, size[1])
                colour_camera = scale_known_camera(KNOWN_CAMERAS[self.layout], size[1])
                depth = reproject_depth(depth, depth_camera, colour_camera, COLOUR_CAMERA_OFFSET)
        elif flow is not None and self.truth_format == "disparity":
            disparity = -flow[..., 0]
            depth = np.full(disparity.shape, np.nan, np.float32)
            np.divide(1, disparity, out=depth, where=disparity > 0)
        else:
            return None
        if not np.isfinite(depth).any():
            source, pixels = self.depth or self.truth, depth.size
            raise FormatError(f"{source} has no known depth at any of its {pixels} pixels")
        return depth

    def _read_pose(self) -> NDArray[np.float64] | None:
        if self.truth_format == "disparity":
            pose = np.eye(4)
            pose[:3, 3] = _STEREO_TRANSLATION
            return pose
        if self.pose0 is None or self.pose1 is None:
            return None
        if self.pose_rows is None:
            return motion_between(read_pose(self.pose0), read_pose(self.pose1))
        row0, row1 = self.pose_rows
        return motion_between(read_pose_row(self.pose0, row0), read_pose_row(self.pose1, row1))

    def _read_calibration(self, size: tuple[int, ...]) -> Calibration:
        if self.calibration is None:
            camera = KNOWN_CAMERAS.get(self.layout)
            return Calibration(
                camera=None if camera is None else scale_known_camera(camera, size[1])
            )
        if self.layout == "calibrated":
            return read_calibration(self.calibration)
        return Calibration(camera=read_camera(self.calibration, self.frame0))

    def _read_occlusion(
        self, flow: NDArray[np.float32] | None, size: tuple[int, ...]
    ) -> NDArray[np.bool_] | None:
        if self.occluded is not None:
            return self._read_mask(self.occluded, size)
        if self.visible is None or flow is None:
            return None
        has_flow = np.isfinite(flow).all(axis=2)
        return np.asarray(has_flow & ~self._read_visible(self.visible, size))

    def _read_visible(self, path: Path, size: tuple[int, ...]) -> NDArray[np.bool_]:
        if self.truth_format != "kitti":
            return self._read_mask(path, size)
        flow = read_kitti_flow(path)
        self._require_size(path, flow, size)
        return np.asarray(np.isfinite(flow).all(axis=2))

    def _read_mask(self, path: Path, size: tuple[int, ...]) -> NDArray[np.bool_]:
        picture = read_image(path)
        self._require_size(path, picture, size)
        return np.asarray(picture.reshape(*size, -1).any(axis=2))

    def _require_size(
        self, path: str | os.PathLike[str], array: NDArray[Any], size: tuple[int, ...]
    ) -> None:
        if array.shape[:2] != size:
            raise FormatError(
                f"{os.fspath(path)} is {array.shape[0]} × {array.shape[1]} px but {self.frame0} "
                f"is {size[0]} × {size[1]} px: the files of a pair must have the same size"
            )
