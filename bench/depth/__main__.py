"""``python -m bench.depth``: depth and motion of the camera beside a flow with two stages after.

The two stages are an essential matrix by random sampling and triangulation, after the flow of
OpenCV's DeepFlow or DIS, and of tisfm itself. DeepFlow needs an environment of its own, which
``python -m bench.peers --prepare DIR`` makes; ``--peer-python`` names its interpreter. The tables
and all numbers are left in bench/results.
"""

import argparse
import contextlib
import sys
import tempfile
from pathlib import Path

import cv2
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from bench.depth.contest import DepthContest, hold
from bench.depth.methods import FlowThenDepth, Joint, Method
from bench.depth.pairs import Entry, data_entries, scene_entries
from bench.depth.report import show, write
from bench.shared.contest import preset as own_flow
from bench.shared.contest_command import (
    SMOKE_SIZE,
    add_method_options,
    add_options,
    check_counts,
    choose,
    wide_console,
)
from bench.shared.peer_process import Peer, find_peers
from bench.shared.results import RESULTS, machine
from bench.shared.sequences import data_folder
from tisfm import runtime
from tisfm.settings import Motion, Preset

FLOWS = ("OpenCV DeepFlow", "OpenCV DIS medium")
SCENE_SIZE = (240, 320)
MOTIONS: tuple[Motion, ...] = ("camera",)
REMARKS = (
    "Flows of other libraries run with their defaults, each in a process of its own, on 8-bit grey "
    "frames whose conversion is not timed. tisfm takes the frames as they were read.",
)


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(prog="python -m bench.depth", description=__doc__)
    add_options(parser)
    add_method_options(parser)
    parser.add_argument("--remark", metavar="TEXT", help="what else to say beside the tables")
    options = parser.parse_args(arguments)
    check_counts(parser, options)
    return options


def find_entries(options: argparse.Namespace) -> tuple[list[Entry], dict[str, str]]:
    """Return the pairs that the options ask for, and why others are missing."""
    missing: dict[str, str] = {}
    entries = scene_entries(*_scene_size(options))
    folder = None if options.smoke else data_folder(options.data)
    if folder is not None:
        real, missing = data_entries(folder)
        entries += real
    elif not options.smoke:
        missing = {"real sequences": "no folder of them named"}
    name = "{0.group} {0.name}".format
    return choose(entries, options.pairs, what="pair", name=name), missing


def compare(options: argparse.Namespace) -> DepthContest:
    """Run tisfm's methods and the two stages after every flow."""
    entries, missing = find_entries(options)
    height, width = _scene_size(options)
    runtime.start(threads=options.threads)
    python, peers = find_peers(options.peer_python)
    missing |= {name: why for name, why in peers.missing.items() if name in (*FLOWS, "all peers")}
    presets: list[Preset] = options.preset
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="tisfm-depth-")))
        methods: list[Method] = []
        for preset in presets:
            methods += [Joint(preset, motion) for motion in MOTIONS]
            methods.append(FlowThenDepth(own_flow(preset)))
        for name in FLOWS:
            if name in peers.available:
                peer = Peer(name, python=python, threads=options.threads, folder=folder)
                stack.callback(peer.close)
                methods.append(FlowThenDepth(peer))
        methods = choose(methods, options.only, what="method", name=lambda method: method.name)
        conditions = {
            "command": command(options),
            "pairs": f"{len(entries)}; scenes are of {height}×{width} px",
            "rounds": 1 if options.smoke else options.rounds,
            "threads": options.threads,
            **machine(),
            "OpenCV of the essential matrix": cv2.__version__,
            "peers": ", ".join(f"{name} {number}" for name, number in peers.versions.items()),
        }
        return _hold_with_progress(methods, entries, conditions, missing)


def _scene_size(options: argparse.Namespace) -> tuple[int, int]:
    return SMOKE_SIZE if options.smoke else SCENE_SIZE


def command(options: argparse.Namespace) -> str:
    """Return the command of this run; folders by what they are, not where."""
    words = ["python -m bench.depth", "--preset", *options.preset]
    words += ["--rounds", str(options.rounds), "--threads", str(options.threads)]
    for name, given in (("--pairs", options.pairs), ("--methods", options.only)):
        words += [name, *given] if given else []
    words += ["--smoke"] if options.smoke else []
    words += ["--data DIR"] if options.data else []
    words += ["--peer-python PATH"] if options.peer_python else []
    return f"`{' '.join(words)}`"


def _hold_with_progress(
    methods: list[Method], entries: list[Entry], conditions: dict, missing: dict[str, str]
) -> DepthContest:
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    rounds = conditions["rounds"]
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task("", total=len(methods) * (1 + rounds * len(entries)))

        def step(text: str) -> None:
            progress.update(task, description=text, advance=1)

        return hold(
            methods, entries, rounds=rounds, conditions=conditions, missing=missing, step=step
        )


def main(arguments: list[str] | None = None) -> int:
    """Return 0, 1 where a method failed on a pair, or 2 where nothing could be run."""
    options = parse(arguments)
    try:
        contest = compare(options)
    except (OSError, ValueError) as error:
        print(f"bench.depth: {error}", file=sys.stderr)
        return 2
    path = RESULTS / (options.output or ("smoke-depth" if options.smoke else "depth"))
    remarks = [*REMARKS, *([options.remark] if options.remark else [])]
    write(contest, path, remarks=remarks)
    show(contest, wide_console())
    return 1 if contest.failures() else 0


if __name__ == "__main__":
    sys.exit(main())
