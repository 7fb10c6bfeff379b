"""``python -m bench.objects``: labels, depth and motion of moving objects.

Rendered scenes of two and three blocks. The peers estimate a flow, and then depth in two stages
with one essential matrix for the whole image. Their depth is compared over the whole image in one
scale, and on each true object in its own scale. With a folder of real sequences, the statue is
added: do the walking man and the cyclist have separate labels? DeepFlow needs the environment of
``python -m bench.peers --prepare DIR``. The tables and all figures are written to bench/results.
"""

import argparse
import sys
from collections.abc import Callable, Iterator
from dataclasses import asdict, replace
from functools import partial
from itertools import product
from typing import Any

import numpy as np
from rich.console import Console

import tisfm
from bench.depth.methods import FlowThenDepth
from bench.depth.pairs import scene_pair
from bench.depth.scores import depth_of
from bench.objects.scores import Score, compare_objects, details, table
from bench.objects.statue import FOLDER, StatuePair, focals_of, interpret_pair, statue_pairs
from bench.objects.statue import table as statue_table
from bench.shared.command import (
    SMOKE_SIZE,
    choose,
    command_text,
    options_parser,
    output_name,
    running_peers,
)
from bench.shared.contest import MethodFailure, measure_time
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
from tisfm.metrics import depth_errors
from tisfm.rigid import pose_matrix
from tisfm.scenes import SyntheticPair, three_blocks, two_blocks
from tisfm.settings import Preset, Settings

# Options that appear in the results.
RECORDED_OPTIONS = ("preset", "threads", "pairs", "only", "smoke", "data", "peer-python")
SIZE = (240, 320)  # px, height and width of rendered scenes
SEEDS: dict[str, tuple[Callable[..., SyntheticPair], range]] = {
    "two blocks": (two_blocks, range(6)),
    "three blocks": (three_blocks, range(10)),
}
FLOWS = ("OpenCV DeepFlow", "OpenCV DIS medium")
NOTES = (
    "IoU: intersection over union of an object and the label that it overlaps most. Complete: "
    "scenes with as many labels as objects.",
    "abs-rel of objects: mean of |ΔZ|/Z after scaling every object by its own median, over pixels "
    "that are visible in both frames and, for tisfm, have the label of the object; depth beyond 10 "
    "medians or behind the camera is set to 10 medians. One scale: the same over the whole image, "
    "scaled by one median, where depth is positive; tisfm leaves the relative scales of objects "
    "open.",
    "Direction: angle between the translations, 180° if opposite; two stages have one translation "
    "for all objects.",
    "Two stages: essential matrix (USAC, MAGSAC) and triangulation after the flow named, with the "
    "threshold of `bench.depth` that gives the lowest abs-rel of objects.",
    "Seconds: median over the scenes, one call each after a warm-up.",
)
STATUE_NOTE = (
    "Number of pairs, three frames apart, in which most of the upper body of the man, and of the "
    "cyclist, has a label that differs from the background's and from the other person's. The "
    "focal length is unknown: 384 px is the guess for this size of image, 600 px the value of the "
    "paper; `tisfm.reconstruct` estimates the third one from all frames."
)


def scenes(options: argparse.Namespace) -> Iterator[tuple[str, str, SyntheticPair]]:
    """Render the scenes that the options name: group, name and pair."""
    size = SMOKE_SIZE if options.smoke else SIZE
    scene_list = [
        (group, f"{group} {seed}", make, seed)
        for group, (make, seeds) in SEEDS.items()
        for seed in seeds[: 1 if options.smoke else None]
    ]
    for group, name, make, seed in choose(
        scene_list, options.pairs, kind="pair", name=lambda s: s[1]
    ):
        yield group, name, make(*size, seed=seed)


def interpret_and_score(preset: Preset, group: str, name: str, pair: SyntheticPair) -> list[Score]:
    """Interpret a scene, and compare labels, depth and motions with the truth."""
    settings = Settings.preset(preset, motion="objects")
    result, seconds = measure_time(
        tisfm.interpret, pair.frame0, pair.frame1, camera=pair.camera, settings=settings
    )
    assert result.motions is not None  # this motion model has them
    motions = np.stack([pose_matrix(motion) for motion in result.motions])
    score = Score(
        method=f"tisfm {preset}, objects",
        group=group,
        pair=name,
        seconds=seconds,
        objects=compare_objects(pair, result.depth, motions, result.labels),
        labels=len(motions),
    )
    return [score]


