"""What the commands do."""

import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
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
from tisfm.horn_schunck import horn_schunck
from tisfm.metrics import angular_error, depth_errors, endpoint_error
from tisfm.outputs import RECORD, PairWriter
from tisfm.pair import interpret
from tisfm.paper_figures import write_paper_figures
from tisfm.scenes import SyntheticPair, two_blocks
from tisfm.sequence import FrameSource, Source
from tisfm.settings import Settings


def run(
    source: Source,
    output: Path,
    *,
    camera: Camera,
    settings: Settings,
    step: int = 1,
    resume: bool = False,
    figures: bool = True,
    threads: int | None = None,
) -> int:
    """Interpret every pair of a source and write the results; return the exit code."""
    pairs = FrameSource(source, step=step)
    runtime.start(threads=threads)
    writer = PairWriter(
        output, camera=camera, settings=settings, figures=figures, resume=resume
    )
    try:
        total: int | None = len(pairs)
    except TypeError:
        total = None
    seconds = []
    with _progress() as progress:
        task = progress.add_task("interpreting", total=total)
        for pair in pairs:
            progress.update(task, description=pair.name0)
            if not (resume and writer.is_complete(pair.name0)):
                begin = time.perf_counter()
                result = pair.interpret(camera=camera, settings=settings)
                seconds.append(time.perf_counter() - begin)
                baseline = (
                    horn_schunck(pair.frame0, pair.frame1, settings=settings) if figures else None
                )
                writer.write(pair.name0, result, baseline_flow=baseline)
            progress.advance(task)
    statuses = ", ".join(f"{count} {code}" for code, count in Counter(writer.statuses).items())
    typical = f", {sorted(seconds)[len(seconds) // 2]:.2f} s each (median)" if seconds else ""
    Console(stderr=True).print(
        f"{len(writer.statuses)} pairs: {statuses}{typical}. Results in {output}, "
        f"settings and scales in {output / RECORD}.",
        highlight=False,
        soft_wrap=True,
    )
    return 0


def demo(output: Path, *, height: int, width: int, seed: int, threads: int | None) -> int:
    """Render the demo scene, interpret it, print errors and write everything."""
    runtime.start(threads=threads)
    console = Console()
    scene = two_blocks(height, width, seed=seed)
    settings = Settings()
    writer = PairWriter(output, camera=scene.camera, settings=settings)
    table = Table(
        title=f"Two blocks on a floor, {height} × {width} px, against the truth",
        caption="Flow where the point stays visible. Depth after scaling by the median, within "
        "each object, whose scale no method can know.",
    )
    for heading in ("", "EPE, px", "angular error, °", "|ΔZ|/Z", "status", "seconds"):
        table.add_column(heading, justify="left" if heading in ("", "status") else "right")
    with _progress() as progress:
        task = progress.add_task("interpreting", total=4)
        interpret(scene.frame0, scene.frame1, camera=scene.camera, settings=settings)  # compiles
        for label, changed in (
            ("preset paper", Settings.preset("paper")),
            ("preset balanced (default)", settings),
        ):
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
        horn_schunck(scene.frame0, scene.frame1)  # compiles
        begin = time.perf_counter()
        baseline = horn_schunck(scene.frame0, scene.frame1)
        elapsed = time.perf_counter() - begin
        table.add_row(
            "Horn–Schunck, same pyramid",
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
    console.print(table)
    console.print(f"Pictures and data in {output}: look at demo_figure.png first.", soft_wrap=True)
    return 0


def figures(
    frames: Sequence[str], output: Path, *, camera: Camera, threads: int | None
) -> int:
    """Draw the paper's comparisons of settings for two image files."""
    runtime.start(threads=threads)
    for pair in FrameSource(tuple(frames)):
        written = write_paper_figures(output, pair.frame0, pair.frame1, camera=camera)
        Console(stderr=True).print(
            "wrote " + ", ".join(map(str, written)), highlight=False, soft_wrap=True
        )
    return 0


def _depth_error(depth, scene: SyntheticPair) -> float:  # type: ignore[no-untyped-def]
    """Mean |ΔZ|/Z after median scaling within every object, over all visible pixels."""
    errors, pixels = 0.0, 0
    for label in range(int(scene.labels.max()) + 1):
        mask = (scene.labels == label) & scene.visible
        if mask.any():
            found = depth_errors(depth, scene.depth, mask)
            errors += found.abs_rel * int(mask.sum())
            pixels += int(mask.sum())
    return errors / pixels


def _progress() -> Progress:
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=Console(stderr=True),
        transient=True,
    )
