"""``tisfm eval --sequence`` and ``tisfm eval --objects``."""

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

import tisfm
from tisfm.camera import Camera
from tisfm.cli.console import notes_as_lines, print_whole, start_kernels, tell
from tisfm.cli.progress import STAGES, TimeEstimate, progress_bar
from tisfm.datasets import (
    SEQUENCE_LAYOUTS,
    DatasetSequence,
    LoadedSequence,
    find_sequences,
)
from tisfm.errors import InputError, is_user_error
from tisfm.evaluation.files import EVALUATION_RECORD
from tisfm.evaluation.moving_objects import (
    compare_masks,
    compare_object_paths,
    has_true_paths,
    mask_table,
    object_path_table,
    true_masks,
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
from tisfm.reconstruction.progress import Progress
from tisfm.runtime import Arch
from tisfm.settings import Settings
from tisfm.trajectory import read_trajectory, write_tum
from tisfm.trajectory.times import times_or_numbers
from tisfm.version import __version__


@notes_as_lines()
def evaluate_sequences(
    folders: Sequence[str],
    output: Path | None,
    *,
    layout: str | None = None,
    camera: Camera | None = None,
    settings: Settings,
    step: int | None = None,
    give_poses: bool = False,
    max_depth: float | None = None,
    result: Path | None = None,
    arch: Arch | None = None,
    threads: int | None = None,
) -> int:
    """Reconstruct the sequences of datasets, print their errors, write all; return the exit code.

    With `result` nothing is reconstructed: it is a trajectory, or what a reconstruction saved.
    """
    sequences = _found(folders, layout)
    if result is not None and len(sequences) > 1:
        names = ", ".join(sequence.name for sequence in sequences)
        raise InputError(
            f"one result is given, but there are {len(sequences)} sequences, {names}: give the "
            "folder of one"
        )
    if max_depth is not None and not max_depth > 0:
        raise InputError(f"max_depth is {max_depth}: expected a positive depth")
    if result is None:
        start_kernels(arch, threads=threads)
    evaluations: list[SequenceEvaluation] = []
    paths = {} if output is None else _paths(sequences, output)
    with progress_bar() as progress:
        task = progress.add_task("", total=len(sequences))
        for sequence in sequences:
            progress.update(task, description=sequence.name)
            try:
                evaluations.append(
                    _evaluate(
                        sequence,
                        paths.get(sequence),
                        camera=camera,
                        settings=settings,
                        step=1 if step is None else step,
                        give_poses=give_poses,
                        max_depth=max_depth,
                        result=result,
                    )
                )
            except (OSError, TypeError, ValueError, RuntimeError, MemoryError) as error:
                if not is_user_error(error):
                    raise
                text = " ".join(str(error).split()) or type(error).__name__
                evaluations.append(SequenceEvaluation(sequence=sequence, fault=text))
            progress.advance(task)
    if output is not None:
        _write_record(output, evaluations, settings=settings, camera=camera)
    for table in sequence_tables(evaluations):
        print_whole(table)
    faults = [evaluation for evaluation in evaluations if evaluation.fault is not None]
    good = len(evaluations) - len(faults)
    if good:
        where = "" if output is None else f" Paths and every number in {output}."
        tell(f"{good} sequence{'s' * (good != 1)}.{where}")
    for evaluation in faults:
        tell(f"tisfm: {evaluation.sequence.name}: {evaluation.fault}")
    return 1 if faults else 0


def _found(folders: Sequence[str], layout: str | None) -> list[DatasetSequence]:
    if layout is not None and layout not in SEQUENCE_LAYOUTS:
        names = ", ".join(map(repr, SEQUENCE_LAYOUTS))
        raise InputError(f"layout is {layout!r}, which has no sequences: expected one of {names}")
    return list(
        dict.fromkeys(found for folder in folders for found in find_sequences(folder, layout))
    )


def _paths(sequences: Sequence[DatasetSequence], output: Path) -> dict[DatasetSequence, Path]:
    """Return the file for the path of each sequence, all different."""
    paths: dict[DatasetSequence, Path] = {}
    taken: set[str] = set()
    for sequence in sequences:
        number, name = 1, sequence.name
        while name.lower() in taken:
            number += 1
            name = f"{sequence.name}_{number}"
        taken.add(name.lower())
        paths[sequence] = output / f"{name}.tum"
    return paths


def _evaluate(
    sequence: DatasetSequence,
    path: Path | None,
    *,
    camera: Camera | None,
    settings: Settings,
    step: int,
    give_poses: bool,
    max_depth: float | None,
    result: Path | None,
) -> SequenceEvaluation:
    loaded = sequence.load(step)
    taken_by = camera or loaded.camera
    if taken_by is None:
        raise InputError(f"{sequence.folder} states no camera: give --focal")
    if result is None:
        evaluation, found = reconstruct_and_compare(
            sequence,
            loaded,
            camera=taken_by,
            settings=settings,
            step=step,
            give_poses=give_poses,
            max_depth=max_depth,
            progress=_estimate(sequence.name),
        )
    else:
        found, with_depth = _read(result, loaded)
        evaluation = compare_sequence(
            sequence,
            loaded,
            found,
            camera=taken_by,
            step=step,
            poses_given=give_poses,
            max_depth=max_depth,
            with_depth=with_depth,
        )
    if path is not None:
        _write_paths(path, loaded, found)
    return evaluation


def _estimate(name: str) -> Progress:
    """Return a progress callback that prints the expected time of a long sequence."""
    estimates = {stage: TimeEstimate(f"frames of {name}, {text}") for stage, text in STAGES.items()}
    return lambda stage, done, total: estimates[stage].update(done, total)


def _read(path: Path, loaded: LoadedSequence) -> tuple[SequenceResult, bool]:
    """Return the saved result, and whether it has depth."""
    if path.is_dir():
        return tisfm.Reconstruction.load(path), True
    return TrajectoryResult(read_trajectory(path), loaded, path), False


def _write_paths(path: Path, loaded: LoadedSequence, found: SequenceResult) -> None:
    """Write the poses of a sequence, each piece, which has its own world, to its own file."""
    known = [None] * len(loaded.frames) if loaded.times is None else list(loaded.times)
    times = times_or_numbers(known)
    numbers, counts = np.unique(found.piece[found.piece >= 0], return_counts=True)
    for place, number in enumerate(numbers[np.argsort(-counts, kind="stable")]):
        file = path if place == 0 else path.with_name(f"{path.stem}-piece{place + 1}.tum")
        InputFiles(loaded.frames).refuse(file)
        make_result_folder(file.parent)
        mine = (found.piece == number)[:, None, None]
        write_tum(file, np.where(mine, found.poses, np.nan), times)


def _write_record(
    folder: Path,
    evaluations: Sequence[SequenceEvaluation],
    *,
    settings: Settings,
    camera: Camera | None,
) -> None:
    make_result_folder(folder)
    record: dict[str, Any] = {
        "version": __version__,
        "settings": asdict(settings),
        "camera": None if camera is None else asdict(camera),
        "sequences": [as_record(evaluation) for evaluation in evaluations],
    }
    text = json.dumps(record, indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    with atomic_write(folder / EVALUATION_RECORD) as file:
        file.write(text.encode("utf-8"))


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
            f"one result is given, but {len(folders)} folders, {', '.join(folders)}: give the one "
            "of its true masks"
        )
    (folder,) = folders
    scores = compare_masks(result, folder, step=1 if step is None else step)
    masks = true_masks(folder).resolve()
    name = masks.parent.name if masks.name == "masks" else masks.name
    labels = {thing.object_id: thing.label for thing in scores.objects if thing.label is not None}
    true_folder = masks.parent if masks.name == "masks" else masks
    paths = None
    if has_true_paths(true_folder):
        paths = compare_object_paths(result, true_folder, labels, step=step or 1)
    if output is not None:
        make_result_folder(output)
        record = {
            "version": __version__,
            "objects": {
                "name": name,
                "iou": scores.iou,
                "switches": scores.switches,
                **asdict(scores),
                **(
                    {"paths": {k: asdict(v) for k, v in paths.items()}} if paths is not None else {}
                ),
            },
        }
        text = json.dumps(record, indent=2, ensure_ascii=False, allow_nan=False) + "\n"
        with atomic_write(output / EVALUATION_RECORD) as file:
            file.write(text.encode("utf-8"))
    print_whole(mask_table(name, scores))
    if paths is not None:
        print_whole(object_path_table(name, paths))
    where = "" if output is None else f" Every number in {output}."
    count = len(scores.objects)
    tell(f"{count} object{'s' * (count != 1)} in {scores.frames} frames.{where}")
    return 0
