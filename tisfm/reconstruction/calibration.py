"""Where the focal length of a sequence is from, and how far to trust it."""

import math
from dataclasses import asdict, dataclass
from typing import Any, Literal

Calibrate = Literal["nothing", "focal", "radial"]
"""What of the camera is found: nothing, the focal length, or it and one radial coefficient."""
Origin = Literal["given", "estimated", "guessed"]


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """Where a camera's focal length is from, and how far to trust it.

    Attributes
    ----------
    origin : {"given", "estimated", "guessed"}
        Whether it was given, found from the sequence, or guessed from the image file or the size.
    focal_std : float
        Its standard deviation, px: 0 where it was given, infinite where it was guessed.
    seen : bool
        Whether it can be relied on: False where it was guessed, or the motion hardly shows it.
    message : str
        That in words; empty where it was given.
    radial : float
        The coefficient k1 of the lens that was found with it, whose distortion was removed; 0 if
        none was sought.
    radial_std : float
        Its standard deviation.
    readout : float
        How long a frame is read, as for `tisfm.Camera`, of the frames as they were taken, if that
        was found from the sequence: what it moves has been undone. 0 if none was seen, or it was
        given.
    readout_std : float
        Its standard deviation.
    """

    origin: Origin
    focal_std: float = 0.0
    seen: bool = True
    message: str = ""
    radial: float = 0.0
    radial_std: float = 0.0
    readout: float = 0.0
    readout_std: float = 0.0

    def __post_init__(self) -> None:
        """Check the values, which may come from a file."""
        if self.origin not in ("given", "estimated", "guessed"):
            raise ValueError(f"origin is {self.origin!r}")
        if not self.focal_std >= 0 or (self.origin == "estimated" and math.isinf(self.focal_std)):
            raise ValueError(f"focal_std is {self.focal_std}")


GIVEN = Calibration(origin="given")


def as_json(calibration: Calibration) -> dict[str, Any]:
    """Return it as JSON has it, where nothing is infinite."""
    about = asdict(calibration)
    if math.isinf(calibration.focal_std):
        about["focal_std"] = None
    return about
