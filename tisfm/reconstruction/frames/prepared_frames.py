"""Frames prepared for all stages: grey levels without distortion, stored on disk."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from tisfm.camera import Camera
from tisfm.errors import InputError
from tisfm.formats import atomic_write
from tisfm.formats.atomic import copy_file
from tisfm.formats.npz import write_npy
from tisfm.frames import check_frame, grey_pair, to_eight_bit
from tisfm.lens import Undistortion
from tisfm.reconstruction.frames.settings import FRAME_FLOW
from tisfm.reconstruction.result.folder import (
    delete_labels,
    read_labels,
    read_picture,
    write_labels,
)
from tisfm.resampling import Resampling, ZoomRemoval
from tisfm.shutter import GlobalShutterFrameMap, RollingShutterMotion
from tisfm.solver.pixel_masks import fill_ignored
from tisfm.sources.frame_reader import SourceFrame

if TYPE_CHECKING:
    from tisfm.reconstruction.frames.image_motion import FlowCache

JPEG_QUALITY = 95  # from 0 to 100: colours are read from these pictures; set by hand
CACHED_FRAMES = 24  # number of frames in memory at a time; set by hand


@dataclass(frozen=True, kw_only=True)
class FrameState:
    """The state of a stored frame."""

    is_masked: bool = False  # whether the frame has ignored pixels
    is_labelled: bool = False  # whether the frame shows a moving object
    # Whether the correction of the frame may be replaced. Then its uncorrected files are stored
    # too.
    is_provisional: bool = False


class PreparedFrames:
    """The frames of a sequence: read from the source once, and later from a folder.

    `add` stores a frame without the distortion of its camera. Corrections that are estimated later
    rewrite stored frames. `correct` is final. `correct_provisionally` can be undone until
    `finalise_corrections` is called. Both resample labels too. `set_labels` is possible at any
    time.
    """

    def __init__(
        self,
        camera: Camera,  # camera of the source's frames
        cache: Path,  # folder for grey levels; it may be deleted after the reconstruction
        pictures: Path,  # folder for pictures, (H, W[, 3]) with 8 bits
        *,
        are_labels_prepared: bool = False,  # whether labels fit these frames without resampling
    ) -> None:
        self.camera = camera.pinhole()  # the pinhole of the prepared frames
        self.shape = (0, 0)  # height and width, px; (0, 0) before the first frame
        self.count = 0
        self._lens: Undistortion | None = None
        self._are_labels_prepared = are_labels_prepared
        self._source_camera, self._cache, self._pictures = camera, cache, pictures
        self._cached_frames: dict[int, np.ndarray] = {}
        self._states: dict[int, FrameState] = {}
        self._flow_cache: FlowCache | None = None

    def add(self, frame: SourceFrame) -> tuple[np.ndarray, np.ndarray | None]:
        """Prepare and store a frame; return it in the form for the tracker.

        Returns grey levels, (H, W) uint8; and ignored pixels, (H, W) bool, or None.

        Raises TypeError, ValueError if `tisfm.frames.check_frame` refuses the frame.
        """
        number = self.count
        self._states[number] = FrameState()
        image = check_frame(frame.image, frame.name)
        grey, _ = grey_pair(image, image, scales_unit_range=frame.scales_unit_range)
        picture = to_eight_bit(image, image, scales_unit_range=frame.scales_unit_range)
        ignored, labels = frame.ignored, frame.labels
        if ignored is not None and ignored.any():
            grey = fill_ignored(grey, ignored)
        if not self._source_camera.is_pinhole:
            if self._lens is None:
                self._lens = Undistortion(self._source_camera, *grey.shape)
            grey, picture = self._lens.apply(grey), self._lens.apply(picture)
            if ignored is not None:
                ignored = self._lens.apply_nearest(ignored.astype(np.float32)) > 0
            if labels is not None and not self._are_labels_prepared:
                labels = _resample_labels(labels, self._lens)
            is_outside = ~self._lens.valid
            ignored = is_outside if ignored is None else ignored | is_outside
        self.shape = grey.shape
        levels = np.rint(grey).clip(0, 255).astype(np.uint8)
        write_npy(self._grey_path(number), levels if (levels == grey).all() else grey)
        if ignored is not None:
            self._write_mask(number, ignored)
        write_picture(self._picture_path(number), picture)
        if labels is not None:
            self.set_labels(number, labels)
        self.count += 1
        return levels, ignored

    def correct(
        self,
        camera: Camera,  # camera of the prepared frames, with the distortion that they still have
        # the motion of frames while their rows were read
        rolling: RollingShutterMotion | None = None,
        # (N,) float64: focal length of each frame over that of the first frame
        zoom: np.ndarray | None = None,
        # (H, W) bool: pixels that are fixed on the sensor, and ignored
        fixed: np.ndarray | None = None,
    ) -> np.ndarray | None:
        """Remove the zoom, the distortion, and then the readout effect, found after reading.

        The stored frames are resampled, and written again.

        Returns (H, W) bool: the pixels of the corrected frames that are ignored in every frame, and
        are fixed on the sensor in at least one frame; None without `fixed`.
        """
        self.camera = camera.pinhole()
        has_lens = not camera.is_pinhole and self.count > 0
        lens = Undistortion(camera, *self.shape) if has_lens else None
        center = self.camera.center_for(*self.shape)
        in_all, in_any = np.ones(self.shape, bool), np.zeros(self.shape, bool)
        for number in range(self.count):
            steps: list[Resampling] = []
            if zoom is not None:
                steps.append(ZoomRemoval(float(zoom[number]), center, self.shape))
            if lens is not None:
                steps.append(lens)
            if rolling is not None and number in rolling.rates:
                steps.append(GlobalShutterFrameMap(rolling, number, self.shape))
            for step in steps:
                self._resample(number, step)
            if fixed is not None:
                is_fixed, is_outside = _move_mask(fixed, steps)
                in_all &= is_fixed | is_outside
                in_any |= is_fixed
        if rolling is not None:
            self.camera = replace(self.camera, readout=0.0)
        return None if fixed is None else in_all & in_any

    def correct_provisionally(self, rolling: RollingShutterMotion | None) -> None:
        """Remove the readout effect of a first estimate; provisional corrections are undone first.

        With None, nothing more is done. The readout time of `camera` stays.
        """
        for number in self.provisional_frames():
            for path in self._paths(number):
                if _uncorrected_file(path).exists():
                    _uncorrected_file(path).replace(path)
                else:
                    path.unlink(missing_ok=True)
            self._cached_frames.pop(number, None)
            is_masked = self._mask_path(number).exists()
            self._change_state(number, is_masked=is_masked, is_provisional=False)
        if rolling is None:
            return
        for number in sorted(rolling.rates):
            for path in self._paths(number):
                if path.exists():
                    copy_file(path, _uncorrected_file(path))
            self._change_state(number, is_provisional=True)
            self._resample(number, GlobalShutterFrameMap(rolling, number, self.shape))

    def provisional_frames(self) -> list[int]:
        """Return the frames whose correction may be replaced, in order."""
        return sorted(number for number, state in self._states.items() if state.is_provisional)

    def ignore(self, mask: np.ndarray) -> None:
        """Ignore more pixels, (H, W) bool, in all frames.

        The image motion that was computed before stays: filled pixels have no motion of their own.
        """
        for number in range(self.count):
            ignored = self.ignored(number)
            ignored = mask if ignored is None else ignored | mask
            grey = fill_ignored(self.grey(number), ignored)
            self._cached_frames.pop(number)
            write_npy(self._grey_path(number), grey)
            self._write_mask(number, ignored)

    def finalise_corrections(self, last: int) -> None:
        """Make the correction of the frames up to `last` final."""
        for number in self.provisional_frames():
            if number <= last:
                self._delete_uncorrected(number)
                self._change_state(number, is_provisional=False)

    def flow(self, number: int) -> np.ndarray | None:
        """Return the image motion from the previous frame to a frame; None for the first frame.

        The motion is computed once (`FlowCache.flow_to`), and again after frames were corrected.
        """
        return None if number == 0 else self._flows().flow_to(number)

    def keep_flow(self, number: int, flow: np.ndarray) -> None:
        """Store the image motion from the previous frame, as `flow` would compute it.

        Only the first frames are kept, for the checks of short films; longer ones would fill the
        disk.
        """
        if number < FRAME_FLOW.max_kept_flows:
            self._flows().keep(number, flow)

    def kept_flow(self, number: int) -> np.ndarray | None:
        """Return the result of `flow` if it is known already; None otherwise."""
        return None if self._flow_cache is None else self._flow_cache.kept_flow_to(number)

    def _flows(self) -> "FlowCache":
        if self._flow_cache is None:
            from tisfm.reconstruction.frames.image_motion import FlowCache

            self._flow_cache = FlowCache(self.camera, lambda frame: self.tracker_input(frame)[0])
        return self._flow_cache

    def _resample(self, number: int, resampling: Resampling) -> None:
        self._flow_cache = None
        ignored = ~resampling.valid
        earlier_ignored = self.ignored(number)
        if earlier_ignored is not None:
            ignored |= resampling.apply_nearest(earlier_ignored.astype(np.float32)) > 0
        grey = self.grey(number)
        self._cached_frames.pop(number)
        write_npy(self._grey_path(number), resampling.apply(grey))
        self._write_mask(number, ignored)
        picture = read_picture(self._pictures.parent, number)
        write_picture(self._picture_path(number), resampling.apply(picture))
        if self._states[number].is_labelled and not self._are_labels_prepared:
            self.set_labels(number, _resample_labels(self.labels(number), resampling))

    def tracker_input(self, number: int) -> tuple[np.ndarray, np.ndarray | None]:
        """Return a frame in the form for the tracker, as `add` does."""
        used_pixels = self.used_pixels(number)
        levels = np.rint(self.grey(number)).clip(0, 255).astype(np.uint8)
        return levels, None if used_pixels is None else ~used_pixels

    def set_labels(self, number: int, labels: np.ndarray) -> bool:
        """Set and write the labels of a frame, (H, W) uint8; later stages ignore labelled pixels.

        Return whether the set of labelled pixels changed. Masked pixels get label 0.
        """
        ignored = self.ignored(number)
        if ignored is not None:
            labels = np.where(ignored, np.uint8(0), labels)
        was_moving = self.labels(number) > 0
        write_labels(self._pictures.parent, number, labels)
        self._change_state(number, is_labelled=bool(labels.any()))
        return not np.array_equal(was_moving, labels > 0)

    def labels(self, number: int) -> np.ndarray:
        """Return the id of the moving object at each pixel, (H, W) uint8; 0 is static."""
        if not self._states[number].is_labelled:
            return np.zeros(self.shape, np.uint8)
        return read_labels(self._pictures.parent, number, self.shape)

    def delete_labels(self) -> None:
        """Delete the labels of all frames: every pixel counts as static again."""
        for number in self._states:
            self._change_state(number, is_labelled=False)
        delete_labels(self._pictures.parent)

    def object_ids(self) -> set[int]:
        """Return the ids of the moving objects in all frames."""
        return {int(k) for number in self._states for k in np.unique(self.labels(number)) if k}

    def ignored(self, number: int) -> np.ndarray | None:
        """Return the masked pixels of a frame, (H, W) bool; None if there are none."""
        if not self._states[number].is_masked:
            return None
        ignored: np.ndarray = np.load(self._mask_path(number))
        return ignored

    def delete(self, number: int) -> None:
        """Delete a frame; the numbers of other frames stay."""
        self._cached_frames.pop(number, None)
        self._states.pop(number, None)
        for path in self._paths(number):
            path.unlink(missing_ok=True)
        self._delete_uncorrected(number)

    def grey(self, number: int) -> np.ndarray:
        """Return a frame, (H, W) float32, grey levels on the 8-bit scale."""
        cached = self._cached_frames.pop(number, None)
        frame: np.ndarray = np.load(self._grey_path(number)) if cached is None else cached
        while len(self._cached_frames) >= CACHED_FRAMES:
            self._cached_frames.pop(next(iter(self._cached_frames)))
        self._cached_frames[number] = frame  # the last entry is the most recently used frame
        return frame.astype(np.float32)

    def used_pixels(self, number: int) -> np.ndarray | None:
        """Return the pixels of a frame that are used, (H, W) bool; None if all are used."""
        ignored = self.ignored(number)
        if self._states[number].is_labelled:
            is_moving = self.labels(number) > 0
            ignored = is_moving if ignored is None else ignored | is_moving
        return None if ignored is None else ~ignored

    def static_pixels(self, number: int) -> np.ndarray:
        """Return the pixels of a frame that count as static, (H, W) bool: all that are used."""
        used_pixels = self.used_pixels(number)
        return np.ones(self.shape, bool) if used_pixels is None else used_pixels

    def _change_state(self, number: int, **changes: Any) -> None:
        self._states[number] = replace(self._states[number], **changes)

    def _write_mask(self, number: int, ignored: np.ndarray) -> None:
        if ignored.any():
            write_npy(self._mask_path(number), ignored)
            self._change_state(number, is_masked=True)

    def _delete_uncorrected(self, number: int) -> None:
        for path in self._paths(number):
            _uncorrected_file(path).unlink(missing_ok=True)

    def _paths(self, number: int) -> tuple[Path, ...]:
        return self._grey_path(number), self._mask_path(number), self._picture_path(number)

    def _grey_path(self, number: int) -> Path:
        return self._cache / f"{number:06d}.npy"

    def _mask_path(self, number: int) -> Path:
        return self._cache / f"{number:06d}_ignored.npy"

    def _picture_path(self, number: int) -> Path:
        return self._pictures / f"{number:06d}.jpg"


def _move_mask(mask: np.ndarray, steps: Sequence[Resampling]) -> tuple[np.ndarray, np.ndarray]:
    """Return a resampled mask, and the pixels outside the frame, both (H, W) bool."""
    is_outside = np.zeros_like(mask)
    for step in steps:
        mask = step.apply_nearest(mask.astype(np.float32)) > 0
        is_outside = ~step.valid | (step.apply_nearest(is_outside.astype(np.float32)) > 0)
    return mask, is_outside


def _resample_labels(labels: np.ndarray, resampling: Resampling) -> np.ndarray:
    """Return resampled labels, (H, W) uint8; 0 outside the frame."""
    return np.nan_to_num(resampling.apply_nearest(labels.astype(np.float32))).astype(np.uint8)


def _uncorrected_file(path: Path) -> Path:
    return path.with_name(f"{path.stem}_read{path.suffix}")


def write_picture(path: Path, picture: np.ndarray) -> None:
    """Write a JPEG picture, (H, W) or (H, W, 3) RGB uint8, completely or not at all."""
    bgr = picture if picture.ndim == 2 else cv2.cvtColor(picture, cv2.COLOR_RGB2BGR)
    is_encoded, jpeg = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    if not is_encoded:
        raise InputError(f"{path} cannot be encoded: the picture is {picture.shape}")
    with atomic_write(path) as file:
        file.write(jpeg.tobytes())
