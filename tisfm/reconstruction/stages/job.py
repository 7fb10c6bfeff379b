"""The job of a reconstruction: a sequence, and the checked arguments of `tisfm.reconstruct`."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from tisfm.camera import Camera
from tisfm.reconstruction.result.calibration import Calibrate
from tisfm.reconstruction.stages.progress import DepthOf, Progress, ReportDepth
from tisfm.settings import FixedPixels, Settings
from tisfm.sources import FrameSource
from tisfm.trajectory import Trajectory


def _no_progress(stage: str, done: int, total: int | None) -> None:
    """Ignore the progress."""


def _no_report(frame: int, error: float) -> None:
    """Ignore the expected error of the depth of a frame."""


@dataclass(frozen=True, kw_only=True)
class Job:
    """A sequence to reconstruct, with the checked arguments of `tisfm.reconstruct`."""

    source: FrameSource
    # camera of the frames of the source, or its file; None for a guess
    camera: Camera | Path | None
    calibrate: Calibrate  # the part of the camera that is estimated from the frames
    settings: Settings
    poses: Trajectory | None  # given poses
    folder: Path  # folder of the result, ready to be written to
    progress: Progress = _no_progress  # as for `tisfm.reconstruct`
    report_depth: ReportDepth = _no_report  # as for `tisfm.reconstruct`
    fixed_pixels: FixedPixels = "mask"  # whether pixels that are fixed on the sensor are masked
    depth_of: DepthOf = "all"  # the frames whose depth is estimated
    # known lengths of moving objects, by their ids
    object_sizes: Mapping[int, float] = field(default_factory=dict)
    # whether is searched what the camera does not state: a zoom, a lens, or pixels that move on
    # their own
    revises_camera: bool = False
    # whether given labels already belong to frames without distortion and readout effect
    are_labels_prepared: bool = False

    @property
    def masks_fixed_pixels(self) -> bool:
        """Whether pixels that are fixed on the sensor are searched and masked."""
        return self.fixed_pixels == "mask"

    @property
    def has_objects(self) -> bool:
        """Whether moving objects are labelled and reconstructed."""
        return self.settings.motion == "objects"
