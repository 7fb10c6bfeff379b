"""The demonstration: rendered scenes whose truth is known, interpreted and compared with it."""

import time
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
from rich.table import Table

from tisfm import runtime
from tisfm.cli.console import print_whole, progress_bar, tell
from tisfm.cli.demo_animation import ANIMATION, write_animation
from tisfm.cli.outputs import USUAL, PairWriter
from tisfm.cli.paper_figures import PAPER_FIGURES, write_paper_figures
from tisfm.cli.run_record import ENDINGS, RECORD
from tisfm.formats.flo import require_writable_flow
from tisfm.horn_schunck import horn_schunck
from tisfm.interpretation import Interpretation
from tisfm.metrics import (
    PoseErrors,
    angular_error,
    depth_errors,
    endpoint_error,
    pose_errors,
    std_coverage,
)
from tisfm.motion.egomotion import TooFewPixelsError, camera_motion
from tisfm.pair import interpret
from tisfm.rigid import pose_matrix
from tisfm.scenes import SyntheticPair, static_scene, two_blocks
from tisfm.settings import Settings
from tisfm.stated import is_stated

MOST_PIXELS = 10_000_000  # of a scene: its ray casting takes about 5 s a million
NAME = "demo"  # of its pairs
_NONE = "–"


def demo(output: Path, *, height: int, width: int, seed: int, threads: int | None) -> int:
    """Render scenes, interpret them, print errors and write everything; return the exit code.

    Parameters
    ----------
    output : Path
        Receives every output for moving blocks under ``motion="field"``, the paper's comparisons
        and the animation, its folder ``camera`` those for a scene at rest under
        ``motion="camera"``, and ``objects`` those for the moving blocks under
        ``motion="objects"``.
    height, width : int
        Size of the frames, px.
    seed : int
        Of the textures.
    threads : int or None
        Most CPU threads.

    Raises
    ------
    OSError, ValueError
        If the folder cannot be written to or holds files of these names that no demo wrote, or if
        an option is impossible.
    """
    if height * width > MOST_PIXELS:
        raise ValueError(
            f"the demo scene would have {height} × {width} px: expected at most {MOST_PIXELS:,} px"
        )
    require_writable_flow("the demo scene", height, width)
    folders = output, output / "camera", output / "objects"
    _refuse_foreign(folders)
    runtime.start(threads=threads)
    moving = two_blocks(height, width, seed=seed)
    still = static_scene("forward+rotation", height, width, seed=seed)
    settings, camera_settings = Settings(), Settings(motion="camera")
    objects_settings = Settings(motion="objects")
    writer, camera_writer, objects_writer = (
        PairWriter(folder, camera=scene.camera, settings=changed, outputs=(*USUAL, "flow"))
        for folder, scene, changed in zip(
            folders,
            (moving, still, moving),
            (settings, camera_settings, objects_settings),
            strict=True,
        )
    )
    for started in (writer, camera_writer, objects_writer):
        started.write_record()
    with progress_bar() as progress:
        task = progress.add_task("interpreting", total=8)
        paper = Settings.preset("paper")
        _compile(still, paper, settings, camera_settings)
        blocks = _blocks_table(height, width)
        known = {}
        for label, changed in (("preset paper", paper), ("balanced (default)", settings)):
            result, seconds = _timed(_interpretation(moving, changed))
            known[changed] = result
            depth = _by_part(moving, moving.labels, _relative_error(result))
            blocks.add_row(
                label, *_flow_cells(result.flow, moving), _cell(depth, 3), result.status, seconds
            )
            progress.advance(task)
        baseline, seconds = _timed(lambda: horn_schunck(moving.frame0, moving.frame1))
        blocks.add_row("Horn–Schunck", *_flow_cells(baseline, moving), _NONE, _NONE, seconds)
        progress.advance(task)

        models = _models_table(height, width)
        shown = {}
        for label, scene, changed in (
            ("field, at rest", still, settings),
            ("camera, at rest", still, camera_settings),
            ("objects, moving", moving, objects_settings),
        ):
            result, seconds = _timed(_interpretation(scene, changed))
            shown[changed] = result
            models.add_row(label, *_model_cells(result, scene), result.status, seconds)
            progress.advance(task)
        _write(writer, moving, known[settings], baseline)
        _write(camera_writer, still, shown[camera_settings])
        _write(objects_writer, moving, shown[objects_settings])
        write_animation(output / ANIMATION, shown[camera_settings])
        progress.advance(task)
        write_paper_figures(
            output,
            moving.frame0,
            moving.frame1,
            camera=moving.camera,
            known={changed: result.inverse_depth for changed, result in known.items()},
        )
        progress.advance(task)
    print_whole(blocks)
    print_whole(models)
    first, *others = (folder / f"{NAME}{ENDINGS['figure']}" for folder in folders)
    tell(
        f"Pictures and data in {output}. Open {first} first, then {' and '.join(map(str, others))}."
    )
    tell(f"{output / ANIMATION} shows depth by a moving camera: open it in a browser.")
    tell("Your own frames: tisfm run VIDEO -o results --report, and open results/report.html.")
    return 0


