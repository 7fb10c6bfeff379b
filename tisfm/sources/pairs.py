"""Pairs of consecutive frames."""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
import numpy.typing as npt

from tisfm.camera import Camera
from tisfm.interpretation import Interpretation
from tisfm.settings import Settings
from tisfm.window import Window


@dataclass(frozen=True, kw_only=True)
class FramePair:
    """Two consecutive frames of a source, with their names (file stems, or frame numbers).

    The pose, if there is one, is a known motion as for `tisfm.interpret`. `stretch` is False where
    the frames so far show that float frames of the source are on the 8-bit scale, though those of
    this pair may look as if they were in [0, 1]. `full` is height and width of the frames before
    they were cropped or shrunk, px, or None where they were not. `times` is when they were taken,
    s, or None where the source does not say. `ignored0` and `ignored1`, (H, W) bool, are the pixels
    of the frames that do not count, or None where all do. `interval` is how many frames of the
    source it is from the first, whose number there is `index`, to the second: by it a camera's
    readout is counted.
    """

    name0: str
    name1: str
    frame0: np.ndarray
    frame1: np.ndarray
    pose: npt.ArrayLike | None = None
    stretch: bool = True
    full: tuple[int, int] | None = None
    times: tuple[float, float] | None = None
    ignored0: np.ndarray | None = None
    ignored1: np.ndarray | None = None
    interval: int = 1
    index: int = 0
    _digests: tuple["Digest", "Digest"] | None = field(default=None, repr=False, compare=False)

    def interpret(
        self,
        *,
        camera: Camera | None = None,
        settings: Settings | None = None,
        window: Window | None = None,
    ) -> Interpretation:
        """Interpret the pair; errors name its frames.

        `window`, for motion ``"field"``, has what is known of the pair before, and then of this.
        """
        from tisfm.pair import interpret, interpret_pair

        if camera is not None and camera.readout and self.interval > 1:
            camera = replace(camera, readout=camera.readout / self.interval)
        ignored = self.ignored0, self.ignored1
        work: Callable[..., Interpretation] = interpret
        if not self.stretch or any(part is not None for part in ignored):
            work = partial(interpret_pair, stretch=self.stretch, ignored=ignored)
        if window is not None:
            window.begin(self.interval)
            work = partial(interpret_pair, stretch=self.stretch, ignored=ignored, window=window)
        try:
            return work(self.frame0, self.frame1, camera=camera, settings=settings, pose=self.pose)
        except (TypeError, ValueError) as error:
            error.args = (f"frames {self.name0} and {self.name1}: {error}",)
            raise

    def keep(self, window: Window, result: Interpretation, *, camera: Camera | None) -> None:
        """Keep for the next pair what `interpret` keeps that made this result with this camera."""
        from tisfm.pair import keep_pair

        window.begin(self.interval)
        keep_pair(
            window,
            result,
            self.frame0,
            self.frame1,
            camera=camera,
            ignored=(self.ignored0, self.ignored1),
            stretch=self.stretch,
        )

    @property
    def digest(self) -> str:
        """A short hash of both frames, to know them again by.

        And of their masks and the pose, if there are such.
        """
        both = hashlib.blake2b(digest_size=8)
        for frame in self._digests or (Digest(self.frame0), Digest(self.frame1)):
            both.update(frame.value)
        for ignored in (self.ignored0, self.ignored1):
            if ignored is not None:
                both.update(Digest(ignored).value)
        if self.pose is not None:
            both.update(np.array(self.pose, np.float64).tobytes())
        return both.hexdigest()


class Digest:
    """The hash of a frame, computed once though the frame is in two pairs."""

    def __init__(self, frame: np.ndarray) -> None:
        self._frame: np.ndarray | None = frame
        self._value = b""

    @property
    def value(self) -> bytes:
        """Eight bytes or more that differ between frames."""
        frame = self._frame
        if frame is not None:
            pixels = hashlib.blake2b(f"{frame.shape} {frame.dtype}".encode(), digest_size=16)
            pixels.update(np.ascontiguousarray(frame).reshape(-1).data)
            self._value, self._frame = pixels.digest(), None
        return self._value
