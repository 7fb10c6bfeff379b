"""``python -m bench.objects.sequences``: labels of moving objects over whole sequences.

Clips of DAVIS, if a folder of real sequences has them, and rendered films: three boxes that fly
through a room, and people who walk in a street. Peers
are background subtraction after a homography, and clusters of flow. DeepFlow needs the environment
of ``python -m bench.peers --prepare DIR``. The tables and all figures are written to bench/results.
"""

import argparse
import sys
from collections.abc import Callable, Iterator
from dataclasses import asdict
from functools import partial
from typing import Any

from rich.console import Console

from bench.objects.__main__ import FLOWS, RECORDED_OPTIONS, groups
from bench.objects.clips import (
    DAVIS,
    RENDERED,
    RENDERED_CLIPS,
    Clip,
    davis_clip,
    davis_folders,
    render_clip,
)
from bench.objects.sequence_methods import (
    Differences,
    FlowClusters,
    Labeller,
    Mixtures,
    Reconstruct,
)
from bench.objects.sequence_scores import ClipScore, details, every_clip, score_clip, table
from bench.shared.command import choose, command_text, options_parser, output_name, running_peers
from bench.shared.contest import MethodFailure
from bench.shared.results import (
    RESULTS,
    Table,
    machine,
    markdown_page,
    print_missing,
    wide_console,
    write_results,
)
from bench.shared.sequences import data_folder
from tisfm import runtime

TITLES = {DAVIS: "Clips of DAVIS", RENDERED: "Rendered films"}
NOTES = (
    "IoU: intersection over union of a true object and the one label that is assigned to it for "
    "the whole clip, mean over the frames with either of them, then over objects. Followed: share "
    "of the frames with an object in which some label has an IoU of 0.5 or more with it; switches: "
    "number of changes of that label (`tisfm.metrics.label_scores`).",
    "Union and F: of all labels and all objects together, mean over frames: region similarity, and "
    "the F measure of the boundaries, within 0.8 % of the diagonal, as DAVIS defines it.",
    "Depth: of walkers, the median over frames of the median error of the labelled "
    "pixels, in the one scale in which the scene at rest is right. Order: share of the labelled "
    "pixels beside an occluder at rest that are behind it. With depth: share of the frames of "
    "labels in which half of the label has depth.",
    "Every peer is shown in its variant with the best mean IoU over the clips of a table; all "
    "variants are listed below. tisfm has one variant for all clips.",
    "Difference: of each frame from both or either of its neighbours at a distance of some frames, "
    "warped by the homography of tracked corners (RANSAC); threshold, opening and closing. MOG2: "
    "OpenCV's mixture of Gaussians over 8 frames before and 8 after, from a distance on, warped in "
    "the same way.",
    "Clusters: flow to the next frame; pixels off the dominant homography, or off its epipolar "
    "lines, by a threshold; opening and closing; k-means of the residual flow and the position.",
    "One label: all moving pixels are one object. Parts tracked: a connected part of a cluster "
    "takes the label of the last 10 frames that it overlaps most.",
    "Seconds: of one run of the chosen variant, per frame, its flow or homographies included. "
    "tisfm finds the camera, its path, and depth of every frame as well.",
    "Path: root mean square error of the position of a body, in % of the length of its path, and "
    "of its rotation, after the alignment of `tisfm.metrics.object_path_errors`.",
)


def clips(options: argparse.Namespace) -> Iterator[Clip]:
    """Yield the clips that the options name, one at a time, since they are large."""
    data = None if options.smoke else data_folder(options.data)
    readers: dict[str, Callable[[], Clip]] = {
        name: partial(render_clip, name, small=options.smoke) for name in RENDERED_CLIPS
    }
    for folder in [] if data is None else davis_folders(data):
        readers[folder.name] = partial(davis_clip, folder)
    for name in choose(list(readers), options.pairs, kind="clip", name=str):
        yield readers[name]()


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Return conditions, scores, and missing methods and data."""
    runtime.start(threads=options.threads)
    scores: list[ClipScore] = []
    sizes: list[str] = []
    with running_peers(options, FLOWS) as peers:
        missing = dict(peers.survey.missing)
        labellers: list[Labeller] = [Reconstruct(preset) for preset in options.preset]
        labellers += [Differences(), Mixtures(), *map(FlowClusters, peers.methods)]
        methods = choose(labellers, options.only, kind="method", name=lambda method: method.name)
        with Console(stderr=True).status("") as progress:
            for clip in clips(options):
                height, width = clip.frames[0].shape[:2]
                sizes.append(f"{clip.name} ({len(clip.frames)} frames of {height}×{width})")
                for method in methods:
                    progress.update(f"{clip.name}: {method.name}")
                    scores += score_all(method, clip)
                for file in peers.folder.glob("*.npy"):
                    file.unlink()
    if not any(score.group == DAVIS for score in scores):
        missing["DAVIS"] = (
            "a smoke run has only the film" if options.smoke else "not in the folder of sequences"
        )
    conditions = {
        "command": command_text("objects.sequences", options, RECORDED_OPTIONS),
        "clips": ", ".join(sizes),
        "threads": options.threads,
        **machine(),
        "peers": peers.versions,
    }
    return {"conditions": conditions, "scores": scores, "missing": missing}


def score_all(method: Labeller, clip: Clip) -> list[ClipScore]:
    """Return the scores of every variant of a method, or a score with its failure."""
    try:
        return [score_clip(method.name, clip, labels) for labels in method.run(clip)]
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


def failures(scores: list[ClipScore]) -> list[str]:
    """Return a line for every method that failed on a clip."""
    return [f"{s.method} failed on {s.clip}: {s.failure}" for s in scores if s.failure]


def report(results: dict[str, Any]) -> str:
    blocks: list[str | Table] = []
    for group, scores in groups(results["scores"]).items():
        blocks += [f"## {TITLES[group]}", table(scores)]
    blocks += ["## Every clip", every_clip(results["scores"])]
    blocks += ["## Every variant", details(results["scores"])]
    missing_notes = [f"missing: {name}: {reason}" for name, reason in results["missing"].items()]
    notes = [*NOTES, *missing_notes, *failures(results["scores"])]
    title = "# Moving objects over whole sequences"
    return markdown_page(title, results["conditions"], notes, *blocks)


def main(arguments: list[str] | None = None) -> int:
    """Return 0, 1 if a method failed on a clip, or 2 if nothing could be run."""
    parser = options_parser(
        "objects.sequences", __doc__, *RECORDED_OPTIONS, "output", preset=["fast"]
    )
    options = parser.parse_args(arguments)
    try:
        results = measure(options)
    except (OSError, ValueError) as error:
        print(f"bench.objects.sequences: {error}", file=sys.stderr)
        return 2
    record = results | {"scores": [asdict(score) for score in results["scores"]]}
    write_results(RESULTS / output_name(options, "objects_sequences"), report(results), record)
    console = wide_console()
    for group, scores in groups(results["scores"]).items():
        console.print(group, table(scores).rich())
    for line in failures(results["scores"]):
        console.print(line, highlight=False, markup=False)
    print_missing(console, results["missing"])
    return 1 if failures(results["scores"]) else 0


if __name__ == "__main__":
    sys.exit(main())
