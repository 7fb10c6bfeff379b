"""What a pair says about the focal length, and what another focal length would change."""

from dataclasses import dataclass

import numpy as np

from tisfm.motion.camera_search import (
    CameraSearch,
    Changes,
    measure_changes,
    search_cameras,
)
from tisfm.motion.camera_settings import INTRINSICS
from tisfm.motion.epipolar_fit import Pose, Rays, rotation_alone
from tisfm.settings import FocalOrigin
from tisfm.status import FOCAL_NOTE, Status

# Statuses of results that may be right, if the focal length is right.
NOTED_STATUSES = ("converged", "iteration_limit", "uncertain", "two_motions")


@dataclass(frozen=True, kw_only=True)
class FocalEvidence:
    """What a pair says about the focal length, and what another focal length would change."""

    # logarithm of the focal length that explains the rays best over the stated one, and its
    # standard deviation
    value: float
    value_deviation: float
    is_significant: bool  # whether this focal length explains the rays clearly better
    depth_effect: float  # relative change of depth over relative change of the focal length
    # (M,): other focal lengths that the rays allow, as the size of their logarithm over the stated
    # focal length; and the changes that they cause
    sizes: np.ndarray
    changes: Changes

    @property
    def spread(self) -> float:
        """Relative standard deviation of the stated focal length that the rays show."""
        return float(np.hypot(self.value, self.value_deviation))

    @property
    def replaces_guess(self) -> bool:
        """Whether the focal length of the rays is better than a guess."""
        return self.is_significant and self.value_deviation < INTRINSICS.max_focal_deviation

    def add_note(self, status: Status, origin: FocalOrigin) -> Status:
        """Return a status whose message says that the result depends on the focal length.

        With a guess, such a result is uncertain.
        """
        max_sizes = {
            "stated": INTRINSICS.max_wrong_focal,
            "guessed": INTRINSICS.max_wrong_guess,
            "estimated": 2 * self.value_deviation,
        }
        texts = describe_changes(*self.largest_changes(max_sizes[origin]))
        if not texts or status not in NOTED_STATUSES:
            return status
        advice = "Check the focal length" if origin == "stated" else "Give the focal length"
        is_doubtful = origin != "stated" and status == "converged"
        return Status(
            "uncertain" if is_doubtful else str(status),
            f"{status.message}. {FOCAL_NOTE} {origin} focal length, which the image motion does "
            f"not show: another one would change {', '.join(texts)}. {advice}",
        )

    def largest_changes(self, max_size: float) -> tuple[float, float, float]:
        """Largest changes of depth, direction and rotation by allowed focal lengths up to a size.

        The change of depth is relative, and the others are in rad.
        """
        is_chosen = self.sizes <= max_size
        depth, direction, rotation = (
            float(change[is_chosen].max(initial=0))
            for change in (self.changes.depth, self.changes.direction, self.changes.rotation)
        )
        return min(depth, 1.0), direction, rotation


def describe_changes(
    depth: float,  # relative
    # direction, rotation: rad
    direction: float,
    rotation: float,
) -> list[str]:
    """Return texts of the changes that a user has to know of."""
    texts = []
    if depth > INTRINSICS.max_depth_change:
        texts.append(f"depth by up to {100 * depth:.0f} %")
    if direction > INTRINSICS.max_direction_change:
        texts.append(f"the direction of motion by up to {np.degrees(direction):.0f}°")
    if rotation > INTRINSICS.max_rotation_change:
        texts.append(f"the rotation by up to {np.degrees(rotation):.0f}°")
    return texts


def weigh_focal(rays: Rays, pose: Pose, search: CameraSearch) -> FocalEvidence:
    """Return what a search for the focal length says, with the motion of the stated one."""
    sizes = np.abs(search.tried.values)
    max_cost = min(search.costs[0], search.best_cost) + INTRINSICS.max_allowed_cost
    is_allowed = (search.costs <= max_cost) & (sizes > 0)
    follows = (sizes > 0) & (np.arange(sizes.size) <= 2 * len(INTRINSICS.focal_values))
    is_near = follows & (sizes <= INTRINSICS.max_linear_focal)
    chosen = np.flatnonzero(is_allowed | is_near)
    changes = measure_changes(rays, pose, search.tried.select(chosen))
    effects = changes.depth / sizes[chosen]
    allowed = is_allowed[chosen]
    is_small = allowed & (sizes[chosen] <= INTRINSICS.max_wrong_focal)
    effect = max(
        float(np.median(effects[is_near[chosen]])), float(effects[is_small].max(initial=0))
    )
    return FocalEvidence(
        value=search.best_value,
        value_deviation=search.deviation,
        is_significant=search.is_significant,
        depth_effect=min(effect, INTRINSICS.max_depth_effect),
        sizes=sizes[chosen][allowed],
        changes=changes.select(allowed),
    )


def examine_focal(rays: Rays, pose: Pose) -> FocalEvidence:
    """Return what rays say about the focal length; the motion is that of the stated one."""
    sample = rays.subsample(max(1, rays.trust.size // INTRINSICS.max_rays))
    (search,) = search_cameras(sample, pose, rotation_alone(sample), focal_only=True)
    return weigh_focal(sample, pose, search)


def with_focal_note(status: Status, focal: float, evidence: FocalEvidence) -> Status:
    """Return a status whose message names a focal length, px, that replaced a guess."""
    return Status(
        str(status),
        f"{status.message}. The image motion gave the focal length, {focal:.0f} "
        f"± {focal * evidence.value_deviation:.0f} px, because none was stated",
    )
