"""The parts of the demo: each interprets a scene, compares it with the truth, and draws it."""

import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tisfm import runtime
from tisfm.cli.demo_animation import ANIMATION, write_animation
from tisfm.cli.figures import write_paper_figures
from tisfm.errors import is_user_error
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
from tisfm.running.pair_writer import DEFAULT_OUTPUTS, PairWriter
from tisfm.running.pool import sendable_error
from tisfm.scenes import SyntheticPair, static_scene, two_blocks
from tisfm.settings import Settings

NAME = "demo"  # of the pairs of the demo
NO_VALUE = "–"
PAPER, BALANCED, BASELINE = "preset paper", "balanced (default)", "Horn–Schunck"
FIELD, CAMERA, OBJECTS = "field, at rest", "camera, at rest", "objects, moving"
PARTS = "objects", "blocks", "camera"  # the slowest part first
_WARM_UP_SIZE = 144, 96  # px: small, but it uses the same kernels as the whole frame
_CHECK_INTERVAL = 0.1  # s between two checks whether the command still runs

Rows = dict[str, tuple[str, ...]]


@dataclass(frozen=True, kw_only=True)
class Part:
    """A part of the demo, done by one process.

    Attributes
    ----------
    work : {"blocks", "camera", "objects"}
    output : Path
        Folder of the demo.
    height, width, seed, threads
        As for `tisfm.cli.demo.demo`.
    presence : Path
        A file that exists as long as the command runs.
    """

    work: str
    output: Path
    height: int
    width: int
    seed: int
    threads: int
    presence: Path

    @property
    def folder(self) -> Path:
        """The folder for the files of the pair."""
        return self.output if self.work == "blocks" else self.output / self.work


def run_part(part: Part) -> Rows | Exception:
    """Interpret a scene and write its files.

    Returns
    -------
    dict or Exception
        Rows of the tables by their names, or an error of the user's input.
    """
    try:
        runtime.start_worker(threads=part.threads)
        return {"blocks": _blocks, "camera": _camera, "objects": _objects}[part.work](part)
    except Exception as error:
        if is_user_error(error):
            return sendable_error(error)
        raise


def _blocks(part: Part) -> Rows:
    """Interpret moving blocks under ``motion="field"``, and by Horn and Schunck."""
    scene = two_blocks(part.height, part.width, seed=part.seed)
    paper, settings = Settings.preset("paper"), Settings()
    writer = _writer(part, scene, settings)
    horn_schunck(*_warm_up_crops(scene))
    results: dict[Settings, Interpretation] = {}
    rows: Rows = {}
    for label, pair_settings in ((PAPER, paper), (BALANCED, settings)):
        results[pair_settings], seconds = _interpret_timed(part, scene, pair_settings)
        depth = _mean_over_parts(scene, scene.labels, _relative_error(results[pair_settings]))
        cells = _flow_cells(results[pair_settings].flow, scene)
        rows[label] = (*cells, _format_cell(depth, 3), results[pair_settings].status, seconds)
    baseline, seconds = _measure_time(lambda: horn_schunck(scene.frame0, scene.frame1))
    rows[BASELINE] = (*_flow_cells(baseline, scene), NO_VALUE, NO_VALUE, seconds)
    _write(writer, scene, results[settings], baseline)
    write_paper_figures(
        part.folder,
        scene.frame0,
        scene.frame1,
        camera=scene.camera,
        known_depth={
            pair_settings: result.inverse_depth for pair_settings, result in results.items()
        },
    )
    return rows


def _camera(part: Part) -> Rows:
    """Interpret static blocks under ``motion="camera"`` and ``motion="field"``."""
    scene = static_scene("forward+rotation", part.height, part.width, seed=part.seed)
    settings = Settings(motion="camera")
    writer = _writer(part, scene, settings)
    result, seconds = _interpret_timed(part, scene, settings)
    _write(writer, scene, result)
    write_animation(part.output / ANIMATION, result)
    field, field_seconds = _interpret_timed(part, scene, Settings())
    return {
        FIELD: (*_model_cells(field, scene), field.status, field_seconds),
        CAMERA: (*_model_cells(result, scene), result.status, seconds),
    }


def _objects(part: Part) -> Rows:
    """Interpret moving blocks under ``motion="objects"``."""
    scene = two_blocks(part.height, part.width, seed=part.seed)
    settings = Settings(motion="objects")
    writer = _writer(part, scene, settings)
    result, seconds = _interpret_timed(part, scene, settings)
    _write(writer, scene, result)
    return {OBJECTS: (*_model_cells(result, scene), result.status, seconds)}


