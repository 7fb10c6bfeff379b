"""Evidence over several frames that a pixel moves on its own.

The image motion of a static point fits the motion of the camera with some depth. In two frames, an
object that moves along epipolar lines looks like static points at another depth. Over several
frames its depth would have to change, or the lines rotate. For this reason evidence is accumulated
along the image motion.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from tisfm.camera import Camera
from tisfm.motion.egomotion import TooFewPixelsError, camera_motion
from tisfm.reconstruction.frames.disk_cache import DiskCache
from tisfm.reconstruction.frames.image_motion import ImageMotion, pixel_grid, sample_image

# Values without a stated source were set by hand.
# Distances, in frames, of the frames that a frame is compared with, before and after.
FRAME_STEPS = (1, 3)
# Standard deviation of the image motion, as a share of the longer side; added to that of the fit.
MIN_DEVIATION = 1.5e-4
# Standard deviations from the motion of the camera at which evidence is neutral.
NEUTRAL_DEVIATIONS = 3.0
# Evidence of one frame for a clearly static pixel.
STATIC_EVIDENCE = -1.0
# Largest evidence of one frame for a moving pixel.
MOVING_EVIDENCE = 3.0
# Weight, in frames, of the prior that a pixel is static.
STATIC_PRIOR = 0.3
# Share of the evidence of a frame that is passed on to the next one.
PASSED_SHARE = 0.8
# px: side of the window that images are compared in.
COMPARE_WINDOW = 5
# Additional difference, in grey levels, that refutes a static position.
REFUTING_DIFFERENCE = 4.0
# Weight, of 1, of evidence without support from grey levels.
MIN_SUPPORT = 0.05
# Largest static inverse depth that is tried, as a multiple of the largest usual inverse depth.
TRIED_DEPTH_FACTOR = 3.0
# px between two static positions that are tried.
TRIED_STEP = 2.0
# Smallest and largest number of static positions that are tried.
TRIED_COUNTS = (8, 32)
# Smallest depth of a point in another frame, as a share of its depth in this frame.
MIN_DEPTH = 0.05


@dataclass(frozen=True, kw_only=True)
class Evidence:
    """Evidence of several frames on whether pixels move on their own."""

    # (H, W) float32: sum over frames: positive for a pixel that moves on its own, negative for a
    # static one
    moving: np.ndarray
    weight: np.ndarray  # (H, W) float32: number of frames with evidence; each counts 1 at most

    @classmethod
    def of_arrays(cls, moving: np.ndarray, weight: np.ndarray) -> "Evidence":
        """Return the object with these arrays."""
        return cls(moving=moving.astype(np.float32), weight=weight.astype(np.float32))

    def arrays(self) -> tuple[np.ndarray, ...]:
        """Return its arrays, with 11 significant bits."""
        return self.moving.astype(np.float16), self.weight.astype(np.float16)

    def mean(self) -> np.ndarray:
        """Return the mean evidence, (H, W) float32; pixels without evidence are static."""
        return (self.moving + np.float32(STATIC_PRIOR * STATIC_EVIDENCE)) / (
            self.weight + np.float32(STATIC_PRIOR)
        )

    def judged_by(self, many: "Evidence") -> "Evidence":
        """Return this evidence of frame pairs together with that of many frames.

        A pixel that looks static in two frames may move along epipolar lines. Evidence for a static
        pixel counts only where many frames support it.
        """
        confirms_large_motion = (self.moving > 0) | (many.moving < 0)
        return Evidence(
            moving=confirms_large_motion * self.moving + many.moving,
            weight=confirms_large_motion * self.weight + many.weight,
        )

    def at_rest_in(self, place: np.ndarray) -> "Evidence":
        """Return the evidence with the pixels of a mask, (H, W) bool, set to static."""
        return Evidence(
            moving=np.where(place, np.float32(STATIC_EVIDENCE), self.moving),
            weight=np.where(place, np.float32(1), self.weight),
        )

    def overruled_by(self, other: "Evidence") -> "Evidence":
        """Return the evidence, overruled by one that finds objects which look static here."""
        counts = (self.moving > 0) | (other.weight == 0)
        return Evidence(
            moving=counts * self.moving + other.moving,
            weight=counts * self.weight + other.weight,
        )


def evidence_of(motion: ImageMotion, frame: int) -> Evidence:
    """Return the evidence of the image motion from a frame to others.

    One rigid motion is fitted to the image motion between two frames, where it is consistent.
    The evidence is the distance from the nearest position of a static point, compared with the
    usual distance.
    """
    shape, camera = motion.grey(frame).shape, motion.camera()
    total, weight = (np.zeros(shape, np.float32) for _ in range(2))
    start, grey = pixel_grid(shape), motion.grey(frame)
    for led in motion.chained_flows(frame, max(FRAME_STEPS)):
        if led.steps not in FRAME_STEPS:
            continue
        flow = led.places - start
        try:
            fitted = camera_motion(flow, np.float32(led.found), camera)
        except TooFewPixelsError:
            continue
        usual = fitted.residual + MIN_DEVIATION * max(shape) * led.steps**0.5
        at_rest = StaticMotion(fitted.rotation, fitted.translation, camera, shape)
        inverse_depth = at_rest.nearest(led.places)
        far = np.linalg.norm(at_rest.places(inverse_depth) - led.places, axis=-1) / usual
        says = np.clip((far / NEUTRAL_DEVIATIONS) ** 2 - 1, STATIC_EVIDENCE, MOVING_EVIDENCE)
        resting = inverse_depth[led.found & (says < 0)]
        view = motion.grey(led.frame), led.places, led.found, at_rest
        clear = support_of_motion(grey, [view], inverse_depth, resting)
        seen = np.where(says > 0, clear, 1)
        seen *= led.found
        total += seen * says
        weight += seen
    comparisons = 2 * len(FRAME_STEPS)
    return Evidence(moving=total / comparisons, weight=weight / comparisons)


def accumulate_evidence(motion: ImageMotion, evidence: Sequence[Evidence]) -> Sequence[Evidence]:
    """Return the evidence of every frame, accumulated along the image motion in both directions."""
    before, after = _one_way(motion, evidence, 1), _one_way(motion, evidence, -1)
    found = DiskCache(Evidence.arrays, Evidence.of_arrays)
    for frame, own in enumerate(evidence):
        one, two = before[frame], after[len(evidence) - 1 - frame]
        found.append(
            Evidence(
                moving=one.moving + two.moving - own.moving,
                weight=one.weight + two.weight - own.weight,
            )
        )
    return found


def _one_way(motion: ImageMotion, evidence: Sequence[Evidence], way: int) -> DiskCache[Evidence]:
    """Return the evidence accumulated from earlier frames, or, with way −1, from later ones.

    The result has the frames in the order of accumulation.
    """
    found, last = DiskCache(Evidence.arrays, Evidence.of_arrays), None
    for frame in range(len(evidence))[::way]:
        own = evidence[frame]
        if last is not None:
            led = next(led for led in motion.chained_flows(frame, 1) if led.frame == frame - way)
            kept = np.float32(PASSED_SHARE) * led.found
            own = Evidence(
                moving=own.moving + kept * sample_image(last.moving, led.places),
                weight=own.weight + kept * sample_image(last.weight, led.places),
            )
        found.append(own)
        last = own
    return found


class StaticMotion:
    """Positions of static points in another frame, by inverse depth, under one camera motion."""

    def __init__(
        self,
        # rotation, translation: (3, 3) and (3,) array: from a frame to another, P₁ = R P₀ + t
        rotation: np.ndarray,
        translation: np.ndarray,
        camera: Camera,
        shape: tuple[int, ...],  # height and width of the frames, px
    ) -> None:
        self._focal = np.float32(camera.focal)
        self._center = np.array(camera.center_for(*shape[:2]), np.float32)
        start = (pixel_grid(shape) - self._center) / self._focal
        rays = cv2.merge([*cv2.split(start), np.ones(shape[:2], np.float32)])
        self._turned = cv2.transform(rays, rotation.astype(np.float32))
        self._translation = translation.astype(np.float32)

    def places(self, inverse_depth: np.ndarray | float) -> np.ndarray:
        """Return positions, (H, W, 2) float32, of points with an inverse depth, 1/unit of t."""
        moved = [
            turned + np.float32(inverse_depth) * part
            for turned, part in zip(cv2.split(self._turned), self._translation, strict=True)
        ]
        scale = self._focal / np.maximum(moved[2], np.float32(MIN_DEPTH))
        x, y = self._center
        return cv2.merge([moved[0] * scale + x, moved[1] * scale + y])

    def inverse_depth(self, inverse_depth: np.ndarray) -> np.ndarray:
        """Return the inverse depth in the other frame, (H, W) float32."""
        ahead = self._turned[..., 2] + inverse_depth * self._translation[2]
        return inverse_depth / np.maximum(ahead, np.float32(MIN_DEPTH))

    def slope_and_missed(
        self, inverse_depth: np.ndarray, places: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the derivative of positions by inverse depth, and the error of the positions, px.

        (H, W, 2) float32 each.
        """
        x, y, ahead = (
            turned + inverse_depth * part
            for turned, part in zip(cv2.split(self._turned), self._translation, strict=True)
        )
        scale = self._focal / np.maximum(ahead, np.float32(MIN_DEPTH))
        along_x, along_y, along = self._translation
        at_x, at_y = x * scale, y * scale
        slope = [
            scale * along_x - at_x * scale / self._focal * along,
            scale * along_y - at_y * scale / self._focal * along,
        ]
        missed = places - self._center - cv2.merge([at_x, at_y])
        return cv2.merge(slope), missed

    def nearest(self, places: np.ndarray) -> np.ndarray:
        """Return the inverse depth, (H, W) float32, whose position is nearest to given ones."""
        target = (places - self._center) / self._focal
        along, ahead = self._translation[:2], self._translation[2]
        turned, inverse_depth = self._turned, np.zeros(target.shape[:2], np.float32)
        for _ in range(2):  # the second round has the weights of the first result
            depth = np.maximum(turned[..., 2] + inverse_depth * ahead, np.float32(MIN_DEPTH))
            missed = (target * turned[..., 2:] - turned[..., :2]) / depth[..., None]
            slope = (target * ahead - along) / depth[..., None]
            steep = np.maximum((slope * slope).sum(axis=-1), np.float32(1e-12))
            inverse_depth = np.maximum(-(missed * slope).sum(axis=-1) / steep, np.float32(0))
        return inverse_depth


