"""``tisfm eval --sequence`` and ``tisfm eval --objects``."""

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import tisfm
from tisfm.camera import Camera
from tisfm.cli.console import print_full_width, print_source_notes, start_kernels, tell
from tisfm.cli.progress import STAGES, TimeEstimate, progress_bar
from tisfm.datasets import SEQUENCE_LAYOUTS, DatasetSequence, LoadedSequence, find_sequences
from tisfm.errors import InputError, is_user_error
from tisfm.evaluation.files import EVALUATION_RECORD
from tisfm.evaluation.moving_objects import (
    compare_masks,
    compare_object_paths,
    find_true_masks,
    has_true_paths,
    mask_table,
    object_path_table,
)
from tisfm.evaluation.sequence_result import TrajectoryResult
from tisfm.evaluation.sequence_tables import sequence_tables
from tisfm.evaluation.sequences import (
    SequenceEvaluation,
    SequenceResult,
    as_record,
    compare_sequence,
    reconstruct_and_compare,
)
from tisfm.folders.result_folder import InputFiles, make_result_folder
from tisfm.formats import atomic_write
from tisfm.reconstruction.stages.progress import Progress
from tisfm.settings import Settings
from tisfm.trajectory import read_trajectory, write_tum
from tisfm.trajectory.times import times_or_numbers
from tisfm.version import __version__

if TYPE_CHECKING:  # that module imports this one
    from tisfm.cli.evaluate import Eval


@print_source_notes()
def evaluate_sequences(options: "Eval") -> int:
    """Reconstruct the sequences of datasets, print their errors, write all; return the exit code.

    With the option `result` nothing is reconstructed.
    """
    sequences = _sequences(options.folders, options.layout)
    if options.result is not None and len(sequences) > 1:
        names = ", ".join(sequence.name for sequence in sequences)
        raise InputError(
            f"one result is given, but there are {len(sequences)} sequences, {names}: give the "
            "folder of one"
        )
    if options.max_depth is not None and not options.max_depth > 0:
        raise InputError(f"max_depth is {options.max_depth}: expected a positive depth")
    output, camera, settings = options.output, options.camera.camera(), options.settings.settings()
    if options.result is None:
        start_kernels(options.arch, threads=options.threads)
    evaluations: list[SequenceEvaluation] = []
    paths = {} if output is None else _paths(sequences, output)
    with progress_bar() as progress:
        task = progress.add_task("", total=len(sequences))
        for sequence in sequences:
            progress.update(task, description=sequence.name)
            try:
                evaluations.append(
                    _evaluate(
                        sequence, paths.get(sequence), options, camera=camera, settings=settings
                    )
                )
            except (OSError, TypeError, ValueError, RuntimeError, MemoryError) as error:
                if not is_user_error(error):
                    raise
                text = " ".join(str(error).split()) or type(error).__name__
                evaluations.append(SequenceEvaluation(sequence=sequence, fault=text))
            progress.advance(task)
    if output is not None:
        _write_record(
            output,
            settings=asdict(settings),
            camera=None if camera is None else asdict(camera),
            sequences=[as_record(evaluation) for evaluation in evaluations],
        )
    for table in sequence_tables(evaluations):
        print_full_width(table)
    failed_evaluations = [evaluation for evaluation in evaluations if evaluation.fault is not None]
    valid_count = len(evaluations) - len(failed_evaluations)
    if valid_count:
        location = "" if output is None else f" Paths and every number in {output}."
        tell(f"{valid_count} sequence{'s' * (valid_count != 1)}.{location}")
    for evaluation in failed_evaluations:
        tell(f"tisfm: {evaluation.sequence.name}: {evaluation.fault}")
    return 1 if failed_evaluations else 0


def _sequences(folders: Sequence[str], layout: str | None) -> list[DatasetSequence]:
    if layout is not None and layout not in SEQUENCE_LAYOUTS:
        names = ", ".join(map(repr, SEQUENCE_LAYOUTS))
        raise InputError(f"layout is {layout!r}, which has no sequences: expected one of {names}")
    return list(
        dict.fromkeys(sequence for folder in folders for sequence in find_sequences(folder, layout))
    )


def _paths(sequences: Sequence[DatasetSequence], output: Path) -> dict[DatasetSequence, Path]:
    """Return the file for the path of each sequence, all different."""
    paths: dict[DatasetSequence, Path] = {}
    used_names: set[str] = set()
    for sequence in sequences:
        number, name = 1, sequence.name
        while name.lower() in used_names:
            number += 1
            name = f"{sequence.name}_{number}"
        used_names.add(name.lower())
        paths[sequence] = output / f"{name}.tum"
    return paths


