"""A result that is exported, and what is taken of it."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from tisfm.camera import Camera
from tisfm.camera_file import NAME as CAMERA
from tisfm.camera_file import read_camera, record_in
from tisfm.errors import InputError
from tisfm.exports.result_frames import PairFrames, SequenceFrames
from tisfm.folders.result_folder import make_subfolder
from tisfm.reconstruction.result.reconstruction import Reconstruction


@dataclass(frozen=True, kw_only=True)
class Export:
    """A result that is written, and how.

    Attributes
    ----------
    result : Reconstruction or None
        None of a folder of `tisfm run`.
    frames : SequenceFrames or PairFrames
    chosen : sequence of int
        Numbers of the frames that are taken.
    folder : Path
        What is written to; it exists.
    frames_per_second : float or None
    disparity : float or None
        Of anaglyphs and of the swinging camera, as a share of the width.
    screen, screen_depth : float or None
        The plane of their screen, as a quantile of the depth or as a depth.
    """

    result: Reconstruction | None
    frames: SequenceFrames | PairFrames
    chosen: Sequence[int]
    folder: Path
    frames_per_second: float | None = None
    disparity: float | None = None
    screen: float | None = None
    screen_depth: float | None = None

    @property
    def sequence(self) -> Reconstruction:
        """The reconstruction, or ValueError if it is of pairs."""
        if self.result is None:
            raise InputError(
                f"{self.frames.folder} is of tisfm run, whose pairs have no common scale and no "
                "path: export what `tisfm reconstruct` makes of the same frames"
            )
        return self.result

    def subfolder(self, name: str) -> Path:
        """Return a folder in that which is written to; it is made if need be."""
        return make_subfolder(self.folder / name)


def source_camera(export: Export) -> tuple[Camera, tuple[int, int]]:
    """Return the camera with its distortion, and height and width of its frames, px.

    Of a reconstruction they are those of the source, before any part was cut out or shrunk.

    Raises
    ------
    FileNotFoundError
        If the reconstruction has no file of it.
    """
    if isinstance(export.frames, PairFrames):
        return export.frames.camera, export.frames.shape
    file = export.frames.folder / CAMERA
    if not file.is_file():
        raise FileNotFoundError(
            f"{export.frames.folder} has no {CAMERA}, which tisfm reconstruct writes: the lens of "
            "the frames is not known"
        )
    record = record_in(file)
    return read_camera(file), (int(record["height"]), int(record["width"]))
