"""Options that several commands share: the frames, the camera, the settings."""

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
    """The frames that are taken, and what part of them."""

    crop: Annotated[tuple[int, int, int, int] | None, arg(metavar="LEFT TOP WIDTH HEIGHT")] = None
    """Use this part of the frames alone, px. It is cut out before the rest is shrunk."""

    def selection(self) -> FrameSelection:
        """Return a plain selection, which other processes can load without the command line."""
        return FrameSelection(**asdict(self))


@dataclass(kw_only=True)
class CameraOptions:
    """The camera that took the frames."""

    file: Annotated[Path | None, arg(name="camera", metavar="FILE")] = None
    """The camera.json that tisfm reconstruct wrote of the same lens, or its folder."""
    focal: float | Literal["guess"] | None = None
    """Focal length, px of the frames before any crop or resizing. 'guess' takes the first image's
    EXIF data, or else its size. By default the paper's 600 where motion is 'field', else the guess.
    """
    center: tuple[float, float] | None = None
    """Principal point (cx, cy), px. By default the centre of the image."""
    distortion: Annotated[str | None, arg(metavar="K1,K2,P1,P2[,K3...]")] = None
    """OpenCV's coefficients of the lens, 4, 5, 8, 12 or 14 with commas between; removed first."""
    aspect: float = 1.0
    """fy / fx, where pixels are not square; --focal is then the smaller of both. Frames are
    resampled first."""
    readout: float | None = None
    """How long a frame is read, row after row, as a share of the time from a frame to the next; 0
    where all rows are read at once. By default reconstruct finds it for motion 'camera'; elsewhere
    it counts as 0. What it moves is undone by reconstruct, and in pairs for motion 'camera'."""

    def guess(self, motion: Motion) -> bool:
        """Return whether the focal length has to be guessed."""
        if self.file is not None:
            return False
        return self.focal == "guess" or (self.focal is None and motion != "field")

    def camera(self) -> Camera | Path:
        """Return the camera, with a focal length of 600 px if it is not given, or its file."""
        stated = (self.focal, self.center, self.distortion, self.readout)
        if self.file is not None:
            if any(value is not None for value in stated) or self.aspect != 1:
                raise InputError(
                    f"{self.file} states the camera: give neither --focal nor --center, "
                    "--distortion, --aspect or --readout"
                )
            return self.file
        focal = self.focal if isinstance(self.focal, float) else 600.0
        distortion = None if self.distortion is None else _numbers(self.distortion, "distortion")
        return Camera(
            focal=focal,
            center=self.center,
            distortion=distortion,
            aspect=self.aspect,
            readout=self.readout,
        )


@dataclass(frozen=True, kw_only=True)
class SettingsOptions(Settings):
    """What is minimised, and how. The defaults shown are those of --preset."""

    def __post_init__(self) -> None:
        """Skip the checks: the parser would report their errors in its own words."""

    def settings(self) -> Settings:
        """Return the settings, or raise as `Settings` does."""
        return Settings(**asdict(self))


@dataclass(kw_only=True)
class StatedCameraOptions:
    """The camera, where the dataset does not state one or another is wanted."""

    focal: float | None = None
    """Focal length of every pair, px. By default what the dataset states, or else 600."""
    center: tuple[float, float] | None = None
    """Principal point (cx, cy) that goes with --focal, px. By default the centre of the image."""

    def camera(self) -> Camera | None:
        """Return the camera of every pair; None if each dataset states its own."""
        if self.focal is None:
            if self.center is not None:
                raise InputError("center is given without focal: give --focal as well")
            return None
        return Camera(focal=self.focal, center=self.center)


def _numbers(text: str, name: str) -> tuple[float, ...]:
    """Read numbers with commas or spaces between."""
    try:
        return tuple(map(float, text.replace(",", " ").split()))
    except ValueError:
        raise InputError(f"{name} is {text!r}: expected numbers with commas between") from None
