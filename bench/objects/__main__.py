"""``python -m bench.objects``: labels, depth and motion of things that move on their own.

Rendered scenes of two and three blocks, beside two stages after a flow: there one essential matrix
has to do for all of the image. Its depth is compared over the whole image in one scale, and on
each true thing in a scale of its own. With a folder of real sequences, the statue too: whether
the man who walks and the cyclist have labels of their own. DeepFlow needs the environment of
``python -m bench.peers --prepare DIR``. The tables and all numbers are left in bench/results.
"""

import argparse
import contextlib
import json
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

import tisfm
from bench.depth.methods import FlowThenDepth
from bench.depth.pairs import rendered
from bench.depth.scores import depth_of
from bench.objects.scores import Score, compared, details, table
from bench.objects.statue import FOLDER, Seen, focals_of, seen, statue_pairs
from bench.objects.statue import table as statue_table
from bench.shared.contest import MethodFailure
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
from tisfm.metrics import depth_errors
from tisfm.rigid import pose_matrix
from tisfm.scenes import SyntheticPair, three_blocks, two_blocks
from tisfm.settings import Preset, Settings

SIZE = (240, 320)
SEEDS: dict[str, tuple[Callable[..., SyntheticPair], range]] = {
    "two blocks": (two_blocks, range(6)),
    "three blocks": (three_blocks, range(10)),
}
FLOWS = ("OpenCV DeepFlow", "OpenCV DIS medium")
NOTES = (
    "IoU: intersection over union of a thing and the label that it overlaps most. Found: scenes in "
    "which every thing has a label of its own and there is no other.",
    "abs-rel of things: mean of |ΔZ|/Z after scaling every thing by its own median, of what is "
    "visible in both frames and, of tisfm, labelled as that thing; what is beyond 10 medians or "
    "behind the camera was put there. One scale: the same over the whole image, scaled by one "
    "median, where depth is positive; tisfm does not say how the scales of things compare.",
    "Direction: angle between the translations, 180° if opposite; two stages have one for all.",
    "Two stages: essential matrix (USAC, MAGSAC) and triangulation after the flow named, with the "
    "threshold that is best for it in abs-rel of things, of those of `bench.depth`.",
    "Seconds: median over the scenes, one call each after a warm-up.",
)
STATUE_NOTE = (
    "Pairs of frames three apart in which most of the man's upper body, and of the cyclist's, has "
    "a label that is neither the background's nor the other's. The focal length is not known: "
    "384 px is what is guessed for this size of image, 600 px the paper's; found is what "
    "`tisfm.reconstruct` finds from all frames."
)


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(prog="python -m bench.objects", description=__doc__)
    add_options(parser)
    add_method_options(parser)
    parser.add_argument("--statue", action="store_true", help="the statue alone")
    parser.set_defaults(rounds=1)
    options = parser.parse_args(arguments)
    check_counts(parser, options)
    return options


def scenes(options: argparse.Namespace) -> Iterator[tuple[str, str, SyntheticPair]]:
    """Render the scenes that the options ask for: group, name and pair."""
    size = SMOKE_SIZE if options.smoke else SIZE
    named = [
        (group, f"{group} {seed}", make, seed)
        for group, (make, seeds) in SEEDS.items()
        for seed in seeds[: 1 if options.smoke else None]
    ]
    for group, name, make, seed in choose(named, options.pairs, what="pair", name=lambda s: s[1]):
        yield group, name, make(*size, seed=seed)


def own_score(preset: Preset, group: str, name: str, pair: SyntheticPair) -> list[Score]:
    """Interpret a scene, and compare labels, depth and motions with the truth."""
    settings = Settings.preset(preset, motion="objects")
    started = time.perf_counter()
    result = tisfm.interpret(pair.frame0, pair.frame1, camera=pair.camera, settings=settings)
    seconds = time.perf_counter() - started
    assert result.motions is not None  # this motion model has them
    motions = np.stack([pose_matrix(motion) for motion in result.motions])
    score = Score(
        method=f"tisfm {preset}, objects",
        group=group,
        pair=name,
        seconds=seconds,
        things=compared(pair, result.depth, motions, result.labels),
        labels=len(motions),
    )
    return [score]


