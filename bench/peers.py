"""``python -m bench.peers``: tisfm beside other libraries, on the same pairs in one run.

The peers need an environment of their own, which ``--prepare DIR`` makes; ``--peer-python`` names
its interpreter. Without one, those run that the present environment has. The tables, all numbers
and a picture are left in bench/results.
"""

import argparse
import contextlib
import subprocess
import sys
import tempfile
from pathlib import Path

from bench.shared.contest import Contest, Method, baseline, preset
from bench.shared.contest_command import (
    Pairs,
    add_options,
    add_peer_option,
    check_counts,
    choose,
    hold_with_progress,
    load_pairs,
    wide_console,
)
from bench.shared.contest_plot import draw
from bench.shared.contest_report import show, write
from bench.shared.peer_process import Peer, find_peers, prepare, survey
from bench.shared.results import RESULTS, machine
from tisfm import runtime
from tisfm.settings import Preset

REFERENCE = "OpenCV DeepFlow"
REMARKS = (
    "Each peer runs with the defaults of its library, in a process of its own, on 8-bit grey "
    "frames (scikit-image: grey in [0, 1]); their conversion is not timed. tisfm takes the frames "
    "as they were read, and its time includes depth, 3D motion and confidence.",
)


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(prog="python -m bench.peers", description=__doc__)
    add_options(parser)
    parser.add_argument("--paper", action="store_true", help='run the preset "paper", too')
    add_peer_option(parser)
    parser.add_argument("--prepare", type=Path, metavar="DIR", help="make their environment, only")
    options = parser.parse_args(arguments)
    check_counts(parser, options)
    return options


def compare(options: argparse.Namespace, found: Pairs) -> Contest:
    """Run tisfm's methods and the peers."""
    runtime.start(threads=options.threads)
    python, peers = find_peers(options.peer_python)
    presets: list[Preset] = ["fast", "balanced", "accurate"]
    if options.paper:
        presets.append("paper")
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="tisfm-peers-")))
        methods: list[Method] = [preset(name) for name in presets]
        methods.append(baseline())
        for name in peers.available:
            peer = Peer(name, python=python, threads=options.threads, folder=folder)
            stack.callback(peer.close)
            methods.append(peer)
        methods = choose(methods, options.only, what="method", name=lambda method: method.name)
        names = [method.name for method in methods]
        return hold_with_progress(
            methods,
            found,
            options,
            reference=REFERENCE if REFERENCE in names else names[0],
            conditions={
                "pairs": found.source,
                "threads": options.threads,
                **machine(),
                "peers": ", ".join(f"{name} {number}" for name, number in peers.versions.items()),
            },
            missing=found.missing | peers.missing,
        )


def main(arguments: list[str] | None = None) -> int:
    """Return 0, 1 where a method failed on a pair, or 2 where nothing could be run."""
    options = parse(arguments)
    console = wide_console()
    try:
        if options.prepare:
            python = prepare(options.prepare)
            for name, reason in survey(python).missing.items():
                console.print(f"missing: {name}: {reason}", highlight=False, markup=False)
            console.print(f"python -m bench.peers --peer-python {python}", soft_wrap=True)
            return 0
        contest = compare(options, load_pairs(options))
    except (OSError, ValueError, RuntimeError, subprocess.CalledProcessError) as error:
        print(f"bench.peers: {error}", file=sys.stderr)
        return 2
    path = RESULTS / (options.output or ("smoke-peers" if options.smoke else "peers"))
    write(contest, path, title="tisfm beside other libraries", remarks=REMARKS)
    draw(contest, path.with_suffix(".png"))
    show(contest, console)
    return 1 if contest.failures() else 0
