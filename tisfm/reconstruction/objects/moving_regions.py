"""Moving regions of a frame, from the evidence of several frames on every pixel."""

from collections.abc import Iterator

import cv2
import numpy as np

from tisfm.motion.objects.candidates import smallest_object
from tisfm.motion.objects.label_optimisation import Potts
from tisfm.reconstruction.objects.motion_evidence import STATIC_PRIOR, Evidence

# Values without a stated source were set by hand.

# Mean evidence, −1 (static) to 3 (moving), at the boundary of a moving region.
REGION_EVIDENCE = -0.3
# Mean evidence of the core of a region. A new object needs a core.
CORE_EVIDENCE = 0.3
# Frames with evidence that a pixel of the core needs.
MIN_CORE_FRAMES = 1.5
# Pixels of the core, as a share of the smallest object.
MIN_CORE_OF_SMALLEST = 0.25
# Pixels of the core, as a share of the region.
MIN_CORE_SHARE = 0.15
# Mean evidence that is added where a known object is expected.
KNOWN_OBJECT_BONUS = 0.4
# Frames with evidence that give a pixel its full data weight.
FULL_WEIGHT_FRAMES = 4.0
# This full data weight, against the smoothness of labels.
MAX_DATA_WEIGHT = 0.5
# Share of the full data weight without any evidence.
MIN_DATA_SHARE = 0.02


def find_moving_regions(
    grey: np.ndarray,  # (H, W) float32
    evidence: Evidence,
    object_mask: np.ndarray,  # (H, W) bool: pixels of objects that moved in earlier frames
) -> Iterator[tuple[np.ndarray, bool]]:
    """Yield the connected parts of a frame that move, (H, W) bool, and whether they have a core."""
    mean = evidence.mean()
    core = (mean > CORE_EVIDENCE) & (evidence.weight > MIN_CORE_FRAMES)
    mean += np.float32(KNOWN_OBJECT_BONUS) * object_mask
    costs = np.stack(
        [2 * np.clip(mean - REGION_EVIDENCE, 0, 3), 4 * np.clip(REGION_EVIDENCE - mean, 0, 1)]
    )
    weight = MAX_DATA_WEIGHT * np.clip(
        (evidence.weight + STATIC_PRIOR) / FULL_WEIGHT_FRAMES, MIN_DATA_SHARE, 1
    )
    moving = Potts(grey).assign(costs.astype(np.float32), weight.astype(np.float32)) == 1
    count, components, statistics, _ = cv2.connectedComponentsWithStats(
        moving.astype(np.uint8), connectivity=4
    )
    cores = np.bincount(components[core], minlength=count)
    smallest = smallest_object(grey.size)
    for component in range(1, count):
        if statistics[component, cv2.CC_STAT_AREA] >= smallest:
            min_core = max(
                MIN_CORE_OF_SMALLEST * smallest,
                MIN_CORE_SHARE * statistics[component, cv2.CC_STAT_AREA],
            )
            yield components == component, bool(cores[component] >= min_core)
