"""Image motion between neighbouring frames, computed at a reduced size, and chained over frames."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from tisfm.camera import Camera
from tisfm.motion.flow_proposals import flow_proposals
from tisfm.motion.problems import flow_problem
from tisfm.reconstruction.frames.disk_cache import DiskCache
from tisfm.reconstruction.frames.settings import FRAME_FLOW
from tisfm.settings import Settings
from tisfm.solver.coarse_to_fine import coarse_to_fine
from tisfm.solver.image_pyramid import ImagePyramid

# Number of flow pairs in memory: more than the longest chain of flows has steps. Set by hand.
CACHED_PAIRS = 20
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
    # whether to search for objects whose motion is large compared with their size
    search_fast_objects: bool = False,
) -> np.ndarray:
    """Return the image motion between two frames of `shrink_for_flow`.

    Returns (h, w, 2) float32, px of the shrunk frames. Components are limited to the sum of the
    sides of a frame.
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
    proposals = flow_proposals(pyramid, problem) if search_fast_objects else None
    solution = coarse_to_fine(pyramid, problem, level_change=proposals)
    flow, max_motion = solution.unknowns.flow(), float(sum(small0.shape))
    if not (
        flow.min() >= -max_motion and flow.max() <= max_motion
    ):  # the solver diverged, perhaps to NaN
        flow = np.nan_to_num(flow, nan=max_motion).clip(-max_motion, max_motion)
    return cv2.merge(list(flow))


def shrink_for_flow(grey: np.ndarray) -> np.ndarray:
    """Return a frame as float32, halved as long as it has at least `FRAME_FLOW.min_pixels`."""
    return halve_down_to(grey, 4 * FRAME_FLOW.min_pixels)


def halve_down_to(grey: np.ndarray, max_pixels: int) -> np.ndarray:
    """Return a frame as float32, halved until it has fewer than `max_pixels` pixels."""
    small: np.ndarray = grey.astype(np.float32)
    while small.size >= max_pixels:
        height, width = small.shape
        size = (width + 1) // 2, (height + 1) // 2
        padded = cv2.copyMakeBorder(small, 0, height % 2, 0, width % 2, cv2.BORDER_REPLICATE)
        small = cv2.resize(padded, size, interpolation=cv2.INTER_AREA)
    return small


def flow_scale(small: np.ndarray, grey: np.ndarray) -> float:
    """Return the scale of a frame from `shrink_for_flow`: its px per px of the full frame."""
    return float(2.0 ** np.rint(np.log2(small.shape[1] / grey.shape[1])))


class FlowCache:
    """Image motion from the previous frame to each frame, computed once and stored in float16."""

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

    def keep(self, number: int, flow: np.ndarray) -> None:
        """Store a motion that was computed elsewhere, as `flow_to` would compute it."""
        self._cache_indices[number] = len(self._flows)
        self._flows.append(flow)

    def kept_flow_to(self, number: int) -> np.ndarray | None:
        """Return `flow_to` of a frame if it is known already, or None."""
        return self._flows[self._cache_indices[number]] if number in self._cache_indices else None

    def flow_to(self, number: int) -> np.ndarray:
        """Return the motion from the previous frame, (h, w, 2) float32, px of the shrunk frames."""
        if number not in self._cache_indices:
            previous, current = self._grey(number - 1), self._grey(number)
            small0, small1 = shrink_for_flow(previous), shrink_for_flow(current)
            scale = flow_scale(small1, current)
            flow = find_flow(small0, small1, scale, self._camera, TRACKING_SETTINGS)
            self.keep(number, flow)
        return self._flows[self._cache_indices[number]]


def chain_flows(
    flows: Sequence[np.ndarray],  # (h, w, 2) float32 each: from every frame to the next one, px
) -> np.ndarray:  # (h, w, 2) float32
    """Return the motion from the first frame of several flows to the last one."""
    start = pixel_grid(flows[0].shape)
    positions = start + flows[0]
    for flow in flows[1:]:
        positions = positions + sample_image(flow, positions)
    return positions - start


@dataclass(frozen=True, kw_only=True)
class FlowPair:
    """Image motion from a frame to the next, and back."""

    # forward, backward: (H, W, 2) float32, (u, v), px/frame, at the pixels of the earlier and of
    # the later frame
    forward: np.ndarray
    backward: np.ndarray

    @classmethod
    def from_arrays(cls, forward: np.ndarray, backward: np.ndarray) -> "FlowPair":
        """Return the flow pair with these arrays."""
        return cls(forward=forward.astype(np.float32), backward=backward.astype(np.float32))

    def to_arrays(self) -> tuple[np.ndarray, ...]:
        """Return the arrays in float16, with 11 significant bits."""
        return self.forward.astype(np.float16), self.backward.astype(np.float16)


@dataclass(frozen=True, kw_only=True)
class ChainedFlow:
    """Image motion from a frame to another, chained from frame to frame."""

    frame: int  # the other frame
    steps: int  # number of frame intervals between the two frames
    # (H, W, 2) float32: position (x, y) of every pixel in the other frame, px
    positions: np.ndarray
    # (H, W) bool: whether forward and backward motion agree at every step of the chain
    valid: np.ndarray


