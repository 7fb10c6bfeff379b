"""The note on a stated focal length that the image motion does not show."""

from collections.abc import Sequence

import numpy as np

from tisfm.reconstruction.result.calibration import Calibration
from tisfm.reconstruction.result.path_check import LIMITS, PathCheck


def find_focal_note(calibration: Calibration, checks: Sequence[PathCheck]) -> str:
    """Return a sentence if a result depends on a stated focal length; "" otherwise."""
    from tisfm.motion.focal_evidence import describe_changes

    pairs = [pair for check in checks for pair in check.pairs]
    if calibration.origin != "given" or not pairs:
        return ""
    spread = min(check.focal_spread for check in checks if check.pairs)
    changes = np.max(
        [[pair.focal_depth, pair.focal_direction, pair.focal_rotation] for pair in pairs], axis=0
    )
    depth, direction, rotation = (float(change) for change in changes)
    texts = describe_changes(depth, np.radians(direction), np.radians(rotation))
    if spread < LIMITS.max_focal_spread or not texts:
        return ""
    return (
        "the result depends on the stated focal length, which the image motion does not show: "
        f"another one would change {', '.join(texts)}; check the focal length"
    )