def _writer(part: Part, scene: SyntheticPair, settings: Settings) -> PairWriter:
    return PairWriter(
        part.folder, camera=scene.camera, settings=settings, outputs=(*DEFAULT_OUTPUTS, "flow")
    )


def _interpret_timed(
    part: Part, scene: SyntheticPair, settings: Settings
) -> tuple[Interpretation, str]:
    """Return an interpretation, and its time, s, without the compilation of kernels."""
    with _end_with_command(part.presence):
        interpret(*_warm_up_crops(scene), camera=scene.camera, settings=settings)
        return _measure_time(
            lambda: interpret(scene.frame0, scene.frame1, camera=scene.camera, settings=settings)
        )


@contextmanager
def _end_with_command(presence: Path) -> Iterator[None]:
    """Within the block, which writes nothing, end this process if the command ends."""
    is_over = threading.Event()

    def watch() -> None:
        while not is_over.wait(_CHECK_INTERVAL):
            if not presence.exists():
                os._exit(1)

    watcher = threading.Thread(target=watch, daemon=True)
    watcher.start()
    try:
        yield
    finally:
        is_over.set()
        watcher.join()


def _warm_up_crops(scene: SyntheticPair) -> tuple[np.ndarray, np.ndarray]:
    height, width = _WARM_UP_SIZE
    return scene.frame0[:height, :width], scene.frame1[:height, :width]


def _measure_time(work: Callable) -> tuple:
    """Return the result of a function, and its time, s, as text."""
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


def _flow_cells(flow: np.ndarray, scene: SyntheticPair) -> tuple[str, str]:
    return (
        f"{endpoint_error(flow, scene.flow, mask=scene.visible):.3f}",
        f"{angular_error(flow, scene.flow, mask=scene.visible):.2f}",
    )


def _model_cells(result: Interpretation, scene: SyntheticPair) -> tuple[str, ...]:
    """Return errors of depth, flow and motion; surfaces with one motion share a depth scale."""
    _, part = np.unique(scene.motions, axis=0, return_inverse=True)
    parts = part.reshape(-1)[scene.labels]
    coverage = None
    if result.inverse_depth_std is not None:
        coverage = _mean_over_parts(scene, parts, _coverage(result, result.inverse_depth_std))
    pose = _pose_errors(result, scene)
    return (
        _format_cell(_mean_over_parts(scene, parts, _relative_error(result)), 3),
        NO_VALUE if coverage is None else f"{100 * coverage:.0f} %",
        f"{endpoint_error(result.flow, scene.flow, mask=scene.visible):.3f}",
        _format_cell(None if pose is None else pose.direction, 3),
        _format_cell(None if pose is None else pose.rotation, 4),
    )


def _format_cell(value: float | None, digits: int) -> str:
    return NO_VALUE if value is None else f"{value:.{digits}f}"


Measure = Callable[[np.ndarray, np.ndarray], float]  # error from the true depth within a mask


def _relative_error(result: Interpretation) -> Measure:
    return lambda truth, mask: depth_errors(result.depth, truth, mask).abs_rel


def _coverage(result: Interpretation, deviation: np.ndarray) -> Measure:
    return lambda truth, mask: std_coverage(result.inverse_depth, deviation, truth, mask)


def _mean_over_parts(scene: SyntheticPair, parts: np.ndarray, measure: Measure) -> float | None:
    """Return the mean of a measure over the parts of a scene, weighted by their visible pixels.

    None if a part has no depth to measure.
    """
    total, pixels = 0.0, 0
    for part in np.unique(parts):
        mask = (parts == part) & scene.visible
        count = int(mask.sum())
        if count:
            try:
                total += measure(scene.depth, mask) * count
            except ValueError as error:
                if not is_user_error(error):
                    raise
                return None
            pixels += count
    return total / pixels if pixels else None


def _pose_errors(result: Interpretation, scene: SyntheticPair) -> PoseErrors | None:
    """Return the errors of the background's motion; None if a flow field does not determine it."""
    if result.motions is not None:
        pose = pose_matrix(result.motions[0])
    else:
        try:
            motion = camera_motion(result.flow, result.confidence, result.camera)
        except TooFewPixelsError:  # too few pixels with confidence
            return None
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = motion.rotation, motion.translation
    return pose_errors(pose, pose_matrix(scene.motions[0]))
