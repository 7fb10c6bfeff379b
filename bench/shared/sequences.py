"""Pairs of frames with a true flow, from a folder of sequences or from rendered scenes."""

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tisfm import scenes
from tisfm.datasets import LAYOUTS, Layout

MIDDLEBURY = ("RubberWhale", "Grove2", "Urban2", "Venus")


@dataclass(frozen=True, kw_only=True, eq=False)
class FlowPair:
    name: str
    group: str  # errors are averaged over the pairs of a group
    frame0: NDArray  # (H, W) or (H, W, 3) uint8, grey or RGB
    frame1: NDArray
    truth: NDArray  # (H, W, 2), flow from frame 0 to frame 1, px; NaN where it is unknown
    note: str = ""  # remark on the truth

    @property
    def size(self) -> tuple[int, int]:
        """(height, width), px."""
        height, width = self.truth.shape[:2]
        return height, width

    def crop(self, height: int, width: int) -> "FlowPair":
        """Return the upper left part, of at most this size."""
        part = np.s_[:height, :width]
        return FlowPair(
            name=f"{self.name}-crop",
            group=self.group,
            frame0=self.frame0[part],
            frame1=self.frame1[part],
            truth=self.truth[part],
        )


def find_pairs(data: Path) -> tuple[list[FlowPair], dict[str, str]]:
    """Return the pairs in a folder, and name → reason of the missing ones."""
    pairs, missing = [], {}
    for name, source in SOURCES.items():
        try:
            pairs.append(_read(data, name, source))
        except FileNotFoundError as error:
            missing[name] = f"no file {error.filename}" if error.filename else str(error)
    return pairs, missing


def data_folder(path: Path | None = None) -> Path | None:
    """Return the given folder, or else the one of TISFM_DATA, or None."""
    if path is None and not os.environ.get("TISFM_DATA"):
        return None
    folder = path or Path(os.environ["TISFM_DATA"])
    if not folder.is_dir():
        raise NotADirectoryError(f"{folder} is not a folder: expected one with real sequences")
    return folder


def scene_pairs(height: int, width: int) -> list[FlowPair]:
    """Return rendered pairs with exact truth."""
    rendered = {
        "two_blocks": scenes.two_blocks(height, width),
        "static_scene": scenes.static_scene("sideways+rotation", height, width),
    }
    return [
        FlowPair(name=name, group="scenes", frame0=pair.frame0, frame1=pair.frame1, truth=pair.flow)
        for name, pair in rendered.items()
    ]


@dataclass(frozen=True)
class Source:
    folder: str  # path below that folder
    layout: Layout
    group: str
    note: str = ""
    name: str = ""  # of the pair in its dataset, if the folder has several


def _read(data: Path, name: str, source: Source) -> FlowPair:
    rule = LAYOUTS[source.layout]
    folder = data / source.folder
    pairs = [pair for pair in rule.find(folder) if source.name in ("", pair.name)]
    if not pairs:
        raise FileNotFoundError(f"no pair in {folder}: expected {rule.expected_files}")
    pair = pairs[0].load()
    if pair.flow is None:
        raise FileNotFoundError(f"no true flow in {folder}: expected {rule.expected_files}")
    return FlowPair(
        name=name,
        group=source.group,
        frame0=pair.frame0,
        frame1=pair.frame1,
        truth=pair.flow,
        note=source.note,
    )


_STEREO_NOTE = "left to right; occluded pixels count"
_CAVE_NOTE = "cave_2, frames 2 and 3: motions up to 46 px; occluded pixels count"
SOURCES: dict[str, Source] = {
    **{name: Source(f"middlebury/{name}", "middlebury", "middlebury") for name in MIDDLEBURY},
    "yosemite_clouds": Source(
        "yosemite_clouds", "yosemite", "yosemite_clouds", "frames 9 and 10, sky included"
    ),
    "yosemite_cloudless": Source(
        "yosemite_cloudless",
        "yosemite",
        "yosemite_cloudless",
        "frames 9 and 10; the sky, 26% of the pixels, does not count",
    ),
    "sintel_alley": Source(
        "sintel_alley",
        "sintel",
        "sintel_alley",
        "alley_1, clean, frames 2 and 3; occluded pixels count, invalid ones do not",
        "frame_0002",
    ),
    **{
        f"cave, {kind}": Source(
            f"sintel_cave/{kind}", "sintel", f"sintel_cave, {kind}", _CAVE_NOTE, "frame_0002"
        )
        for kind in ("clean", "final")
    },
    "motorcycle": Source("stereo", "stereo", "stereo", _STEREO_NOTE, "motorcycle"),
    "cones": Source("stereo", "stereo", "stereo", _STEREO_NOTE, "cones"),
    "kitti": Source(
        "kitti",
        "stereo",
        "kitti",
        "left to right; the truth is a block matcher's disparity, not a laser's",
    ),
}
