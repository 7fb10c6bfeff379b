"""A real sequence of a walking man and a passing cyclist, filmed by a moving camera."""

import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean, median

import numpy as np
from numpy.typing import NDArray

import tisfm
from bench.shared.contest import measure_time
from bench.shared.results import Table
from tisfm.focal_guess import GuessedFocalWarning
from tisfm.formats import read_image
from tisfm.settings import Preset, Settings

FOLDER = "statue"
FRAME_STEP = 3  # frames between both frames of a pair; in that time both people move by some 3 px
PAIR_STEP = 2  # frames from one pair to the next
FOCALS = (384.0, 600.0)  # px: the guess for this image size, and the paper's; the truth is unknown
ESTIMATED_ORIGIN = "estimated"  # origin of the focal length from all frames
MIN_LABELLED_SHARE = 0.5  # share of labelled pixels of a labelled patch
# Centres of the man's upper body and of the cyclist's in every second frame, px.
MAN = (
    (55, 107), (63, 107), (73, 106), (77, 102), (81, 106), (88, 111), (94, 111), (96, 107),
    (105, 108), (102, 110), (104, 114), (114, 114), (115, 112), (126, 115), (135, 120),
)  # fmt: skip
CYCLIST = (
    (254, 97), (258, 98), (259, 98), (260, 93), (261, 94), (264, 101), (265, 98), (265, 97),
    (265, 97), (261, 99), (260, 104), (264, 104), (262, 104), (268, 104), (274, 106),
)  # fmt: skip
MAN_SIZE = (11, 29)  # px, width and height of the patch
CYCLIST_SIZE = (9, 17)  # px


@dataclass(frozen=True, kw_only=True)
class StatuePair:
    """Labels of the two people in a pair of the sequence."""

    method: str
    pair: str
    focal: float  # px
    origin: str = ""  # `ESTIMATED_ORIGIN`, or nothing
    labels: int  # number of labels
    man: bool  # whether most of his patch has a label other than the background's
    cyclist: bool
    different: bool  # whether the two labels differ
    seconds: float


def statue_pairs(data: Path) -> Iterator[tuple[int, NDArray, NDArray]]:
    """Yield the number of the first frame, and both frames, of every pair."""
    files = sorted((data / FOLDER).iterdir())
    for first in range(0, min(len(files) - FRAME_STEP, PAIR_STEP * len(MAN)), PAIR_STEP):
        yield first, read_image(files[first]), read_image(files[first + FRAME_STEP])


def focals_of(data: Path) -> dict[float, str]:
    """Return focal length, px → origin: `FOCALS`, and the estimate from all frames."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", GuessedFocalWarning)
        result = tisfm.reconstruct(data / FOLDER, depth_of="none")
    return {**dict.fromkeys(FOCALS, ""), result.camera.focal: ESTIMATED_ORIGIN}


def interpret_pair(
    preset: Preset, first: int, frame0: NDArray, frame1: NDArray, focal: float, origin: str = ""
) -> StatuePair:
    """Interpret a pair, and return the labels of both people."""
    settings = Settings.preset(preset, motion="objects")
    camera = tisfm.Camera(focal=focal)
    result, seconds = measure_time(
        tisfm.interpret, frame0, frame1, camera=camera, settings=settings
    )
    assert result.labels is not None and result.motions is not None  # this motion model has them
    man = _label(result.labels, MAN[first // PAIR_STEP], MAN_SIZE)
    cyclist = _label(result.labels, CYCLIST[first // PAIR_STEP], CYCLIST_SIZE)
    return StatuePair(
        method=f"tisfm {preset}, objects",
        pair=f"{FOLDER} {first}",
        focal=focal,
        origin=origin,
        labels=len(result.motions),
        man=man > 0,
        cyclist=cyclist > 0,
        different=man != cyclist,
        seconds=seconds,
    )


def table(pairs: Sequence[StatuePair]) -> Table:
    """Return the number of labelled pairs: a row for every method and focal length."""
    rows = []
    for method, focal in dict.fromkeys((s.method, s.focal) for s in pairs):
        group = [s for s in pairs if (s.method, s.focal) == (method, focal)]
        rows.append(
            [
                method,
                f"{focal:.4g} {group[0].origin}".strip(),
                str(len(group)),
                str(sum(s.man and s.different for s in group)),
                str(sum(s.cyclist and s.different for s in group)),
                str(sum(s.man and s.cyclist and s.different for s in group)),
                f"{fmean(s.labels for s in group):.1f}",
                f"{median(s.seconds for s in group):#.3g}",
            ]
        )
    head = ["method", "f, px", "pairs", "man", "cyclist", "both, different", "labels, mean", "s"]
    return Table(head, rows)


def _label(labels: NDArray, centre: tuple[int, int], size: tuple[int, int]) -> int:
    """Return the label of most of a patch, or 0."""
    (x, y), (width, height) = centre, size
    patch = labels[y - height // 2 : y + height // 2 + 1, x - width // 2 : x + width // 2 + 1]
    areas = np.bincount(patch.ravel())
    label = int(areas.argmax())
    return label if areas[label] >= MIN_LABELLED_SHARE * patch.size else 0
