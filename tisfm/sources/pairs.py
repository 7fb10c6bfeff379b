"""Pairs of consecutive frames."""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
import numpy.typing as npt

from tisfm.camera import Camera
from tisfm.interpretation import Interpretation
from tisfm.settings import FixedPixels, FocalOrigin, Settings
from tisfm.window import Window


@dataclass(frozen=True, kw_only=True)
class FramePair:
    """Two consecutive frames of a source."""

    # name0, name1: names of the frames: file stems, or names with frame numbers
    name0: str
    name1: str
    # frame0, frame1: (H, W) or (H, W, 3) array
    frame0: np.ndarray
    frame1: np.ndarray
    # (4, 4) array_like or None: known motion of the camera, as for `tisfm.interpret`
    pose: npt.ArrayLike | None = None
    # Whether float frames with values from 0 to 1 are scaled to 0 to 255. False after a frame of
    # the source had larger values: then all frames of the source are on the 8-bit scale.
    scales_unit_range: bool = True
    # height and width before cropping and shrinking, px; None if the frames are unchanged
    full_shape: tuple[int, int] | None = None
    # times of the frames, s; None if unknown
    times: tuple[float, float] | None = None
    # ignored0, ignored1: (H, W) bool array: true for ignored pixels; None if a frame has none
    ignored0: np.ndarray | None = None
    ignored1: np.ndarray | None = None
    # Distance of the second frame from the first, in frames of the source. The readout time is a
    # share of the time between neighbouring frames of the source: it is divided by this interval.
    interval: int = 1
    index: int = 0  # number of the first frame in the source
    _digests: tuple["Digest", "Digest"] | None = field(default=None, repr=False, compare=False)

    def interpret(
        self,
        *,
        camera: Camera | None = None,
        settings: Settings | None = None,
        window: Window | None = None,
        fixed_pixels: FixedPixels = "mask",
        focal_origin: FocalOrigin | None = None,
    ) -> Interpretation:
        """Interpret the pair. Errors contain the names of the frames.

        `fixed_pixels` is as for `tisfm.interpret`, `focal_origin` as for
        `tisfm.pair.interpret_pair`. `window`, for motion ``"field"``, contains the result of the
        previous pair, and after the call the result of this pair.
        """
        from tisfm.pair import interpret, interpret_pair

        if camera is not None and camera.readout and self.interval > 1:
            camera = replace(camera, readout=camera.readout / self.interval)
        ignored = self.ignored0, self.ignored1
        interpret_frames: Callable[..., Interpretation] = interpret
        is_plain = self.scales_unit_range and all(mask is None for mask in ignored)
        has_usual_origin = focal_origin in (None, "guessed" if camera is None else "stated")
        if window is not None:
            window.begin(self.interval)
        if not is_plain or not has_usual_origin or window is not None:
            interpret_frames = partial(
                interpret_pair,
                scales_unit_range=self.scales_unit_range,
                ignored=ignored,
                window=window,
                focal_origin=focal_origin,
            )
        try:
            return interpret_frames(
                self.frame0,
                self.frame1,
                camera=camera,
                settings=settings,
                pose=self.pose,
                fixed_pixels=fixed_pixels,
            )
        except (TypeError, ValueError) as error:
            error.args = (f"frames {self.name0} and {self.name1}: {error}",)
            raise

    def store(self, window: Window, result: Interpretation, *, camera: Camera | None) -> None:
        """Store a result of `interpret` in the window, as `interpret` with a window does."""
        from tisfm.pair import store_pair

        window.begin(self.interval)
        store_pair(
            window,
            result,
            self.frame0,
            self.frame1,
            camera=camera,
            ignored=(self.ignored0, self.ignored1),
            scales_unit_range=self.scales_unit_range,
        )

    @property
    def digest(self) -> str:
        """A short hash of both frames, and of their masks and the pose, if any."""
        pair_hash = hashlib.blake2b(digest_size=8)
        for frame in self._digests or (Digest(self.frame0), Digest(self.frame1)):
            pair_hash.update(frame.value)
        for ignored in (self.ignored0, self.ignored1):
            if ignored is not None:
                pair_hash.update(Digest(ignored).value)
        if self.pose is not None:
            pair_hash.update(np.array(self.pose, np.float64).tobytes())
        return pair_hash.hexdigest()


class Digest:
    """The hash of a frame, computed once for the two pairs that contain the frame."""

    def __init__(self, frame: np.ndarray) -> None:
        self._frame: np.ndarray | None = frame
        self._value = b""

    @property
    def value(self) -> bytes:
        """The hash, 16 bytes. The first access computes the hash and releases the frame."""
        frame = self._frame
        if frame is not None:
            frame_hash = hashlib.blake2b(f"{frame.shape} {frame.dtype}".encode(), digest_size=16)
            frame_hash.update(np.ascontiguousarray(frame).reshape(-1).data)
            self._value, self._frame = frame_hash.digest(), None
        return self._value
