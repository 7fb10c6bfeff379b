"""``python -m bench.sequences.memory``: peak memory of `tisfm.reconstruct` by number of frames.

A camera circles in a rendered room and looks outward, 225 frames a round, so that most frames show
new surfaces. Each film is read from files and reconstructed in its own process. Its peak resident
memory, with libraries, counts. Rendered frames are kept in a temporary folder. The table and all
figures are written to bench/results.
"""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any, get_args

import cv2
from rich.console import Console

import tisfm
from bench.pair_memory import peak
from bench.sequences.rendered_films import CACHE, circle_path, path_error, poses_of_segment
from bench.shared.command import options_parser
from bench.shared.results import RESULTS, Table, machine, markdown_page, write_results
from tisfm import runtime
from tisfm.reconstruction.stages.progress import DepthOf
from tisfm.scenes import room_film
from tisfm.settings import Preset

HEIGHT = 120  # px
WIDTH = 160  # px
BATCH = 50  # frames that are rendered together
FIGURES = {  # name of a figure → its format
    "frames": "g",
    "peak memory, MB": ".0f",
    "pieces": "g",
    "frames with a pose": "g",
    "ATE, %": ".3f",
}


def render_frames(count: int) -> tuple[Path, tisfm.Camera]:
    """Return a folder with at least `count` rendered frames, and their camera."""
    folder = CACHE / f"rounds-{HEIGHT}x{WIDTH}"
    folder.mkdir(parents=True, exist_ok=True)
    camera = room_film(circle_path(1), 8, WIDTH, samples=1).camera
    for begin in range(0, count, BATCH):
        files = [folder / f"{k:05d}.png" for k in range(begin, begin + BATCH)]
        if all(file.exists() for file in files):
            continue
        some = room_film(
            circle_path(begin + BATCH)[begin:], HEIGHT, WIDTH, textured=True, samples=2
        )
        for file, frame in zip(files, some.frames, strict=True):
            cv2.imwrite(str(file), frame)
    return folder, camera


def measure(count: int, preset: Preset, depth_of: DepthOf, threads: int) -> dict[str, float]:
    """Reconstruct `count` frames in this process, and return the figures."""
    runtime.start(threads=threads)
    folder, camera = render_frames(count)
    settings = tisfm.Settings.preset(preset, motion="camera")
    result = tisfm.reconstruct(
        str(folder), stop=count, camera=camera, settings=settings, depth_of=depth_of
    )
    memory = peak() / 1e6
    posed = result.piece >= 0
    values = count, memory, len(set(result.piece[posed].tolist())), int(posed.sum())
    return dict(
        zip(
            FIGURES,
            (*values, path_error(poses_of_segment(result), circle_path(count))),
            strict=True,
        )
    )


def report(conditions: dict[str, Any], rows: list[dict[str, float]]) -> str:
    cells = [[format(row[word], form) for word, form in FIGURES.items()] for row in rows]
    table = Table(list(FIGURES), cells, text_columns=0)
    return markdown_page("# Memory of a sequence over its frames", conditions, table)


def main(arguments: list[str] | None = None) -> int:
    parser = options_parser(
        "sequences.memory", __doc__, "threads", "output", output="sequences_memory"
    )
    add = parser.add_argument
    add("--counts", nargs="+", type=int, default=[250, 500, 1000, 2000], metavar="N", help="frames")
    add("--preset", choices=get_args(Preset), default="fast")
    add("--depth-of", choices=get_args(DepthOf), default="all")
    add("--here", action="store_true", help="measure one film in this process, and print its row")
    options = parser.parse_args(arguments)
    if options.here:
        (count,) = options.counts
        print(json.dumps(measure(count, options.preset, options.depth_of, options.threads)))
        return 0
    render_frames(max(options.counts))
    console, rows = Console(), []
    module = [sys.executable, "-m", "bench.sequences.memory", "--here"]
    settings = [f"--{name}={getattr(options, name)}" for name in ("preset", "threads")]
    settings.append(f"--depth-of={options.depth_of}")
    for count in options.counts:
        command = [*module, f"--counts={count}", *settings]
        process_result = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
        rows.append(json.loads(process_result.stdout.splitlines()[-1]))
        console.print(rows[-1])
    conditions = {
        "command": "python -m bench.sequences.memory",
        "preset": options.preset,
        "depth of": options.depth_of,
        "size": f"{HEIGHT}×{WIDTH} px",
        "threads": options.threads,
        **machine(),
    }
    text = report(conditions, rows)
    write_results(RESULTS / options.output, text, {"conditions": conditions, "rows": rows})
    return 0


if __name__ == "__main__":
    sys.exit(main())
