"""Parts of a frame that move on their own, by what several frames say of every pixel."""

from collections.abc import Iterator

import cv2
import numpy as np

from tisfm.motion.objects.candidates import smallest_object
from tisfm.motion.objects.label_optimisation import Potts
from tisfm.reconstruction.objects.motion_evidence import DOUBT, Evidence

# Of mean evidence: where the boundary lies; of a core, which a thing has to have, with so many
# frames that say something; and the share of the smallest thing that is core.
BOUNDARY, CORE, CORE_WEIGHT, CORE_SHARE = -0.3, 0.3, 1.5, 0.25
KNOWN = 0.4  # of mean evidence: so much more, where something was seen to move before
CORE_PART = 0.15  # and of the part itself: what is hardly shown anywhere is no thing
SURE = 4.0  # frames that say something: more have no more say in the boundary
SEEN, UNSEEN = 0.5, 0.02  # what pixels weigh in the boundary: those of sure evidence, and others


def find_moving_regions(
    grey: np.ndarray, evidence: Evidence, known: np.ndarray
) -> Iterator[tuple[np.ndarray, bool]]:
    """Yield the connected parts of a frame that move, (H, W) bool, and whether they have a core.

    Parameters
    ----------
    grey : (H, W) float32
    evidence : Evidence
    known : (H, W) bool
        What belongs to things that were seen to move before.
    """
    mean = evidence.mean()
    core = (mean > CORE) & (evidence.weight > CORE_WEIGHT)
    mean += np.float32(KNOWN) * known
    costs = np.stack([2 * np.clip(mean - BOUNDARY, 0, 3), 4 * np.clip(BOUNDARY - mean, 0, 1)])
    weight = SEEN * np.clip((evidence.weight + DOUBT) / SURE, UNSEEN, 1)
    moving = Potts(grey).assign(costs.astype(np.float32), weight.astype(np.float32)) == 1
    count, parts, statistics, _ = cv2.connectedComponentsWithStats(
        moving.astype(np.uint8), connectivity=4
    )
    cores = np.bincount(parts[core], minlength=count)
    smallest = smallest_object(grey.size)
    for part in range(1, count):
        if statistics[part, cv2.CC_STAT_AREA] >= smallest:
            enough = max(CORE_SHARE * smallest, CORE_PART * statistics[part, cv2.CC_STAT_AREA])
            yield parts == part, bool(cores[part] >= enough)
