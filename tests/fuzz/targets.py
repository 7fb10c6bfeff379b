"""What is fuzzed: each reader, the files that it starts from, and what it may raise."""

import functools
import shutil
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

from tests.fuzz import seeds
from tisfm import camera_file, focal_guess, formats, trajectory
from tisfm.datasets import calibration, depth_files, pose_files
from tisfm.datasets.depth_files import read_disparity
from tisfm.formats.label_picture import has_colour_palette, read_label_picture
from tisfm.interpretation import Interpretation
from tisfm.reconstruction.result import folder as record
from tisfm.reconstruction.result.calibration import read_calibration
from tisfm.sources.labels import Labels
from tisfm.sources.masks import Masks

MIB = 2**20
FRAMES = 12  # of a video, at most: a damaged one may have thousands


@dataclass(frozen=True, kw_only=True)
class Target:
    """A reader.

    Attributes
    ----------
    read : callable
        Takes the path of a file.
    seeds : callable
        Returns files to start from, as bytes.
    suffix : str
        Of the file.
    raises : tuple of exception types
        Those that its docstring names.
    memory : int
        Bytes that reading a small file may add to those that the process holds.
    seconds : float
        Time of the processor that reading a small file may take.
    slow : bool
        Whether a file takes milliseconds: it gets fewer of them.
    """

    read: Callable[[Path], Any]
    seeds: Callable[[], list[bytes]]
    suffix: str = ""
    raises: tuple[type[Exception], ...] = (formats.FormatError, OSError)
    memory: int = 64 * MIB
    seconds: float = 2.0
    slow: bool = False


def _of_folder(name: str, read: Callable[[Path], Any]) -> Callable[[Path], Any]:
    """Return a reader of one file of the folder of a reconstruction, whose others are whole."""

    def within(path: Path) -> Any:
        place = _folder(path.parent)
        file = place / name
        whole = file.read_bytes()
        shutil.copyfile(path, file)
        try:
            return read(place)
        finally:
            file.write_bytes(whole)

    return within


@functools.cache
def _folder(parent: Path) -> Path:
    place = parent / "reconstruction"
    for part in ("depth", "masks"):
        (place / part).mkdir(parents=True, exist_ok=True)
    for name, data in (
        (record.RECORD, seeds.reconstructions()[0]),
        (record.PATH, seeds.path_of_frames()[0]),
        (record.OBJECTS, seeds.objects()[0]),
        ("depth/000000.npz", seeds.depth_of_frame()[0]),
        ("masks/000000.png", seeds.labels()[0]),
    ):
        (place / name).write_bytes(data)
    return place


def _depth(place: Path) -> Any:
    return record.read_depth(place, 0, (seeds.H, seeds.W))


def _things(place: Path) -> Any:
    return record.read_labels(place, 0, (seeds.H, seeds.W))


def _mask(path: Path) -> Any:
    return Masks(path).reader().read_ignored(0, "0", (seeds.H, seeds.W, 3))


def _labels(path: Path) -> Any:
    return Labels(path, count=1).reader().read_labels(0, "0", [(seeds.H, seeds.W)])


def _calibrated(path: Path) -> Any:
    return read_calibration(path, camera_file.read_camera(path).focal)


def _cam(path: Path) -> Any:
    return calibration.read_camera(path, Path("image_2/0.png"))


def _first_row(path: Path) -> Any:
    return pose_files.read_pose_row(path, 1)


def _av(path: Path) -> Any:
    from tisfm.sources.av_video import AvVideo

    _frames(AvVideo(str(path)))


def _opencv(path: Path) -> Any:
    from tisfm.sources.video import OpenCvVideo

    _frames(OpenCvVideo(str(path)))


def _frames(video: Any) -> None:
    with closing(video.read(slice(0, FRAMES, 1))) as frames:
        for _ in islice(frames, FRAMES):
            pass


_SAYS = (ValueError, OSError)  # of readers that document ValueError
_VIDEO = dict(seeds=seeds.videos, raises=_SAYS, memory=512 * MIB, seconds=20.0, slow=True)
TARGETS: dict[str, Target] = {
    "interpretation": Target(read=Interpretation.load, seeds=seeds.interpretations, suffix=".npz"),
    "disparity": Target(read=read_disparity, seeds=seeds.disparities, suffix=".npz"),
    "flo": Target(read=formats.read_flo, seeds=seeds.flo),
    "dpt": Target(read=formats.read_dpt, seeds=seeds.dpt),
    "image": Target(read=formats.read_image, seeds=seeds.pictures, memory=512 * MIB),
    "depth_png": Target(read=formats.read_depth_png, seeds=seeds.depth_png),
    "kitti_flow": Target(read=formats.read_kitti_flow, seeds=seeds.kitti_flow),
    "depth_map": Target(read=depth_files.read_depth, seeds=seeds.depth_png),
    "label_picture": Target(read=read_label_picture, seeds=seeds.labels),
    "palette": Target(read=has_colour_palette, seeds=seeds.labels),
    "focal": Target(
        read=focal_guess.guess_focal, seeds=seeds.pictures, raises=_SAYS, memory=512 * MIB
    ),
    "mask": Target(read=_mask, seeds=seeds.labels, raises=_SAYS),
    "labels": Target(read=_labels, seeds=seeds.labels, raises=_SAYS),
    "cam": Target(read=_cam, seeds=seeds.cam, suffix=".cam"),
    "kitti_calibration": Target(read=_cam, seeds=seeds.kitti_calibration, suffix=".txt"),
    "calibration": Target(read=calibration.read_calibration, seeds=seeds.calibration),
    "pose": Target(read=pose_files.read_pose, seeds=seeds.one_pose),
    "pose_row": Target(read=_first_row, seeds=seeds.twelve),
    "poses": Target(read=pose_files.read_poses, seeds=seeds.twelve),
    "tum": Target(read=trajectory.read_tum, seeds=seeds.tum),
    "kitti": Target(read=trajectory.read_kitti, seeds=seeds.twelve),
    "trajectory": Target(
        read=trajectory.read_trajectory, seeds=lambda: seeds.tum() + seeds.twelve()
    ),
    "camera": Target(read=camera_file.read_camera, seeds=seeds.camera, raises=_SAYS),
    "calibrated_camera": Target(read=_calibrated, seeds=seeds.camera, raises=_SAYS),
    "reconstruction": Target(
        read=_of_folder(record.RECORD, record.read_record), seeds=seeds.reconstructions
    ),
    "objects": Target(read=_of_folder(record.OBJECTS, record.read_record), seeds=seeds.objects),
    "path": Target(read=_of_folder(record.PATH, record.read_record), seeds=seeds.path_of_frames),
    "depth_of_frame": Target(
        read=_of_folder("depth/000000.npz", _depth), seeds=seeds.depth_of_frame
    ),
    "labels_of_frame": Target(read=_of_folder("masks/000000.png", _things), seeds=seeds.labels),
    "av_video": Target(read=_av, **_VIDEO),
    "opencv_video": Target(read=_opencv, **_VIDEO),
}
