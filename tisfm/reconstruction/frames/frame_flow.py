"""Image motion between two frames, computed at a reduced size and cached for several stages."""

from collections.abc import Callable

import cv2
import numpy as np

from tisfm.camera import Camera
from tisfm.motion.flow_proposals import flow_proposals
from tisfm.motion.problems import flow_problem
from tisfm.reconstruction.frames.disk_cache import DiskCache
from tisfm.settings import Settings
from tisfm.solver.coarse_to_fine import coarse_to_fine
from tisfm.solver.image_pyramid import ImagePyramid

# Smallest number of pixels of the shrunk frames for image motion. Set by hand.
MIN_FLOW_PIXELS = 2**16
# Settings of the image motion that tracks follow.
TRACKING_SETTINGS = Settings.preset("fast")


def find_flow(
    # small0, small1: (h, w) float32
    small0: np.ndarray,
    small1: np.ndarray,
    scale: float,  # scale of the shrunk frames, from `flow_scale`
    camera: Camera,  # pinhole camera of the frames
    settings: Settings,
    *,
    # whether to search for objects that move far in relation to their size
    search_fast_objects: bool = False,
) -> np.ndarray:
    """Return the image motion between two frames of `shrink_for_flow`.

    Returns (h, w, 2) float32: motion, px of the shrunk frames; limited to the sum of their sides.
    """
    small_camera = Camera(focal=camera.focal * scale)
    pyramid = ImagePyramid(
        small0,
        small1,
        small_camera,
        factor=settings.pyramid_factor,
        presmoothing=settings.presmoothing,
    )
    problem = flow_problem(settings, small_camera.focal)
    amendment = flow_proposals(pyramid, problem) if search_fast_objects else None
    solution = coarse_to_fine(pyramid, problem, amendment=amendment)
    flow, limit = solution.unknowns.flow(), float(sum(small0.shape))
    if not (flow.min() >= -limit and flow.max() <= limit):  # it diverged, perhaps to NaN
        flow = np.nan_to_num(flow, nan=limit).clip(-limit, limit)
    return cv2.merge(list(flow))


def shrink_for_flow(grey: np.ndarray) -> np.ndarray:
    """Return a frame as float32, halved while it keeps `MIN_FLOW_PIXELS`."""
    small: np.ndarray = grey.astype(np.float32)
    while small.size >= 4 * MIN_FLOW_PIXELS:
        height, width = small.shape
        size = (width + 1) // 2, (height + 1) // 2
        padded = cv2.copyMakeBorder(small, 0, height % 2, 0, width % 2, cv2.BORDER_REPLICATE)
        small = cv2.resize(padded, size, interpolation=cv2.INTER_AREA)
    return small


def flow_scale(small: np.ndarray, grey: np.ndarray) -> float:
    """Return the scale of a frame from `shrink_for_flow`, in its px per px of the full frame."""
    return float(2.0 ** np.rint(np.log2(small.shape[1] / grey.shape[1])))


class FlowCache:
    """Image motion from the previous frame to each frame, computed once, stored with 11 bits."""

    def __init__(
        self,
        camera: Camera,  # pinhole camera of the frames
        grey: Callable[[int], np.ndarray],  # returns a frame, (H, W) uint8
    ) -> None:
        self._camera, self._grey = camera, grey
        self._cache_indices: dict[int, int] = {}
        self._flows: DiskCache[np.ndarray] = DiskCache(
            lambda flow: (flow.astype(np.float16),), lambda flow: flow.astype(np.float32)
        )

    def flow_to(self, number: int) -> np.ndarray:
        """Return the motion from the previous frame, (h, w, 2) float32, px of the shrunk frames."""
        if number not in self._cache_indices:
            before, now = self._grey(number - 1), self._grey(number)
            small = shrink_for_flow(now)
            scale = flow_scale(small, now)
            flow = find_flow(shrink_for_flow(before), small, scale, self._camera, TRACKING_SETTINGS)
            self._cache_indices[number] = len(self._flows)
            self._flows.append(flow)
        return self._flows[self._cache_indices[number]]
