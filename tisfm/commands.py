"""What the commands do."""

import os
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.measure import Measurement
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Table

from tisfm import runtime
from tisfm.camera import Camera
from tisfm.datasets import LAYOUTS, Layout, LoadedPair, find_pairs
from tisfm.datasets.trajectories import motion_between, read_poses
from tisfm.evaluation import PairEvaluation
from tisfm.evaluation import evaluate as evaluate_pairs
from tisfm.evaluation_outputs import EVALUATION_RECORD, EvaluationWriter
from tisfm.evaluation_table import evaluation_tables
from tisfm.focal_guess import guess_focal
from tisfm.horn_schunck import horn_schunck
from tisfm.interpretation import Interpretation
from tisfm.lens import undistort
from tisfm.metrics import angular_error, depth_errors, endpoint_error
from tisfm.outputs import RECORD, PairWriter
from tisfm.pair import interpret
from tisfm.paper_figures import write_paper_figures
from tisfm.scenes import SyntheticPair, two_blocks
from tisfm.sequence import FramePair, FrameSource, Source, with_poses
from tisfm.settings import Settings

MOST_PIXELS = 10_000_000  # of the demo scene: its ray casting takes about 5 s a million


def run(
    source: Source,
    output: Path,
    *,
    camera: Camera,
    guess: bool = False,
    settings: Settings,
    step: int = 1,
    poses: Path | None = None,
    resume: bool = False,
    figures: bool = True,
    ply: bool = False,
    threads: int | None = None,
) -> int:
    """Interpret every pair of a source and write the results; return the exit code.

    With `guess` the first frame decides on the focal length, whatever that of the camera. `poses`
    is a file of a pose for every frame, those between the steps included.
    """
    _refuse_mixing(source, output)
    pairs = FrameSource(source, step=step)
    motions = None if poses is None else _motions(poses, pairs, settings)
    posed = with_poses(pairs, motions, title=f"the motions of {poses}")
    runtime.start(threads=threads)
    if guess:
        camera = _guessed(camera, pairs)
    writer = PairWriter(
        output, camera=camera, settings=settings, figures=figures, ply=ply, resume=resume
    )
    try:
        total: int | None = len(pairs)
    except TypeError:
        total = None
    seconds = []
    with _progress() as progress:
        task = progress.add_task("interpreting", total=total)
        for pair in posed:
            progress.update(task, description=pair.name0)
            digest = pair.digest
            if not writer.is_complete(pair.name0, digest):
                begin = time.perf_counter()
                result = pair.interpret(camera=camera, settings=settings)
                seconds.append(time.perf_counter() - begin)
                compared = figures and settings.motion == "field"
                writer.write(
                    pair.name0,
                    result,
                    digest=digest,
                    pose=None if pair.pose is None else np.asarray(pair.pose),
                    baseline_flow=_baseline(pair, camera, settings) if compared else None,
                )
            progress.advance(task)
    statuses = ", ".join(f"{count} {code}" for code, count in Counter(writer.statuses).items())
    typical = f", {sorted(seconds)[len(seconds) // 2]:.2f} s each (median)" if seconds else ""
    number = len(writer.statuses)
    _tell(
        f"{number} pair{'s' * (number != 1)}: {statuses}{typical}. Results in {output}, settings "
        f"and scales in {output / RECORD}."
    )
    for code, advice in writer.advice.items():
        _tell(f"{code}: {advice}")
    return 0