def _refuse_foreign(folders: Iterable[Path]) -> None:
    """Refuse to replace files where no record says that a demo, or a run, wrote them."""
    for folder in folders:
        if (folder / RECORD).is_file():
            continue
        pairs = (f"{NAME}{ending}" for ending in ENDINGS.values())
        for name in (*pairs, *PAPER_FIGURES, ANIMATION):
            if (folder / name).exists():
                raise ValueError(
                    f"the demo would replace {folder / name}, which is not of a demo: give "
                    "another folder with -o"
                )


def _compile(scene: SyntheticPair, *settings: Settings) -> None:
    """Interpret a small part, so that the compilation of kernels is not timed."""
    small0, small1 = scene.frame0[:48, :48], scene.frame1[:48, :48]
    for changed in settings:
        interpret(small0, small1, camera=scene.camera, settings=changed)
    horn_schunck(small0, small1)


def _interpretation(scene: SyntheticPair, settings: Settings) -> Callable[[], Interpretation]:
    return lambda: interpret(scene.frame0, scene.frame1, camera=scene.camera, settings=settings)


def _timed(work: Callable) -> tuple:
    """Return what a function returns, and the seconds it took, as text."""
    begin = time.perf_counter()
    result = work()
    return result, f"{time.perf_counter() - begin:.2f}"


def _write(
    writer: PairWriter,
    scene: SyntheticPair,
    result: Interpretation,
    baseline: np.ndarray | None = None,
) -> None:
    with writer:
        writer.write(
            NAME,
            result,
            baseline_flow=baseline,
            truth_flow=scene.flow,
            truth_inverse_depth=scene.inverse_depth,
        )


def _blocks_table(height: int, width: int) -> Table:
    table = Table(
        title=f"Two blocks on a floor, {height} × {width} px, against the truth",
        caption="End-point and angular error of the flow where the point stays visible. Depth "
        "after scaling by the median, within each object, whose scale no method can know.",
    )
    return _with_columns(table, "EPE, px", "angle, °", "|ΔZ|/Z")


def _models_table(height: int, width: int) -> Table:
    table = Table(
        title=f"Motion as a field, of the camera and of objects, {height} × {width} px",
        caption="Depth after scaling by the median, and the share of its errors that are below "
        "its standard deviation. Direction of translation and rotation of the background; those "
        "of a field by tisfm.egomotion. At rest: three blocks, the camera goes forward and turns. "
        "Moving: the two blocks above, depth within each.",
    )
    return _with_columns(table, "|ΔZ|/Z", "within std", "EPE, px", "direction, °", "rotation, °")


def _with_columns(table: Table, *headings: str) -> Table:
    table.add_column("", no_wrap=True)
    for heading in headings:
        table.add_column(heading, justify="right")
    table.add_column("status", no_wrap=True)
    table.add_column("s", justify="right", no_wrap=True)
    return table


def _flow_cells(flow: np.ndarray, scene: SyntheticPair) -> tuple[str, str]:
    return (
        f"{endpoint_error(flow, scene.flow, mask=scene.visible):.3f}",
        f"{angular_error(flow, scene.flow, mask=scene.visible):.2f}",
    )


def _model_cells(result: Interpretation, scene: SyntheticPair) -> tuple[str, ...]:
    """Return errors of depth, flow and motion; what moves alike shares one scale of depth."""
    _, part = np.unique(scene.motions, axis=0, return_inverse=True)
    parts = part.reshape(-1)[scene.labels]
    covered = None
    if result.inverse_depth_std is not None:
        covered = _by_part(scene, parts, _coverage(result, result.inverse_depth_std))
    pose = _pose_errors(result, scene)
    return (
        _cell(_by_part(scene, parts, _relative_error(result)), 3),
        _NONE if covered is None else f"{100 * covered:.0f} %",
        f"{endpoint_error(result.flow, scene.flow, mask=scene.visible):.3f}",
        _cell(None if pose is None else pose.direction, 3),
        _cell(None if pose is None else pose.rotation, 4),
    )


def _cell(value: float | None, digits: int) -> str:
    return _NONE if value is None else f"{value:.{digits}f}"


Measure = Callable[[np.ndarray, np.ndarray], float]  # of the true depth, where a mask is set


def _relative_error(result: Interpretation) -> Measure:
    return lambda truth, mask: depth_errors(result.depth, truth, mask).abs_rel


def _coverage(result: Interpretation, deviation: np.ndarray) -> Measure:
    return lambda truth, mask: std_coverage(result.inverse_depth, deviation, truth, mask)


def _by_part(scene: SyntheticPair, parts: np.ndarray, measure: Measure) -> float | None:
    """Return the mean over all visible pixels of what is measured in each part of the scene.

    None if there is no depth to be measured in one of them.
    """
    total, pixels = 0.0, 0
    for part in np.unique(parts):
        mask = (parts == part) & scene.visible
        count = int(mask.sum())
        if count:
            try:
                total += measure(scene.depth, mask) * count
            except ValueError as error:
                if not is_stated(error):
                    raise
                return None
            pixels += count
    return total / pixels if pixels else None


def _pose_errors(result: Interpretation, scene: SyntheticPair) -> PoseErrors | None:
    """Compare the motion of the background; None if a flow field does not tell it."""
    if result.motions is not None:
        pose = pose_matrix(result.motions[0])
    else:
        try:
            motion = camera_motion(result.flow, result.confidence, result.camera)
        except TooFewPixelsError:  # too little of it is trusted
            return None
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = motion.rotation, motion.translation
    return pose_errors(pose, pose_matrix(scene.motions[0]))
