"""How far the image motion is from anything that the camera's motion explains, over several frames.

At two frames a thing that moves along epipolar lines looks like another depth. Over several its
depth would have to change, or the lines turn. So what tells it is summed up along the image motion.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from tisfm.camera import Camera
from tisfm.motion.egomotion import TooFewPixelsError, camera_motion
from tisfm.reconstruction.frames.disk_cache import DiskCache
from tisfm.reconstruction.frames.image_motion import ImageMotion, pixel_grid, sample_image

AWAY = (1, 3)  # frames, before and after, that a frame is compared with
# Deviation of the image motion: that of the fit, and of as much as this share of the longer side.
LEAST_DEVIATION = 1.5e-4
NEUTRAL = 3.0  # deviations: what is as far from the camera's motion says nothing
AT_REST, MOVING = -1.0, 3.0  # the most that a frame may say
DOUBT = 0.3  # frames: as much speaks for a pixel at rest before anything is seen
LASTING = 0.8  # of what a frame says is left for the next
WINDOW = 5  # px, over which images are compared
# Grey levels, beside those that are missed anyway: a place that misses as many more is wrong. And
# what the image motion says anyway.
CLEAR, LEAST_SHOWN = 4.0, 0.05
# Depths at rest that are tried: up to this many times what is usual, every so many px, at least and
# at most so many.
BEYOND, TRIED_EVERY, TRIED = 3.0, 2.0, (8, 32)
NEAREST = 0.05  # of the unit of depth: nothing is nearer


@dataclass(frozen=True, kw_only=True)
class Evidence:
    """What frames say of whether a pixel follows the camera's motion.

    Attributes
    ----------
    moving : (H, W) float32
        Sum of what frames say: positive if it moves on its own.
    weight : (H, W) float32
        How many frames say something, at most 1 each.
    """

    moving: np.ndarray
    weight: np.ndarray

    @classmethod
    def of_arrays(cls, moving: np.ndarray, weight: np.ndarray) -> "Evidence":
        """Return what has these arrays."""
        return cls(moving=moving.astype(np.float32), weight=weight.astype(np.float32))

    def arrays(self) -> tuple[np.ndarray, ...]:
        """Return what it is made of, with 11 significant bits."""
        return self.moving.astype(np.float16), self.weight.astype(np.float16)

    def mean(self) -> np.ndarray:
        """Return what a frame says on average, (H, W) float32: where none does, it is at rest."""
        return (self.moving + np.float32(DOUBT * AT_REST)) / (self.weight + np.float32(DOUBT))

    def judged_by(self, many: "Evidence") -> "Evidence":
        """Return this, of two frames at a time, with what many frames say together.

        What looks at rest at two frames may be something that moves along epipolar lines. So it
        counts as far as many frames bear it out.
        """
        confirms_large_motion = (self.moving > 0) | (many.moving < 0)
        return Evidence(
            moving=confirms_large_motion * self.moving + many.moving,
            weight=confirms_large_motion * self.weight + many.weight,
        )

    def at_rest_in(self, place: np.ndarray) -> "Evidence":
        """Return this where a place, (H, W) bool, is at rest."""
        return Evidence(
            moving=np.where(place, np.float32(AT_REST), self.moving),
            weight=np.where(place, np.float32(1), self.weight),
        )

    def overruled_by(self, other: "Evidence") -> "Evidence":
        """Return this with what says that something moves which looks at rest anyway."""
        counts = (self.moving > 0) | (other.weight == 0)
        return Evidence(
            moving=counts * self.moving + other.moving,
            weight=counts * self.weight + other.weight,
        )


def evidence_of(motion: ImageMotion, frame: int) -> Evidence:
    """Return what a frame's motion to others says.

    One rigid motion is fitted to all of the image motion from the frame to another, where the way
    back agrees. Distances from where points at rest may go are compared with that of the others.

    Parameters
    ----------
    motion : ImageMotion
    frame : int
    """
    shape, camera = motion.grey(frame).shape, motion.camera()
    total, weight = (np.zeros(shape, np.float32) for _ in range(2))
    start, grey = pixel_grid(shape), motion.grey(frame)
    for led in motion.chained_flows(frame, max(AWAY)):
        if led.steps not in AWAY:
            continue
        flow = led.places - start
        try:
            fitted = camera_motion(flow, np.float32(led.found), camera)
        except TooFewPixelsError:
            continue
        usual = fitted.residual + LEAST_DEVIATION * max(shape) * led.steps**0.5
        at_rest = StaticMotion(fitted.rotation, fitted.translation, camera, shape)
        inverse_depth = at_rest.nearest(led.places)
        far = np.linalg.norm(at_rest.places(inverse_depth) - led.places, axis=-1) / usual
        says = np.clip((far / NEUTRAL) ** 2 - 1, AT_REST, MOVING)
        resting = inverse_depth[led.found & (says < 0)]
        view = motion.grey(led.frame), led.places, led.found, at_rest
        clear = shown(grey, [view], inverse_depth, resting)
        seen = np.where(says > 0, clear, 1)
        seen *= led.found
        total += seen * says
        weight += seen
    comparisons = 2 * len(AWAY)
    return Evidence(moving=total / comparisons, weight=weight / comparisons)


def accumulate_evidence(motion: ImageMotion, evidence: Sequence[Evidence]) -> Sequence[Evidence]:
    """Return what frames say together with those before and after, along the image motion."""
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
    """Return what frames say together with those before, or, way −1, with those after.

    In the order in which they were taken, or the opposite one.
    """
    found, last = DiskCache(Evidence.arrays, Evidence.of_arrays), None
    for frame in range(len(evidence))[::way]:
        own = evidence[frame]
        if last is not None:
            led = next(led for led in motion.chained_flows(frame, 1) if led.frame == frame - way)
            kept = np.float32(LASTING) * led.found
            own = Evidence(
                moving=own.moving + kept * sample_image(last.moving, led.places),
                weight=own.weight + kept * sample_image(last.weight, led.places),
            )
        found.append(own)
        last = own
    return found


class StaticMotion:
    """Where points at rest go, under one motion of the camera, by their inverse depth.

    Parameters
    ----------
    rotation, translation : (3, 3) and (3,) array
        From a frame to another, P₁ = R P₀ + t.
    camera : Camera
    shape : (int, int)
        Height and width of the frames, px.
    """

    def __init__(
        self,
        rotation: np.ndarray,
        translation: np.ndarray,
        camera: Camera,
        shape: tuple[int, ...],
    ) -> None:
        self._focal = np.float32(camera.focal)
        self._center = np.array(camera.center_for(*shape[:2]), np.float32)
        start = (pixel_grid(shape) - self._center) / self._focal
        rays = cv2.merge([*cv2.split(start), np.ones(shape[:2], np.float32)])
        self._turned = cv2.transform(rays, rotation.astype(np.float32))
        self._translation = translation.astype(np.float32)

    def places(self, inverse_depth: np.ndarray | float) -> np.ndarray:
        """Return the places, (H, W, 2) float32, of points of inverse depths, in the unit of t."""
        moved = [
            turned + np.float32(inverse_depth) * part
            for turned, part in zip(cv2.split(self._turned), self._translation, strict=True)
        ]
        scale = self._focal / np.maximum(moved[2], np.float32(NEAREST))
        x, y = self._center
        return cv2.merge([moved[0] * scale + x, moved[1] * scale + y])

    def inverse_depth(self, inverse_depth: np.ndarray) -> np.ndarray:
        """Return the inverse depth in the other frame, (H, W) float32, of points of one in this."""
        ahead = self._turned[..., 2] + inverse_depth * self._translation[2]
        return inverse_depth / np.maximum(ahead, np.float32(NEAREST))

    def slope_and_missed(
        self, inverse_depth: np.ndarray, places: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return how places change with inverse depth, and what is missing to others, px.

        (H, W, 2) float32 each.
        """
        x, y, ahead = (
            turned + inverse_depth * part
            for turned, part in zip(cv2.split(self._turned), self._translation, strict=True)
        )
        scale = self._focal / np.maximum(ahead, np.float32(NEAREST))
        along_x, along_y, along = self._translation
        at_x, at_y = x * scale, y * scale
        slope = [
            scale * along_x - at_x * scale / self._focal * along,
            scale * along_y - at_y * scale / self._focal * along,
        ]
        missed = places - self._center - cv2.merge([at_x, at_y])
        return cv2.merge(slope), missed

    def nearest(self, places: np.ndarray) -> np.ndarray:
        """Return the inverse depth, (H, W) float32, of what comes nearest to places."""
        target = (places - self._center) / self._focal
        along, ahead = self._translation[:2], self._translation[2]
        turned, inverse_depth = self._turned, np.zeros(target.shape[:2], np.float32)
        for _ in range(2):  # the second one weighs as the first has found
            depth = np.maximum(turned[..., 2] + inverse_depth * ahead, np.float32(NEAREST))
            missed = (target * turned[..., 2:] - turned[..., :2]) / depth[..., None]
            slope = (target * ahead - along) / depth[..., None]
            steep = np.maximum((slope * slope).sum(axis=-1), np.float32(1e-12))
            inverse_depth = np.maximum(-(missed * slope).sum(axis=-1) / steep, np.float32(0))
        return inverse_depth