def evaluate(
    folders: Sequence[str],
    output: Path | None,
    *,
    layout: Layout | None = None,
    camera: Camera | None = None,
    settings: Settings,
    step: int | None = None,
    threads: int | None = None,
) -> int:
    """Interpret the pairs of datasets, print their errors, write all; return the exit code."""
    pairs = dict.fromkeys(
        pair for folder in folders for pair in find_pairs(folder, layout, step=step)
    )
    if step is not None and all(LAYOUTS[pair.layout].step is None for pair in pairs):
        raise ValueError(
            f"step is {step}, but there is no sequence with poses in {', '.join(folders)}: leave "
            "it out"
        )
    runtime.start(threads=threads)
    writer = None if output is None else EvaluationWriter(output, camera=camera, settings=settings)
    with _progress() as progress:
        task = progress.add_task("compiling", total=len(pairs))

        def finish_pair(
            evaluation: PairEvaluation, result: Interpretation | None, loaded: LoadedPair | None
        ) -> None:
            if writer is not None:
                writer.write(evaluation, result, loaded)
            progress.update(task, advance=1, description=evaluation.label)

        evaluation = evaluate_pairs(pairs, camera=camera, settings=settings, on_pair=finish_pair)
    if writer is not None:
        writer.finish(evaluation)
    for table in evaluation_tables(evaluation):
        _print_whole(table)
    good = [pair for pair in evaluation.pairs if pair.fault is None]
    if good:
        counts = Counter(pair.status for pair in good)
        number = len(good)
        statuses = ", ".join(f"{count} {code}" for code, count in counts.items())
        where = (
            ""
            if output is None
            else (f" Pictures and flow in {output}, every number in {output / EVALUATION_RECORD}.")
        )
        _tell(f"{number} pair{'s' * (number != 1)}: {statuses}.{where}")
    advice = {pair.status: pair.message for pair in reversed(good) if pair.status != "converged"}
    for code, message in advice.items():
        _tell(f"{code}: {message}")
    for pair in evaluation.faults:
        _tell(f"tisfm: {pair.label}: {pair.fault}")
    return 1 if evaluation.faults else 0


def demo(output: Path, *, height: int, width: int, seed: int, threads: int | None) -> int:
    """Render the demo scene, interpret it, print errors and write everything."""
    if height * width > MOST_PIXELS:
        raise ValueError(
            f"the demo scene would have {height} × {width} px: expected at most {MOST_PIXELS:,} px"
        )
    runtime.start(threads=threads)
    scene = two_blocks(height, width, seed=seed)
    settings = Settings()
    writer = PairWriter(output, camera=scene.camera, settings=settings)
    table = Table(
        title=f"Two blocks on a floor, {height} × {width} px, against the truth",
        caption="End-point and angular error of the flow where the point stays visible. Depth "
        "after scaling by the median, within each object, whose scale no method can know.",
    )
    table.add_column("")
    for heading in ("EPE, px", "angle, °", "|ΔZ|/Z"):
        table.add_column(heading, justify="right")
    table.add_column("status", no_wrap=True)
    table.add_column("s", justify="right", no_wrap=True)
    with _progress() as progress:
        task = progress.add_task("interpreting", total=4)
        paper = Settings.preset("paper")
        small0, small1 = scene.frame0[:32, :32], scene.frame1[:32, :32]
        for compiled in (paper, settings):  # beforehand, so that it is not timed
            interpret(small0, small1, settings=compiled)
        horn_schunck(small0, small1)
        for label, changed in (("preset paper", paper), ("balanced (default)", settings)):
            begin = time.perf_counter()
            result = interpret(scene.frame0, scene.frame1, camera=scene.camera, settings=changed)
            elapsed = time.perf_counter() - begin
            table.add_row(
                label,
                f"{endpoint_error(result.flow, scene.flow, mask=scene.visible):.3f}",
                f"{angular_error(result.flow, scene.flow, mask=scene.visible):.2f}",
                f"{_depth_error(result.depth, scene):.3f}",
                str(result.status),
                f"{elapsed:.2f}",
            )
            progress.advance(task)
        begin = time.perf_counter()
        baseline = horn_schunck(scene.frame0, scene.frame1)
        elapsed = time.perf_counter() - begin
        table.add_row(
            "Horn–Schunck",
            f"{endpoint_error(baseline, scene.flow, mask=scene.visible):.3f}",
            f"{angular_error(baseline, scene.flow, mask=scene.visible):.2f}",
            "–",
            "–",
            f"{elapsed:.2f}",
        )
        progress.advance(task)
        writer.write(
            "demo",
            result,
            baseline_flow=baseline,
            truth_flow=scene.flow,
            truth_inverse_depth=scene.inverse_depth,
        )
        write_paper_figures(output, scene.frame0, scene.frame1, camera=scene.camera)
        progress.advance(task)
    Console().print(table)
    _tell(f"Pictures and data in {output}: look at demo_figure.png first.")
    return 0


