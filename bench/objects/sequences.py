"""``python -m bench.objects.sequences``: labels of moving things over whole sequences.

Clips of DAVIS, where a folder of real sequences has them, and a rendered film of three bodies;
beside background subtraction after a homography, and clusters of flow. DeepFlow needs the
environment of ``python -m bench.peers --prepare DIR``. The tables and all numbers are left in
bench/results.
"""

import argparse
import contextlib
import json
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rich.console import Console

from bench.objects.clips import BODIES, DAVIS, Clip, davis_clip, davis_folders, rendered_clip
from bench.objects.sequence_methods import (
    Differences,
    FlowClusters,
    Labeller,
    Mixtures,
    Reconstruct,
)
from bench.objects.sequence_scores import ClipScore, details, scored, table
from bench.shared.contest import MethodFailure
from bench.shared.contest_command import (
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

FLOWS = ("OpenCV DeepFlow", "OpenCV DIS medium")
TITLES = {DAVIS: "Clips of DAVIS", BODIES: "Film of bodies"}
NOTES = (
    "IoU: intersection over union of a true thing and the one label that stands for it throughout "
    "the clip, mean over the frames where either is, then over things. Followed: frames with a "
    "thing in which some label has an IoU of 0.5 or more with it; switches: how often that label "
    "became another one (`tisfm.metrics.label_scores`).",
    "Every peer is shown in the variant that is best for it in mean IoU over the clips of a table, "
    "of all that are listed below; tisfm has one, for all clips.",
    "Difference: of each frame from both or either of its neighbours a gap away, brought to it by "
    "the homography of followed corners (RANSAC); threshold, opening and closing. MOG2: OpenCV's "
    "mixture of Gaussians of 8 frames before and 8 after, from a gap on, brought to each frame "
    "alike.",
    "Clusters: flow to the next frame; what is off the homography, or off the epipolar lines, of "
    "most of it by a threshold; opening and closing; k-means of what is left and of the place.",
    "One label: all that moves is one thing. Parts tracked: connected parts of a cluster take the "
    "label, of the last 10 frames, that they overlap most.",
    "Seconds: of one run of the chosen variant, per frame, its flow or homographies included. "
    "tisfm finds the camera, its path, and depth of every frame as well.",
    "Path: root mean square error of a body's position in % of its path's length, and of its turn, "
    "after the alignment of `tisfm.metrics.object_path_errors`.",
)


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(prog="python -m bench.objects.sequences", description=__doc__)
    add_options(parser)
    add_method_options(parser)
    parser.set_defaults(rounds=1, preset=["fast"])
    options = parser.parse_args(arguments)
    check_counts(parser, options)
    return options


def clips(options: argparse.Namespace) -> Iterator[Clip]:
    """Yield the clips that the options ask for, one at a time: they are large."""
    folder = None if options.smoke else data_folder(options.data)
    named: list[Path | None] = [None, *([] if folder is None else davis_folders(folder))]
    chosen = choose(named, options.pairs, what="clip", name=lambda it: it.name if it else "bodies")
    for item in chosen:
        yield rendered_clip(small=options.smoke) if item is None else davis_clip(item)


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Return conditions, scores, and what is missing."""
    runtime.start(threads=options.threads)
    python, peers = find_peers(options.peer_python)
    missing = {name: why for name, why in peers.missing.items() if name in (*FLOWS, "all peers")}
    scores: list[ClipScore] = []
    sizes: list[str] = []
    with contextlib.ExitStack() as stack:
        temporary = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="tisfm-objects-")))
        every: list[Labeller] = [Reconstruct(preset) for preset in options.preset]
        every += [Differences(), Mixtures()]
        for flow in FLOWS:
            if flow in peers.available:
                peer = Peer(flow, python=python, threads=options.threads, folder=temporary)
                stack.callback(peer.close)
                every.append(FlowClusters(peer))
        methods = choose(every, options.only, what="method", name=lambda method: method.name)
        progress = stack.enter_context(Console(stderr=True).status(""))
        for clip in clips(options):
            height, width = clip.frames[0].shape[:2]
            sizes.append(f"{clip.name} ({len(clip.frames)} frames of {height}×{width})")
            for method in methods:
                progress.update(f"{clip.name}: {method.name}")
                scores += score_all(method, clip)
            for file in temporary.glob("*.npy"):
                file.unlink()
    if not any(score.group == DAVIS for score in scores):
        missing["DAVIS"] = "small scenes alone" if options.smoke else "no folder that has it"
    conditions = {
        "command": command(options),
        "clips": ", ".join(sizes),
        "threads": options.threads,
        **machine(),
        "peers": ", ".join(f"{name} {number}" for name, number in peers.versions.items()),
    }
    return {"conditions": conditions, "scores": scores, "missing": missing}


def score_all(method: Labeller, clip: Clip) -> list[ClipScore]:
    """Return the scores of every variant of a method, or the one that says why it failed."""
    try:
        return [scored(method.name, clip, found) for found in method.run(clip)]
    except MethodFailure as failure:
        return [
            ClipScore(
                method=method.name,
                variant="",
                clip=clip.name,
                group=clip.group,
                failure=str(failure),
            )
        ]


def command(options: argparse.Namespace) -> str:
    """Return the command of this run; folders by what they are, not where."""
    words = ["python -m bench.objects.sequences", "--preset", *options.preset]
    words += ["--threads", str(options.threads)]
    for name, given in (("--pairs", options.pairs), ("--methods", options.only)):
        words += [name, *given] if given else []
    words += ["--smoke"] if options.smoke else []
    words += ["--data DIR"] if options.data else []
    words += ["--peer-python PATH"] if options.peer_python else []
    return f"`{' '.join(words)}`"


def groups(scores: list[ClipScore]) -> dict[str, list[ClipScore]]:
    """Return group → its scores."""
    return {
        group: [score for score in scores if score.group == group]
        for group in dict.fromkeys(score.group for score in scores)
    }


def failures(scores: list[ClipScore]) -> list[str]:
    """Return a line for every method that failed on a clip."""
    return [f"{s.method} failed on {s.clip}: {s.failure}" for s in scores if s.failure]


def write(measured: dict[str, Any], path: Path) -> None:
    """Write PATH.md and PATH.json."""
    lines = ["# Things that move on their own, over whole sequences", ""]
    lines += [f"- {name}: {value}" for name, value in measured["conditions"].items()]
    lines += ["", *(f"- {note}" for note in NOTES)]
    lines += [f"- missing: {name}: {why}" for name, why in measured["missing"].items()]
    lines += [f"- {line}" for line in failures(measured["scores"])]
    for group, scores in groups(measured["scores"]).items():
        lines += ["", f"## {TITLES[group]}", "", *table(scores).markdown()]
    lines += ["", "## Every variant", "", *details(measured["scores"]).markdown()]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.with_suffix(".md").write_text("\n".join([*lines, ""]), encoding="utf-8")
    plain = measured | {"scores": [asdict(score) for score in measured["scores"]]}
    content = json.dumps(plain, indent=1, ensure_ascii=False)
    path.with_suffix(".json").write_text(content + "\n", encoding="utf-8")


def main(arguments: list[str] | None = None) -> int:
    """Return 0, 1 where a method failed on a clip, or 2 where nothing could be run."""
    options = parse(arguments)
    try:
        measured = measure(options)
    except (OSError, ValueError) as error:
        print(f"bench.objects.sequences: {error}", file=sys.stderr)
        return 2
    name = "smoke-objects_sequences" if options.smoke else "objects_sequences"
    write(measured, RESULTS / (options.output or name))
    console = wide_console()
    for group, scores in groups(measured["scores"]).items():
        console.print(group, table(scores).rich())
    told = failures(measured["scores"])
    told += [f"missing: {name}: {why}" for name, why in measured["missing"].items()]
    for line in told:
        console.print(line, highlight=False, markup=False)
    return 1 if failures(measured["scores"]) else 0


if __name__ == "__main__":
    sys.exit(main())
