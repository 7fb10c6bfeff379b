"""``python -m bench.trust.against_pairs``: paths of real sequences without true poses.

Each path is compared with pairs of its frames, interpreted alone with the same camera: the rotation
of a path should be the product of the rotations of the pairs, and its depth should have the order
of a pair's depth. The tables are written to bench/results.
"""

import argparse
import sys
import warnings
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import spearmanr

import tisfm
from bench.shared.command import choose, command_text, options_parser, progress
from bench.shared.results import (
    RESULTS,
    Table,
    cell,
    machine,
    markdown_page,
    missing_sections,
    write_results,
)
from bench.shared.sequences import data_folder
from bench.trust.cases import Clip
from bench.trust.judge import is_green, rotation_angle
from bench.trust.worker import load_clip
from tisfm import runtime
from tisfm.rigid import pose_matrix
from tisfm.settings import Motion

# Statuses of pairs whose rotation is compared, and whose depth is.
WITH_ROTATION = ("converged", "uncertain", "little_parallax", "pure_rotation")
WITH_DEPTH = ("converged", "uncertain")
MIN_PIXELS = 1000  # fewest pixels for a rank correlation
NEAREST = 0.8  # share of the pixels whose depth is compared: the nearest, by the path
MIN_STEP = 1e-3  # of the median step: shorter ones have no direction
NOTES = (
    "Posed: frames with a pose. Pieces: those with positions.",
    "Focal: that of the frames as they were reconstructed, px; its deviation if it was found. Only "
    "the focal length is stated, the centre is that of the frame.",
    "Forward: median angle between the motion and the optical axis.",
    "Rotation: of the largest piece, from its first to its last frame. Difference: angle between "
    "it and the product of the rotations of the pairs. A pair without a usable rotation counts "
    "with the rotation of the path.",
    "Rank: rank correlation of the inverse depth of a keyframe with that of its pair, median over "
    "the ranked pairs; lower: lower quartile. The nearest 80 % of the pixels by the path count, "
    "without labelled and masked ones.",
    "Laser: the same with the inverse depth of a laser, at all of its points where the frame has "
    "depth; moving cars are points, too.",
    "Green: share of the frames with depth, which are keyframes, whose status is `converged` and "
    "whose grade is good or fair. Expected: median of their expected relative errors of depth.",
)


@dataclass(frozen=True, kw_only=True)
class Recording:
    """A real sequence, or a part of it."""

    name: str
    source: str  # in the folder of sequences
    focal: float | None = None  # px, stated; None if the program has to find it
    gap: int = 1  # posed frames from the first to the second frame of a pair
    options: dict[str, Any] = field(default_factory=dict)  # of `tisfm.reconstruct`
    motion: Motion = "camera"
    laser: Clip | None = None  # the frames with the depth of a laser


