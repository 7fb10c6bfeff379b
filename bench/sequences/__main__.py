"""``python -m bench.sequences``: paths and depth of whole sequences, beside other ways to them.

`tisfm.reconstruct`, pairs chained by the overlap of their depths, and pycolmap, each in a process
of its own. ``--peer-python`` names an interpreter with another version of pycolmap. The tables and
all numbers are left in bench/results.
"""

import argparse
import json
import subprocess
import sys
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from bench.sequences.contest import (
    COLMAP_WORKER,
    Colmap,
    Method,
    Own,
    Score,
    SequenceContest,
    hold,
    presets,
)
from bench.sequences.entries import Entry, data_entries, folder_entries
from bench.sequences.report import show, write
from bench.shared.contest_command import check_counts, choose, wide_console
from bench.shared.results import RESULTS, machine
from bench.shared.sequences import data_folder


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(prog="python -m bench.sequences", description=__doc__)
    add = parser.add_argument
    add("--data", type=Path, metavar="DIR", help="sequences; default: TISFM_DATA")
    add("--sequences", nargs="+", metavar="WORD", help="those with a WORD in the name")
    add("--folder", nargs="+", type=Path, default=[], metavar="DIR", help="other sequences, alone")
    add("--step", nargs="+", type=int, default=[1], metavar="N", help="every N frames of --folder")
    add("--methods", nargs="+", metavar="WORD", help="those with a WORD in the name")
    add("--preset", nargs="+", choices=presets(), default=["fast", "balanced"], metavar="PRESET")
    add("--poses-given", action="store_true", help="also tisfm with the true poses")
    add("--camera-unknown", action="store_true", help="also tisfm without a camera")
    add("--threads", type=int, default=2, metavar="N")
    add("--rounds", type=int, default=1, metavar="N", help="runs of each, all timed")
    add("--peer-python", type=Path, metavar="PATH", help="of another pycolmap")
    add("--output", default="sequences", metavar="NAME", help="of the files in bench/results")
    options = parser.parse_args(arguments)
    check_counts(parser, options)
    return options


def find_entries(options: argparse.Namespace) -> tuple[list[Entry], dict[str, str]]:
    """Return the sequences that the options ask for, and why others are missing."""
    missing: dict[str, str] = {}
    if options.folder:
        entries = folder_entries(options.folder, options.step)
    else:
        folder = data_folder(options.data)
        if folder is None:
            raise ValueError("no folder of sequences is named: give --data, or set TISFM_DATA")
        entries, missing = data_entries(folder)
    chosen = choose(entries, options.sequences, what="sequence", name=lambda entry: entry.name)
    return chosen, missing


def find_methods(options: argparse.Namespace) -> tuple[list[Method], dict[str, str], str]:
    """Return the methods that the options ask for, why others are missing, and pycolmap's version.

    `tisfm.reconstruct` stands first.
    """
    methods: list[Method] = []
    missing: dict[str, str] = {}
    for given in (False, True) if options.poses_given else (False,):
        methods += [
            Own(preset=preset, method="reconstruct", threads=options.threads, poses_given=given)
            for preset in options.preset
        ]
    if options.camera_unknown:
        methods += [
            Own(preset=preset, method="reconstruct", threads=options.threads, camera_given=False)
            for preset in options.preset
        ]
    methods += [
        Own(preset=preset, method="chain", threads=options.threads) for preset in options.preset
    ]
    python = options.peer_python or Path(sys.executable)
    about = _survey(python)
    if "version" in about:
        methods.append(Colmap(python=python, threads=options.threads))
    else:
        missing["pycolmap"] = about["reason"]
    chosen = choose(methods, options.methods, what="method", name=lambda method: method.name)
    return chosen, missing, about.get("version", "none")


def _survey(python: Path) -> dict[str, str]:
    try:
        done = subprocess.run(
            [python, COLMAP_WORKER, "survey"], capture_output=True, text=True, check=True
        )
        found: dict[str, str] = json.loads(done.stdout.splitlines()[-1])
        return found
    except (OSError, subprocess.CalledProcessError, ValueError, IndexError) as error:
        return {"reason": f"{python.name} does not run its worker: {error}"}


def command(options: argparse.Namespace) -> str:
    """Return the command of this run; folders by what they are, not where."""
    words = ["python -m bench.sequences", "--preset", *options.preset]
    words += ["--rounds", str(options.rounds), "--threads", str(options.threads)]
    for name, given in (("--sequences", options.sequences), ("--methods", options.methods)):
        words += [name, *given] if given else []
    if options.folder:
        words += ["--folder DIR", "--step", *map(str, options.step)]
    words += ["--poses-given"] if options.poses_given else []
    words += ["--camera-unknown"] if options.camera_unknown else []
    words += ["--peer-python PATH"] if options.peer_python else []
    return f"`{' '.join(words)}`"


def main(arguments: list[str] | None = None) -> int:
    """Return 0, 1 where a method failed on a sequence, or 2 where nothing could be run."""
    options = parse(arguments)
    path = RESULTS / options.output
    try:
        entries, missing = find_entries(options)
        methods, absent, version = find_methods(options)
        conditions = {
            "command": command(options),
            "rounds": options.rounds,
            "threads": options.threads,
            **machine(),
            "pycolmap": version,
        }
        columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
        with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
            total = len(methods) * len(entries) * options.rounds
            task = progress.add_task("", total=total)

            def keep(scores: list[Score]) -> None:
                write(SequenceContest(conditions=conditions, scores=tuple(scores)), path)

            contest = hold(
                methods,
                entries,
                rounds=options.rounds,
                conditions=conditions,
                missing=missing | absent,
                step=lambda text: progress.update(task, description=text, advance=1),
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
