"""The camera of a source: given, guessed or estimated, before and after crop and reduction.

Whole sequences and streams set up their camera here, and get their calibration report here.
"""

import math
from dataclasses import dataclass, replace
from pathlib import Path

from tisfm.camera import Camera
from tisfm.camera_file import read_camera
from tisfm.focal_guess import FocalGuess, at_size, guess_focal
from tisfm.reconstruction.mapping.solution import MAX_USEFUL_DEVIATION, FocalEstimate
from tisfm.reconstruction.result.calibration import (
    GIVEN,
    Calibration,
    calibration_in,
    describe_focal,
)
from tisfm.sources import FrameSource, SourceFrame

# Share of the focal length: an estimate with a larger standard deviation is worse than the focal
# length in the EXIF data of a file. Set by hand.
MAX_EXIF_DEVIATION = 0.1
UNSEEN_SAID = (
    "the motion does not show the focal length, as where the camera goes straight on without "
    "turning or all lies in one plane"
)
BENT_SAID = 'the lens seems to distort: calibrate="radial" (--calibrate radial) finds that as well'
HARDLY_SAID = "the motion hardly shows it"
ADVICE = "give it if you know it, for instance from a calibration"


@dataclass(frozen=True, kw_only=True)
class SourceCamera:
    """The camera of a source's frames."""

    full: Camera  # camera of the frames of the source, before crop and reduction
    shape: tuple[int, int]  # height and width of these frames, px
    used: Camera  # camera of the frames after crop and reduction
    # Share of a full frame's rows that the crop keeps. The readout time of a used frame is this
    # share of the readout time of the full frame.
    rows: float
    guess: FocalGuess | None  # the guess of the focal length; None if a camera was given
    stated: Calibration  # known calibration of a given camera

    @classmethod
    def of_first_frame(
        cls, source: FrameSource, given: Camera | Path | None, frame: SourceFrame
    ) -> "SourceCamera":
        """Return the given camera, the camera of a file, or a guess from the first frame."""
        height, width = frame.full or frame.image.shape[:2]
        guess, stated = None, GIVEN
        if isinstance(given, Path):
            full = read_camera(given, (height, width))
            stated = calibration_in(given, full.focal)
        elif given is not None:
            full = given
        else:
            guess = guess_focal(source.first_file or frame.full or frame.image.shape)
            full = Camera(focal=guess.focal)
        whole = source.camera_after(replace(full, readout=1.0), frame.full)
        return cls(
            full=full,
            shape=(height, width),
            used=source.camera_after(full, frame.full),
            rows=whole.readout or 1.0,
            guess=guess,
            stated=stated,
        )

    @property
    def is_focal_stated(self) -> bool:
        """Whether the focal length is given, and the given value is reliable."""
        return self.guess is None and self.stated.seen

    @property
    def max_focal_deviation(self) -> float:
        """The largest relative standard deviation of an estimate that replaces the guess."""
        is_exif = self.guess is not None and self.guess.origin == "exif"
        return MAX_EXIF_DEVIATION if is_exif else MAX_USEFUL_DEVIATION

    def full_readout(self, readout: float) -> float:
        """Return the readout time of full frames, at most 1 interval, from that of used frames."""
        return max(-1.0, min(readout / self.rows, 1.0))

    def calibration(
        self,
        # found, used, sought, focal: as `found`, `camera`, `sought` and `focal` of
        # `make_calibration`
        found: FocalEstimate | None,
        used: Camera,
        *,
        sought: bool,
        focal: float,
        # (float, float): estimated readout time of used frames, and its standard deviation, in
        # intervals between frames
        readout: tuple[float, float] | None = None,
    ) -> Calibration:
        """Return the origin and the uncertainty of the camera, in px of full frames."""
        calibration = make_calibration(
            found,
            self.guess,
            used,
            sought=sought,
            focal=focal,
            shape=self.shape,
            stated=self.stated,
        )
        if readout is None:
            return calibration
        return replace(
            calibration,
            readout=self.full_readout(readout[0]),
            readout_std=readout[1] / self.rows,
        )


def make_calibration(
    # estimate from the sequence, px of the used frames (after crop and reduction)
    found: FocalEstimate | None,
    # guess from the first file or the size of frames; None if a camera was given
    guess: FocalGuess | None,
    camera: Camera,  # camera of the used frames
    *,
    sought: bool,  # whether the focal length was to be estimated from the sequence
    focal: float,  # focal length of `camera`, px of the frames of the source
    shape: tuple[int, int],  # height and width of the frames of the source, px
    stated: Calibration = GIVEN,  # known calibration of a given camera
) -> Calibration:
    """Return the origin and uncertainty of a focal length, in px of the frames of the source."""
    if not sought and guess is None:
        return replace(stated, focal=focal, shape=shape)
    if found is None or not found.is_useful:
        told = f"the focal length is a guess, {focal:.0f} px{at_size(shape)}"
        if guess is not None:
            told += f", {guess.reason}"
        if sought:
            told += f": {'no path was found' if found is None else UNSEEN_SAID}"
        message = f"{told}; {ADVICE}"
        return Calibration(
            origin="guessed",
            focal=focal,
            focal_std=math.inf,
            shape=shape,
            seen=False,
            message=message,
        )
    deviation = found.deviation * focal / camera.focal
    told = f"{describe_focal(focal, deviation, shape)}, found from the sequence"
    if found.radial:
        told += f" with k1 = {found.radial:.3f} ± {float(f'{found.radial_deviation:.1g}'):g}"
    doubt = BENT_SAID if found.shows_distortion else HARDLY_SAID
    message = told if found.is_certain else f"the focal length is {told}: {doubt}; {ADVICE}"
    return Calibration(
        origin="estimated",
        focal=focal,
        focal_std=deviation,
        shape=shape,
        seen=found.is_certain,
        message=message,
        radial=found.radial,
        radial_std=found.radial_deviation,
    )
