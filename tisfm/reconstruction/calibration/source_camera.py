"""The camera of a source: given, guessed or estimated, before and after crop and reduction.

Whole sequences and streams set up their camera here, and get their calibration report here.
"""

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tisfm.camera import Camera
from tisfm.camera_file import read_camera
from tisfm.focal_guess import FocalGuess, at_size, guess_focal
from tisfm.reconstruction.calibration.settings import CALIBRATION
from tisfm.reconstruction.mapping.settings import MAPPING
from tisfm.reconstruction.mapping.solution import FocalEstimate
from tisfm.reconstruction.result.calibration import (
    GIVEN,
    Calibration,
    describe_focal,
    describe_zoom,
    read_calibration,
)
from tisfm.sources import FrameSource, SourceFrame

UNKNOWN_FOCAL_NOTE = (
    "the motion does not show the focal length: the camera moves straight without a rotation, or "
    "the scene is one plane"
)
DISTORTION_NOTE = 'the lens seems to distort: use calibrate="radial" (--calibrate radial)'
UNCERTAIN_NOTE = "the motion hardly shows it"
ADVICE = "if you know the focal length, give it"


@dataclass(frozen=True, kw_only=True)
class SourceCamera:
    """The camera of a source's frames."""

    full_camera: Camera  # camera of the frames of the source, before crop and reduction
    shape: tuple[int, int]  # height and width of these frames, px
    used_camera: Camera  # camera of the frames after crop and reduction
    # Share of a full frame's rows that the crop keeps. The readout time of a used frame is this
    # share of the readout time of the full frame.
    row_share: float
    guess: FocalGuess | None  # the guess of the focal length; None if a camera was given
    given_calibration: Calibration  # calibration of a given camera, from its file if it has one

    @classmethod
    def from_first_frame(
        cls, source: FrameSource, given_camera: Camera | Path | None, frame: SourceFrame
    ) -> "SourceCamera":
        """Return the given camera, the camera of a file, or a guess from the first frame."""
        height, width = frame.full_shape or frame.image.shape[:2]
        guess, given_calibration = None, GIVEN
        if isinstance(given_camera, Path):
            full_camera = read_camera(given_camera, (height, width))
            given_calibration = read_calibration(given_camera, full_camera.focal)
        elif given_camera is not None:
            full_camera = given_camera
        else:
            guess = guess_focal(source.first_file or frame.full_shape or frame.image.shape)
            full_camera = Camera(focal=guess.focal)
        # The readout time of used frames for a readout time of 1 of full frames: the share of rows
        unit_readout_camera = source.camera_after(
            replace(full_camera, readout=1.0), frame.full_shape
        )
        return cls(
            full_camera=full_camera,
            shape=(height, width),
            used_camera=source.camera_after(full_camera, frame.full_shape),
            row_share=unit_readout_camera.readout or 1.0,
            guess=guess,
            given_calibration=given_calibration,
        )

    @property
    def is_focal_known(self) -> bool:
        """Whether the focal length is given, and the given value is reliable."""
        return self.guess is None and self.given_calibration.seen

    @property
    def max_focal_deviation(self) -> float:
        """The largest relative standard deviation of an estimate that replaces the guess."""
        is_exif = self.guess is not None and self.guess.origin == "exif"
        return CALIBRATION.max_exif_deviation if is_exif else MAPPING.max_useful_deviation

    def full_readout(self, readout: float) -> float:
        """Return the readout time of full frames, at most 1 interval, for that of used frames."""
        return max(-1.0, min(readout / self.row_share, 1.0))

    def calibration(
        self,
        # estimate, used_camera, is_estimated, focal: as for `make_calibration`, where the used
        # camera is `camera`
        estimate: FocalEstimate | None,
        used_camera: Camera,
        *,
        is_estimated: bool,
        focal: float,
        # estimated readout time of used frames, and its standard deviation, in intervals between
        # frames
        readout: tuple[float, float] | None = None,
        # (N,) float64: focal length of each frame over that of the first frame
        zoom: np.ndarray | None = None,
    ) -> Calibration:
        """Return the origin and the uncertainty of the camera, in px of full frames."""
        calibration = make_calibration(
            estimate,
            self.guess,
            used_camera,
            is_estimated=is_estimated,
            focal=focal,
            shape=self.shape,
            given_calibration=self.given_calibration,
        )
        if zoom is not None:
            calibration = add_zoom(calibration, zoom)
        if readout is None:
            return calibration
        return replace(
            calibration,
            readout=self.full_readout(readout[0]),
            readout_std=readout[1] / self.row_share,
        )


def add_zoom(calibration: Calibration, zoom: np.ndarray) -> Calibration:
    """Return a calibration whose message says how the focal length changes."""
    focal = calibration.focal or 0.0
    text = calibration.message or f"{focal:.4g} px{at_size(calibration.shape)}"
    return replace(
        calibration,
        message=f"{text}; {describe_zoom(focal, zoom)}",
    )


def add_radial(calibration: Calibration, estimate: FocalEstimate) -> Calibration:
    """Return the calibration of a stated focal length, with an estimated k1 of the lens."""
    text = calibration.message or f"{calibration.focal:.4g} px{at_size(calibration.shape)}, given"
    return replace(
        calibration,
        radial=estimate.radial,
        radial_std=estimate.radial_deviation,
        message=f"{text}; the lens distorts: k1 = {describe_radial(estimate)}, estimated from the "
        "sequence and removed",
    )


def describe_radial(estimate: FocalEstimate) -> str:
    """Return a text: the coefficient of the lens and its deviation."""
    return f"{estimate.radial:.3f} ± {float(f'{estimate.radial_deviation:.1g}'):g}"


def make_calibration(
    # estimate from the sequence, px of the used frames (after crop and reduction)
    estimate: FocalEstimate | None,
    # guess from the first file or the size of frames; None if a camera was given
    guess: FocalGuess | None,
    camera: Camera,  # camera of the used frames
    *,
    is_estimated: bool,  # whether the focal length was to be estimated from the sequence
    focal: float,  # focal length of `camera`, px of the frames of the source
    shape: tuple[int, int],  # height and width of the frames of the source, px
    given_calibration: Calibration = GIVEN,  # calibration of a given camera
) -> Calibration:
    """Return the origin and uncertainty of a focal length, in px of the frames of the source."""
    if not is_estimated and guess is None:
        calibration = replace(given_calibration, focal=focal, shape=shape)
        return calibration if estimate is None else add_radial(calibration, estimate)
    if estimate is None or not estimate.is_useful:
        text = f"the focal length is a guess, {focal:.0f} px{at_size(shape)}"
        if guess is not None:
            text += f", {guess.reason}"
        if is_estimated:
            text += f": {'no path was found' if estimate is None else UNKNOWN_FOCAL_NOTE}"
        message = f"{text}; {ADVICE}"
        return Calibration(
            origin="guessed",
            focal=focal,
            focal_std=math.inf,
            shape=shape,
            seen=False,
            message=message,
        )
    deviation = estimate.deviation * focal / camera.focal
    text = f"{describe_focal(focal, deviation, shape)}, estimated from the sequence"
    if estimate.radial:
        text += f" with k1 = {describe_radial(estimate)}"
    reason = DISTORTION_NOTE if estimate.shows_distortion else UNCERTAIN_NOTE
    message = text if estimate.is_certain else f"the focal length is {text}: {reason}; {ADVICE}"
    return Calibration(
        origin="estimated",
        focal=focal,
        focal_std=deviation,
        shape=shape,
        seen=estimate.is_certain,
        message=message,
        radial=estimate.radial,
        radial_std=estimate.radial_deviation,
    )
