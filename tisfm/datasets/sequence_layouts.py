"""Layouts of datasets of sequences.

A loader gets the folder of a sequence and reads its poses, times and camera; `LoadedSequence` has
the paths of its frames and depth maps.
"""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tisfm.camera import Camera
from tisfm.datasets.calibration import (
    KNOWN_CAMERAS,
    TUM_CAMERAS,
    read_calibration,
    read_camera,
    scale_known_camera,
)
from tisfm.datasets.depth_files import MM_PER_METRE
from tisfm.datasets.pair_layouts import TSUKUBA_POSES, find_files, find_numbered_files
from tisfm.datasets.pose_files import read_pose, read_poses
from tisfm.datasets.sequence import LoadedSequence
from tisfm.formats import IMAGE_SUFFIXES, FormatError, read_image
from tisfm.formats.image_names import sort_by_name
from tisfm.trajectory import associate, read_kitti, read_tum
from tisfm.trajectory.poses import check_times
from tisfm.trajectory.text_files import read_lines, read_rows

SequenceLayout = Literal["new_tsukuba", "sevenscenes", "calibrated", "tum", "kitti_odometry"]

_CENTIMETRES_PER_METRE = 100.0  # per metre; the unit of New Tsukuba's poses
_TUM_DEPTH_SCALE = 5000.0  # values of a depth map per metre
_TUM_CAMERA = re.compile(r"(?:freiburg|fr)(\d)")
_KITTI_FRAMES = ("image_0", "image_2")  # image_0 first: the poses are of camera 0


def _load_new_tsukuba(folder: Path) -> LoadedSequence:
    frames = find_numbered_files(folder, "rgb_*.png", r"rgb_(\d+)\.png")
    path = folder / TSUKUBA_POSES
    rows = read_poses(path)
    if max(frames) >= len(rows):
        raise FormatError(f"{path} has {len(rows)} rows, but there is a frame {max(frames)}")
    poses = np.array([rows[number] for number in sorted(frames)])
    poses[:, :3, 3] /= _CENTIMETRES_PER_METRE
    files = tuple(frames[number] for number in sorted(frames))
    return LoadedSequence(
        frames=files,
        poses=poses,
        camera=_scale_layout_camera("new_tsukuba", files),
        depths=(None,) * len(files),
    )


def _load_sevenscenes(folder: Path) -> LoadedSequence:
    frames = find_numbered_files(folder, "frame-*.color.*", r"frame-(\d+)\.color\.(?:png|jpg)")
    poses = find_numbered_files(folder, "frame-*.pose.txt", r"frame-(\d+)\.pose\.txt")
    depths = find_numbered_files(folder, "frame-*.depth.png", r"frame-(\d+)\.depth\.png")
    numbers = sorted(frames)
    files = tuple(frames[number] for number in numbers)
    return LoadedSequence(
        frames=files,
        poses=np.array([read_pose(poses[n]) if n in poses else _missing_pose() for n in numbers]),
        camera=_scale_layout_camera("sevenscenes", files),
        depths=tuple(depths.get(number) for number in numbers),
    )


def _load_calibrated(folder: Path) -> LoadedSequence:
    frames = tuple(_find_pictures(folder / "images"))
    path = folder / "poses.txt"
    poses = np.tile(_missing_pose(), (len(frames), 1, 1))
    if path.is_file():
        poses = read_kitti(path).poses
        if len(poses) != len(frames):
            raise FormatError(
                f"{path} has {len(poses)} poses, but there are {len(frames)} images: expected a "
                "line for each image"
            )
    depth_maps = {file.stem: file for file in find_files(folder / "depth", "*.png")}
    calibration = read_calibration(folder / "camera.txt")
    return LoadedSequence(
        frames=frames,
        poses=poses,
        camera=calibration.camera,
        depths=tuple(depth_maps.get(file.stem) for file in frames),
        depth_scale=calibration.depth_scale or MM_PER_METRE,
    )


def _load_tum(folder: Path) -> LoadedSequence:
    times, frames = _read_tum_list(folder / "rgb.txt")
    depths: list[Path | None] = [None] * len(frames)
    if (folder / "depth.txt").is_file():
        depth_times, maps = _read_tum_list(folder / "depth.txt")
        for frame, depth in zip(*associate(times, depth_times), strict=True):
            depths[frame] = maps[depth]
    poses = np.tile(_missing_pose(), (len(frames), 1, 1))
    if (folder / "groundtruth.txt").is_file():
        truth = read_tum(folder / "groundtruth.txt")
        assert truth.times is not None
        frame_indices, pose_indices = associate(times, truth.times)
        poses[frame_indices] = truth.poses[pose_indices]
    match = _TUM_CAMERA.search(folder.name)
    return LoadedSequence(
        frames=tuple(frames),
        poses=poses,
        camera=TUM_CAMERAS.get(match.group(1)) if match else None,
        times=times,
        depths=tuple(depths),
        depth_scale=_TUM_DEPTH_SCALE,
    )


