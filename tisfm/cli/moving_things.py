"""What `tisfm eval --objects` does."""

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from tisfm.cli.console import print_whole, tell
from tisfm.errors import InputError
from tisfm.evaluation.files import EVALUATION_RECORD
from tisfm.evaluation.masks import compare_masks, mask_table, true_masks
from tisfm.evaluation.object_paths import (
    compare_object_paths,
    has_true_paths,
    object_path_table,
)
from tisfm.formats import atomic_write
from tisfm.formats.result_folder import make_folder
from tisfm.version import __version__


def evaluate_objects(
    folders: Sequence[str], output: Path | None, *, result: Path | None, step: int | None = None
) -> int:
    """Compare the masks of a reconstruction with true ones, print the scores; return the exit code.

    With `output`, its ``eval.json`` receives them.
    """
    if result is None:
        raise InputError(
            "result is missing: give the folder of a reconstruction, as in: "
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
    labels = {thing.thing: thing.label for thing in scores.things if thing.label is not None}
    true_folder = masks.parent if masks.name == "masks" else masks
    paths = None
    if has_true_paths(true_folder):
        paths = compare_object_paths(result, true_folder, labels, step=step or 1)
    if output is not None:
        make_folder(output)
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
    count = len(scores.things)
    tell(f"{count} thing{'s' * (count != 1)} in {scores.frames} frames.{where}")
    return 0
