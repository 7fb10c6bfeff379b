"""Layouts of datasets of frame pairs.

A finder gets one folder and yields the pairs whose root is this folder, without reading files. It
searches for the files of ground truth. Frames without ground truth are not a pair. A pair whose
frames are missing is yielded too: its `load` raises an error.
"""

import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Literal, NamedTuple

from tisfm.datasets.pair import DatasetPair
from tisfm.formats import IMAGE_SUFFIXES
from tisfm.formats.image_names import sort_by_name

Layout = Literal[
    "middlebury",
    "kitti",
    "sintel",
    "yosemite",
    "stereo",
    "new_tsukuba",
    "sevenscenes",
    "calibrated",
]

_KITTI_FRAMES = ("image_2", "colored_0", "image_0")
_KITTI_CALIBRATIONS = ("calib_cam_to_cam", "calib")
TSUKUBA_POSES = "poses_camera_to_world_3x4_cm.txt"
_DISPARITY_NAMES = ("disp", "disparity", "gt")
_DISPARITY_SUFFIXES = (".npz", ".npy", ".png", ".tif", ".tiff")


def find_middlebury(folder: Path) -> Iterator[DatasetPair]:
    """Find flow10.flo beside frames, or in other-gt-flow/NAME with frames in other-data/NAME."""
    truth = folder / "flow10.flo"
    if not truth.is_file():
        return
    base, frames = folder.parent, folder
    if base.name == "other-gt-flow" and not (folder / "frame10.png").is_file():
        base = base.parent
        frames = base / "other-data" / folder.name
    yield DatasetPair(
        layout="middlebury",
        dataset=base.name,
        name=folder.name,
        frame0=frames / "frame10.png",
        frame1=frames / "frame11.png",
        truth=truth,
    )


def find_kitti(folder: Path) -> Iterator[DatasetPair]:
    """Find flow_occ/NNNNNN_10.png, or else flow_noc, with the frames in folders beside it."""
    occ_folder, noc_folder = folder / "flow_occ", folder / "flow_noc"
    truth_folder = occ_folder if occ_folder.is_dir() else noc_folder
    frames = _find_folder(folder, _KITTI_FRAMES) or folder / _KITTI_FRAMES[0]
    calibration_folder = _find_folder(folder, _KITTI_CALIBRATIONS)
    for truth in find_files(truth_folder, "*_10.png"):
        name = truth.stem.removesuffix("_10")
        yield DatasetPair(
            layout="kitti",
            dataset=_dataset_folder(folder).name,
            name=name,
            frame0=frames / truth.name,
            frame1=frames / f"{name}_11.png",
            truth=truth,
            truth_format="kitti",
            visible=noc_folder / truth.name
            if truth_folder is not noc_folder and noc_folder.is_dir()
            else None,
            calibration=None if calibration_folder is None else calibration_folder / f"{name}.txt",
        )


def find_sintel(folder: Path) -> Iterator[DatasetPair]:
    """Find flow/SCENE/frame_NNNN.flo with passes clean or final, or gt/frame_NNNN.flo."""
    passes = [name for name in ("clean", "final") if (folder / name).is_dir()]
    for name in passes:
        for truth in find_files(folder / "flow", "*/frame_*.flo"):
            scene = truth.parent.name
            yield from _sintel_pair(
                truth,
                frames=folder / name / scene,
                masks=folder,
                scene=scene,
                dataset=f"{_dataset_folder(folder).name} {name}",
            )
    if not passes:
        for truth in find_files(folder / "gt", "frame_*.flo"):
            yield from _sintel_pair(truth, frames=folder, masks=folder / "gt", dataset=folder.name)


def _sintel_pair(
    truth: Path, *, frames: Path, masks: Path, dataset: str, scene: str = ""
) -> Iterator[DatasetPair]:
    digits = truth.stem.removeprefix("frame_")
    if not digits.isdecimal():
        return

    def file_of(kind: str, suffix: str) -> Path | None:
        return masks / kind / scene / f"{truth.stem}{suffix}" if (masks / kind).is_dir() else None

    yield DatasetPair(
        layout="sintel",
        dataset=dataset,
        name=f"{scene}/{truth.stem}" if scene else truth.stem,
        frame0=frames / f"{truth.stem}.png",
        frame1=frames / f"frame_{int(digits) + 1:0{len(digits)}d}.png",
        truth=truth,
        occluded=file_of("occlusions", ".png"),
        invalid=file_of("invalid", ".png"),
        calibration=file_of("camdata_left", ".cam"),
    )


