"""``python -m bench.sequences.clouds``: fused points and meshes of TartanAir against its surface.

The keyframes of the largest piece are fused, with each coverage. Accuracy is the share of the
points up to 40 m that lie within 2 or 5 % of their depth from the true surface, as the frame sees
it that fits best; of larger clouds, about 100,000 points are measured. Completeness is the share of
the true points up to 40 m, of every eighth pixel of every eighth row of all frames, with a fused
point within 2 or 5 % of their depth. A mesh counts by its vertices and the centres of its faces.
"Depth of keyframes" has a point for every fourth pixel of every fourth row of the keyframes,
however uncertain. A reconstruction whose poses are found is aligned by its depth
(`bench.sequences.cloud_errors.align_surfaces`). CPU time is that of fusion, after a first run that
compiles its kernels.
"""

import sys
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import asdict
from functools import partial
from typing import Any

import numpy as np
from rich.console import Console

import tisfm
from bench.sequences.cloud_errors import (
    TOLERANCES,
    CloudErrors,
    TrueFrame,
    align_surfaces,
    cloud_errors,
)
from bench.sequences.entries import MAX_DEPTH, parse_one
from bench.shared.command import options_parser
from bench.shared.results import RESULTS, Table, cell, machine, markdown_page, write_results
from tisfm import runtime
from tisfm.datasets import LoadedSequence
from tisfm.fusion.agreement import COVERAGES
from tisfm.lens import undistort_depth
from tisfm.metrics import Similarity
from tisfm.settings import Preset

SEQUENCE = "tartanair"
RUNS: tuple[tuple[Preset, bool], ...] = (
    ("balanced", True),
    ("fast", False),
)  # preset, whether poses are given
KEYFRAME_STEP = 4  # px between the points of "depth of keyframes"

Row = dict[str, Any]


def true_frames(loaded: LoadedSequence) -> dict[int, TrueFrame]:
    """Return the frames with a true pose and true depth, by their numbers."""
    camera, frames = loaded.camera, {}
    if camera is None:
        raise ValueError("the sequence has no camera")
    for index in np.flatnonzero(loaded.posed).tolist():
        depth = loaded.depth(index)
        if depth is not None:
            frames[index] = TrueFrame(
                depth=undistort_depth(depth, camera),
                pose=loaded.poses[index],
                camera=camera.pinhole(),
            )
    return frames


def measure(
    result: tisfm.Reconstruction, truth: dict[int, TrueFrame], poses_given: bool
) -> Iterator[tuple[str, CloudErrors, float | None]]:
    """Yield the name of each cloud, its errors, and the CPU time of its fusion, s."""
    alignment = None if poses_given else _align(result, truth)

    def errors(points: np.ndarray) -> CloudErrors:
        aligned = points if alignment is None else alignment.apply(points)
        return cloud_errors(aligned, list(truth.values()), MAX_DEPTH)

    yield "depth of keyframes", errors(_keyframe_points(result)), None
    for coverage in COVERAGES:
        cloud, seconds = _timed(partial(result.points, coverage=coverage))
        yield f"points, {coverage}", errors(cloud.positions), seconds
    for coverage in COVERAGES:
        mesh, seconds = _timed(partial(result.mesh, coverage=coverage))
        centres = mesh.vertices[mesh.faces].mean(axis=1)
        yield f"mesh, {coverage}", errors(np.concatenate([mesh.vertices, centres])), seconds


def _align(result: tisfm.Reconstruction, truth: dict[int, TrueFrame]) -> Similarity:
    frames = [frame for frame in truth if result.piece[frame] == result.largest_piece]
    depths = [result.depth(frame) for frame in frames]
    return align_surfaces(depths, result.poses[frames], [truth[frame] for frame in frames])


def _keyframe_points(result: tisfm.Reconstruction) -> np.ndarray:
    points = []
    for key in result.keyframes:
        if result.piece[key] == result.largest_piece:
            depth = result.depth(key)
            frame = TrueFrame(depth=depth, pose=result.poses[key], camera=result.camera)
            points.append(frame.surface(depth, KEYFRAME_STEP)[0])
    return np.concatenate(points)


def _timed(fuse: Callable[[], Any]) -> tuple[Any, float]:
    begin = time.process_time()
    fused = fuse()
    return fused, time.process_time() - begin


def report(conditions: dict[str, Any], rows: list[Row]) -> str:
    """Return the page with the table of all clouds."""
    shares = [f"{100 * tolerance:g} %" for tolerance in TOLERANCES]
    head = ["preset, poses", "cloud", *(f"accuracy, {share}" for share in shares)]
    head += [*(f"completeness, {share}" for share in shares), "points", "CPU, s"]
    cells = [
        [
            row["run"],
            row["cloud"],
            *(f"{value:.1f}" for value in (*row["accuracy"], *row["completeness"])),
            str(row["points"]),
            cell(row["seconds"], ".1f"),
        ]
        for row in rows
    ]
    table = Table(head, cells, text_columns=2)
    note = " ".join((__doc__ or "").split("\n\n", 1)[1].split())
    return markdown_page("# Fused points and meshes", conditions, note, table)


def main(arguments: list[str] | None = None) -> int:
    """Reconstruct the sequence with each preset, and write the table."""
    parser = options_parser("sequences.clouds", __doc__, "data", "threads", "output")
    parser.set_defaults(output="clouds")
    options, loaded = parse_one(parser, arguments, SEQUENCE)
    runtime.start(threads=options.threads)
    truth, console, rows = true_frames(loaded), Console(), list[Row]()
    for preset, poses_given in RUNS:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            result = tisfm.reconstruct(
                loaded.frames,
                camera=loaded.camera,
                settings=tisfm.Settings.preset(preset, motion="camera"),
                poses=loaded.poses if poses_given else None,
            )
        if not rows:  # compiles kernels
            result.points()
            result.mesh()
            result.mesh(coverage="complete")
        run = f"{preset}, {'given' if poses_given else 'found'}"
        for name, found, seconds in measure(result, truth, poses_given):
            rows.append({"run": run, "cloud": name, **asdict(found), "seconds": seconds})
            console.print(rows[-1])
    conditions = {
        "command": "python -m bench.sequences.clouds",
        "sequence": f"{SEQUENCE}, {len(loaded.frames)} frames",
        "threads": options.threads,
        **machine(),
    }
    text = report(conditions, rows)
    write_results(RESULTS / options.output, text, {"conditions": conditions, "rows": rows})
    return 0


if __name__ == "__main__":
    sys.exit(main())
