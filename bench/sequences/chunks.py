"""``python -m bench.sequences.chunks``: sequences in chunks of frames, beside the same at once.

Real sequences, as far as they are there, in chunks that are shorter than the default, since they
have at most 100 frames; and a rendered film in which a camera goes round and round in a room and
looks outward, 225 frames a round. The table and all numbers are left in bench/results. With
``--folder``, results are kept there, and a second run takes those that are complete.
"""

import argparse
import json
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

import tisfm
from bench.sequences.entries import FARTHEST
from bench.sequences.memory import HEIGHT, WIDTH, film
from bench.sequences.rendered_films import rounds
from bench.sequences.rendered_scores import path_error
from bench.shared.results import RESULTS, machine
from bench.shared.sequences import data_folder
from tisfm.datasets import find_sequences
from tisfm.evaluation.sequences import compare_sequence
from tisfm.reconstruction.chunks.entry import ChunkedRun

SELECTED = (
    ("new_tsukuba", (36, 60)),
    ("hololens", (30,)),
    ("kitti_odometry_06", (30,)),
    ("tum_fr1_rpy", (60,)),
)
ROUNDS = (450, (150,))  # frames of the film
AT_ONCE = 100_000  # frames: more than there are
SETTINGS = tisfm.Settings.preset("fast", motion="camera")
WORDS = (
    "sequence", "frames", "chunk", "chunks", "pieces", "frames of the largest", "ATE, %",
    "depth error", "spread of its scale",
)  # fmt: skip
DIGITS = ("", "g", "", "g", "g", "g", ".3f", ".4f", ".4f")
Row = dict[str, Any]


def in_turn(function: Any, items: Sequence[Any]) -> Iterator[tuple[int, Any]]:
    """Call a function with each item, here."""
    for number, item in enumerate(items):
        yield number, function(item)


def made(
    source: Any, folder: Path, camera: tisfm.Camera | None, chunk: int, stop: int | None = None
) -> tuple[tisfm.Reconstruction, int]:
    """Return a sequence reconstructed in chunks, and how many."""
    run = ChunkedRun(source, folder, camera=camera, settings=SETTINGS, chunk=chunk, stop=stop)
    result = run.result(in_turn, resume=True)
    return result, len(list(folder.glob(".tisfm-chunks/[0-9]*.json")))


def real_rows(data: Path, name: str, chunks: Sequence[int], folder: Path) -> Iterator[Row]:
    """Measure a real sequence at once, and in chunks."""
    (sequence,) = find_sequences(data / name)
    loaded = sequence.load(1)
    files = [str(file) for file in loaded.frames]
    for chunk in (AT_ONCE, *chunks):
        result, count = made(files, folder / f"{name}-{chunk}", loaded.camera, chunk)
        found = compare_sequence(sequence, loaded, result, camera=result.camera, max_depth=FARTHEST)
        largest, depth = found.pieces[0], found.depth
        values = (
            name, found.frames, chunk if chunk < AT_ONCE else "at once", count, len(found.pieces),
            largest.frames, None if largest.share is None else 100 * largest.share,
            None if depth is None else depth.error, None if depth is None else depth.scale_spread,
        )  # fmt: skip
        yield dict(zip(WORDS, values, strict=True))


def film_rows(count: int, chunks: Sequence[int], folder: Path) -> Iterator[Row]:
    """Measure the rendered film."""
    source, camera = film(count)
    for chunk in (AT_ONCE, *chunks):
        result, number = made(str(source), folder / f"rounds-{chunk}", camera, chunk, count)
        inside = result.piece == result.largest_piece
        poses = np.where(inside[:, None, None], result.poses, np.nan)
        values = (
            f"rounds, {WIDTH}×{HEIGHT} px", count, chunk if chunk < AT_ONCE else "at once", number,
            int(result.piece.max()) + 1, int(inside.sum()), path_error(poses, rounds(count)), None,
            None,
        )  # fmt: skip
        yield dict(zip(WORDS, values, strict=True))


def write(conditions: dict[str, Any], rows: list[Row], path: Path) -> None:
    """Write PATH.md and PATH.json."""
    lines = ["# Sequences in chunks of frames", ""]
    lines += [f"- {name}: {value}" for name, value in conditions.items()]
    lines += ["", f"| {' | '.join(WORDS)} |", "| --- |" + " ---: |" * (len(WORDS) - 1)]
    for row in rows:
        values = (
            "–" if row[word] is None else format(row[word], kind)
            for word, kind in zip(WORDS, DIGITS, strict=True)
        )
        lines.append(f"| {' | '.join(values)} |")
    path.parent.mkdir(parents=True, exist_ok=True)
    path.with_suffix(".md").write_text("\n".join([*lines, ""]), encoding="utf-8")
    text = json.dumps({"conditions": conditions, "rows": rows}, indent=1, ensure_ascii=False)
    path.with_suffix(".json").write_text(text + "\n", encoding="utf-8")


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(prog="python -m bench.sequences.chunks", description=__doc__)
    add = parser.add_argument
    add("--data", type=Path, metavar="DIR", help="sequences; default: TISFM_DATA")
    add("--folder", type=Path, metavar="DIR", help="where results are kept; default: nowhere")
    add("--no-film", action="store_true", help="leave out the rendered film")
    add(
        "--output", default="sequences_chunks", metavar="NAME", help="of the files in bench/results"
    )
    return parser.parse_args(arguments)


def main(arguments: list[str] | None = None) -> int:
    """Measure and write; return 0."""
    options = parse(arguments)
    data, console, rows = data_folder(options.data), Console(), list[Row]()
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.folder or Path(temporary)
        parts = [
            real_rows(data, name, chunks, folder) for name, chunks in SELECTED if data is not None
        ]
        if not options.no_film:
            parts.append(film_rows(*ROUNDS, folder))
        for part in parts:
            for row in part:
                rows.append(row)
                console.print(row)
    conditions = {
        "command": "python -m bench.sequences.chunks",
        "preset": "fast",
        "ATE": "of the largest piece, over the length of the path",
        **machine(),
    }
    write(conditions, rows, RESULTS / options.output)
    return 0


if __name__ == "__main__":
    sys.exit(main())
