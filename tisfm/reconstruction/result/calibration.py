"""The origin and the uncertainty of the camera of a result."""

import math
import os
from dataclasses import asdict, dataclass, fields, replace
from typing import Any, Literal

from tisfm.camera_file import camera_file_path, read_camera_record
from tisfm.errors import InputError
from tisfm.focal_guess import at_size
from tisfm.formats import FormatError

Calibrate = Literal["nothing", "focal", "radial"]
"""The camera parameters that are found: none, the focal length, or a radial coefficient as well."""
Origin = Literal["given", "estimated", "guessed"]


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """Origin and uncertainty of a camera's focal length.

    Lengths are px of the frames of the source, before cropping and shrinking, as in `tisfm.Camera`
    and ``--focal``. `Reconstruction.camera` has px of the frames of the result.
    """

    # Whether the focal length was given, estimated from the sequence, or guessed from the image
    # file or the image size. If the camera was given as a file, the origin that the file states.
    origin: Origin
    # the focal length, px of the frames of the source; None before any frame is known
    focal: float | None = None
    # its standard deviation, px of the frames of the source: 0 if it was given, infinite if it was
    # guessed
    focal_std: float = 0.0
    # height and width of the frames of the source, px
    shape: tuple[int, int] | None = None
    # whether the focal length is reliable: False if it was guessed, or if the motion hardly
    # determines it
    seen: bool = True
    # the focal length, its origin and the size of its frames in words; empty if it was given
    message: str = ""
    # the lens coefficient k1 that was estimated with it, whose distortion was removed; 0 if none
    # was estimated
    radial: float = 0.0
    radial_std: float = 0.0  # its standard deviation
    # Readout time of the frames of the source, as for `tisfm.Camera`, if it was estimated from the
    # sequence; its effect has been removed from the frames. 0 if there is no effect, or if it was
    # given.
    readout: float = 0.0
    readout_std: float = 0.0  # its standard deviation

    def __post_init__(self) -> None:
        """Check the values, which may come from a file."""
        if self.origin not in ("given", "estimated", "guessed"):
            raise InputError(f"origin is {self.origin!r}: expected given, estimated or guessed")
        if not self.focal_std >= 0 or (self.origin == "estimated" and math.isinf(self.focal_std)):
            raise InputError(
                f"focal_std is {self.focal_std}: expected at least 0, finite if estimated"
            )
        if self.focal is not None and not 0 < self.focal < math.inf:
            raise InputError(f"focal is {self.focal}: expected a positive number of px")
        if self.shape is not None and (len(self.shape) != 2 or min(self.shape) < 1):
            raise InputError(f"shape is {self.shape}: expected two positive numbers of px")


GIVEN = Calibration(origin="given")


def describe_focal(focal: float, deviation: float, shape: tuple[int, int] | None) -> str:
    """Return a focal length and its deviation, px, with the size (H, W) of their frames.

    A deviation that is 0 or infinite is left out.
    """
    text = f"{focal:.4g}"
    if 0 < deviation < math.inf:
        text += f" ± {float(f'{deviation:.1g}'):g}"  # one significant digit
    return f"{text} px{at_size(shape)}"


def as_json(calibration: Calibration) -> dict[str, Any]:
    """Return the calibration as JSON, which has no infinite numbers."""
    values = asdict(calibration)
    if math.isinf(calibration.focal_std):
        values["focal_std"] = None
    return values


def from_json(stored: dict[str, Any]) -> Calibration:
    """Return the calibration that `as_json` wrote."""
    deviation = math.inf if stored["focal_std"] is None else float(stored["focal_std"])
    names = {field.name for field in fields(Calibration)}  # later versions may have more fields
    converters: dict[str, Any] = {"origin": str, "seen": bool, "message": str, "shape": _shape}
    # The file of a camera has null for an unknown readout time.
    stored_names = [name for name in names - {"focal_std"} if stored.get(name) is not None]
    values = {name: converters.get(name, float)(stored[name]) for name in stored_names}
    return Calibration(**values, focal_std=deviation)


def _shape(values: Any) -> tuple[int, int]:
    height, width = map(int, values)
    return height, width


def calibration_in(
    path: str | os.PathLike[str],  # a file or folder that `tisfm.camera_file.read_camera` reads
    # px: focal length of the frames of the source, whose size may differ from the size in the file.
    # The returned focal length and deviation are px of these frames; the message is that of the
    # file.
    focal: float,
) -> Calibration:
    """Return the calibration in the file of a camera; "given" if the file states no origin.

    Raises OSError if the file cannot be read.

    Raises tisfm.formats.FormatError if its content is damaged.
    """
    record = read_camera_record(path)
    if "origin" not in record:
        return GIVEN
    try:
        calibration = from_json({"focal_std": 0.0} | record)
        ratio = focal / float(record["focal"])
    except (ValueError, KeyError, TypeError, ArithmeticError) as error:
        raise FormatError(f"{camera_file_path(path)} is damaged: {error}") from error
    return replace(
        calibration,
        focal=focal,
        focal_std=ratio * calibration.focal_std,
        shape=None,  # the size of these frames is unknown here
        readout=0.0,  # from now on it counts as given
        readout_std=0.0,
    )
