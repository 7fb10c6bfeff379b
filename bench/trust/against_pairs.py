"""``python -m bench.trust.against_pairs``: paths of real sequences without true poses.

Each path is compared with pairs of its frames, interpreted alone with the same camera. The turn of
a path should be the product of the turns of the pairs, and its depth should have the order that
the depth of a pair has. The tables are written to bench/results.
"""

import argparse
import sys
import time
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import spearmanr

import tisfm
from bench.shared.command import command_text, options_parser, progress
from bench.shared.results import RESULTS, Table, cell, machine, markdown_page, write_results
from bench.shared.sequences import data_folder
from bench.trust.cases import Clip
from bench.trust.judge import is_green, rotation_angle
from bench.trust.worker import load_clip
from tisfm import runtime
from tisfm.rigid import pose_matrix
from tisfm.settings import Motion

USABLE = ("converged", "uncertain")  # statuses of pairs with which a path is compared
MIN_PIXELS = 1000  # pixels whose depth is compared
NEAREST = 0.8  # share of the pixels whose depth is compared, the nearest; others are far
NOTES = (
    "Frames with a pose; pieces with positions; focal length that was found or stated, px. "
    "Forward: median angle between the motion and the optical axis. Turn: of the largest piece "
    "from its first to its last frame, and how far the product of the turns of its pairs is from "
    "it. Pairs with the status `converged` or `uncertain` are used; others turn as the path does. "
    "Rank: rank correlation of the inverse depth of a keyframe with that of its pair, median and "
    "lowest quarter over the used pairs; the nearest 80 % of the pixels, without labelled and "
    "masked ones. Rank, laser: with the inverse depth of a laser, all of its points.",
    "Green: share of the frames with depth, the keyframes, whose status is `converged` "
    "and whose grade is good or fair. Expected: median of the expected relative error of depth.",
)


@dataclass(frozen=True, kw_only=True)
class Recording:
    """A real sequence, or a part of it."""

    name: str
    source: str  # in the folder of sequences
    focal: float | None = None  # px, stated; None if the program has to find it
    gap: int = 1  # frames from the first to the second frame of a pair
    options: tuple[tuple[str, Any], ...] = ()  # of `tisfm.reconstruct`
    motion: Motion = "camera"


MOTORWAY = "clips/carnd_solidWhiteRight.mp4"
CARS, CARS_FOCAL = "kitti_cars/images", 721.5
DAVIS = (
    "blackswan", "camel", "car-roundabout", "car-shadow", "libby", "motocross-jump",
)  # fmt: skip
RECORDINGS = (
    Recording(name="motorway, 0–80", source=MOTORWAY, gap=8, options=(("stop", 81),)),
    Recording(
        name="motorway, 120–160", source=MOTORWAY, gap=8, options=(("start", 120), ("stop", 161))
    ),
    Recording(name="motorway, whole", source=MOTORWAY, gap=8),
    *(
        Recording(
            name=f"kitti_cars, {size or 'full size'}, focal {'stated' if focal else 'unknown'}",
            source=CARS,
            focal=focal,
            options=(("size", size),),
        )
        for size in (None, 800, 640)
        for focal in (CARS_FOCAL, None)
    ),
    *(
        Recording(name=f"parkour, {motion}", source="davis/parkour/images", gap=2, motion=motion)
        for motion in ("camera", "objects")
    ),
    *(Recording(name=name, source=f"davis/{name}/images", gap=2) for name in DAVIS),
    Recording(name="phone", source="phone/images", gap=2),
    Recording(name="drone", source="drone/images"),
)


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """A path, and how far it is from its pairs."""

    name: str
    frames: int
    posed: int
    pieces: int
    focal: float  # px, of the frames as they were reconstructed
    focal_deviation: float | None  # px; None if stated or unknown
    forward: float | None  # degrees: median angle between the motion and the optical axis
    turn: float | None  # degrees, from the first to the last frame of the largest piece
    turn_error: float | None  # degrees, from the product of the turns of the pairs
    pairs: float | None  # share of the pairs that are used
    rank: float | None  # of depth with pairs, median
    low_rank: float | None  # lower quartile
    laser_rank: float | None  # of depth with a laser's, median
    with_depth: int  # frames with depth: keyframes
    green: float  # share of these frames
    expected: float | None  # median expected relative error of depth
    seconds: float
    message: str  # of the first frame that is not green


