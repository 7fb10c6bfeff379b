"""``python -m bench.peers``: flow of tisfm and of other libraries, on the same pairs in one run.

The other libraries need their own environment: ``--prepare DIR`` makes it, and ``--peer-python``
names its interpreter. By default, methods run if the present environment has them. The tables, all
figures and a picture are written to bench/results.
"""

import argparse
import subprocess
import sys
from pathlib import Path

from bench.shared.command import (
    Pairs,
    choose,
    load_pairs,
    options_parser,
    output_name,
    run_with_progress,
    running_peers,
)
from bench.shared.contest import Contest, Method, baseline, preset
from bench.shared.contest_report import show, write
from bench.shared.figures import contest_figure
from bench.shared.peer_process import make_environment, survey
from bench.shared.results import RESULTS, machine, print_missing, wide_console
from tisfm import runtime
from tisfm.settings import Preset

REFERENCE = "OpenCV DeepFlow"
REMARKS = (
    "Each method of another library runs with the defaults of its library, in a process of its "
    "own, on 8-bit grey frames (scikit-image: grey in [0, 1]); the conversion is not timed. tisfm "
    "takes the frames as they were read, and its time includes depth, 3D motion and confidence.",
)


def compare(options: argparse.Namespace, pairs: Pairs) -> Contest:
    runtime.start(threads=options.threads)
    presets: list[Preset] = ["fast", "balanced", "accurate"]
    if options.paper:
        presets.append("paper")
    with running_peers(options) as peers:
        methods: list[Method] = [preset(name) for name in presets]
        methods += [baseline(), *peers.methods]
        methods = choose(methods, options.only, kind="method", name=lambda method: method.name)
        names = [method.name for method in methods]
        return run_with_progress(
            methods,
            pairs,
            options,
            reference=REFERENCE if REFERENCE in names else names[0],
            conditions={
                "pairs": pairs.source,
                "threads": options.threads,
                **machine(),
                "peers": peers.versions,
            },
            missing=pairs.missing | peers.survey.missing,
        )


def main(arguments: list[str] | None = None) -> int:
    """Return 0, 1 if a method failed on a pair, or 2 if nothing could be run."""
    names = ("data", "pairs", "only", "threads", "rounds", "smoke", "output", "peer-python")
    parser = options_parser("peers", __doc__, *names)
    parser.add_argument("--paper", action="store_true", help='run the preset "paper", too')
    parser.add_argument("--prepare", type=Path, metavar="DIR", help="make the environment only")
    options = parser.parse_args(arguments)
    console = wide_console()
    try:
        if options.prepare:
            python = make_environment(options.prepare)
            print_missing(console, survey(python).missing)
            console.print(f"python -m bench.peers --peer-python {python}", soft_wrap=True)
            return 0
        contest = compare(options, load_pairs(options))
    except (OSError, ValueError, RuntimeError, subprocess.CalledProcessError) as error:
        print(f"bench.peers: {error}", file=sys.stderr)
        return 2
    path = RESULTS / output_name(options, "peers")
    write(contest, path, title="tisfm beside other libraries", remarks=REMARKS)
    contest_figure(contest).savefig(path.with_suffix(".png"))
    show(contest, console)
    return 1 if contest.failures() else 0


if __name__ == "__main__":
    sys.exit(main())
