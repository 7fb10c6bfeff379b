"""Options that several commands share: the frames, the camera, the settings."""

import inspect
import re
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import arg

from tisfm.camera import Camera
from tisfm.errors import InputError
from tisfm.running.pairs import FrameSelection
from tisfm.settings import Motion, Settings


@dataclass(frozen=True, kw_only=True)
class FrameOptions(FrameSelection):
    """The frames to use, and the part of each frame."""

    crop: Annotated[tuple[int, int, int, int] | None, arg(metavar="LEFT TOP WIDTH HEIGHT")] = None
    """Use only this part of the frames, px. It is cut out before it is shrunk."""

    def selection(self) -> FrameSelection:
        """Return a plain selection, which other processes can load without the command line."""
        return FrameSelection(**asdict(self))


@dataclass(kw_only=True)
class CameraOptions:
    """The camera that took the frames."""

    file: Annotated[Path | None, arg(name="camera", metavar="FILE")] = None
    """The camera.json that tisfm reconstruct wrote for the same lens, or its folder."""
    focal: float | Literal["guess"] | None = None
    """Focal length, px of the frames before they are cropped or shrunk. guess computes it from the
    EXIF data of the first image, or else from its size. The default depends on the command: tisfm
    reconstruct estimates it; tisfm run guesses it for the motion models camera and objects, and
    takes 600 for field; tisfm figures takes 600."""
    center: tuple[float, float] | None = None
    """Principal point (cx, cy), px. By default the centre of the image."""
    distortion: Annotated[str | None, arg(metavar="K1,K2,P1,P2[,K3...]")] = None
    """Coefficients of the lens distortion as in OpenCV: 4, 5, 8, 12 or 14 numbers with commas
    between. The distortion is removed first."""
    aspect: float = 1.0
    """fy / fx, if pixels are not square; --focal is then the smaller of the two. Frames are
    first resampled to square pixels."""
    readout: float | None = None
    """Readout time of a rolling shutter, as a share of the time between two frames: the delay from
    the first row to the last; 0 if all rows are read at once. tisfm reconstruct corrects the frames
    for it, and estimates it if it is not given, except for motion objects. tisfm run corrects the
    frames for a given readout time, for motion camera alone."""

    def guess(self, motion: Motion) -> bool:
        """Return whether to guess the focal length."""
        if self.file is not None:
            return False
        return self.focal == "guess" or (self.focal is None and motion != "field")

    def camera(self) -> Camera | Path:
        """Return the camera, with a focal length of 600 px if it is not given, or its file."""
        values = (self.focal, self.center, self.distortion, self.readout)
        if self.file is not None:
            if any(value is not None for value in values) or self.aspect != 1:
                raise InputError(
                    f"{self.file} states the camera: leave out --focal, --center, --distortion, "
                    "--aspect and --readout"
                )
            return self.file
        focal = self.focal if isinstance(self.focal, float) else 600.0
        distortion = (
            None if self.distortion is None else _parse_numbers(self.distortion, "distortion")
        )
        return Camera(
            focal=focal,
            center=self.center,
            distortion=distortion,
            aspect=self.aspect,
            readout=self.readout,
        )


@dataclass(frozen=True, kw_only=True)
class SettingsOptions(Settings):
    """Settings of the energy and its minimisation.

    The defaults shown are those of --preset. The paper is Sekkati and Mitiche (2007),
    doi:10.1016/j.robot.2006.11.006.
    """

    def __post_init__(self) -> None:
        """Skip the checks: the parser would report their errors in its own words."""

    def settings(self) -> Settings:
        """Return the settings, or raise as `Settings` does."""
        return Settings(**asdict(self))


def _with_options(text: str) -> str:
    """Return a docstring in which options replace names of settings, and values have no marks."""
    text = re.sub(r'``"(\w+)"``', r"\1", text)
    return re.sub(
        r"`{1,2}(\w+)(?:=\"?(\w+)\"?)?`{1,2}",
        lambda match: " ".join(["--" + match[1].replace("_", "-"), *filter(None, [match[2]])]),
        text,
    )


# The help of the settings is in the docstring of `Settings`, between these two headings.
_PARAMETERS = (
    inspect.cleandoc(Settings.__doc__ or "").partition("Parameters\n")[2].partition("Raises\n")[0]
)
SettingsOptions.__doc__ = f"{SettingsOptions.__doc__}\n\nParameters\n{_with_options(_PARAMETERS)}"


@dataclass(kw_only=True)
class StatedCameraOptions:
    """The camera, if the dataset does not state it, or to replace the stated one."""

    focal: float | None = None
    """Focal length for all pairs, px. By default the focal length that the dataset states, or else
    600."""
    center: tuple[float, float] | None = None
    """Principal point (cx, cy), px; only with --focal. By default the centre of the image."""

    def camera(self) -> Camera | None:
        """Return the camera of every pair; None if each dataset states its own."""
        if self.focal is None:
            if self.center is not None:
                raise InputError("center is given without focal: give --focal as well")
            return None
        return Camera(focal=self.focal, center=self.center)


def _parse_numbers(text: str, name: str) -> tuple[float, ...]:
    """Read numbers with commas or spaces between."""
    try:
        return tuple(map(float, text.replace(",", " ").split()))
    except ValueError:
        raise InputError(f"{name} is {text!r}: expected numbers with commas between") from None
