"""``python -m bench.sequences.chunks``: reconstruction in chunks, compared with all frames at once.

Real sequences have at most 100 frames, so their chunks are shorter than the default. In a rendered
film, a camera moves in circles in a room and looks outward, 225 frames a round. The table and all
figures are written to bench/results. With ``--folder``, results are kept there, and a second run
uses the complete results.
"""

import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

import tisfm
from bench.sequences.entries import MAX_DEPTH
from bench.sequences.memory import HEIGHT, WIDTH, render_frames
from bench.sequences.rendered_films import circle_path, path_error, poses_of_segment
from bench.shared.command import options_parser
from bench.shared.results import RESULTS, Table, cell, machine, markdown_page, write_results
from bench.shared.sequences import data_folder
from tisfm.datasets import find_sequences
from tisfm.evaluation.sequences import compare_sequence
from tisfm.reconstruction.chunks.entry import ChunkedRun

SEQUENCES = (
    ("new_tsukuba", (36, 60)),
    ("hololens", (30,)),
    ("kitti_odometry_06", (30,)),
    ("tum_fr1_rpy", (60,)),
)
ROUNDS = (450, (150,))  # frames of the film, and of its chunks
ONE_CHUNK = 100_000  # frames: more than any sequence has, so that it is one chunk
SETTINGS = tisfm.Settings.preset("fast", motion="camera")
FIGURES = {  # name of a figure → its format
    "sequence": "",
    "frames": "g",
    "chunk": "",
    "chunks": "g",
    "pieces": "g",
    "frames of the largest": "g",
    "ATE, %": ".3f",
    "depth error": ".4f",
    "spread of its scale": ".4f",
}
Row = dict[str, Any]


def map_in_process(function: Any, items: Sequence[Any]) -> Iterator[tuple[int, Any]]:
    """Call a function with each item, in this process."""
    for number, item in enumerate(items):
        yield number, function(item)


def reconstruct_in_chunks(
    source: Any, folder: Path, camera: tisfm.Camera | None, chunk: int, stop: int | None = None
) -> tuple[tisfm.Reconstruction, int]:
    """Return a sequence reconstructed in chunks, and the number of chunks."""
    run = ChunkedRun(source, folder, camera=camera, settings=SETTINGS, chunk=chunk, stop=stop)
    result = run.result(map_in_process, resume=True)
    return result, len(list(folder.glob(".tisfm-chunks/[0-9]*.json")))


def real_rows(data: Path, name: str, chunks: Sequence[int], folder: Path) -> Iterator[Row]:
    """Measure a real sequence at once, and in chunks."""
    (sequence,) = find_sequences(data / name)
    loaded = sequence.load(1)
    files = [str(file) for file in loaded.frames]
    for chunk in (ONE_CHUNK, *chunks):
        result, count = reconstruct_in_chunks(
            files, folder / f"{name}-{chunk}", loaded.camera, chunk
        )
        errors = compare_sequence(
            sequence, loaded, result, camera=result.camera, max_depth=MAX_DEPTH
        )
        largest, depth = errors.pieces[0], errors.depth
        values = (
            name, errors.frames, chunk if chunk < ONE_CHUNK else "at once", count,
            len(errors.pieces), largest.frames,
            None if largest.share is None else 100 * largest.share,
            None if depth is None else depth.error, None if depth is None else depth.scale_spread,
        )  # fmt: skip
        yield dict(zip(FIGURES, values, strict=True))


def film_rows(count: int, chunks: Sequence[int], folder: Path) -> Iterator[Row]:
    source, camera = render_frames(count)
    for chunk in (ONE_CHUNK, *chunks):
        result, number = reconstruct_in_chunks(
            str(source), folder / f"rounds-{chunk}", camera, chunk, count
        )
        is_inside = result.piece == result.largest_piece
        error = path_error(poses_of_segment(result, result.largest_piece), circle_path(count))
        values = (
            f"rounds, {WIDTH}×{HEIGHT} px", count, chunk if chunk < ONE_CHUNK else "at once",
            number,
            int(result.piece.max()) + 1, int(is_inside.sum()), error, None, None,
        )  # fmt: skip
        yield dict(zip(FIGURES, values, strict=True))


def main(arguments: list[str] | None = None) -> int:
    parser = options_parser(
        "sequences.chunks", __doc__, "data", "output", output="sequences_chunks"
    )
    add = parser.add_argument
    add("--folder", type=Path, metavar="DIR", help="keep the results there; default: not kept")
    add("--no-film", action="store_true", help="leave out the rendered film")
    options = parser.parse_args(arguments)
    data, console, rows = data_folder(options.data), Console(), list[Row]()
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.folder or Path(temporary)
        parts = [
            real_rows(data, name, chunks, folder) for name, chunks in SEQUENCES if data is not None
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
    cells = [[cell(row[word], form) for word, form in FIGURES.items()] for row in rows]
    text = markdown_page("# Sequences in chunks of frames", conditions, Table(list(FIGURES), cells))
    write_results(RESULTS / options.output, text, {"conditions": conditions, "rows": rows})
    return 0


if __name__ == "__main__":
    sys.exit(main())
