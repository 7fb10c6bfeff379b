"""``python -m bench.sequences``: path and depth of whole sequences, compared with other methods.

The methods are `tisfm.reconstruct`, pairs chained by the overlap of their depths, and pycolmap.
Each runs in its own process. ``--peer-python`` names an interpreter with another version of
pycolmap. The tables and all figures are written to bench/results.
"""

import argparse
import json
import subprocess
import sys
from pathlib import Path

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
from bench.shared.results import RESULTS, machine, wide_console
from bench.shared.sequences import data_folder

# Options that appear in the results.
WORDS = (
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
    for poses_given in (False, True) if options.poses_given else (False,):
        methods += [
            OwnMethod(
                preset=preset,
                method="reconstruct",
                threads=options.threads,
                poses_given=poses_given,
            )
            for preset in options.preset
        ]
    if options.camera_unknown:
        methods += [
            OwnMethod(
                preset=preset, method="reconstruct", threads=options.threads, camera_given=False
            )
            for preset in options.preset
        ]
    methods += [
        OwnMethod(preset=preset, method="chain", threads=options.threads)
        for preset in options.preset
    ]
    python = options.peer_python or Path(sys.executable)
    about = _survey(python)
    if "version" in about:
        methods.append(Colmap(python=python, threads=options.threads))
    else:
        missing["pycolmap"] = about["reason"]
    chosen = choose(methods, options.methods, kind="method", name=lambda method: method.name)
    return chosen, missing, about.get("version", "none")


def _survey(python: Path) -> dict[str, str]:
    try:
        done = subprocess.run(
            [python, COLMAP_WORKER, "survey"], capture_output=True, text=True, check=True
        )
        answer: dict[str, str] = json.loads(done.stdout.splitlines()[-1])
        return answer
    except (OSError, subprocess.CalledProcessError, ValueError, IndexError) as error:
        return {"reason": f"{python.name} does not run its worker: {error}"}


def main(arguments: list[str] | None = None) -> int:
    """Return 0, 1 if a method failed on a sequence, or 2 if nothing could be run."""
    options = parse(arguments)
    path = RESULTS / options.output
    try:
        entries, missing = find_entries(options)
        methods, absent, version = find_methods(options)
        conditions = {
            "command": command_text(
                "sequences", options, [*WORDS, *["step"] * bool(options.folder)]
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
