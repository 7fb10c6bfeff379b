"""Labels from the folder of an earlier reconstruction."""

import glob
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tisfm.camera import Camera
from tisfm.camera_file import FILE_NAME as CAMERA
from tisfm.camera_file import read_camera
from tisfm.errors import InputError
from tisfm.reconstruction.result.folder import MASKS, PICTURES, RECORD, mask_path, read_record

# Distortion coefficients of OpenCV's largest lens model.
MAX_COEFFICIENTS = 14
# Relative difference of parameters, below which two cameras are equal.
SAME_CAMERA_TOLERANCE = 1e-6


@dataclass(frozen=True, kw_only=True)
class ResultLabels:
    """The labels of an earlier reconstruction."""

    folder: Path
    files: Mapping[str, Path]  # label files by the names of the frames
    # the labels fit frames that are corrected for distortion and rolling shutter of this camera;
    # None if they fit uncorrected frames
    camera: Camera | None

    def check(self, given_camera: Camera | None, calibrate: str) -> None:
        """Raise InputError unless frames get the same correction as the frames of the labels."""
        if self.camera is None or (
            given_camera is not None
            and calibrate == "nothing"
            and _is_same_camera(self.camera, given_camera)
        ):
            return
        raise InputError(
            f"the labels in {self.folder} fit its frames, without lens distortion and rolling "
            f"shutter: give its camera too, {self.folder / CAMERA}; or reconstruct its frames, "
            f"{self.folder / PICTURES}"
        )


def find_result_labels(
    # labels, source: as for `tisfm.reconstruct`. If the source is the frames folder of the
    # reconstruction with the labels, the labels fit uncorrected frames.
    labels: Any,
    source: Any,
) -> ResultLabels | None:
    """Return the labels in the folder of a reconstruction or in its masks folder; else None."""
    if not isinstance(labels, (str, os.PathLike)):
        return None
    path = Path(labels)
    if glob.has_magic(path.name) and path.parent.name == MASKS:
        path = path.parent
    folder = path.parent if path.name == MASKS else path
    if not (folder / RECORD).is_file() or not (folder / MASKS).is_dir():
        return None
    names = read_record(folder)["names"]
    files = [mask_path(folder, number) for number in range(len(names))]
    pictures = (folder / PICTURES).resolve()
    if isinstance(source, (str, os.PathLike)) and Path(source).resolve() == pictures:
        return ResultLabels(folder=folder, files={f.stem: f for f in files}, camera=None)
    camera = read_camera(folder)
    is_corrected = not camera.is_pinhole or bool(camera.readout)
    files_by_name = dict(zip(names, files, strict=True))
    return ResultLabels(folder=folder, files=files_by_name, camera=camera if is_corrected else None)


def _is_same_camera(camera0: Camera, camera1: Camera) -> bool:
    values0, values1 = (
        (
            camera.focal,
            camera.aspect,
            *(camera.center or ()),
            *_all_coefficients(camera.distortion or ()),
        )
        for camera in (camera0, camera1)
    )
    return (
        len(values0) == len(values1)
        and np.allclose(values0, values1, rtol=SAME_CAMERA_TOLERANCE, atol=SAME_CAMERA_TOLERANCE)
        and abs((camera0.readout or 0) - (camera1.readout or 0)) < SAME_CAMERA_TOLERANCE
    )


def _all_coefficients(distortion: Sequence[float]) -> tuple[float, ...]:
    """Return all distortion coefficients; missing ones are zero."""
    return (*distortion, *(0.0,) * (MAX_COEFFICIENTS - len(distortion)))
