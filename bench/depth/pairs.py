"""Pairs with known depth or known motion of the camera: rendered scenes and real sequences."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from bench.shared.sequences import FlowPair
from tisfm.camera import Camera
from tisfm.datasets import LAYOUTS, DatasetPair, Layout
from tisfm.datasets.calibration import KNOWN_CAMERAS
from tisfm.datasets.depth_files import read_depth
from tisfm.frames import grey_pair
from tisfm.lens import undistort, undistort_depth
from tisfm.motion.sparse_matches import sparse_matches
from tisfm.rigid import pose_matrix
from tisfm.scenes import SyntheticPair, room, static_scene, two_blocks
from tisfm.scenes.block_scenes import STATIC_KINDS

SCENE_FOCALS = (300.0, 320.0, 600.0, 1200.0)  # px at a width of 320, of the seeds 0, 1, 2, 3
BLOCK_SEEDS = (0, 1)
STATIC_LABELS = 2  # labels below this belong to the background and the floor
# Groups of pairs.
TWO_BLOCKS = "two blocks"
HAND_HELD = "7-Scenes"
LITTLE_MOTION = "7-Scenes, hardly moved"
RENDERED_STUDIO = "New Tsukuba"
ROOM = "TartanAir"
OFFICE = "HoloLens"
SPACED = "7-Scenes, four apart"  # pairs of frames i and i + 4
RENDERED_ROOM = "rendered room"
ROOM_SEEDS = (0, 1)
POSE_GIVEN = ", pose given"
ROOMS = tuple(
    group + suffix for group in (RENDERED_ROOM, ROOM, OFFICE, SPACED) for suffix in (POSE_GIVEN, "")
)
MAX_ROOM_DEPTH = 40.0  # m: larger true depths do not count in rooms
WIDE_BASELINE = "fountain"  # views of a wide baseline, with true poses
WIDE_BASELINES = (WIDE_BASELINE + POSE_GIVEN, WIDE_BASELINE)
STEREO = "stereo, pose given"
BLOCK_MATCHER = "KITTI stereo, pose given"  # true depth by a block matcher


@dataclass(frozen=True, kw_only=True, eq=False)
class DepthPair:
    """Two frames, their camera, and the known depth and motion."""

    name: str
    group: str
    frame0: NDArray  # (H, W) or (H, W, 3) uint8
    frame1: NDArray
    camera: Camera
    depth: NDArray | None = None  # (H, W); true depth of frame 0, NaN where unknown
    raw_depth: NDArray | None = None  # (H, W); depth camera's map, not registered to the frame
    pose: NDArray | None = None  # (4, 4) float64; true motion of the static scene, P₁ = R P₀ + t
    pose_given: bool = False  # whether methods get the pose
    object_labels: NDArray | None = (
        None  # (H, W) int; 0 static, another number for each moving object
    )
    visible: NDArray | None = None  # (H, W) bool; visible in frame 1, if known

    def flow_pair(self) -> FlowPair:
        """Return the frames as a pair of the flow contest, with unknown truth."""
        unknown_flow = np.full((*self.frame0.shape[:2], 2), np.nan)
        return FlowPair(
            name=self.name,
            group=self.group,
            frame0=self.frame0,
            frame1=self.frame1,
            truth=unknown_flow,
        )


@dataclass(frozen=True)
class Entry:
    """A pair that is loaded or rendered in its turn."""

    name: str
    group: str
    load: Callable[[], DepthPair]


@dataclass(frozen=True, kw_only=True)
class Selection:
    """Pairs of a sequence with poses: the frames i and i + `step` for i in `first`."""

    group: str
    folder: str
    first: range
    step: int
    pose_given: bool = False
    raw: bool = False  # whether depth maps are used without registration


SELECTIONS: dict[Layout, list[Selection]] = {
    "new_tsukuba": [
        Selection(group=RENDERED_STUDIO, folder="new_tsukuba", first=range(0, 74, 3), step=1)
    ],
    "sevenscenes": [
        Selection(group=HAND_HELD, folder="sevenscenes", first=range(41, 57), step=3),
        Selection(group=LITTLE_MOTION, folder="sevenscenes", first=range(0, 20, 3), step=3),
        *(
            Selection(
                group=SPACED + suffix,
                folder="sevenscenes",
                first=range(40, 56),
                step=4,
                pose_given=bool(suffix),
                raw=True,
            )
            for suffix in (POSE_GIVEN, "")
        ),
    ],
    "calibrated": [
        Selection(group=group + suffix, folder=folder, first=first, step=1, pose_given=bool(suffix))
        for group, folder, first in (
            (ROOM, "tartanair", range(2, 27, 4)),
            (OFFICE, "hololens", range(2, 63, 6)),
            (WIDE_BASELINE, "fountain", range(10)),
        )
        for suffix in (POSE_GIVEN, "")
    ],
}
STEREO_FOLDERS = {"stereo": STEREO, "kitti": BLOCK_MATCHER}


def scene_entries(height: int, width: int) -> list[Entry]:
    """Return rendered scenes: static ones by kind of motion and focal length, blocks and rooms."""
    entries = []

    def add(name: str, group: str, render: Callable[[int, int], SyntheticPair]) -> None:
        entries.append(Entry(name, group, lambda: scene_pair(name, group, render(height, width))))

    for kind, (seed, focal) in product(STATIC_KINDS, enumerate(SCENE_FOCALS)):
        render = partial(static_scene, kind, seed=seed, focal=focal * width / 320)
        add(f"{kind}-f{focal:g}", f"scenes, {kind}", render)
    for seed in BLOCK_SEEDS:
        add(f"two-blocks-{seed}", TWO_BLOCKS, partial(two_blocks, seed=seed))
    for seed, suffix in product(ROOM_SEEDS, (POSE_GIVEN, "")):
        add(f"room-{seed}{suffix}", RENDERED_ROOM + suffix, partial(room, seed=seed))
    return entries


def data_entries(data: Path) -> tuple[list[Entry], dict[str, str]]:
    """Return the pairs found in a folder of sequences, and group → why others are missing."""
    entries: list[Entry] = []
    missing: dict[str, str] = {}
    for layout, selections in SELECTIONS.items():
        for selection in selections:
            entries_of_selection = list(_select_entries(data, layout, selection))
            if not entries_of_selection:
                missing[selection.group] = f"none of its frames in {selection.folder}"
            entries += entries_of_selection
    for folder, group in STEREO_FOLDERS.items():
        pairs = list(LAYOUTS["stereo"].find(data / folder))
        if not pairs:
            missing[group] = f"no {LAYOUTS['stereo'].expected_files} in {folder}"
        entries += [Entry(p.name, group, partial(_load_pair, p, p.name, group)) for p in pairs]
    return entries, missing


def _select_entries(data: Path, layout: Layout, selection: Selection) -> Iterator[Entry]:
    for pair in LAYOUTS[layout].find(data / selection.folder, step=selection.step):
        number = int("".join(filter(str.isdigit, pair.name)))
        if number in selection.first:
            name = pair.name
            # In these groups names are numbers, and each pair occurs twice.
            if selection.group in (*ROOMS, *WIDE_BASELINES):
                name = f"{selection.folder} {name}, {selection.step} apart"
            if selection.pose_given:
                name += POSE_GIVEN
            load = partial(_load_pair, pair, name, selection.group, selection=selection)
            yield Entry(name, selection.group, load)


def _load_pair(
    pair: DatasetPair, name: str, group: str, *, selection: Selection | None = None
) -> DepthPair:
    dataset_pair = pair.load()
    camera = dataset_pair.camera or Camera()  # depth of a stereo pair does not depend on the camera
    depth, raw = dataset_pair.depth, None
    if pair.layout in KNOWN_CAMERAS and pair.depth is not None:
        raw = read_depth(pair.depth)
    if depth is not None:
        depth = undistort_depth(depth, camera)
    if selection is not None and selection.raw:
        depth, raw = raw, None
    if depth is not None and group in ROOMS:
        depth = np.where(depth < MAX_ROOM_DEPTH, depth, np.nan)
    frame0, frame1 = (
        undistort(frame, camera) for frame in (dataset_pair.frame0, dataset_pair.frame1)
    )
    if group in WIDE_BASELINES:
        assert dataset_pair.pose is not None
        depth = depth_of_matches(frame0, frame1, camera.pinhole(), dataset_pair.pose)
    return DepthPair(
        name=name,
        group=group,
        frame0=frame0,
        frame1=frame1,
        camera=camera.pinhole(),
        depth=depth,
        raw_depth=raw,
        pose=dataset_pair.pose,
        pose_given=dataset_pair.pose_given or (selection is not None and selection.pose_given),
    )


def scene_pair(name: str, group: str, pair: SyntheticPair) -> DepthPair:
    """Return a rendered scene as a pair with known depth and motion."""
    object_labels = (
        np.where(pair.labels < STATIC_LABELS, 0, pair.labels) if group == TWO_BLOCKS else None
    )
    return DepthPair(
        name=name,
        group=group,
        frame0=pair.frame0,
        frame1=pair.frame1,
        camera=pair.camera,
        depth=pair.depth,
        pose=pose_matrix(pair.motions[0]),
        pose_given=POSE_GIVEN in group,
        object_labels=object_labels,
        visible=pair.visible,
    )


MAX_MATCH_ERROR = 0.7  # px between a match and its projected point in each frame; set by hand


def depth_of_matches(
    frame0: NDArray,  # (H, W) or (H, W, 3) uint8
    frame1: NDArray,
    camera: Camera,  # a pinhole
    pose: NDArray,  # (4, 4); true motion, P₁ = R P₀ + t; depth is in its unit
) -> NDArray[np.float32]:
    """Return the depth of triangulated matches in frame 0, (H, W); NaN between the matches."""
    matches = sparse_matches(*grey_pair(frame0, frame1))
    cx, cy = camera.center_for(*frame0.shape[:2])
    pinhole = np.array([[camera.focal, 0, cx], [0, camera.focal, cy], [0, 0, 1]])
    views = [np.asarray(pinhole @ motion) for motion in (np.eye(3, 4), pose[:3])]
    points = cv2.triangulatePoints(views[0], views[1], matches.points0.T, matches.points1.T)
    points = points / points[3]
    valid = points[2] > 0
    for view, positions in zip(views, (matches.points0, matches.points1), strict=True):
        image = view @ points
        valid &= np.linalg.norm(image[:2] / image[2] - positions.T, axis=0) <= MAX_MATCH_ERROR
    depth = np.full(frame0.shape[:2], np.nan)
    columns, rows = np.rint(matches.points0[valid]).astype(int).T
    depth[rows, columns] = points[2, valid]
    return depth.astype(np.float32)
