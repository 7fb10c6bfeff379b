"""Evidence from the ground: moving objects whose apparent depth lies below the ground.

An object that drives ahead of a vehicle moves along the same lines as the camera. In any number of
frames it looks like a static object that is farther away. But it stands on the ground. If its
apparent depth lies below the ground, and it hides points that would hide it at this depth, then it
moves on its own.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from tisfm.camera import Camera
from tisfm.motion.objects.candidates import smallest_object
from tisfm.reconstruction.frames.image_motion import ChainedFlow, ImageMotion, sample_image
from tisfm.reconstruction.objects.motion_evidence import (
    MOVING_EVIDENCE,
    REFUTING_DIFFERENCE,
    Evidence,
    StaticMotion,
    grey_difference,
)

# Values without a stated source were set by hand.

# Share of the frame that shows the ground.
MIN_GROUND = 0.03
# An upright camera: the inverse depth of the ground changes less from left to right than this share
# of its change from top to bottom,
MIN_VERTICAL_SLOPE = 0.15
# and its inverse depth at the image centre is smaller than this share of that change.
MIN_SLOPE_TO_CENTRE = 0.4
# Share of the inverse depth within which a pixel fits the ground plane.
FIT_TOLERANCE = 0.07
# Trials of the robust fit.
RANSAC_TRIALS = 300
# Pixels on which the trials are compared.
RANSAC_POINTS = 4000
# Least-squares rounds after the trials.
FIT_ROUNDS = 3
# Largest relative change of the camera's height above the ground. A vehicle keeps its height, a
# hand above a table does not.
MAX_HEIGHT_CHANGE = 0.3
# Frames before and after with which this height is compared.
HEIGHT_FRAMES = 10
# Share of these frames that need a ground plane.
MIN_STEADY_SHARE = 0.5
# Depth of a pixel below the ground, as a multiple of the depth of the ground.
MIN_DEPTH_RATIO = 1.3
# Share of the largest inverse depth of the ground: farther pixels are not judged.
MIN_JUDGED_DEPTH = 0.2
# Distances, in frames, of the frames whose static points an object may hide.
HIDDEN_STEPS = (3, 5, 8)
# Grey levels: smallest mean difference at the position of a hidden point.
MIN_GREY_DIFFERENCE = 12.0
# Points that an object has to hide, per square root of its area in px.
MIN_HIDDEN = 1.0


@dataclass(frozen=True, kw_only=True)
class StaticDepth:
    """Depth of the static pixels of a frame, under the camera path."""

    inverse_depth: np.ndarray  # (H, W) float32
    at_rest: np.ndarray  # (H, W) bool: pixels that are known to be static

    @classmethod
    def unknown(cls, shape: tuple[int, ...]) -> "StaticDepth":
        """Return a depth without static pixels."""
        return cls(inverse_depth=np.zeros(shape, np.float32), at_rest=np.zeros(shape, bool))

    @classmethod
    def of_arrays(cls, inverse_depth: np.ndarray, at_rest: np.ndarray) -> "StaticDepth":
        """Return the object with these arrays."""
        return cls(inverse_depth=inverse_depth.astype(np.float32), at_rest=at_rest)

    def arrays(self) -> tuple[np.ndarray, ...]:
        """Return its arrays; the unit of depth is arbitrary, so all bits are kept."""
        return self.inverse_depth, self.at_rest


class BelowGround:
    """Finds objects whose apparent depth lies below the ground."""

    def __init__(
        self,
        motion: ImageMotion,
        # sequence of (4, 4) array or None: camera to world, of every frame, in one scale; None for
        # a frame without a pose
        poses: Sequence[np.ndarray | None],
        camera: Camera,  # a pinhole, for the frames of the image motion
        depths: Sequence[StaticDepth],  # static depth of every frame
    ) -> None:
        self._motion, self._poses, self._camera, self._depths = motion, poses, camera, depths
        self._rays = _rays(camera, motion.grey(0).shape)
        self._grounds = [
            None if pose is None else self._ground(depth)
            for pose, depth in zip(poses, depths, strict=True)
        ]

    def evidence(
        self,
        frame: int,
        moving: np.ndarray,  # (H, W) bool: pixels that are known to move
    ) -> Evidence | None:
        """Return the evidence of pixels whose apparent depth lies below the ground, or None."""
        ground = self._steady_ground(frame)
        if ground is None:
            return None
        depth, height = self._rays @ ground, self._depths[frame].inverse_depth
        below = (
            (depth > MIN_JUDGED_DEPTH * np.abs(depth).max())
            & (height * MIN_DEPTH_RATIO < depth)
            & ~moving
        )
        parts = list(_inner_parts(below))
        if not parts:
            return None
        hiding = self._hiding(frame)
        found = np.zeros(below.shape, bool)
        for part in parts:
            found |= part & (np.count_nonzero(hiding & part) > MIN_HIDDEN * part.sum() ** 0.5)
        if not found.any():
            return None
        weight = np.float32(found * self._clear(frame, depth))
        return Evidence(moving=MOVING_EVIDENCE * weight, weight=weight)

    def _ground(self, depth: StaticDepth) -> np.ndarray | None:
        """Return the ground plane, (3,), or None. Its product with a ray is the inverse depth."""
        below_middle = depth.at_rest & (self._rays[..., 1] > 0)
        rays, inverse_depth = self._rays[below_middle], depth.inverse_depth[below_middle]
        if len(rays) < MIN_GROUND * depth.at_rest.size:
            return None
        drawn = np.random.default_rng(0)
        some = drawn.integers(len(rays), size=min(RANSAC_POINTS, len(rays)))
        triples = drawn.integers(len(rays), size=(RANSAC_TRIALS, 3))
        solvable = np.abs(np.linalg.det(rays[triples])) > 1e-9
        planes = np.linalg.solve(rays[triples[solvable]], inverse_depth[triples[solvable], None])
        planes = planes[..., 0]
        planes = planes[_is_upright(planes)]
        if not len(planes):
            return None
        fits = _fits(rays[some] @ planes.T, inverse_depth[some, None])
        plane = planes[np.argmax(fits.sum(axis=0))]
        for _ in range(FIT_ROUNDS):
            inliers = _fits(rays @ plane, inverse_depth)
            if inliers.sum() < MIN_GROUND * depth.at_rest.size:
                return None
            plane = np.linalg.lstsq(rays[inliers], inverse_depth[inliers], rcond=None)[0]
        return plane if _is_upright(plane) else None

    def _steady_ground(self, frame: int) -> np.ndarray | None:
        """Return the median ground plane, (3,), of the frames around a frame.

        None if the height of the camera above the ground changes, or too few frames show it.
        """
        around = slice(max(0, frame - HEIGHT_FRAMES), frame + HEIGHT_FRAMES + 1)
        planes = [plane for plane in self._grounds[around] if plane is not None]
        if self._poses[frame] is None or len(planes) < max(
            3, MIN_STEADY_SHARE * len(self._grounds[around])
        ):
            return None
        plane = np.median(planes, axis=0)
        least, most = np.quantile(np.array(planes)[:, 1], (0.1, 0.9))
        return plane if most - least < MAX_HEIGHT_CHANGE * plane[1] else None

    def _hiding(self, frame: int) -> np.ndarray:
        """Return the pixels, (H, W) bool, that hide static points nearer than their apparent depth.

        The static points are known from other frames. The image motion loses them on the way to
        this frame. At their projected position, this frame has other grey levels and a larger
        apparent depth.
        """
        found = np.zeros(self._rays.shape[:2], bool)
        grey, own = self._motion.grey(frame), self._depths[frame]
        height, width = self._motion.grey(frame).shape
        for way in (-1, 1):
            for steps in HIDDEN_STEPS:
                number = frame + way * steps
                if not 0 <= number < len(self._poses) or self._poses[number] is None:
                    continue
                other = self._depths[number]
                at_rest = self._at_rest(number, frame)
                places = at_rest.places(other.inverse_depth)
                there = at_rest.inverse_depth(other.inverse_depth)
                inside = (places > 0).all(axis=-1) & (places < (width - 1, height - 1)).all(axis=-1)
                lost = other.at_rest & inside & ~self._led(number, frame).found
                behind = sample_image(own.inverse_depth, places) * MIN_DEPTH_RATIO < there
                known = sample_image(np.float32(own.at_rest), places) > 0.5
                unlike = (
                    grey_difference(grey, places, self._motion.grey(number)) > MIN_GREY_DIFFERENCE
                )
                x, y = np.rint(places[lost & behind & known & unlike]).astype(int).T
                found[y, x] = True
        return found

    def _clear(self, frame: int, ground: np.ndarray) -> np.ndarray:
        """Return how clearly the images refute that a pixel lies on the ground, (H, W), 0 to 1."""
        grey, depth = self._motion.grey(frame), self._depths[frame].inverse_depth
        clear = np.zeros(depth.shape, np.float32)
        for way in (-1, 1):
            furthest = [
                frame + way * steps
                for steps in HIDDEN_STEPS
                if 0 <= frame + way * steps < len(self._poses)
                and self._poses[frame + way * steps] is not None
            ]
            if not furthest:
                continue
            at_rest, other = self._at_rest(frame, furthest[-1]), self._motion.grey(furthest[-1])
            missed = grey_difference(other, at_rest.places(depth), grey)
            on_ground = grey_difference(other, at_rest.places(ground), grey)
            clear = np.maximum(clear, (on_ground - missed) / (REFUTING_DIFFERENCE + missed))
        return np.clip(clear, 0, 1)

    def _at_rest(self, frame: int, other: int) -> StaticMotion:
        pose, pose_of_other = self._poses[frame], self._poses[other]
        assert pose is not None and pose_of_other is not None
        relative = np.linalg.inv(pose_of_other) @ pose
        shape = self._rays.shape[:2]
        return StaticMotion(relative[:3, :3], relative[:3, 3], self._camera, shape)

    def _led(self, frame: int, other: int) -> ChainedFlow:
        steps = abs(other - frame)
        return next(led for led in self._motion.chained_flows(frame, steps) if led.frame == other)


def _rays(camera: Camera, shape: tuple[int, ...]) -> np.ndarray:
    """Return (x̂, ŷ, 1) of every pixel, (H, W, 3) float64."""
    cx, cy = camera.center_for(*shape[:2])
    rows, columns = np.indices(shape[:2])
    x_hat, y_hat = (columns - cx) / camera.focal, (rows - cy) / camera.focal
    return np.stack([x_hat, y_hat, np.ones_like(x_hat)], axis=-1)


def _is_upright(planes: np.ndarray) -> np.ndarray:
    """Return which planes, (..., 3), are ground below an upright camera."""
    across, down, middle = np.moveaxis(planes, -1, 0)
    return (np.abs(across) < MIN_VERTICAL_SLOPE * down) & (
        np.abs(middle) < MIN_SLOPE_TO_CENTRE * down
    )


def _fits(of_plane: np.ndarray, inverse_depth: np.ndarray) -> np.ndarray:
    return np.abs(inverse_depth - of_plane) < FIT_TOLERANCE * np.abs(of_plane)


def _inner_parts(below: np.ndarray) -> Iterator[np.ndarray]:
    """Yield the large connected parts, (H, W) bool, that touch neither side of the frame."""
    opened = cv2.morphologyEx(below.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    count, parts, statistics, _ = cv2.connectedComponentsWithStats(opened, connectivity=4)
    width = below.shape[1]
    for part in range(1, count):
        left, _, columns, _, area = statistics[part]
        if area >= smallest_object(below.size) and left > 1 and left + columns < width - 1:
            yield parts == part
