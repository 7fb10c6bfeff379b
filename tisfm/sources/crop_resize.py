"""Cropping and shrinking of frames, and of their masks, labels and cameras."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from tisfm.camera import Camera
from tisfm.errors import InputError
from tisfm.frames import MIN_SIDE, check_frame
from tisfm.sources.frame_reader import is_integer


@dataclass(frozen=True, kw_only=True)
class CropResize:
    """A crop of a frame, and the size of the frame after shrinking.

    Raises TypeError, ValueError if the values are not integers, or are too small.
    """

    # (int, int, int, int): left, top, width and height of the crop, px of the frame. By default the
    # whole frame.
    crop: tuple[int, int, int, int] | None = None
    # Longer side of the result, px. A larger crop is shrunk to this side by averaging over areas,
    # with the same scale along both axes. A smaller crop keeps its size.
    size: int | None = None

    def __post_init__(self) -> None:
        if self.crop is not None:
            object.__setattr__(self, "crop", _check_crop(self.crop))
        if self.size is not None and not (is_integer(self.size) and self.size >= MIN_SIDE):
            raise InputError(
                f"size is {self.size!r}: expected the longer side as a whole number of px, at "
                f"least {MIN_SIDE}"
            )

    @property
    def keeps_frames(self) -> bool:
        """Whether frames are neither cropped nor shrunk."""
        return self.crop is None and self.size is None

    def apply(
        self,
        frame: np.ndarray,  # (H, W) or (H, W, 3) array: uint8, uint16 or float. Not modified.
        name: str,  # name of the frame in messages
    ) -> np.ndarray:
        """Return a frame, cropped and shrunk.

        Raises TypeError, ValueError if the array is not a frame, does not contain the crop, or
        becomes too small.
        """
        image = check_frame(frame, name)
        crop = image[self._crop_slices(image.shape, name)]
        scale = self._scale(crop.shape, name)
        if scale == 1:
            return np.ascontiguousarray(crop)
        dtype = image.dtype
        # OpenCV can shrink uint8, uint16, float32 and float64; other types are converted.
        if dtype not in (np.uint8, np.uint16):
            crop = crop.astype(np.float32 if dtype.itemsize <= 4 else np.float64)
        return _shrink(crop, scale).astype(dtype, copy=False)

    def apply_to_mask(self, ignored: NDArray[np.bool_], name: str) -> NDArray[np.bool_]:
        """Return the ignored pixels of the result: pixels with any ignored source pixel."""
        crop = ignored[self._crop_slices(ignored.shape, name)]
        scale = self._scale(crop.shape, name)
        if scale == 1:
            return np.ascontiguousarray(crop)
        return _shrink(crop.astype(np.float32), scale) > 0

    def apply_to_labels(self, labels: NDArray[np.uint8], name: str) -> NDArray[np.uint8]:
        """Return the labels of the result: each is the label of the nearest source pixel."""
        crop = labels[self._crop_slices(labels.shape, name)]
        scale = self._scale(crop.shape, name)
        if scale == 1:
            return np.ascontiguousarray(crop)
        size = _shrink(np.empty(crop.shape, np.uint8), scale).shape[::-1]
        return cv2.resize(crop, size, interpolation=cv2.INTER_NEAREST_EXACT).astype(np.uint8)

    def camera_after(
        self,
        camera: Camera,  # Camera of the whole frame. Its distortion stays the same.
        # height and width of the whole frame, px
        height: int,
        width: int,
    ) -> Camera:
        """Return the camera of the cropped and shrunk frame."""
        rows, columns = self._crop_slices((height, width), "the frame")
        cx, cy = camera.center_for(height, width)
        readout_share = (rows.stop - rows.start) / height  # of the readout time of the whole frame
        cropped_camera = replace(
            camera,
            center=(cx - columns.start, cy - rows.start),
            readout=None if camera.readout is None else readout_share * camera.readout,
        )
        height, width = rows.stop - rows.start, columns.stop - columns.start
        scale = self._scale((height, width), "the frame")
        return cropped_camera if scale == 1 else cropped_camera.scaled(scale, height, width)

    def _crop_slices(self, shape: tuple[int, ...], name: str) -> tuple[slice, slice]:
        height, width = shape[:2]
        left, top, crop_width, crop_height = self.crop or (0, 0, width, height)
        if left + crop_width > width or top + crop_height > height:
            raise InputError(
                f"crop is {self.crop}, but {name} is {width} px wide and {height} px high: "
                "expected (left, top, width, height) inside it"
            )
        return slice(top, top + crop_height), slice(left, left + crop_width)

    def _scale(self, shape: tuple[int, ...], name: str) -> float:
        height, width = shape[:2]
        if self.size is None or self.size >= max(height, width):
            return 1.0
        scale = self.size / max(height, width)
        if round(min(height, width) * scale) < MIN_SIDE:
            raise InputError(
                f"size is {self.size}, which leaves less than {MIN_SIDE} px of the shorter side "
                f"of {name}, {height} × {width} px: give a larger size"
            )
        return scale


def _shrink(image: np.ndarray, scale: float) -> np.ndarray:
    """Return an image shrunk by averaging.

    The sides are rounded, but the scale is the same along both axes, and so is the focal length.
    """
    return cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)


def _check_crop(crop: Iterable[int]) -> tuple[int, int, int, int]:
    values = tuple(crop) if isinstance(crop, Iterable) else ()
    if len(values) != 4 or not all(map(is_integer, values)):
        raise InputError(
            f"crop is {crop!r}: expected four whole numbers, (left, top, width, height), in px"
        )
    left, top, width, height = map(int, values)
    if min(left, top) < 0 or min(width, height) < MIN_SIDE:
        raise InputError(
            f"crop is {(left, top, width, height)}: expected (left, top, width, height) with a "
            f"corner inside the frame and at least {MIN_SIDE} px each way"
        )
    return left, top, width, height