MOTORWAY = "clips/carnd_solidWhiteRight.mp4"
CARS_FOCAL = 721.5  # px
DAVIS = (
    "blackswan", "camel", "car-roundabout", "car-shadow", "libby", "motocross-jump",
)  # fmt: skip
RECORDINGS = (
    Recording(name="motorway, 0–80", source=MOTORWAY, gap=8, options={"stop": 81}),
    Recording(
        name="motorway, 120–160", source=MOTORWAY, gap=8, options={"start": 120, "stop": 161}
    ),
    Recording(name="motorway, whole", source=MOTORWAY, gap=8),
    *(
        Recording(
            name=f"kitti_cars, {size or 'full size'}, focal {'stated' if focal else 'unknown'}",
            source="kitti_cars/images",
            focal=focal,
            options={"size": size},
            laser=Clip(folder="kitti_cars", count=24),
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
class PairAgreement:
    """Differences between a path and pairs of its frames; None where no pair is usable."""

    rotation: float | None = None  # degrees, of the path, from its first to its last frame
    difference: float | None = None  # degrees, from the product of the rotations of the pairs
    usable_pairs: int = 0  # pairs whose rotation was taken
    pairs: int = 0
    rank: float | None = None  # of depth, median
    low_rank: float | None = None  # lower quartile
    ranked_pairs: int = 0


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """A result without true poses, beside pairs of its frames."""

    name: str
    frames: int
    posed: int
    pieces: int
    focal: float  # px, of the frames as they were reconstructed
    focal_deviation: float | None  # px; None if it was stated or guessed
    forward: float | None  # degrees: median angle between the motion and the optical axis
    agreement: PairAgreement
    laser_rank: float | None  # of depth, with that of a laser, median
    with_depth: int  # frames with depth: keyframes
    green: float  # share of these frames
    expected: float | None  # median of their expected relative errors of depth
    message: str  # the first of frames with depth that are not green, or of frames without depth


def compare(recording: Recording, data: Path) -> Comparison:
    """Reconstruct a recording, and compare its largest piece with its pairs."""
    camera = None if recording.focal is None else tisfm.Camera(focal=recording.focal)
    result = tisfm.reconstruct(
        data / recording.source,
        camera=camera,
        settings=tisfm.Settings.preset("fast", motion=recording.motion),
        depth_of="keyframes",
        **recording.options,
    )
    members = np.flatnonzero((result.piece == result.largest_piece) & result.has_position)
    with_depth = np.flatnonzero(np.isfinite(result.depth_error))
    are_green = [is_green(result, int(k)) for k in with_depth]
    expected = result.depth_error[with_depth]
    flagged = [int(k) for k, good in zip(with_depth, are_green, strict=True) if not good]
    messages = [result.status[k].message for k in (flagged if are_green else range(len(result)))]
    deviation = result.camera.focal * result.calibration.relative_focal_std
    return Comparison(
        name=recording.name,
        frames=len(result),
        posed=int((result.piece >= 0).sum()),
        pieces=len(set(result.piece[result.has_position])),
        focal=result.camera.focal,
        focal_deviation=float(deviation) if 0 < deviation < np.inf else None,
        forward=angle_to_axis(result.poses[members[:: recording.gap]]),
        agreement=compare_with_pairs(result, members, recording.gap),
        laser_rank=laser_rank(result, recording.laser, data),
        with_depth=len(with_depth),
        green=float(np.mean(are_green)) if are_green else 0.0,
        expected=float(np.median(expected)) if expected.size else None,
        message=next(filter(None, messages), ""),
    )


def angle_to_axis(poses: NDArray) -> float | None:
    """Return the median angle between the motion and the optical axis, degrees."""
    steps = np.einsum("nji,nj->ni", poses[:-1, :3, :3], np.diff(poses[:, :3, 3], axis=0))
    lengths = np.linalg.norm(steps, axis=1)
    if not lengths.any():
        return None
    steps = steps[lengths > MIN_STEP * np.median(lengths)]
    sideways = np.linalg.norm(steps[:, :2], axis=1)
    return float(np.degrees(np.median(np.arctan2(sideways, steps[:, 2]))))


def compare_with_pairs(
    result: tisfm.Reconstruction,
    members: NDArray,  # (N,): frames of a piece
    gap: int,  # members from the first to the second frame of a pair
) -> PairAgreement:
    """Compare the rotation of a piece and the depth of its keyframes with pairs of its frames."""
    ends = [int(k) for k in members[::gap]]
    if len(members) and ends[-1] != members[-1]:
        ends.append(int(members[-1]))
    if len(ends) < 2:
        return PairAgreement()
    product, usable = np.eye(3), 0
    for first, second in pairwise(ends):
        pair = interpret(result, first, second)
        motion = np.linalg.inv(result.poses[second]) @ result.poses[first]
        if pair.status in WITH_ROTATION and pair.motions is not None:
            motion = pose_matrix(pair.motions[0])
            usable += 1
        product = motion[:3, :3] @ product
    ranks = []
    for first, second in zip(members[:-gap], members[gap:], strict=True):
        if np.isfinite(result.depth_error[first]):
            pair = interpret(result, int(first), int(second))
            rank = rank_of_pair(result, int(first), pair)
            if rank is not None:
                ranks.append(rank)
    rotation = result.poses[ends[-1], :3, :3].T @ result.poses[ends[0], :3, :3]
    return PairAgreement(
        rotation=rotation_angle(rotation),
        difference=rotation_angle(rotation @ product.T) if usable else None,
        usable_pairs=usable,
        pairs=len(ends) - 1,
        rank=float(np.median(ranks)) if ranks else None,
        low_rank=float(np.percentile(ranks, 25)) if ranks else None,
        ranked_pairs=len(ranks),
    )


def interpret(result: tisfm.Reconstruction, first: int, second: int) -> tisfm.Interpretation:
    """Interpret two frames of a result alone, with its camera and without its fixed pixels."""
    frames = [np.asarray(result.picture(k)) for k in (first, second)]
    settings = tisfm.Settings.preset("fast", motion="camera")
    return tisfm.interpret(*frames, camera=result.camera, settings=settings, mask=result.mask)


def rank_of_pair(
    result: tisfm.Reconstruction, frame: int, pair: tisfm.Interpretation
) -> float | None:
    """Return the rank correlation of the inverse depth of a frame and of a pair, or None."""
    if pair.status not in WITH_DEPTH or pair.inverse_depth_std is None:
        return None
    known = np.isfinite(result.inverse_depth_std(frame)) & np.isfinite(pair.inverse_depth_std)
    known &= result.labels(frame) == 0
    if known.sum() < MIN_PIXELS:
        return None
    ours, other = result.inverse_depth(frame)[known], pair.inverse_depth[known]
    is_near = ours >= np.quantile(ours, 1 - NEAREST)
    return rank_correlation(ours[is_near], other[is_near])


def laser_rank(result: tisfm.Reconstruction, clip: Clip | None, data: Path) -> float | None:
    """Return the median rank correlation with the inverse depth of a laser.

    None without a laser, and where a lens or a zoom was removed: its points lie elsewhere then.
    """
    if clip is None or result.zoom is not None or result.calibration.radial:
        return None
    loaded, ranks = load_clip(clip, data), []
    for frame in map(int, np.flatnonzero(np.isfinite(result.depth_error))):
        laser = loaded.depth(frame)
        if laser is None:
            continue
        points = np.argwhere(np.isfinite(laser) & (laser > 0))
        rows, columns = ((points + 0.5) * np.divide(result.shape, laser.shape)).astype(int).T
        is_stated = np.isfinite(result.inverse_depth_std(frame)[rows, columns])
        ours = result.inverse_depth(frame)[rows, columns][is_stated]
        rank = rank_correlation(ours, 1 / laser[tuple(points.T)][is_stated])
        if rank is not None:
            ranks.append(rank)
    return float(np.median(ranks)) if ranks else None


def rank_correlation(ours: NDArray, other: NDArray) -> float | None:
    """Return Spearman's rank correlation; None for few or equal values."""
    if ours.size < MIN_PIXELS or not np.ptp(ours) or not np.ptp(other):
        return None
    return float(spearmanr(ours, other).statistic)


def table(comparisons: Sequence[Comparison]) -> Table:
    head = [
        "sequence", "frames", "posed", "pieces", "focal, px", "forward, °", "rotation, °",
        "difference, °", "usable pairs", "rank", "lower", "ranked pairs", "laser", "green, %",
        "expected",
    ]  # fmt: skip
    rows = []
    for found in comparisons:
        pairs, deviation = found.agreement, found.focal_deviation
        rows.append([
            found.name, str(found.frames), str(found.posed), str(found.pieces),
            f"{found.focal:.0f}" + (f" ± {deviation:.0f}" if deviation else ""),
            cell(found.forward, ".1f"), cell(pairs.rotation, ".2f"), cell(pairs.difference, ".2f"),
            f"{pairs.usable_pairs} of {pairs.pairs}", cell(pairs.rank, ".2f"),
            cell(pairs.low_rank, ".2f"), str(pairs.ranked_pairs), cell(found.laser_rank, ".2f"),
            f"{100 * found.green:.0f}", cell(found.expected, ".3f"),
        ])  # fmt: skip
    return Table(head, rows)


def page(
    conditions: dict[str, Any], comparisons: Sequence[Comparison], missing: dict[str, str]
) -> str:
    messages = [f"{found.name}: {found.message}" for found in comparisons if found.message]
    return markdown_page(
        "# Paths against pairs",
        conditions,
        table(comparisons),
        NOTES,
        "## Messages of frames that are not green",
        messages or "None.",
        *missing_sections(missing, {}),
    )


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = options_parser("trust.against_pairs", __doc__, "data", "threads", "output")
    parser.add_argument("--sequences", nargs="+", metavar="WORD", help="with a WORD in the name")
    return parser.parse_args(arguments)


def main(arguments: Sequence[str] | None = None) -> int:
    """Return 0, or 2 if nothing could be run."""
    options = parse(arguments)
    data = data_folder(options.data)
    if data is None:
        print("bench.trust.against_pairs: name a folder of sequences with --data", file=sys.stderr)
        return 2
    recordings = choose(RECORDINGS, options.sequences, kind="sequence", name=lambda r: r.name)
    present = [recording for recording in recordings if (data / recording.source).exists()]
    missing = {r.name: f"no {r.source} in the folder" for r in recordings if r not in present}
    if not present:
        print(f"bench.trust.against_pairs: {data} has none of these sequences", file=sys.stderr)
        return 2
    warnings.simplefilter("ignore")
    runtime.start(threads=options.threads)
    conditions = {
        "command": command_text("trust.against_pairs", options, ("threads", "sequences")),
        **machine(),
    }
    path = RESULTS / (options.output or "against_pairs")
    comparisons: list[Comparison] = []
    with progress(len(present)) as step:
        for recording in present:
            step(recording.name)
            comparisons.append(compare(recording, data))
            record = {**conditions, "found": [asdict(found) for found in comparisons]}
            write_results(path, page(conditions, comparisons, missing), record)
    return 0


if __name__ == "__main__":
    sys.exit(main())
