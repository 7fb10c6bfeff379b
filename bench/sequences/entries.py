"""Sequences of the comparison: from a folder of real data, and from any folder."""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from bench.shared.command import Parser
from bench.shared.sequences import data_folder
from tisfm.datasets import DatasetSequence, LoadedSequence, find_sequences

# Folder, and the step from frame to frame.
SEQUENCES = (
    ("new_tsukuba", 1),
    ("tartanair", 1),
    ("hololens", 1),
    ("sevenscenes", 1),
    ("sevenscenes", 2),
    ("tum_fr1_rpy", 1),
    ("tum_fr1_rpy", 2),
    ("fountain", 1),
    ("kitti_odometry_06", 1),
)
# Folder, and the number of the frame from which every second frame is left out: the car then seems
# to drive faster.
THINNED = (("kitti_odometry_06", 25),)
BLURRED = ("hololens", "sevenscenes")  # folders whose sensor of true depth blurs outlines
MAX_DEPTH = 40.0  # m: larger true depths do not count


@dataclass(frozen=True, kw_only=True)
class Entry:
    sequence: DatasetSequence
    step: int = 1  # from frame to frame
    thinned: int | None = None  # from this frame on, every second frame is left out

    @property
    def name(self) -> str:
        name = self.sequence.name
        if self.step > 1:
            name += f", every {self.step}"
        return name if self.thinned is None else f"{name}, every 2 from {self.thinned} on"

    @property
    def is_truth_blurred(self) -> bool:
        """Whether the sensor of the true depth blurs outlines."""
        return self.sequence.name in BLURRED

    def load(self) -> LoadedSequence:
        """Return the sequence without its frames and depth maps."""
        loaded = self.sequence.load(self.step)
        if self.thinned is None:
            return loaded
        count = len(loaded.frames)
        return loaded.take([*range(min(self.thinned, count)), *range(self.thinned, count, 2)])


def data_entries(data: Path) -> tuple[list[Entry], dict[str, str]]:
    """Return the sequences found in a folder, and why others are missing, by name."""
    entries: list[Entry] = []
    missing: dict[str, str] = {}
    choices: list[tuple[str, int, int | None]] = [(name, step, None) for name, step in SEQUENCES]
    choices += [(name, 1, thinned) for name, thinned in THINNED]
    for name, step, thinned in choices:
        try:
            (sequence,) = find_sequences(data / name)
        except FileNotFoundError as error:
            missing[name] = str(error)
            continue
        entries.append(Entry(sequence=sequence, step=step, thinned=thinned))
    return entries, missing


def folder_entries(folders: Sequence[Path], steps: Sequence[int]) -> list[Entry]:
    """Return the sequences in folders, with every step."""
    sequences = [sequence for folder in folders for sequence in find_sequences(folder)]
    return [Entry(sequence=sequence, step=step) for sequence in sequences for step in steps]


def parse_one(
    parser: Parser, arguments: Sequence[str] | None, sequence: str
) -> tuple[argparse.Namespace, LoadedSequence]:
    """Return the options, and the sequence of that name; end the program if there is none."""
    options = parser.parse_args(arguments)
    data = data_folder(options.data)
    if data is None:
        parser.error("no folder of sequences is named: give --data, or set TISFM_DATA")
    (dataset,) = find_sequences(data / sequence)
    return options, dataset.load(1)
