"""Pairs of frames with a true flow, from a folder of sequences or from rendered scenes."""

import os
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tisfm import scenes
from tisfm.formats import read_flo, read_image

MIDDLEBURY = ("RubberWhale", "Grove2", "Urban2", "Venus")


@dataclass(frozen=True, kw_only=True, eq=False)
class FlowPair:
    """Two frames and their true flow.

    Attributes
    ----------
    name, group : str
        Errors are averaged over the pairs of a group.
    frame0, frame1 : (H, W) or (H, W, 3) uint8
        Grey or RGB.
    truth : (H, W, 2) float
        Flow from frame 0 to frame 1, px; NaN or above 1e9 where it is unknown.
    note : str
        What to know about the truth.
    """

    name: str
    group: str
    frame0: NDArray
    frame1: NDArray
    truth: NDArray
    note: str = ""

    @property
    def size(self) -> tuple[int, int]:
        """(height, width), px."""
        height, width = self.truth.shape[:2]
        return height, width

    def crop(self, height: int, width: int) -> "FlowPair":
        """Return the upper left part, at most so large."""
        part = np.s_[:height, :width]
        return FlowPair(
            name=f"{self.name}-crop",
            group=self.group,
            frame0=self.frame0[part],
            frame1=self.frame1[part],
            truth=self.truth[part],
        )


Reader = Callable[[Path], FlowPair]


def find_pairs(data: Path) -> tuple[list[FlowPair], dict[str, str]]:
    """Return the pairs found in a folder, and why the others are missing, by name."""
    pairs, missing = [], {}
    for name, read in READERS.items():
        try:
            pairs.append(read(data))
        except FileNotFoundError as error:
            missing[name] = f"no file {error.filename or error}"
    return pairs, missing


def data_folder(given: Path | None = None) -> Path | None:
    """Return the folder given, or else the one that TISFM_DATA names, or None."""
    if given is None and not os.environ.get("TISFM_DATA"):
        return None
    folder = given or Path(os.environ["TISFM_DATA"])
    if not folder.is_dir():
        raise NotADirectoryError(f"{folder} is not a folder: expected one with real sequences")
    return folder


def scene_pairs(height: int, width: int) -> list[FlowPair]:
    """Return rendered pairs, whose truth is exact."""
    rendered = {
        "two_blocks": scenes.two_blocks(height, width),
        "static_scene": scenes.static_scene("sideways+rotation", height, width),
    }
    return [
        FlowPair(name=name, group="scenes", frame0=pair.frame0, frame1=pair.frame1, truth=pair.flow)
        for name, pair in rendered.items()
    ]


def _middlebury(data: Path, name: str) -> FlowPair:
    folder = data / "middlebury" / name
    return FlowPair(
        name=name,
        group="middlebury",
        frame0=read_image(folder / "frame10.png"),
        frame1=read_image(folder / "frame11.png"),
        truth=read_flo(folder / "flow10.flo"),
    )


def _yosemite_clouds(data: Path) -> FlowPair:
    folder = data / "yosemite_clouds"
    return FlowPair(
        name="yosemite_clouds",
        group="yosemite_clouds",
        frame0=read_image(folder / "yos9.tif"),
        frame1=read_image(folder / "yos10.tif"),
        truth=read_flo(folder / "flow09_derived.flo"),
        note="frames 9 and 10, sky included",
    )


def _yosemite_cloudless(data: Path) -> FlowPair:
    folder = data / "yosemite_cloudless"
    return FlowPair(
        name="yosemite_cloudless",
        group="yosemite_cloudless",
        frame0=read_image(folder / "yoscloudless_009.png"),
        frame1=read_image(folder / "yoscloudless_010.png"),
        truth=read_flo(folder / "flow09_derived_sky_unknown.flo"),
        note="frames 9 and 10; the sky, 26% of the pixels, does not count",
    )


def _sintel_alley(data: Path) -> FlowPair:
    folder = data / "sintel_alley"
    truth = read_flo(folder / "gt" / "frame_0002.flo").astype(np.float32)
    truth[read_image(folder / "gt" / "invalid" / "frame_0002.png") > 0] = np.nan
    return FlowPair(
        name="sintel_alley",
        group="sintel_alley",
        frame0=read_image(folder / "frame_0002.png"),
        frame1=read_image(folder / "frame_0003.png"),
        truth=truth,
        note="alley_1, clean, frames 2 and 3; occluded pixels count, invalid ones do not",
    )


def _motorcycle(data: Path) -> FlowPair:
    folder = data / "stereo"
    with np.load(folder / "motorcycle_disp.npz") as stored:
        disparity = stored["arr_0"]
    return _stereo("motorcycle", "stereo", folder, "motorcycle_", disparity)


def _cones(data: Path) -> FlowPair:
    folder = data / "stereo"
    disparity = read_image(folder / "cones_gt.png").astype(np.float32)
    return _stereo("cones", "stereo", folder, "cones_", np.where(disparity > 0, disparity, np.nan))


def _kitti(data: Path) -> FlowPair:
    folder = data / "kitti"
    disparity = read_image(folder / "disparity.png").astype(np.float32)
    note = "left to right; the truth is a block matcher's disparity, not a laser's"
    return _stereo("kitti", "kitti", folder, "", disparity, note=note)


def _stereo(
    name: str,
    group: str,
    folder: Path,
    prefix: str,
    disparity: NDArray,
    *,
    note: str = "left to right; occluded pixels count",
) -> FlowPair:
    disparity = np.where(np.isfinite(disparity), disparity, np.nan)
    return FlowPair(
        name=name,
        group=group,
        frame0=read_image(folder / f"{prefix}left.png"),
        frame1=read_image(folder / f"{prefix}right.png"),
        truth=np.stack([-disparity, np.zeros_like(disparity)], axis=-1),
        note=note,
    )


READERS: dict[str, Reader] = {
    **{name: partial(_middlebury, name=name) for name in MIDDLEBURY},
    "yosemite_clouds": _yosemite_clouds,
    "yosemite_cloudless": _yosemite_cloudless,
    "sintel_alley": _sintel_alley,
    "motorcycle": _motorcycle,
    "cones": _cones,
    "kitti": _kitti,
}
