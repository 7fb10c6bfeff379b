"""What `tisfm eval` does with pairs, and `tisfm figures`."""

from collections import Counter
from collections.abc import Sequence
from itertools import count
from pathlib import Path

from tisfm.camera import Camera
from tisfm.cli.console import print_whole, progress_bar, tell
from tisfm.cli.foretelling import Foretelling
from tisfm.cli.kernels_start import start_kernels
from tisfm.cli.paper_figures import write_paper_figures
from tisfm.cli.stated_camera import guessed_camera, stated_camera
from tisfm.datasets import LAYOUTS, Layout, LoadedPair, find_pairs
from tisfm.errors import InputError
from tisfm.evaluation.files import EVALUATION_RECORD, EvaluationWriter
from tisfm.evaluation.pair_tables import evaluation_tables
from tisfm.evaluation.pairs import PairEvaluation
from tisfm.evaluation.pairs import evaluate as evaluate_pairs
from tisfm.formats.float_maps import require_writable_flow
from tisfm.formats.result_folder import InputFiles
from tisfm.interpretation import Interpretation
from tisfm.runtime import Arch
from tisfm.settings import Settings
from tisfm.sources import FrameSource


def evaluate(
    folders: Sequence[str],
    output: Path | None,
    *,
    layout: Layout | None = None,
    camera: Camera | None = None,
    settings: Settings,
    step: int | None = None,
    give_poses: bool = False,
    max_depth: float | None = None,
    arch: Arch | None = None,
    threads: int | None = None,
) -> int:
    """Interpret the pairs of datasets, print their errors, write all; return the exit code."""
    pairs = dict.fromkeys(
        pair for folder in folders for pair in find_pairs(folder, layout, step=step)
    )
    if step is not None and all(LAYOUTS[pair.layout].step is None for pair in pairs):
        raise InputError(
            f"step is {step}, but there is no sequence with poses in {', '.join(folders)}: leave "
            "it out"
        )
    start_kernels(arch, threads=threads)
    writer = (
        None
        if output is None
        else EvaluationWriter(output, camera=camera, settings=settings, pairs=pairs)
    )
    foretelling, done = Foretelling("pairs"), count(1)
    with progress_bar() as progress:
        task = progress.add_task("compiling", total=len(pairs))

        def finish_pair(
            evaluation: PairEvaluation, result: Interpretation | None, loaded: LoadedPair | None
        ) -> None:
            if writer is not None:
                writer.write(evaluation, result, loaded)
            progress.update(task, advance=1, description=evaluation.label)
            foretelling.done(next(done), len(pairs))

        evaluation = evaluate_pairs(
            pairs,
            camera=camera,
            settings=settings,
            give_poses=give_poses,
            max_depth=max_depth,
            on_load=None if writer is None else _require_writable,
            on_pair=finish_pair,
        )
    if writer is not None:
        writer.finish(evaluation)
    for table in evaluation_tables(evaluation):
        print_whole(table)
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
        tell(f"{number} pair{'s' * (number != 1)}: {statuses}.{where}")
    advice = {pair.status: pair.message for pair in reversed(good) if pair.status != "converged"}
    for code, message in advice.items():
        tell(f"{code}: {message}")
    for pair in evaluation.faults:
        tell(f"tisfm: {pair.label}: {pair.fault}")
    return 1 if evaluation.faults else 0


def figures(
    frames: Sequence[str],
    output: Path,
    *,
    camera: Camera | Path,
    guess: bool = False,
    threads: int | None,
) -> int:
    """Draw the paper's comparisons of settings for two image files; `guess` as for `run`."""
    pairs = FrameSource(tuple(frames))
    inputs = InputFiles(pairs.files)
    start_kernels(None, threads=threads)
    for pair in pairs:
        if isinstance(camera, Path):
            camera = stated_camera(camera, pair.frame0.shape[:2])
        elif guess:
            camera = guessed_camera(camera, pairs.files[0])
        written = write_paper_figures(
            output, pair.frame0, pair.frame1, camera=camera, inputs=inputs
        )
        tell("wrote " + ", ".join(map(str, written)))
    return 0


def _require_writable(loaded: LoadedPair) -> None:
    """Refuse frames that are too large for the files of `tisfm eval`."""
    require_writable_flow("frame0", *loaded.frame0.shape[:2])
