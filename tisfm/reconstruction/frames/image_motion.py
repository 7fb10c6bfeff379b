"""Image motion between neighbouring frames, forward and backward, and chains over more frames."""

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from tisfm.camera import Camera
from tisfm.reconstruction.frames.disk_cache import DiskCache
from tisfm.reconstruction.frames.frame_flow import find_flow, flow_scale, shrink_for_flow
from tisfm.settings import Settings

# px: largest distance from the start after forward and backward motion. Set by hand.
MAX_RETURN_ERROR = 0.5
# This share of the length of the motion is added to that distance. Set by hand.
MAX_RETURN_SHARE = 0.05
# Flow pairs in memory: more than the longest chain has steps.
CACHED_PAIRS = 20


@dataclass(frozen=True, kw_only=True)
class FlowPair:
    """Image motion from a frame to the next, and back."""

    # forward, backward: (H, W, 2) float32, (u, v), px/frame, at the pixels of the earlier and of
    # the later frame
    forward: np.ndarray
    backward: np.ndarray

    @classmethod
    def of_arrays(cls, forward: np.ndarray, backward: np.ndarray) -> "FlowPair":
        """Return the flow pair with these arrays."""
        return cls(forward=forward.astype(np.float32), backward=backward.astype(np.float32))

    def arrays(self) -> tuple[np.ndarray, ...]:
        """Return the arrays, with 11 significant bits."""
        return self.forward.astype(np.float16), self.backward.astype(np.float16)


@dataclass(frozen=True, kw_only=True)
class ChainedFlow:
    """Image motion from a frame to another, chained from frame to frame."""

    frame: int  # the other frame
    steps: int  # number of frame intervals between the two frames
    places: np.ndarray  # (H, W, 2) float32: position (x, y) of every pixel in the other frame, px
    # (H, W) bool: whether forward and backward motion agree at every step of the chain
    found: np.ndarray


class ImageMotion:
    """Image motion of a sequence, frame by frame; large frames are shrunk.

    Parameters
    ----------
    camera : Camera
        Pinhole camera of the frames.
    settings : Settings
        Settings of the image motion.

    Attributes
    ----------
    share : float
        Scale of the shrunk frames, their px per px of the sequence's frames.
    """

    def __init__(self, camera: Camera, settings: Settings) -> None:
        self._camera, self._settings = camera, settings
        self._greys = DiskCache(lambda grey: (grey,), lambda grey: grey)
        self._steps = DiskCache(FlowPair.arrays, FlowPair.of_arrays)
        self._cached: dict[int, tuple[FlowPair, np.ndarray, np.ndarray]] = {}
        self._shape = (0, 0)  # of the sequence's frames
        self.share = 1.0

    def add(self, grey: np.ndarray) -> None:
        """Add the next frame, (H, W) uint8."""
        self._shape = grey.shape
        small = shrink_for_flow(grey)
        self.share = flow_scale(small, grey)
        if len(self._greys):
            before = self._greys[len(self._greys) - 1]
            self._steps.append(
                FlowPair(forward=self._flow(before, small), backward=self._flow(small, before))
            )
        self._greys.append(small)

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self._greys)

    def grey(self, frame: int) -> np.ndarray:
        """Return a shrunk frame, (H, W) float32."""
        return self._greys[frame]

    def camera(self, of_frames: Camera | None = None) -> Camera:
        """Return the camera of the shrunk frames, from a camera of the sequence's frames."""
        return (of_frames or self._camera).scaled(self.share, *self._shape)

    def forward(self, frame: int) -> np.ndarray:
        """Return the motion from a frame to the next, (H, W, 2) float32."""
        return self._step(frame)[0].forward

    def backward(self, frame: int) -> np.ndarray:
        """Return the motion from a frame to the previous one, (H, W, 2) float32."""
        return self._step(frame - 1)[0].backward

    def chained_flows(self, frame: int, furthest: int) -> Iterator[ChainedFlow]:
        """Yield chains to later frames, at most `furthest` frames away, then to earlier frames."""
        start = pixel_grid(self.grey(frame).shape)
        for direction in (1, -1):
            places, found, at = start, np.ones(start.shape[:2], bool), frame
            for steps in range(1, furthest + 1):
                if not 0 <= at + direction < len(self):
                    break
                step, returns, comes = self._step(min(at, at + direction))
                motion, fits = (step.forward, returns) if direction > 0 else (step.backward, comes)
                moved = sample_image(motion, places)
                found = found & (sample_image(fits, places) > 0.99)
                places, at = places + moved, at + direction
                yield ChainedFlow(frame=at, steps=steps, places=places, found=found)

    def _step(self, frame: int) -> tuple[FlowPair, np.ndarray, np.ndarray]:
        """Return the flow pair from a frame to the next, and the consistency mask of each."""
        if frame not in self._cached:
            while len(self._cached) >= CACHED_PAIRS:
                self._cached.pop(next(iter(self._cached)))
            step = self._steps[frame]
            self._cached[frame] = (
                step,
                returns_to_start(step.forward, step.backward),
                returns_to_start(step.backward, step.forward),
            )
        return self._cached[frame]

    def _flow(self, small0: np.ndarray, small1: np.ndarray) -> np.ndarray:
        return find_flow(small0, small1, self.share, self._camera, self._settings, fast_things=True)


def returns_to_start(there: np.ndarray, back: np.ndarray) -> np.ndarray:
    """Return 1 where motion there and back ends near its start, else 0, (H, W) float32."""
    height, width = there.shape[:2]
    places = pixel_grid((height, width)) + there
    missed = vector_lengths(there + sample_image(back, places))
    fits = missed < MAX_RETURN_ERROR + MAX_RETURN_SHARE * vector_lengths(there)
    x, y = cv2.split(places)
    inside = (x >= 0) & (y >= 0) & (x <= width - 1) & (y <= height - 1)
    return np.float32(fits & inside)


def vector_lengths(vectors: np.ndarray) -> np.ndarray:
    """Return the lengths, (H, W) float32, of vectors, (H, W, 2) float32."""
    return cv2.magnitude(*cv2.split(vectors))  # many times faster than `np.linalg.norm`


def pixel_grid(shape: tuple[int, ...]) -> np.ndarray:
    """Return (x, y) of every pixel, (H, W, 2) float32."""
    rows, columns = np.indices(shape[:2], np.float32)
    return np.stack([columns, rows], axis=-1)


def sample_image(image: np.ndarray, places: np.ndarray, *, nearest: bool = False) -> np.ndarray:
    """Sample an image, (H, W[, C]), at positions, (h, w, 2) px, bilinearly or at nearest pixels."""
    x, y = cv2.split(np.ascontiguousarray(places, np.float32))
    how = cv2.INTER_NEAREST if nearest else cv2.INTER_LINEAR
    return cv2.remap(image, x, y, how, borderMode=cv2.BORDER_REPLICATE)