def _load_kitti_odometry(folder: Path) -> LoadedSequence:
    image_folder = next(folder / name for name in _KITTI_FRAMES if (folder / name).is_dir())
    frames = tuple(_find_pictures(image_folder))
    path = _kitti_pose_file(folder)
    poses = read_kitti(path).poses
    if len(poses) != len(frames):
        raise FormatError(
            f"{path} has {len(poses)} poses, but there are {len(frames)} images: expected a line "
            "for each image"
        )
    times_file, times = folder / "times.txt", None
    if times_file.is_file():
        numbers = [number for _, (number,) in read_rows(times_file, columns=1)]
        try:
            times = check_times(numbers, len(frames))
        except ValueError as error:
            raise FormatError(f"{times_file}: {error}") from None
    return LoadedSequence(
        frames=frames,
        poses=poses,
        camera=read_camera(folder / "calib.txt", frames[0]) if frames else None,
        times=times,
        depths=(None,) * len(frames),
    )


def _kitti_pose_file(folder: Path) -> Path:
    return folder.parent.parent / "poses" / f"{folder.name}.txt"


def _read_tum_list(path: Path) -> tuple[NDArray[np.float64], list[Path]]:
    """Return times and files of a TUM list, which has a time and a file name on every line."""
    times, files = [], []
    for number, words in read_lines(path):
        try:
            time, name = words
            times.append(float(time))
        except ValueError:
            raise FormatError(
                f"{path}, line {number} is {' '.join(words)!r}: expected a time and a file"
            ) from None
        files.append(path.parent / name)
    try:
        return check_times(times, len(files)), files
    except ValueError as error:
        raise FormatError(f"{path}: {error}") from None


def _find_pictures(folder: Path) -> list[Path]:
    files = [file for file in find_files(folder, "*") if file.suffix.lower() in IMAGE_SUFFIXES]
    return sort_by_name(files)


def _scale_layout_camera(layout: SequenceLayout, frames: tuple[Path, ...]) -> Camera:
    """Return the known camera of a layout, for the size of these frames."""
    return scale_known_camera(KNOWN_CAMERAS[layout], read_image(frames[0]).shape[1])


def _missing_pose() -> NDArray[np.float64]:
    return np.full((4, 4), np.nan)


def _folder_name(folder: Path) -> str:
    return folder.name


def _part_name(folder: Path) -> str:
    """Return the name of a folder, after the name of its parent if it is a numbered part."""
    is_part = re.fullmatch(r"seq-\d+|\d+", folder.name) is not None
    return f"{folder.parent.name} {folder.name}" if is_part else folder.name


class SequenceRule(NamedTuple):
    """A layout of sequences."""

    recognises: Callable[[Path], bool]  # whether a folder has this layout
    load: Callable[[Path], LoadedSequence]
    expected_files: str  # description of its files, for messages
    name: Callable[[Path], str] = _folder_name  # name of the sequence in a folder


def _is_new_tsukuba(folder: Path) -> bool:
    return (folder / TSUKUBA_POSES).is_file() and bool(find_files(folder, "rgb_*.png"))


def _is_sevenscenes(folder: Path) -> bool:
    frames = find_files(folder, "frame-*.color.*")
    return bool(frames) and bool(find_files(folder, "frame-*.pose.txt"))


def _is_calibrated(folder: Path) -> bool:
    has_truth = (folder / "poses.txt").is_file() or (folder / "depth").is_dir()
    return has_truth and (folder / "camera.txt").is_file() and (folder / "images").is_dir()


def _is_tum(folder: Path) -> bool:
    has_truth = (folder / "groundtruth.txt").is_file() or (folder / "depth.txt").is_file()
    return has_truth and (folder / "rgb.txt").is_file()


def _is_kitti_odometry(folder: Path) -> bool:
    has_images = any((folder / name).is_dir() for name in _KITTI_FRAMES)
    return has_images and (folder / "calib.txt").is_file() and _kitti_pose_file(folder).is_file()


SEQUENCE_LAYOUTS: dict[SequenceLayout, SequenceRule] = {
    "new_tsukuba": SequenceRule(
        _is_new_tsukuba, _load_new_tsukuba, f"rgb_NNNNN.png with {TSUKUBA_POSES}"
    ),
    "sevenscenes": SequenceRule(
        _is_sevenscenes,
        _load_sevenscenes,
        "frame-NNNNNN.color.png or .jpg with frame-NNNNNN.pose.txt",
        _part_name,
    ),
    "calibrated": SequenceRule(
        _is_calibrated, _load_calibrated, "images/ with camera.txt and poses.txt or depth/"
    ),
    "tum": SequenceRule(_is_tum, _load_tum, "rgb.txt with groundtruth.txt or depth.txt"),
    "kitti_odometry": SequenceRule(
        _is_kitti_odometry,
        _load_kitti_odometry,
        "sequences/NN/image_0 or image_2 with calib.txt, and poses/NN.txt beside sequences",
        _part_name,
    ),
}
"""The rules of the layouts, by name."""