def stage_scores(method: FlowThenDepth, group: str, name: str, pair: SyntheticPair) -> list[Score]:
    """Return the scores of the two stages after a flow, one for each threshold."""
    scores = []
    for estimate in method.run(scene_pair(name, group, pair)):
        score = Score(
            method=estimate.method,
            group=group,
            pair=name,
            seconds=estimate.seconds,
            threshold=estimate.threshold,
            failure=estimate.failure,
        )
        if estimate.inverse_depth is not None and estimate.pose is not None:
            depth = depth_of(estimate.inverse_depth)
            score = replace(
                score,
                objects=compare_objects(pair, depth, estimate.pose[None], None),
                one_scale=depth_errors(depth, pair.depth).abs_rel,
            )
        scores.append(score)
    return scores


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Return conditions, scores, labels of the statue's pairs, and missing methods and data."""
    runtime.start(threads=options.threads)
    rendered = [] if options.statue else list(scenes(options))
    folder = None if options.smoke else data_folder(options.data)
    scores: list[Score] = []
    statue: list[StatuePair] = []
    with running_peers(options, FLOWS) as peers:
        missing = dict(peers.survey.missing)
        methods: dict[str, Callable[[str, str, SyntheticPair], list[Score]]] = {
            f"tisfm {preset}, objects": partial(interpret_and_score, preset)
            for preset in options.preset
        }
        for stages in map(FlowThenDepth, peers.methods):
            methods[stages.name] = partial(stage_scores, stages)
        names = choose(list(methods), options.only, kind="method", name=str)
        warm_up = two_blocks(*SMOKE_SIZE)
        with Console(stderr=True).status("") as progress:
            for method in names:
                progress.update(f"{method}: first calls")
                methods[method]("", "warm-up", warm_up)
            for group, name, pair in rendered:
                for method in names:
                    progress.update(f"{name}: {method}")
                    scores += methods[method](group, name, pair)
            if folder is None or not (folder / FOLDER).is_dir():
                missing["statue"] = (
                    "a smoke run has only small scenes"
                    if options.smoke
                    else "not in the folder of sequences"
                )
            else:
                focals = focals_of(folder)
                for first, frame0, frame1 in statue_pairs(folder):
                    for preset, (focal, origin) in product(options.preset, focals.items()):
                        progress.update(f"statue {first}, f = {focal:g} px: {preset}")
                        statue.append(interpret_pair(preset, first, frame0, frame1, focal, origin))
    height, width = SMOKE_SIZE if options.smoke else SIZE
    conditions = {
        "command": command_text("objects", options, [*RECORDED_OPTIONS, "statue"]),
        "scenes": f"{len(rendered)} of {height}×{width} px",
        "threads": options.threads,
        **machine(),
        "peers": peers.versions,
    }
    return {"conditions": conditions, "scores": scores, "statue": statue, "missing": missing}


def groups(scores: list[Any]) -> dict[str, list[Any]]:
    return {
        group: [score for score in scores if score.group == group]
        for group in dict.fromkeys(score.group for score in scores)
    }


def report(results: dict[str, Any]) -> str:
    blocks: list[str | Table] = []
    for group, scores in groups(results["scores"]).items():
        blocks += [f"## {group.capitalize()}", table(scores)]
    if results["statue"]:
        blocks += ["## Statue", STATUE_NOTE, statue_table(results["statue"])]
    blocks += ["## Every scene", details(results["scores"])]
    missing_notes = [f"missing: {name}: {reason}" for name, reason in results["missing"].items()]
    title = "# Moving objects, compared with two stages"
    return markdown_page(title, results["conditions"], [*NOTES, *missing_notes], *blocks)


def main(arguments: list[str] | None = None) -> int:
    """Return 0, or 2 if nothing could be run."""
    parser = options_parser("objects", __doc__, *RECORDED_OPTIONS, "output", preset=["balanced"])
    parser.add_argument("--statue", action="store_true", help="only the statue")
    options = parser.parse_args(arguments)
    try:
        results = measure(options)
    except (MethodFailure, OSError, ValueError) as error:
        print(f"bench.objects: {error}", file=sys.stderr)
        return 2
    record = results | {
        name: [asdict(score) for score in results[name]] for name in ("scores", "statue")
    }
    write_results(RESULTS / output_name(options, "objects"), report(results), record)
    console = wide_console()
    for group, scores in groups(results["scores"]).items():
        console.print(group, table(scores).rich())
    if results["statue"]:
        console.print("statue", statue_table(results["statue"]).rich())
    print_missing(console, results["missing"])
    return 0


if __name__ == "__main__":
    sys.exit(main())