def stage_scores(method: FlowThenDepth, group: str, name: str, pair: SyntheticPair) -> list[Score]:
    """Return the scores of the two stages after a flow, one for each threshold."""
    scores = []
    for found in method.run(rendered(name, group, pair)):
        score = Score(
            method=found.method,
            group=group,
            pair=name,
            seconds=found.seconds,
            threshold=found.threshold,
            failure=found.failure,
        )
        if found.inverse_depth is not None and found.pose is not None:
            depth = depth_of(found.inverse_depth)
            score = replace(
                score,
                things=compared(pair, depth, found.pose[None], None),
                one_scale=depth_errors(depth, pair.depth).abs_rel,
            )
        scores.append(score)
    return scores


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Return conditions, scores, what the statue shows, and what is missing."""
    runtime.start(threads=options.threads)
    chosen = [] if options.statue else list(scenes(options))
    folder = None if options.smoke else data_folder(options.data)
    python, peers = find_peers(options.peer_python)
    missing = {name: why for name, why in peers.missing.items() if name in (*FLOWS, "all peers")}
    scores: list[Score] = []
    statue: list[Seen] = []
    with contextlib.ExitStack() as stack:
        temporary = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="tisfm-objects-")))
        methods: dict[str, Callable[[str, str, SyntheticPair], list[Score]]] = {
            f"tisfm {preset}, objects": partial(own_score, preset) for preset in options.preset
        }
        for flow in FLOWS:
            if flow in peers.available:
                peer = Peer(flow, python=python, threads=options.threads, folder=temporary)
                stack.callback(peer.close)
                stages = FlowThenDepth(peer)
                methods[stages.name] = partial(stage_scores, stages)
        names = choose(list(methods), options.only, what="method", name=str)
        warm_up = two_blocks(*SMOKE_SIZE)
        progress = stack.enter_context(Console(stderr=True).status(""))
        for method in names:
            progress.update(f"{method}: first calls")
            methods[method]("", "warm-up", warm_up)
        for group, name, pair in chosen:
            for method in names:
                progress.update(f"{name}: {method}")
                scores += methods[method](group, name, pair)
        if folder is None or not (folder / FOLDER).is_dir():
            missing["statue"] = "small scenes alone" if options.smoke else "no folder that has it"
        else:
            focals = focals_of(folder)
            for first, frame0, frame1 in statue_pairs(folder):
                for preset, (focal, origin) in product(options.preset, focals.items()):
                    progress.update(f"statue {first}, f = {focal:g} px: {preset}")
                    statue.append(seen(preset, first, frame0, frame1, focal, origin))
    height, width = SMOKE_SIZE if options.smoke else SIZE
    conditions = {
        "command": command(options),
        "scenes": f"{len(chosen)} of {height}×{width} px",
        "threads": options.threads,
        **machine(),
        "peers": ", ".join(f"{name} {number}" for name, number in peers.versions.items()),
    }
    return {"conditions": conditions, "scores": scores, "statue": statue, "missing": missing}


def command(options: argparse.Namespace) -> str:
    """Return the command of this run; folders by what they are, not where."""
    words = ["python -m bench.objects", "--preset", *options.preset]
    words += ["--threads", str(options.threads)]
    for name, given in (("--pairs", options.pairs), ("--methods", options.only)):
        words += [name, *given] if given else []
    words += ["--smoke"] if options.smoke else []
    words += ["--statue"] if options.statue else []
    words += ["--data DIR"] if options.data else []
    words += ["--peer-python PATH"] if options.peer_python else []
    return f"`{' '.join(words)}`"


def groups(scores: list[Score]) -> dict[str, list[Score]]:
    """Return group → its scores."""
    return {
        group: [score for score in scores if score.group == group]
        for group in dict.fromkeys(score.group for score in scores)
    }


def write(measured: dict[str, Any], path: Path) -> None:
    """Write PATH.md and PATH.json."""
    lines = ["# Things that move on their own, beside two stages", ""]
    lines += [f"- {name}: {value}" for name, value in measured["conditions"].items()]
    lines += [""] + [f"- {note}" for note in NOTES]
    lines += [f"- missing: {name}: {why}" for name, why in measured["missing"].items()]
    for group, scores in groups(measured["scores"]).items():
        lines += ["", f"## {group.capitalize()}", "", *table(scores).markdown()]
    if measured["statue"]:
        lines += [
            "",
            "## Statue",
            "",
            STATUE_NOTE,
            "",
            *statue_table(measured["statue"]).markdown(),
        ]
    lines += ["", "## Every scene", "", *details(measured["scores"]).markdown()]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.with_suffix(".md").write_text("\n".join([*lines, ""]), encoding="utf-8")
    plain = measured | {
        name: [asdict(score) for score in measured[name]] for name in ("scores", "statue")
    }
    content = json.dumps(plain, indent=1, ensure_ascii=False)
    path.with_suffix(".json").write_text(content + "\n", encoding="utf-8")


def main(arguments: list[str] | None = None) -> int:
    """Return 0, or 2 where nothing could be run."""
    options = parse(arguments)
    try:
        measured = measure(options)
    except (MethodFailure, OSError, ValueError) as error:
        print(f"bench.objects: {error}", file=sys.stderr)
        return 2
    write(measured, RESULTS / (options.output or ("smoke-objects" if options.smoke else "objects")))
    console = wide_console()
    for group, scores in groups(measured["scores"]).items():
        console.print(group, table(scores).rich())
    if measured["statue"]:
        console.print("statue", statue_table(measured["statue"]).rich())
    for name, why in measured["missing"].items():
        console.print(f"missing: {name}: {why}", highlight=False, markup=False)
    return 0


if __name__ == "__main__":
    sys.exit(main())