def support_of_motion(
    grey: np.ndarray,  # (H, W) float32
    # sequence of (other, places, found, StaticMotion): another frame, (H, W) float32; the position
    # of each pixel in it, (H, W, 2) float32; where this position is known, (H, W) bool; and the
    # motion of static points
    views: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray, StaticMotion]],
    # (H, W) float32: the inverse depth whose static position is nearest to these positions
    nearest: np.ndarray,
    usual: np.ndarray,  # (N,) float32: inverse depths of static points
) -> np.ndarray:  # (H, W) float32: from `MIN_SUPPORT` to 1
    """Return how far the images support the image motion against every static position.

    In an area without texture all positions look alike, and the image motion is arbitrary. Where
    the image motion is wrong, some static depth fits the images as well or better. One depth has to
    fit all given frames.
    """
    furthest = float(np.quantile(usual, 0.99)) * TRIED_DEPTH_FACTOR if len(usual) else 0.0
    reach = [
        np.median(np.linalg.norm(at_rest.places(furthest) - at_rest.places(0.0), axis=-1))
        for *_, at_rest in views
    ]
    count = int(np.clip(max(reach) / TRIED_STEP, *TRIED_COUNTS))
    missed = _missed(grey, [(other, led, found) for other, led, found, _ in views])
    least = np.full(grey.shape, np.inf, np.float32)
    tried: list[np.ndarray | float] = [nearest, *map(float, np.linspace(0, furthest, count))]
    for inverse_depth in tried:
        at_rest_places = [
            (other, at_rest.places(inverse_depth), found) for other, _, found, at_rest in views
        ]
        least = np.minimum(least, _missed(grey, at_rest_places))
    return np.clip((least - missed) / (REFUTING_DIFFERENCE + missed), MIN_SUPPORT, 1)


def _missed(
    grey: np.ndarray, views: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]]
) -> np.ndarray:
    """Return the mean difference of pixels and positions in other frames, grey levels, (H, W)."""
    total, count = np.zeros(grey.shape, np.float32), np.zeros(grey.shape, np.float32)
    for other, places, found in views:
        total += found * grey_difference(other, places, grey)
        count += found
    return total / np.maximum(count, 1)


def grey_difference(other: np.ndarray, places: np.ndarray, grey: np.ndarray) -> np.ndarray:
    """Return the difference of two frames at positions, grey levels, (H, W) float32.

    It is averaged over windows.
    """
    return cv2.blur(np.abs(sample_image(other, places) - grey), (COMPARE_WINDOW, COMPARE_WINDOW))
