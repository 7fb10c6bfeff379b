"""Whether one of two frames is brighter, where that may be why there is doubt about them."""

import numpy as np

from tisfm.outcome import Status
from tisfm.settings import Settings
from tisfm.solver.image_pyramid import ImagePyramid

BRIGHTER = 1.15  # times as bright in the mean, and more: the light may have changed
DOUBTS = (
    "uncertain", "little_parallax", "pure_rotation", "two_motions", "behind_camera", "unexplained",
    "unrelated", "diverged",
)  # fmt: skip


def told_of_light(status: Status, pyramid: ImagePyramid, settings: Settings) -> Status:
    """Return a status whose message also says which frame is brighter, where that may be why.

    Its code stays: what a camera sees may be brighter from another place.
    """
    if status not in DOUBTS:
        return status
    mean0, mean1 = (float(frames[-1].mean()) for frames in (pyramid.frames0, pyramid.frames1))
    dark, bright = sorted((mean0, mean1))
    if not BRIGHTER * dark <= bright < np.inf or dark <= 0:
        return status
    brighter, other = (1, 0) if mean1 > mean0 else (0, 1)
    times = bright / dark
    advice = "bring both frames to one brightness"
    weights = ["brightness"] if settings.motion == "field" else ["brightness", "depth_brightness"]
    in_use = [name for name in weights if getattr(settings, name) > 0]
    if in_use and settings.gradient > 0:  # which is left then
        advice += ", or take " + " and ".join(f"{name}=0" for name in in_use)
    return Status(
        status,
        f"{status.message}. Frame {brighter} is {times:.3g} times as bright as frame {other}: if "
        f"light or exposure changed, {advice}",
    )
