"""What the tests of evaluation share: scenes, settings, and what is written of them."""

import io
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console

import tisfm
from tests.rendered import static_scene
from tisfm.datasets import find_pairs
from tisfm.evaluation.files import EvaluationWriter
from tisfm.evaluation.pair_tables import evaluation_tables
from tisfm.evaluation.pairs import evaluate
from tisfm.formats import write_png
from tisfm.rigid import pose_matrix

H, W = 40, 56
SCENES = [static_scene("sideways", H, W, seed=seed) for seed in (0, 1)]
FAST = tisfm.Settings.preset("fast", outer_iterations=3, warps=1)
HOLE = np.zeros((H, W), bool)
HOLE[5:12, 9:20] = True


def put(path: Path, data: np.ndarray, write: Callable = write_png) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    write(path, data)


CALIBRATION = "P2: 56 0 27.5 0 0 56 19.5 0 0 0 1 0\n"
LABELS = ["mid/A", "mid/B", "road/000003", "valley/yos9"]
FILES = {"mid/A", "mid/B", "road/000003", "valley/yos9"}


def written(folder):
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in Path(folder).rglob("*")
        if path.is_file()
    }


def promised(*stems):
    endings = ("_flow.flo", "_flow.png", "_error.png")
    return {stem + ending for stem in stems for ending in endings} | {"eval.json"}


def record(folder):
    return json.loads((folder / "eval.json").read_text(encoding="utf-8"))


def evaluate_to(folder, data, *, settings=FAST, **options):
    writer = EvaluationWriter(folder, camera=options.get("camera"), settings=settings)
    result = evaluate(find_pairs(data), settings=settings, on_pair=writer.write, **options)
    writer.finish(result)
    return result


MOTION = pose_matrix(SCENES[0].motions[0])
SEQUENCE_LABELS = [
    "chess/frame-000000", "chess/frame-000001", "chess/frame-000002",
    "lab/rgb_00000", "lab/rgb_00001", "two/block",
]  # fmt: skip


def camera_settings():
    """Settings of one motion of the camera."""
    return replace(FAST, motion="camera")


def printed(result, width=110, table=0):
    console = Console(width=width, record=True, file=io.StringIO())
    console.print(evaluation_tables(result)[table])
    rows = [line for line in console.export_text().splitlines() if line.startswith("│")]
    return [[cell.strip() for cell in row.strip("│").split("│")] for row in rows]
