"""Inverse depth of a partly textureless background, carried across around moving objects."""

import cv2
import numpy as np

from tisfm.motion.camera import CARRIED_RANGE
from tisfm.motion.plane_sweep import COMMON
from tisfm.motion.rigid_depth import RigidSolution, scaled_translations
from tisfm.motion.textureless_depth import (
    MOST_TEXTURELESS,
    TexturelessSolution,
    textureless_depth,
    textureless_share,
)
from tisfm.settings import Settings
from tisfm.solver.image_pyramid import ImagePyramid

RIM = 7  # px: window that erodes the background, as windows across its boundary mix depths


def carry_background_depth(
    pyramid: ImagePyramid,
    settings: Settings,
    solution: RigidSolution,
    labels: np.ndarray,  # (H, W) int32: 0 for the background
    # (3, 4) array: R and t of the background's layer, because wrong depth of textureless surfaces
    # spoils the refined motion
    motion: np.ndarray,
) -> TexturelessSolution | None:
    """Return a solution with carried depth of the background, if this is partly textureless.

    Pixels of other labels keep their motion and depth. They are neither matched nor constrained
    under the background's motion.

    Returns none if little of the frame is textureless, if the background's parallax differs too
    little between near and far, or if too little of the background could be matched.
    """
    if (
        textureless_share(pyramid.frames0[pyramid.last], pyramid.counted0(pyramid.last))
        < MOST_TEXTURELESS
    ):
        return None
    background = labels == 0
    low, high = np.percentile(solution.inverse_depth[background], COMMON)
    if not high - low >= CARRIED_RANGE * max(labels.shape):
        return None
    core = cv2.erode(background.astype(np.uint8), np.ones((RIM, RIM), np.uint8)) > 0
    motions = solution.motions.copy()
    motions[0] = scaled_translations(motion[None], labels, pyramid.cameras[0])[0]
    carried = textureless_depth(pyramid, settings, motions[0], support=core)
    if carried is None:
        return None
    size = solution.precision.shape[:0:-1]
    is_background = (
        cv2.resize(background.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
    )
    solutions: list[RigidSolution] = [solution, carried]
    if labels.any() and not solution.converged:
        solutions.reverse()  # the last one gives the status of the iterations
    first, last = solutions
    return TexturelessSolution(
        motions=motions,
        inverse_depth=np.where(background, carried.inverse_depth, solution.inverse_depth),
        precision=np.where(is_background, _resize_precision(carried, solution), solution.precision),
        level=solution.level,
        density=solution.density,
        history=first.history + last.history,
        converged=last.converged,
        is_adjustable=last.is_adjustable,
        carried_deviation=np.where(background, carried.deviation(), solution.deviation()),
    )


def _resize_precision(carried: TexturelessSolution, other: RigidSolution) -> np.ndarray:
    """Return the precision of one solution on the level of another, (7, h, w) float32."""
    if carried.level == other.level:
        return carried.precision
    size = other.precision.shape[:0:-1]
    area = np.float32((carried.density / other.density) ** 2)  # ratio of px² of both levels
    units = (area, area, area, 1 / area, 1 / area, 1 / area, 1 / area)
    channels = zip(carried.precision, units, strict=True)
    return np.stack([cv2.resize(channel, size) * unit for channel, unit in channels])