class ImageMotion:
    """Image motion of a sequence between neighbouring frames; large frames are shrunk."""

    def __init__(
        self,
        camera: Camera,  # pinhole camera of the frames
        settings: Settings,  # settings of the image motion
    ) -> None:
        self._camera, self._settings = camera, settings
        self._frames = DiskCache(lambda grey: (grey,), lambda grey: grey)
        self._pairs = DiskCache(FlowPair.to_arrays, FlowPair.from_arrays)
        self._cached_pairs: dict[int, tuple[FlowPair, np.ndarray, np.ndarray]] = {}
        self._shape = (0, 0)  # height and width of the sequence's frames, px
        self.scale = 1.0  # px of the shrunk frames per px of the sequence's frames

    def add(self, grey: np.ndarray) -> None:
        """Add the next frame, (H, W) uint8."""
        self._shape = grey.shape
        small = shrink_for_flow(grey)
        self.scale = flow_scale(small, grey)
        if len(self._frames):
            previous = self._frames[len(self._frames) - 1]
            self._pairs.append(
                FlowPair(forward=self._flow(previous, small), backward=self._flow(small, previous))
            )
        self._frames.append(small)

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self._frames)

    def grey(self, frame: int) -> np.ndarray:
        """Return a shrunk frame, (H, W) float32."""
        return self._frames[frame]

    def camera(self, frame_camera: Camera | None = None) -> Camera:
        """Return the camera of the shrunk frames, from a camera of the sequence's frames."""
        return (frame_camera or self._camera).scaled(self.scale, *self._shape)

    def forward(self, frame: int) -> np.ndarray:
        """Return the motion from a frame to the next frame, (H, W, 2) float32."""
        return self._pair(frame)[0].forward

    def backward(self, frame: int) -> np.ndarray:
        """Return the motion from a frame to the previous frame, (H, W, 2) float32."""
        return self._pair(frame - 1)[0].backward

    def chained_flows(self, frame: int, max_steps: int) -> Iterator[ChainedFlow]:
        """Yield flows to later frames, at most `max_steps` frames away, then to earlier frames."""
        start = pixel_grid(self.grey(frame).shape)
        for direction in (1, -1):
            positions, valid, current = start, np.ones(start.shape[:2], bool), frame
            for steps in range(1, max_steps + 1):
                if not 0 <= current + direction < len(self):
                    break
                pair, forward_valid, backward_valid = self._pair(min(current, current + direction))
                flow, flow_valid = (
                    (pair.forward, forward_valid)
                    if direction > 0
                    else (pair.backward, backward_valid)
                )
                displacement = sample_image(flow, positions)
                valid = valid & (sample_image(flow_valid, positions) > 0.99)
                positions, current = positions + displacement, current + direction
                yield ChainedFlow(frame=current, steps=steps, positions=positions, valid=valid)

    def chained_flow(self, frame: int, other: int) -> ChainedFlow:
        """Return the chained flow from a frame to another frame."""
        chains = self.chained_flows(frame, abs(other - frame))
        return next(chain for chain in chains if chain.frame == other)

    def _pair(self, frame: int) -> tuple[FlowPair, np.ndarray, np.ndarray]:
        """Return the flow pair from a frame to the next, and the consistency mask of each flow."""
        if frame not in self._cached_pairs:
            while len(self._cached_pairs) >= CACHED_PAIRS:
                self._cached_pairs.pop(next(iter(self._cached_pairs)))
            pair = self._pairs[frame]
            self._cached_pairs[frame] = (
                pair,
                consistency_mask(pair.forward, pair.backward),
                consistency_mask(pair.backward, pair.forward),
            )
        return self._cached_pairs[frame]

    def _flow(self, frame0: np.ndarray, frame1: np.ndarray) -> np.ndarray:
        return find_flow(
            frame0, frame1, self.scale, self._camera, self._settings, search_fast_objects=True
        )


def consistency_mask(flow: np.ndarray, reverse_flow: np.ndarray) -> np.ndarray:
    """Return 1 where the reverse flow leads back near the start, else 0, (H, W) float32."""
    height, width = flow.shape[:2]
    positions = pixel_grid((height, width)) + flow
    return_error = vector_lengths(flow + sample_image(reverse_flow, positions))
    relative_bound = FRAME_FLOW.max_relative_return_error * vector_lengths(flow)
    is_consistent = return_error < FRAME_FLOW.max_return_error + relative_bound
    x, y = cv2.split(positions)
    is_inside = (x >= 0) & (y >= 0) & (x <= width - 1) & (y <= height - 1)
    return np.float32(is_consistent & is_inside)


def vector_lengths(vectors: np.ndarray) -> np.ndarray:
    """Return the lengths, (H, W) float32, of vectors, (H, W, 2) float32."""
    return cv2.magnitude(*cv2.split(vectors))  # many times faster than `np.linalg.norm`


def pixel_grid(shape: tuple[int, ...]) -> np.ndarray:
    """Return (x, y) of every pixel, (H, W, 2) float32."""
    rows, columns = np.indices(shape[:2], np.float32)
    return np.stack([columns, rows], axis=-1)


def sample_image(image: np.ndarray, positions: np.ndarray, *, nearest: bool = False) -> np.ndarray:
    """Sample an image, (H, W[, C]), at positions, (h, w, 2) px, bilinearly or at nearest pixels."""
    x, y = cv2.split(np.ascontiguousarray(positions, np.float32))
    interpolation = cv2.INTER_NEAREST if nearest else cv2.INTER_LINEAR
    return cv2.remap(image, x, y, interpolation, borderMode=cv2.BORDER_REPLICATE)
