"""The origin and the uncertainty of the camera of a result."""

import math
import os
from dataclasses import asdict, dataclass, fields, replace
from typing import Any, Literal

import numpy as np

from tisfm.camera_file import camera_file_path, read_camera_record
from tisfm.errors import InputError
from tisfm.focal_guess import at_size
from tisfm.formats import FormatError

Calibrate = Literal["nothing", "focal", "radial"]
"""The estimated camera parameters: none, the focal length, or also a radial coefficient."""
Origin = Literal["given", "estimated", "guessed"]


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """Origin and uncertainty of a camera's focal length.

    Lengths are px of the frames of the source, before cropping and shrinking, as in `tisfm.Camera`
    and ``--focal``. `Reconstruction.camera` has px of the frames of the result.
    """

    # Whether the user gave the focal length, or it was estimated from the sequence, or guessed from
    # the image file or the image size. For a camera file, this is the origin in the file.
    origin: Origin
    # the focal length, px of the frames of the source; None before any frame is known
    focal: float | None = None
    # standard deviation of the focal length, px of the frames of the source: 0 for a given focal
    # length, infinite for a guess
    focal_std: float = 0.0
    # height and width of the frames of the source, px
    shape: tuple[int, int] | None = None
    # whether the focal length is reliable: False for a guess, or if the motion hardly determines it
    seen: bool = True
    # the focal length, its origin and the size of its frames in words; for a given focal length,
    # what else was found, such as a lens, or empty
    message: str = ""
    # the estimated lens coefficient k1, whose distortion was removed; 0 without an estimate
    radial: float = 0.0
    radial_std: float = 0.0  # standard deviation of `radial`
    # the estimated readout time of the frames of the source, as for `tisfm.Camera`; its effect was
    # removed from the frames; 0 for no effect, or if the user gave the readout time
    readout: float = 0.0
    readout_std: float = 0.0  # standard deviation of `readout`

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

    @property
    def relative_focal_std(self) -> float:
        """Standard deviation of the focal length over the focal length; infinite for a guess."""
        if math.isinf(self.focal_std) or self.origin == "guessed":
            return math.inf
        return self.focal_std / self.focal if self.focal else 0.0


GIVEN = Calibration(origin="given")


def describe_focal(focal: float, deviation: float, shape: tuple[int, int] | None) -> str:
    """Return a text: a focal length and its deviation, px, and the size (H, W) of the frames.

    The text leaves out a deviation of 0 or infinity.
    """
    text = f"{focal:.4g}"
    if 0 < deviation < math.inf:
        text += f" ± {float(f'{deviation:.1g}'):g}"  # one significant digit
    return f"{text} px{at_size(shape)}"


def describe_zoom(focal: float, zoom: np.ndarray) -> str:
    """Return a text: the range of a focal length that changes.

    The focal length is that of the first frame, px. `zoom` is (N,), as `Reconstruction.zoom`.
    """
    return (
        "the camera zooms: this is the focal length of the first frame, that of the last frame is "
        f"{focal * zoom[-1]:.4g} px, and the range is {focal * zoom.min():.4g} to "
        f"{focal * zoom.max():.4g} px"
    )


def as_json(calibration: Calibration) -> dict[str, Any]:
    """Return the calibration as JSON values; JSON has no infinite numbers."""
    values = asdict(calibration)
    if math.isinf(calibration.focal_std):
        values["focal_std"] = None
    return values


def from_json(stored: dict[str, Any]) -> Calibration:
    """Return the calibration from the values of `as_json`."""
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


def read_calibration(
    path: str | os.PathLike[str],  # a file or folder that `tisfm.camera_file.read_camera` reads
    # px: focal length for the frames of the source, whose size may differ from the size in the
    # file. The returned focal length and deviation are for these frames; the message is unchanged.
    focal: float,
) -> Calibration:
    """Return the calibration in a camera file; "given" if the file states no origin.

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
        shape=None,  # the size of the frames is unknown here
        readout=0.0,  # not an estimate of this run
        readout_std=0.0,
    )
