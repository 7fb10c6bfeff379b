"""What benchmarks of one real sequence share: their options, and how it is found."""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import get_args

from bench.shared.sequences import data_folder
from tisfm.datasets import find_sequences
from tisfm.datasets.sequence import LoadedSequence
from tisfm.settings import Preset


def parsed(
    parser: argparse.ArgumentParser,
    arguments: Sequence[str] | None,
    *,
    sequence: str,
    preset: Preset,
    output: str,
) -> tuple[argparse.Namespace, LoadedSequence]:
    """Return the options and the sequence of that name; end the program if there is none.

    `preset` and `output` are the defaults of the options of these names.
    """
    parser.add_argument("--data", type=Path, metavar="DIR", help="the folder of sequences")
    parser.add_argument("--preset", choices=get_args(Preset), default=preset)
    parser.add_argument("--output", default=output, metavar="NAME", help="in bench/results")
    options = parser.parse_args(arguments)
    data = data_folder(options.data)
    if data is None:
        parser.error("no folder of sequences is named: give --data, or set TISFM_DATA")
    (found,) = find_sequences(data / sequence)
    return options, found.load(1)