def _evaluate(
    sequence: DatasetSequence,
    path: Path | None,
    options: "Eval",
    *,
    camera: Camera | None,
    settings: Settings,
) -> SequenceEvaluation:
    step = 1 if options.step is None else options.step
    loaded = sequence.load(step)
    camera = camera or loaded.camera
    if camera is None:
        raise InputError(f"{sequence.folder} states no camera: give --focal")
    result: SequenceResult
    if options.result is None:
        evaluation, result = reconstruct_and_compare(
            sequence,
            loaded,
            camera=camera,
            settings=settings,
            step=step,
            give_poses=options.give_poses,
            max_depth=options.max_depth,
            progress=_progress_callback(sequence.name),
        )
    else:
        result, has_depth = _read(options.result, loaded)
        evaluation = compare_sequence(
            sequence,
            loaded,
            result,
            camera=camera,
            step=step,
            poses_given=options.give_poses,
            max_depth=options.max_depth,
            with_depth=has_depth,
        )
    if path is not None:
        _write_paths(path, loaded, result)
    return evaluation


def _progress_callback(name: str) -> Progress:
    """Return a progress callback that prints the expected time of a long sequence."""
    estimates = {stage: TimeEstimate(f"frames of {name}, {text}") for stage, text in STAGES.items()}
    return lambda stage, done, total: estimates[stage].update(done, total)


def _read(path: Path, loaded: LoadedSequence) -> tuple[SequenceResult, bool]:
    """Return the saved result, and whether it has depth."""
    if path.is_dir():
        return tisfm.Reconstruction.load(path), True
    return TrajectoryResult(read_trajectory(path), loaded, path), False


def _write_paths(path: Path, loaded: LoadedSequence, result: SequenceResult) -> None:
    """Write the poses of a sequence, each piece, which has its own world, to its own file."""
    frame_times = [None] * len(loaded.frames) if loaded.times is None else list(loaded.times)
    times = times_or_numbers(frame_times)
    pieces, counts = np.unique(result.piece[result.piece >= 0], return_counts=True)
    for rank, piece in enumerate(pieces[np.argsort(-counts, kind="stable")], 1):
        file = path if rank == 1 else path.with_name(f"{path.stem}-piece{rank}.tum")
        InputFiles(loaded.frames).refuse(file)
        make_result_folder(file.parent)
        in_piece = (result.piece == piece)[:, None, None]
        write_tum(file, np.where(in_piece, result.poses, np.nan), times)


def _write_record(folder: Path, **record: Any) -> None:
    make_result_folder(folder)
    text = json.dumps(
        {"version": __version__, **record}, indent=2, ensure_ascii=False, allow_nan=False
    )
    with atomic_write(folder / EVALUATION_RECORD) as file:
        file.write(f"{text}\n".encode())


def evaluate_objects(
    folders: Sequence[str], output: Path | None, *, result: Path | None, step: int | None = None
) -> int:
    """Compare the masks of a reconstruction with true ones, print the scores; return the exit code.

    With `output`, its ``eval.json`` receives them.
    """
    if result is None:
        raise InputError(
            "--result is missing: give the folder of a reconstruction, as in: "
            "tisfm eval FOLDER --objects --result DIR"
        )
    if len(folders) > 1:
        raise InputError(
            f"one result is given, but {len(folders)} folders, {', '.join(folders)}: give the "
            "folder of its true masks"
        )
    (folder,) = folders
    scores = compare_masks(result, folder, step=1 if step is None else step)
    masks = find_true_masks(folder).resolve()
    name = masks.parent.name if masks.name == "masks" else masks.name
    labels = {score.object_id: score.label for score in scores.objects if score.label is not None}
    true_folder = masks.parent if masks.name == "masks" else masks
    paths = None
    if has_true_paths(true_folder):
        paths = compare_object_paths(result, true_folder, labels, step=step or 1)
    if output is not None:
        objects = {"name": name, "iou": scores.iou, "switches": scores.switches, **asdict(scores)}
        if paths is not None:
            objects["paths"] = {label: asdict(errors) for label, errors in paths.items()}
        _write_record(output, objects=objects)
    print_full_width(mask_table(name, scores))
    if paths is not None:
        print_full_width(object_path_table(name, paths))
    location = "" if output is None else f" Every number in {output}."
    count = len(scores.objects)
    tell(f"{count} object{'s' * (count != 1)} in {scores.frames} frames.{location}")
    return 0