def figures(
    frames: Sequence[str],
    output: Path,
    *,
    camera: Camera,
    guess: bool = False,
    threads: int | None,
) -> int:
    """Draw the paper's comparisons of settings for two image files; `guess` as for `run`."""
    pairs = FrameSource(tuple(frames))
    runtime.start(threads=threads)
    if guess:
        camera = _guessed(camera, pairs)
    for pair in pairs:
        written = write_paper_figures(output, pair.frame0, pair.frame1, camera=camera)
        _tell("wrote " + ", ".join(map(str, written)))
    return 0


def _refuse_mixing(source: Source, output: Path) -> None:
    """Refuse to write among the frames, where results would count as frames the next time."""
    if isinstance(source, (str, os.PathLike)) and not os.path.isfile(source):
        folder = Path(source) if os.path.isdir(source) else Path(source).parent
        if folder.resolve() == output.resolve():
            raise ValueError(
                f"the results would lie among the frames in {output}, and count as frames the "
                "next time: give another folder with -o"
            )


def _motions(path: Path, pairs: FrameSource, settings: Settings) -> list[np.ndarray]:
    """Return the motion of every pair, of a file with the pose of every frame."""
    if settings.motion == "field":
        raise ValueError(
            f"the poses of {path} are given, but motion 'field' leaves the motion free: give "
            "--motion camera"
        )
    poses = read_poses(path)
    if pairs.count is not None and len(poses) != pairs.count:
        raise ValueError(
            f"{path} has {len(poses)} poses, but there are {pairs.count} frames: expected a line "
            "of twelve numbers for every frame"
        )
    return [motion_between(*ends) for ends in pairwise(poses[:: pairs.step])]


def _guessed(camera: Camera, pairs: FrameSource) -> Camera:
    """Return the camera with a focal length guessed by the first frame, and say so."""
    first = pairs.first_file
    guess = guess_focal(next(iter(pairs)).frame0.shape if first is None else first)
    _tell(f"focal length guessed: {guess.focal:.0f} px, {guess.reason}; give --focal if known")
    return replace(camera, focal=guess.focal)


def _baseline(pair: FramePair, camera: Camera, settings: Settings) -> np.ndarray:
    """Return Horn and Schunck's flow of the frames without distortion."""
    frames = (undistort(frame, camera) for frame in (pair.frame0, pair.frame1))
    return horn_schunck(*frames, settings=settings)


def _tell(line: str) -> None:
    """Print one line on standard error, as it is."""
    Console(stderr=True).print(line, highlight=False, markup=False, soft_wrap=True)


def _depth_error(depth: np.ndarray, scene: SyntheticPair) -> float:
    """Mean |ΔZ|/Z after median scaling within every object, over all visible pixels."""
    errors, pixels = 0.0, 0
    for label in range(int(scene.labels.max()) + 1):
        mask = (scene.labels == label) & scene.visible
        if mask.any():
            found = depth_errors(depth, scene.depth, mask)
            errors += found.abs_rel * int(mask.sum())
            pixels += int(mask.sum())
    return errors / pixels


def _print_whole(table: Table) -> None:
    """Print a table with all its columns, were it wider than the terminal."""
    console = Console()
    wanted = Measurement.get(console, console.options.update(max_width=1000), table).maximum
    Console(width=max(console.width, wanted)).print(table)


def _progress() -> Progress:
    console = Console(stderr=True)
    return Progress(
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=console,
        transient=True,
        disable=not console.is_terminal,  # it would leave blank lines in a log
    )
