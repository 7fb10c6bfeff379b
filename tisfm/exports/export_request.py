"""The request of an export: the result, the chosen frames and the options."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from tisfm.camera import Camera
from tisfm.camera_file import NAME as CAMERA
from tisfm.camera_file import read_camera, record_in
from tisfm.errors import InputError
from tisfm.folders.result_folder import make_subfolder
from tisfm.reconstruction.result.reconstruction import Reconstruction
from tisfm.results.pair_frames import PairFrames
from tisfm.results.sequence_frames import SequenceFrames


@dataclass(frozen=True, kw_only=True)
class ExportRequest:
    """What to export, and how."""

    result: Reconstruction | None  # none for a folder of `tisfm run`
    frames: SequenceFrames | PairFrames
    chosen: Sequence[int]  # numbers of the frames to export
    folder: Path  # folder of the exported files; it exists
    frames_per_second: float | None = None
    # of anaglyphs and of the swinging camera, as a share of the width
    disparity: float | None = None
    # screen, screen_depth: the plane of the screen of these, as a quantile of the depth or as a
    # depth
    screen: float | None = None
    screen_depth: float | None = None

    @property
    def sequence(self) -> Reconstruction:
        """The reconstruction; raises ValueError for a folder of pairs."""
        if self.result is None:
            raise InputError(
                f"{self.frames.folder} is a run, whose pairs have no common scale and no path: "
                "export the result of tisfm reconstruct for the same frames"
            )
        return self.result

    def subfolder(self, name: str) -> Path:
        """Return a folder inside the folder of the export; make it if it does not exist."""
        return make_subfolder(self.folder / name)


def source_camera(export: ExportRequest) -> tuple[Camera, tuple[int, int]]:
    """Return the camera with distortion, and height and width of its frames, px.

    For a reconstruction these are the frames of the source, before cropping and shrinking.

    Raises FileNotFoundError if the reconstruction has no camera file.
    """
    if isinstance(export.frames, PairFrames):
        return export.frames.camera, export.frames.shape
    file = export.frames.folder / CAMERA
    if not file.is_file():
        raise FileNotFoundError(
            f"{export.frames.folder} has no {CAMERA}, so the lens of the frames is unknown: run "
            "tisfm reconstruct again"
        )
    record = record_in(file)
    return read_camera(file), (int(record["height"]), int(record["width"]))