def find_yosemite(folder: Path) -> Iterator[DatasetPair]:
    """Find flowNN*.flo beside frames yos*N and yos*N+1, and a sky mask."""
    frames: dict[int, Path] = {}
    pattern = None
    for file in find_files(folder, "yos*"):
        number = re.search(r"\d+$", file.stem)
        if number is not None and file.suffix.lower() in IMAGE_SUFFIXES:
            frames[int(number.group())] = file
            pattern = f"{file.stem[: number.start()]}{{}}{file.suffix}"
    if pattern is None:
        return
    sky = next(iter(find_files(folder, "sky_mask*.png")), None)
    for truth in find_files(folder, "flow*.flo"):
        digits = re.match(r"flow(\d+)", truth.stem)
        if digits is not None:
            first = int(digits.group(1))
            frame0, frame1 = (frames.get(k, folder / pattern.format(k)) for k in (first, first + 1))
            yield DatasetPair(
                layout="yosemite",
                dataset=folder.name,
                name=frame0.stem,
                frame0=frame0,
                frame1=frame1,
                truth=truth,
                sky=sky,
            )


def find_stereo(folder: Path) -> Iterator[DatasetPair]:
    """Find NAME_left and NAME_right, or left and right, with a disparity of the left view."""
    views: dict[str, dict[str, Path]] = {}
    for file in find_files(folder, "*"):
        view = re.fullmatch(r"(|.*_)(left|right)", file.stem)
        if view is not None and file.suffix.lower() in IMAGE_SUFFIXES:
            views.setdefault(view.group(1), {})[view.group(2)] = file
    for prefix, views_of_pair in views.items():
        candidates = (
            folder / f"{prefix}{name}{suffix}"
            for name in _DISPARITY_NAMES
            for suffix in _DISPARITY_SUFFIXES
        )
        truth = next((path for path in candidates if path.is_file()), None)
        if truth is not None:
            suffix = next(iter(views_of_pair.values())).suffix  # assumed also for a missing view
            mask = folder / f"{prefix}mask.png"
            yield DatasetPair(
                layout="stereo",
                dataset=folder.name,
                name=prefix.rstrip("_") or folder.name,
                frame0=views_of_pair.get("left", folder / f"{prefix}left{suffix}"),
                frame1=views_of_pair.get("right", folder / f"{prefix}right{suffix}"),
                truth=truth,
                truth_format="disparity",
                visible=mask if mask.is_file() else None,
            )


def find_new_tsukuba(folder: Path, *, step: int) -> Iterator[DatasetPair]:
    """Find rgb_NNNNN.png beside a file with a row for the pose of each frame."""
    poses = folder / TSUKUBA_POSES
    if not poses.is_file():
        return
    frames = find_numbered_files(folder, "rgb_*.png", r"rgb_(\d+)\.png")
    for number in sorted(frames):
        if number + step in frames:
            yield DatasetPair(
                layout="new_tsukuba",
                dataset=folder.name,
                name=frames[number].stem,
                frame0=frames[number],
                frame1=frames[number + step],
                pose0=poses,
                pose1=poses,
                pose_rows=(number, number + step),
            )


def find_sevenscenes(folder: Path, *, step: int) -> Iterator[DatasetPair]:
    """Find frame-NNNNNN.color, .depth.png and .pose.txt."""
    poses = find_numbered_files(folder, "frame-*.pose.txt", r"frame-(\d+)\.pose\.txt")
    frames = find_numbered_files(folder, "frame-*.color.*", r"frame-(\d+)\.color\.(?:png|jpg)")
    if not poses or not frames:
        return
    suffix = next(iter(frames.values())).suffix  # assumed also for a missing frame
    digits = len(next(iter(poses.values())).name) - len("frame-.pose.txt")
    is_part = re.fullmatch(r"seq-\d+", folder.name) is not None
    numbers = poses.keys() | frames.keys()
    for number in sorted(numbers):
        if number + step in numbers:
            stem0, stem1 = (folder / f"frame-{k:0{digits}d}" for k in (number, number + step))
            yield DatasetPair(
                layout="sevenscenes",
                dataset=f"{folder.parent.name} {folder.name}" if is_part else folder.name,
                name=stem0.name,
                frame0=frames.get(number, Path(f"{stem0}.color{suffix}")),
                frame1=frames.get(number + step, Path(f"{stem1}.color{suffix}")),
                depth=Path(f"{stem0}.depth.png"),
                pose0=Path(f"{stem0}.pose.txt"),
                pose1=Path(f"{stem1}.pose.txt"),
            )


