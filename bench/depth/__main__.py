"""``python -m bench.depth``: depth and motion of the camera, compared with two-stage methods.

The two stages are an essential matrix by random sampling, and triangulation, after a flow of
OpenCV's DeepFlow or DIS, or of tisfm. DeepFlow needs its own environment, which ``python -m
bench.peers --prepare DIR`` makes; ``--peer-python`` names its interpreter. The tables and all
figures are written to bench/results.
"""

import argparse
import sys

import cv2

from bench.depth.contest import DepthContest, run_contest
from bench.depth.methods import FlowThenDepth, Method, OwnMethod
from bench.depth.pairs import Entry, data_entries, scene_entries
from bench.depth.report import show, write
from bench.shared.command import (
    SMOKE_SIZE,
    choose,
    command_text,
    options_parser,
    output_name,
    progress,
    running_peers,
)
from bench.shared.contest import preset as own_flow
from bench.shared.results import RESULTS, machine, wide_console
from bench.shared.sequences import data_folder
from tisfm import runtime
from tisfm.settings import Motion

FLOWS = ("OpenCV DeepFlow", "OpenCV DIS medium")
SCENE_SIZE = (240, 320)  # px, height and width of rendered scenes
# Options that appear in the results.
RECORDED_OPTIONS = ("preset", "rounds", "threads", "pairs", "only", "smoke", "data", "peer-python")
MOTIONS: tuple[Motion, ...] = ("camera",)
REMARKS = (
    "Flows of other libraries run with their defaults, each in a process of its own, on 8-bit grey "
    "frames whose conversion is not timed. tisfm takes the frames as they were read.",
)


def find_entries(options: argparse.Namespace) -> tuple[list[Entry], dict[str, str]]:
    """Return the pairs that the options name, and why others are missing."""
    missing: dict[str, str] = {}
    entries = scene_entries(*_scene_size(options))
    folder = None if options.smoke else data_folder(options.data)
    if folder is not None:
        real, missing = data_entries(folder)
        entries += real
    elif not options.smoke:
        missing = {"real sequences": "no folder of them named"}
    name = "{0.group} {0.name}".format
    return choose(entries, options.pairs, kind="pair", name=name), missing


def compare(options: argparse.Namespace) -> DepthContest:
    entries, missing = find_entries(options)
    height, width = _scene_size(options)
    runtime.start(threads=options.threads)
    rounds = 1 if options.smoke else options.rounds
    with running_peers(options, FLOWS) as peers:
        methods: list[Method] = []
        for preset in options.preset:
            methods += [OwnMethod(preset, motion) for motion in MOTIONS]
            methods.append(FlowThenDepth(own_flow(preset)))
        methods += map(FlowThenDepth, peers.methods)
        methods = choose(methods, options.only, kind="method", name=lambda method: method.name)
        conditions = {
            "command": command_text("depth", options, RECORDED_OPTIONS),
            "pairs": f"{len(entries)}; scenes are of {height}×{width} px",
            "rounds": rounds,
            "threads": options.threads,
            **machine(),
            "OpenCV of the essential matrix": cv2.__version__,
            "peers": peers.versions,
        }
        with progress(len(methods) * (1 + rounds * len(entries))) as step:
            return run_contest(
                methods,
                entries,
                rounds=rounds,
                conditions=conditions,
                missing=missing | peers.survey.missing,
                step=step,
            )


def _scene_size(options: argparse.Namespace) -> tuple[int, int]:
    return SMOKE_SIZE if options.smoke else SCENE_SIZE


def main(arguments: list[str] | None = None) -> int:
    """Return 0, 1 if a method failed on a pair, or 2 if nothing could be run."""
    parser = options_parser("depth", __doc__, *RECORDED_OPTIONS, "output", preset=["balanced"])
    parser.add_argument("--remark", metavar="TEXT", help="added to the notes of the tables")
    options = parser.parse_args(arguments)
    try:
        contest = compare(options)
    except (OSError, ValueError) as error:
        print(f"bench.depth: {error}", file=sys.stderr)
        return 2
    path = RESULTS / output_name(options, "depth")
    remarks = [*REMARKS, *([options.remark] if options.remark else [])]
    write(contest, path, remarks=remarks)
    show(contest, wide_console())
    return 1 if contest.failures() else 0


if __name__ == "__main__":
    sys.exit(main())
