"""One pair of frames and what is known about its motion: where it lies, and what it holds."""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from tisfm.camera import Camera
from tisfm.datasets.calibration import read_camera
from tisfm.datasets.disparity import read_disparity
from tisfm.formats import read_flo, read_image, read_kitti_flow
from tisfm.metrics import UNKNOWN

TruthFormat = Literal["flo", "kitti", "disparity"]


@dataclass(frozen=True, kw_only=True, eq=False)
class LoadedPair:
    """What the files of a pair hold.

    Attributes
    ----------
    frame0, frame1 : (H, W) or (H, W, 3) ndarray
        Grey levels or colours (red, green, blue), as stored.
    flow : (H, W, 2) float32 ndarray
        True motion (u, v) from frame 0 to frame 1, px; NaN where it is unknown.
    occlusion : (H, W) bool ndarray or None
        Where a point of frame 0 is not seen in frame 1, as far as its motion is known. None if
        the dataset does not say.
    sky : (H, W) bool ndarray or None
        Where the sky is, whose motion is not that of a scene; None if the dataset does not say.
    camera : Camera or None
        The camera of frame 0, if the dataset states one.
    """

    frame0: NDArray[Any]
    frame1: NDArray[Any]
    flow: NDArray[np.float32]
    occlusion: NDArray[np.bool_] | None = None
    sky: NDArray[np.bool_] | None = None
    camera: Camera | None = None


@dataclass(frozen=True, kw_only=True)
class DatasetPair:
    """Where a pair of frames and its truth lie. Nothing is read before `load`.

    Attributes
    ----------
    layout : str
        Name of the layout it was recognised by, one of `LAYOUTS`.
    dataset : str
        Name of the dataset, after its folder.
    name : str
        Name of the pair within the dataset.
    frame0, frame1 : Path
        The frames.
    truth : Path
        True motion: a .flo file, a KITTI flow PNG, or a disparity.
    truth_format : {"flo", "kitti", "disparity"}
        Which of these. A disparity d is the flow (-d, 0).
    occluded, invalid, sky : Path, optional
        Pictures that are not 0 where a point is not seen in frame 1, where the truth does not
        count, and where the sky is.
    visible : Path, optional
        The opposite of `occluded`: a picture that is not 0 where a point is seen in frame 1 too;
        of a KITTI flow PNG, where it is valid.
    calibration : Path, optional
        The camera: a Sintel .cam or a KITTI calibration text.
    """

    layout: str
    dataset: str
    name: str
    frame0: Path
    frame1: Path
    truth: Path
    truth_format: TruthFormat = "flo"
    occluded: Path | None = None
    visible: Path | None = None
    invalid: Path | None = None
    sky: Path | None = None
    calibration: Path | None = None

    def load(self) -> LoadedPair:
        """Read the files of the pair.

        Returns
        -------
        LoadedPair
            Frames, true flow, and masks where there are any, all of one size.

        Raises
        ------
        FileNotFoundError, OSError
            If a file is missing or cannot be read; the text names it.
        tisfm.formats.FormatError
            A ValueError: if a file is damaged, incomplete or of another format.
        ValueError
            If the files differ in size, or the flow is unknown everywhere.
        """
        frame0, frame1 = read_image(self.frame0), read_image(self.frame1)
        size = frame0.shape[:2]
        self._require_size(self.frame1, frame1, size)
        flow = self._read_flow()
        self._require_size(self.truth, flow, size)
        if self.invalid is not None:
            flow[self._read_mask(self.invalid, size)] = np.nan
        known = np.isfinite(flow).all(axis=2)
        if not known.any():
            raise ValueError(f"{self.truth} has no known motion at any of its {known.size} pixels")
        occlusion = None
        if self.occluded is not None:
            occlusion = self._read_mask(self.occluded, size)
        elif self.visible is not None:
            occlusion = known & ~self._read_visible(self.visible, size)
        return LoadedPair(
            frame0=frame0,
            frame1=frame1,
            flow=flow,
            occlusion=occlusion,
            sky=None if self.sky is None else self._read_mask(self.sky, size),
            camera=None if self.calibration is None else read_camera(self.calibration, self.frame0),
        )

    def _read_flow(self) -> NDArray[np.float32]:
        if self.truth_format == "kitti":
            return read_kitti_flow(self.truth)
        if self.truth_format == "disparity":
            disparity = read_disparity(self.truth)
            nothing = np.where(np.isnan(disparity), disparity, np.float32(0))
            return np.stack([-disparity, nothing], axis=2)
        flow = read_flo(self.truth)
        # A comparison with NaN is false, as wanted.
        known = (np.abs(flow) <= UNKNOWN).all(axis=2)
        flow[~known] = np.nan
        return flow

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
            raise ValueError(
                f"{os.fspath(path)} is {array.shape[0]} × {array.shape[1]} px but {self.frame0} "
                f"is {size[0]} × {size[1]} px: the files of a pair must have the same size"
            )
