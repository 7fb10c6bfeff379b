"""``tisfm demo``: rendered scenes, interpreted and compared with the known truth."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import Annotated

from rich.table import Table
from tyro.conf import arg

from tisfm.cli.console import print_full_width, tell
from tisfm.cli.demo_animation import ANIMATION
from tisfm.cli.demo_scenes import (
    BALANCED,
    BASELINE,
    CAMERA,
    FIELD,
    NAME,
    OBJECTS,
    PAPER,
    PARTS,
    Part,
    Rows,
    run_part,
)
from tisfm.cli.figures import PAPER_FIGURES
from tisfm.cli.progress import progress_bar
from tisfm.errors import InputError
from tisfm.folders.result_folder import LOCK, make_result_folder, make_subfolder
from tisfm.folders.run_record import ENDINGS, read_record
from tisfm.formats.float_maps import require_writable_flow
from tisfm.running.pool import open_pool
from tisfm.threads import usable_cores


@dataclass(kw_only=True)
class Demo:
    """Render scenes with a known truth, estimate motion and depth, and print the errors.

    In the first scene the camera moves sideways, and two textured blocks on a floor move
    independently. A table compares the preset paper, the default preset, and the method of Horn and
    Schunck. In the second scene the camera moves forward and rotates in front of three static
    blocks. A second table compares three motion models. Two of them are applied to the second
    scene: field, with a free motion at every pixel, and camera, with one rigid motion. The third,
    objects, with a rigid motion of each object, is applied to the first scene. DIR receives the
    outputs of tisfm run for the first scene, and comparisons of settings as in the paper of Sekkati
    and Mitiche (2007). DIR/camera and DIR/objects receive the outputs of these two motion models.
    """

    output: Annotated[Path, arg(aliases=["-o"], metavar="DIR")] = Path("tisfm-demo")
    """Folder for the results; made if it does not exist."""
    height: int = 240
    """Height of the rendered frames, px."""
    width: int = 320
    """Width of the rendered frames, px."""
    seed: int = 0
    """Seed of the random textures."""
    threads: int | None = None
    """Maximum number of CPU threads. By default all cores."""

    def __call__(self) -> int:
        """Run the command and return the exit code."""
        return demo(
            self.output, height=self.height, width=self.width, seed=self.seed, threads=self.threads
        )


MAX_PIXELS = 10_000_000  # in a scene: ray casting takes about 5 s per million


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
        Seed of the random textures.
    threads : int or None
        Maximum number of CPU threads of all processes together.

    Raises
    ------
    OSError, ValueError
        If the folder cannot be written to, if it holds files of these names that no demo wrote, or
        if an option is impossible.
    """
    if height * width > MAX_PIXELS:
        raise InputError(
            f"the demo scene would have {height} × {width} px: expected at most {MAX_PIXELS:,} px"
        )
    require_writable_flow("the demo scene", height, width)
    folders = output, output / "camera", output / "objects"
    _refuse_foreign(folders)
    make_result_folder(output)
    for folder in folders[1:]:
        make_subfolder(folder)
    workers, worker_threads = _processes_and_threads(threads)
    rows: Rows = {}
    with (
        progress_bar() as progress,
        open_pool(workers) as processes,
        NamedTemporaryFile() as presence,
    ):
        parts = [
            Part(
                work=work,
                output=output,
                height=height,
                width=width,
                seed=seed,
                threads=worker_threads,
                presence=Path(presence.name),
            )
            for work in PARTS
        ]
        task = progress.add_task("interpreting", total=len(parts))
        for _, part_rows in processes.map_unordered(run_part, parts):
            if isinstance(part_rows, Exception):
                raise part_rows
            rows |= part_rows
            progress.advance(task)
    time_caption = (
        f"Seconds on {'one thread' if worker_threads == 1 else f'{worker_threads} threads'}."
    )
    print_full_width(
        _fill_table(_blocks_table(height, width, time_caption), rows, (PAPER, BALANCED, BASELINE))
    )
    print_full_width(
        _fill_table(_models_table(height, width, time_caption), rows, (FIELD, CAMERA, OBJECTS))
    )
    first, *others = (folder / f"{NAME}{ENDINGS['figure']}" for folder in folders)
    tell(
        f"Pictures and data in {output}. Open {first} first, then {' and '.join(map(str, others))}."
    )
    tell(
        f"{output / ANIMATION} is an animation of the depth: open it in a browser. "
        f"tisfm view {output} shows the scene from any side (pip install 'tisfm[view]')."
    )
    tell("Your own frames: tisfm run VIDEO -o results --report, and open results/report.html.")
    return 0


def _processes_and_threads(threads: int | None) -> tuple[int, int]:
    """Return the number of processes, which do one part each, and the threads of each."""
    if threads is not None and threads < 1:
        raise InputError(f"threads is {threads}: expected a positive integer")
    cores = usable_cores()
    max_threads = min(threads or cores, cores)
    workers = min(2, max_threads)
    return workers, max_threads // workers


def _refuse_foreign(folders: Iterable[Path]) -> None:
    """Raise InputError if the demo would replace a run, or files without a record of a demo."""
    for folder in folders:
        record = read_record(folder)
        if record is not None:
            if not record["pairs"].keys() <= {NAME}:
                raise InputError(
                    f"the demo would replace the run in {folder}: give another folder with -o"
                )
            continue
        if (folder / LOCK).exists():  # a demo was killed here before it wrote a record
            continue
        pairs = (f"{NAME}{ending}" for ending in ENDINGS.values())
        for name in (*pairs, *PAPER_FIGURES, ANIMATION):
            if (folder / name).exists():
                raise InputError(
                    f"the demo would replace {folder / name}, which no demo wrote: give another "
                    "folder with -o"
                )


def _fill_table(table: Table, rows: Rows, labels: Iterable[str]) -> Table:
    for label in labels:
        table.add_row(label, *rows[label])
    return table


def _blocks_table(height: int, width: int, time_caption: str) -> Table:
    table = Table(
        title=f"Two blocks on a floor, {height} × {width} px, against the truth",
        caption="End-point and angular error of the flow where the point stays visible. Depth "
        "after scaling by the median, within each object, whose scale no method can know. "
        + time_caption,
    )
    return _with_columns(table, "EPE, px", "angle, °", "|ΔZ|/Z")


def _models_table(height: int, width: int, time_caption: str) -> Table:
    table = Table(
        title=f"Motion as a field, of the camera and of objects, {height} × {width} px",
        caption="Depth after scaling by the median, and the share of its errors that are below "
        "its standard deviation. Direction of translation and rotation of the background; those "
        "of a field by tisfm.egomotion. At rest: three blocks, the camera goes forward and turns. "
        "Moving: the two blocks above, depth within each. " + time_caption,
    )
    return _with_columns(table, "|ΔZ|/Z", "within std", "EPE, px", "direction, °", "rotation, °")


def _with_columns(table: Table, *headings: str) -> Table:
    table.add_column("", no_wrap=True)
    for heading in headings:
        table.add_column(heading, justify="right")
    table.add_column("status", no_wrap=True)
    table.add_column("s", justify="right", no_wrap=True)
    return table