def compare(recording: Recording, data: Path) -> Comparison:
    """Reconstruct a recording, and compare its largest piece with its pairs."""
    camera = None if recording.focal is None else tisfm.Camera(focal=recording.focal)
    settings = tisfm.Settings.preset("fast", motion=recording.motion)
    begin = time.perf_counter()
    result = tisfm.reconstruct(
        data / recording.source,
        camera=camera,
        settings=settings,
        depth_of="keyframes",
        **dict(recording.options),
    )
    seconds = time.perf_counter() - begin
    members = np.flatnonzero((result.piece == result.largest_piece) & result.has_position)
    turn = turn_error = pairs = None
    angles: list[float] = []
    ranks: list[float] = []
    if len(members) > recording.gap:
        members = members[:: recording.gap]
        turn, turn_error, pairs, ranks = compare_with_pairs(result, members)
        steps = np.diff(result.poses[members, :3, 3], axis=0)
        along = np.einsum("nji,nj->ni", result.poses[members[:-1], :3, :3], steps)
        angles = np.degrees(np.arctan2(np.linalg.norm(along[:, :2], axis=1), along[:, 2])).tolist()
    with_depth = np.flatnonzero(np.isfinite(result.depth_error))
    green = [is_green(result, int(k)) for k in with_depth]
    expected = result.depth_error[with_depth]
    deviation = result.calibration.focal_std
    flagged = [k for k, good in zip(with_depth, green, strict=True) if not good]
    messages = [result.status[k].message for k in (flagged if green else range(len(result)))]
    return Comparison(
        name=recording.name,
        frames=len(result),
        posed=int((result.piece >= 0).sum()),
        pieces=len(set(result.piece[result.has_position])),
        focal=result.camera.focal,
        focal_deviation=deviation if deviation and np.isfinite(deviation) else None,
        forward=float(np.median(angles)) if angles else None,
        turn=turn,
        turn_error=turn_error,
        pairs=pairs,
        rank=float(np.median(ranks)) if ranks else None,
        laser_rank=laser_rank(result, recording, data),
        low_rank=float(np.percentile(ranks, 25)) if ranks else None,
        with_depth=len(green),
        green=float(np.mean(green)) if green else 0.0,
        expected=float(np.median(expected)) if expected.size else None,
        seconds=seconds,
        message=next(filter(None, messages), ""),
    )


def compare_with_pairs(
    result: tisfm.Reconstruction, members: np.ndarray
) -> tuple[float, float, float, list[float]]:
    """Return the turn of a path, its distance from that of pairs, used pairs, and ranks of depth.

    Turns are in degrees; used pairs are a share. Other pairs turn as the path does.
    """
    settings = tisfm.Settings.preset("fast", motion="camera")
    chain = np.eye(3)  # from the axes of the first camera to those of the current one
    ranks, turned, first_depths = [], 0, set(np.flatnonzero(np.isfinite(result.depth_error)))
    for first, second in pairwise(members):
        frames = [np.asarray(result.picture(int(k))) for k in (first, second)]
        pair = tisfm.interpret(*frames, camera=result.camera, settings=settings)
        turn = np.linalg.inv(result.poses[second]) @ result.poses[first]
        is_usable = pair.status in USABLE
        if is_usable and pair.motions is not None:
            turn = pose_matrix(pair.motions[0])
        turned += is_usable
        chain = turn[:3, :3] @ chain
        if first in first_depths and is_usable:
            rank = rank_of(result, int(first), pair)
            ranks += [] if rank is None else [rank]
    start, end = (result.poses[k, :3, :3] for k in (members[0], members[-1]))
    path_turn = end.T @ start
    return (
        rotation_angle(path_turn),
        rotation_angle(path_turn @ chain.T),
        turned / (len(members) - 1),
        ranks,
    )


def rank_of(result: tisfm.Reconstruction, frame: int, pair: tisfm.Interpretation) -> float | None:
    """Return the rank correlation of the inverse depths of a frame; None for too few pixels."""
    ours, other = result.inverse_depth(frame), pair.inverse_depth
    if pair.inverse_depth_std is None:
        return None
    known = np.isfinite(result.inverse_depth_std(frame)) & np.isfinite(pair.inverse_depth_std)
    if result.objects:
        known &= result.labels(frame) == 0
    if known.sum() < MIN_PIXELS:
        return None
    ours, other = ours[known], other[known]
    near = ours >= np.quantile(ours, 1 - NEAREST)
    return float(spearmanr(ours[near], other[near]).statistic)


