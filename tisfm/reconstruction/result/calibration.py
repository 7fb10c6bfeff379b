"""The origin and the uncertainty of the camera of a result."""

import math
import os
from dataclasses import asdict, dataclass, fields, replace
from typing import Any, Literal

from tisfm.camera_file import file_of, record_in
from tisfm.errors import InputError
from tisfm.focal_guess import at_size
from tisfm.formats import FormatError

Calibrate = Literal["nothing", "focal", "radial"]
"""The part of the camera that is found: nothing, the focal length, or a radial coefficient too."""
Origin = Literal["given", "estimated", "guessed"]


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """Where a camera's focal length is from, and how far to trust it.

    Its lengths are px of the frames of the source, before these are cropped and shrunk, as those of
    `tisfm.Camera` and ``--focal`` are. `Reconstruction.camera` is of the frames of the result.

    Attributes
    ----------
    origin : {"given", "estimated", "guessed"}
        Whether it was given, found from the sequence, or guessed from the image file or the size.
        Of a camera that was given as a file, what the file says of it.
    focal : float or None
        The focal length, px of the frames of the source; None where no frame is known yet.
    focal_std : float
        Its standard deviation, px of the frames of the source: 0 where it was given, infinite where
        it was guessed.
    shape : (int, int) or None
        Height and width of the frames of the source, px.
    seen : bool
        Whether it can be relied on: False where it was guessed, or the motion hardly shows it.
    message : str
        The focal length, its origin and the size of its frames in words; empty where it was given.
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
    focal: float | None = None
    focal_std: float = 0.0
    shape: tuple[int, int] | None = None
    seen: bool = True
    message: str = ""
    radial: float = 0.0
    radial_std: float = 0.0
    readout: float = 0.0
    readout_std: float = 0.0

    def __post_init__(self) -> None:
        """Check the values, which may come from a file."""
        if self.origin not in ("given", "estimated", "guessed"):
            raise InputError(f"origin is {self.origin!r}")
        if not self.focal_std >= 0 or (self.origin == "estimated" and math.isinf(self.focal_std)):
            raise InputError(f"focal_std is {self.focal_std}")
        if self.focal is not None and not 0 < self.focal < math.inf:
            raise InputError(f"focal is {self.focal}")
        if self.shape is not None and (len(self.shape) != 2 or min(self.shape) < 1):
            raise InputError(f"shape is {self.shape}")


GIVEN = Calibration(origin="given")


def describe_focal(focal: float, deviation: float, shape: tuple[int, int] | None) -> str:
    """Return a focal length and its deviation, px, with the size (H, W) of their frames.

    A deviation of 0 is left out, and so is an infinite one.
    """
    told = f"{focal:.4g}"
    if 0 < deviation < math.inf:
        told += f" ± {float(f'{deviation:.1g}'):g}"  # one significant digit
    return f"{told} px{at_size(shape)}"


def as_json(calibration: Calibration) -> dict[str, Any]:
    """Return the calibration as JSON, which has no infinite numbers."""
    about = asdict(calibration)
    if math.isinf(calibration.focal_std):
        about["focal_std"] = None
    return about


def from_json(about: dict[str, Any]) -> Calibration:
    """Return the calibration that `as_json` wrote."""
    deviation = math.inf if about["focal_std"] is None else float(about["focal_std"])
    known = {field.name for field in fields(Calibration)}  # later versions may say more
    kinds: dict[str, Any] = {"origin": str, "seen": bool, "message": str, "shape": _shape}
    # The file of a camera has null for a readout that is not known.
    stated = [name for name in known - {"focal_std"} if about.get(name) is not None]
    values = {name: kinds.get(name, float)(about[name]) for name in stated}
    return Calibration(**values, focal_std=deviation)


def _shape(given: Any) -> tuple[int, int]:
    height, width = map(int, given)
    return height, width


def calibration_in(path: str | os.PathLike[str], focal: float) -> Calibration:
    """Return what the file of a camera says of its focal length; "given" if that is nothing.

    Parameters
    ----------
    path : path
        One that `tisfm.camera_file.read_camera` reads.
    focal : float
        Of the frames that the file was read for, px: their size may differ from that in the file.
        The returned focal length and deviation are px of the same frames; the message is that of
        the file.

    Raises
    ------
    OSError
        If it cannot be read.
    tisfm.formats.FormatError
        If what it says is damaged.
    """
    record = record_in(path)
    if "origin" not in record:
        return GIVEN
    try:
        about = from_json({"focal_std": 0.0} | record)
        ratio = focal / float(record["focal"])
    except (ValueError, KeyError, TypeError, ArithmeticError) as error:
        raise FormatError(f"{file_of(path)} is damaged: {error}") from error
    return replace(
        about,
        focal=focal,
        focal_std=ratio * about.focal_std,
        shape=None,  # of the frames that it was read for, which are not known here
        readout=0.0,  # it is given now
        readout_std=0.0,
    )