def find_calibrated(folder: Path, *, step: int) -> Iterator[DatasetPair]:
    """Find images/ with camera.txt, and with poses.txt (a row for each image), or depth/, or both.

    A depth map has the name of its image. Pairs without pose and depth are left out.
    """
    camera, poses = folder / "camera.txt", folder / "poses.txt"
    image_folder, depth_folder = folder / "images", folder / "depth"
    if not camera.is_file() or not image_folder.is_dir():
        return
    frames = sort_by_name(
        file for file in find_files(image_folder, "*") if file.suffix.lower() in IMAGE_SUFFIXES
    )
    depth_maps = {file.stem: file for file in find_files(depth_folder, "*.png")}
    has_poses = poses.is_file()
    for number in range(len(frames) - step):
        frame0, frame1 = frames[number], frames[number + step]
        if not has_poses and frame0.stem not in depth_maps:
            continue
        yield DatasetPair(
            layout="calibrated",
            dataset=folder.name,
            name=frame0.stem,
            frame0=frame0,
            frame1=frame1,
            depth=depth_maps.get(frame0.stem),
            pose0=poses if has_poses else None,
            pose1=poses if has_poses else None,
            pose_rows=(number, number + step) if has_poses else None,
            calibration=camera,
        )


class PairRule(NamedTuple):
    """A layout of pairs."""

    find: Callable[..., Iterator[DatasetPair]]  # takes a folder; for sequences also a `step`
    expected_files: str  # description of its files, for messages
    step: int | None = None  # default frames from the first to the second frame, for sequences


LAYOUTS: dict[str, PairRule] = {
    "middlebury": PairRule(
        find_middlebury,
        "NAME/flow10.flo beside frame10.png and frame11.png, or "
        "other-gt-flow/NAME/flow10.flo with other-data/NAME",
    ),
    "kitti": PairRule(
        find_kitti,
        "flow_occ or flow_noc/NNNNNN_10.png with image_2, colored_0 or image_0/NNNNNN_10.png and "
        "NNNNNN_11.png",
    ),
    "sintel": PairRule(
        find_sintel,
        "flow/SCENE/frame_NNNN.flo with clean or final/SCENE/frame_NNNN.png, or "
        "gt/frame_NNNN.flo with frame_NNNN.png",
    ),
    "yosemite": PairRule(find_yosemite, "flowNN*.flo with yos*NN.tif or .png"),
    "stereo": PairRule(
        find_stereo,
        "NAME_left.png and NAME_right.png, or left.png and right.png, with NAME_disp, "
        "NAME_disparity or NAME_gt (.npz, .npy, .png or .tif)",
    ),
    "new_tsukuba": PairRule(find_new_tsukuba, f"rgb_NNNNN.png with {TSUKUBA_POSES}", step=1),
    "sevenscenes": PairRule(
        find_sevenscenes,
        "frame-NNNNNN.color.png or .jpg with frame-NNNNNN.depth.png and frame-NNNNNN.pose.txt",
        step=3,
    ),
    "calibrated": PairRule(
        find_calibrated, "images/ with camera.txt and poses.txt or depth/NAME.png", step=1
    ),
}
"""The rules of the layouts, by name."""


def _find_folder(folder: Path, names: tuple[str, ...]) -> Path | None:
    return next((folder / name for name in names if (folder / name).is_dir()), None)


def find_numbered_files(folder: Path, pattern: str, name: str) -> dict[int, Path]:
    """Return the files of a pattern by the number in their names, group 1 of a regex `name`."""
    matches = ((file, re.fullmatch(name, file.name)) for file in find_files(folder, pattern))
    return {int(match.group(1)): file for file, match in matches if match is not None}


def _dataset_folder(folder: Path) -> Path:
    """Return the folder that a dataset is named after: the parent of a folder "training"."""
    return folder.parent if folder.name == "training" else folder


def find_files(folder: Path, pattern: str) -> list[Path]:
    """Return the files of a pattern in the order of their names, without hidden files."""
    return sorted(path for path in folder.glob(pattern) if not path.name.startswith("."))
