"""``python -m bench.sequences``: path and depth of whole sequences, compared with other methods.

The methods are `tisfm.reconstruct`, pairs chained by the overlap of their depths, and pycolmap.
Each runs in its own process. ``--peer-python`` names an interpreter with another version of
pycolmap. The tables and all figures are written to bench/results.
"""

import argparse
import sys
from pathlib import Path
from typing import Any

from bench.sequences.contest import (
    COLMAP_WORKER,
    Colmap,
    Method,
    OwnMethod,
    Score,
    SequenceContest,
    run_contest,
)
from bench.sequences.entries import Entry, data_entries, folder_entries
from bench.sequences.report import show, write
from bench.shared.command import choose, command_text, options_parser, progress
from bench.shared.peer_process import run_survey
from bench.shared.results import RESULTS, machine, wide_console
from bench.shared.sequences import data_folder

# Options that appear in the results.
RECORDED_OPTIONS = (
    "preset", "rounds", "threads", "sequences", "methods", "folder", "poses-given",
    "camera-unknown", "peer-python",
)  # fmt: skip


def parse(arguments: list[str] | None) -> argparse.Namespace:
    parser = options_parser(
        "sequences",
        __doc__,
        *("data", "preset", "threads", "rounds", "peer-python", "output"),
        preset=["fast", "balanced"],
        rounds=1,
        output="sequences",
    )
    add = parser.add_argument
    add("--sequences", nargs="+", metavar="WORD", help="sequences with a WORD in the name")
    add("--folder", nargs="+", type=Path, default=[], metavar="DIR", help="other sequences, alone")
    add("--step", nargs="+", type=int, default=[1], metavar="N", help="every N frames of --folder")
    add("--methods", nargs="+", metavar="WORD", help="methods with a WORD in the name")
    add("--poses-given", action="store_true", help="also tisfm with the true poses")
    add("--camera-unknown", action="store_true", help="also tisfm without a camera")
    return parser.parse_args(arguments)


def find_entries(options: argparse.Namespace) -> tuple[list[Entry], dict[str, str]]:
    """Return the sequences that the options name, and why others are missing."""
    missing: dict[str, str] = {}
    if options.folder:
        entries = folder_entries(options.folder, options.step)
    else:
        folder = data_folder(options.data)
        if folder is None:
            raise ValueError("no folder of sequences is named: give --data, or set TISFM_DATA")
        entries, missing = data_entries(folder)
    chosen = choose(entries, options.sequences, kind="sequence", name=lambda entry: entry.name)
    return chosen, missing


def find_methods(options: argparse.Namespace) -> tuple[list[Method], dict[str, str], str]:
    """Return the methods that the options name, why others are missing, and pycolmap's version.

    `tisfm.reconstruct` stands first.
    """
    methods: list[Method] = []
    missing: dict[str, str] = {}
    cases: list[dict[str, Any]] = [{}]
    cases += [{"poses_given": True}] * options.poses_given
    cases += [{"camera_given": False}] * options.camera_unknown
    for case in (*cases, {"method": "chain"}):
        for preset in options.preset:
            methods.append(OwnMethod(preset=preset, threads=options.threads, **case))
    python = options.peer_python or Path(sys.executable)
    try:
        about = run_survey(python, COLMAP_WORKER)
    except RuntimeError as error:
        about = {"reason": str(error)}
    if "version" in about:
        methods.append(Colmap(python=python, threads=options.threads))
    else:
        missing["pycolmap"] = about["reason"]
    chosen = choose(methods, options.methods, kind="method", name=lambda method: method.name)
    return chosen, missing, about.get("version", "none")


def main(arguments: list[str] | None = None) -> int:
    """Return 0, 1 if a method failed on a sequence, or 2 if nothing could be run."""
    options = parse(arguments)
    path = RESULTS / options.output
    try:
        entries, missing = find_entries(options)
        methods, absent, version = find_methods(options)
        conditions = {
            "command": command_text(
                "sequences", options, [*RECORDED_OPTIONS, *["step"] * bool(options.folder)]
            ),
            "rounds": options.rounds,
            "threads": options.threads,
            **machine(),
            "pycolmap": version,
        }
        with progress(len(methods) * len(entries) * options.rounds) as step:

            def keep(scores: list[Score]) -> None:
                write(SequenceContest(conditions=conditions, scores=tuple(scores)), path)

            contest = run_contest(
                methods,
                entries,
                rounds=options.rounds,
                conditions=conditions,
                missing=missing | absent,
                step=step,
                keep=keep,
            )
    except (OSError, ValueError) as error:
        print(f"bench.sequences: {error}", file=sys.stderr)
        return 2
    write(contest, path)
    show(contest, wide_console())
    return 1 if contest.failures else 0


if __name__ == "__main__":
    sys.exit(main())