def shown(
    grey: np.ndarray,
    views: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray, StaticMotion]],
    nearest: np.ndarray,
    usual: np.ndarray,
) -> np.ndarray:
    """Return how far the images show that a pixel goes where it is led, and not where it rests.

    Where frames are bare, any place looks alike, and the image motion may be anything; where it is
    wrong, some depth at rest looks as well or better. Of several frames one depth has to do so.

    Parameters
    ----------
    grey : (H, W) float32
    views : sequence of (other, places, found, StaticMotion)
        Another frame, (H, W) float32; where the image motion leads in it, (H, W, 2) float32; and
        where it does, (H, W) bool.
    nearest : (H, W) float32
        The inverse depth at rest that comes nearest to that.
    usual : (N,) float32
        Inverse depths of points at rest.

    Returns
    -------
    (H, W) float32
        From `LEAST_SHOWN` to 1.
    """
    furthest = float(np.quantile(usual, 0.99)) * BEYOND if len(usual) else 0.0
    reach = [
        np.median(np.linalg.norm(at_rest.places(furthest) - at_rest.places(0.0), axis=-1))
        for *_, at_rest in views
    ]
    count = int(np.clip(max(reach) / TRIED_EVERY, *TRIED))
    missed = _missed(grey, [(other, led, found) for other, led, found, _ in views])
    least = np.full(grey.shape, np.inf, np.float32)
    tried: list[np.ndarray | float] = [nearest, *map(float, np.linspace(0, furthest, count))]
    for inverse_depth in tried:
        at_rest_places = [
            (other, at_rest.places(inverse_depth), found) for other, _, found, at_rest in views
        ]
        least = np.minimum(least, _missed(grey, at_rest_places))
    return np.clip((least - missed) / (CLEAR + missed), LEAST_SHOWN, 1)


def _missed(
    grey: np.ndarray, views: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]]
) -> np.ndarray:
    """Return by how many grey levels places in other frames differ, (H, W) float32, on average."""
    total, count = np.zeros(grey.shape, np.float32), np.zeros(grey.shape, np.float32)
    for other, places, found in views:
        total += found * grey_difference(other, places, grey)
        count += found
    return total / np.maximum(count, 1)


def grey_difference(other: np.ndarray, places: np.ndarray, grey: np.ndarray) -> np.ndarray:
    """Return by how many grey levels another frame at places differs from a frame, (H, W) float32.

    On average over windows.
    """
    return cv2.blur(np.abs(sample_image(other, places) - grey), (WINDOW, WINDOW))
