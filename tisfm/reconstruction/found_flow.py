"""Image motion from frame to frame, found once where several trackers follow it."""

from collections.abc import Callable

import numpy as np

from tisfm.camera import Camera
from tisfm.reconstruction.path import TRACKING
from tisfm.reconstruction.shelf import Shelf
from tisfm.reconstruction.tracks import flow_between, share_of, smaller


class FoundFlow:
    """Finds the image motion to frames, and keeps it with 11 significant bits.

    Parameters
    ----------
    camera : Camera
        A pinhole, of the frames.
    grey : callable
        Returns a frame, (H, W) uint8.
    """

    def __init__(self, camera: Camera, grey: Callable[[int], np.ndarray]) -> None:
        self._camera, self._grey = camera, grey
        self._places: dict[int, int] = {}
        self._found: Shelf[np.ndarray] = Shelf(
            lambda flow: (flow.astype(np.float16),), lambda flow: flow.astype(np.float32)
        )

    def to(self, number: int) -> np.ndarray:
        """Return the motion from the frame before, (h, w, 2) float32, px of `smaller` frames."""
        if number not in self._places:
            before, now = self._grey(number - 1), self._grey(number)
            small = smaller(now)
            share = share_of(small, now)
            flow = flow_between(smaller(before), small, share, self._camera, TRACKING)
            self._places[number] = len(self._found)
            self._found.append(flow)
        return self._found[self._places[number]]