def laser_rank(result: tisfm.Reconstruction, recording: Recording, data: Path) -> float | None:
    """Return the median rank correlation with the depth of a laser; None without one."""
    if recording.source != CARS:
        return None
    loaded = load_clip(Clip(folder=str(Path(CARS).parent), count=len(result)), data)
    ranks = []
    for frame in np.flatnonzero(np.isfinite(result.depth_error)):
        laser = loaded.depth(int(frame))
        if laser is None:
            continue
        seen = np.argwhere(np.isfinite(laser) & (laser > 0))
        share = np.divide(result.shape, laser.shape)
        rows, columns = ((seen + 0.5) * share).astype(int).T
        inverse_depth = result.inverse_depth(int(frame))[rows, columns]
        is_stated = np.isfinite(result.inverse_depth_std(int(frame))[rows, columns])
        ranks.append(
            spearmanr(inverse_depth[is_stated], 1 / laser[tuple(seen.T)][is_stated]).statistic
        )
    return float(np.median(ranks)) if ranks else None


def table(comparisons: Sequence[Comparison]) -> Table:
    head = [
        "sequence", "frames", "posed", "pieces", "focal, px", "forward, °", "turn, °",
        "from pairs, °", "used pairs, %", "rank", "lowest quarter",
        "rank, laser", "green, %", "expected", "s",
    ]  # fmt: skip
    rows = [
        [
            c.name, str(c.frames), str(c.posed), str(c.pieces),
            f"{c.focal:.0f}" + (f" ± {c.focal_deviation:.0f}" if c.focal_deviation else ""),
            cell(c.forward, ".1f"), cell(c.turn, ".2f"), cell(c.turn_error, ".2f"),
            cell(None if c.pairs is None else 100 * c.pairs, ".0f"),
            cell(c.rank, ".2f"), cell(c.low_rank, ".2f"),
            cell(c.laser_rank, ".2f"), f"{100 * c.green:.0f}",
            cell(c.expected, ".3f"), f"{c.seconds:.0f}",
        ]
        for c in comparisons
    ]  # fmt: skip
    return Table(head, rows)


def page(conditions: dict[str, Any], comparisons: Sequence[Comparison]) -> str:
    messages = [f"{c.name}: {c.message}" for c in comparisons if c.message]
    return markdown_page(
        "# Paths against pairs",
        conditions,
        table(comparisons),
        NOTES,
        "## Messages of frames that are not green",
        messages or "None.",
    )


def choose(words: Sequence[str] | None) -> Iterator[Recording]:
    """Yield the sequences that have one of the words in the name; all without words."""
    for sequence in RECORDINGS:
        if not words or any(word in sequence.name for word in words):
            yield sequence


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = options_parser("trust.against_pairs", __doc__, "data", "threads", "output")
    parser.add_argument("--sequences", nargs="+", metavar="WORD", help="with a WORD in the name")
    return parser.parse_args(arguments)


def main(arguments: Sequence[str] | None = None) -> int:
    """Return 0, or 2 if nothing could be run."""
    options = parse(arguments)
    data = data_folder(options.data)
    chosen = [] if data is None else list(choose(options.sequences))
    chosen = [sequence for sequence in chosen if data and (data / sequence.source).exists()]
    if data is None or not chosen:
        print(
            "bench.trust.against_pairs: no such sequences; name a folder with --data",
            file=sys.stderr,
        )
        return 2
    warnings.simplefilter("ignore")
    runtime.start(threads=options.threads)
    conditions = {
        "command": command_text("trust.against_pairs", options, ("threads", "sequences")),
        **machine(),
    }
    comparisons: list[Comparison] = []
    with progress(len(chosen)) as step:
        for sequence in chosen:
            step(sequence.name)
            comparisons.append(compare(sequence, data))
            record = [vars(c) for c in comparisons]
            path = RESULTS / (options.output or "against_pairs")
            write_results(path, page(conditions, comparisons), record)
    return 0


if __name__ == "__main__":
    sys.exit(main())
