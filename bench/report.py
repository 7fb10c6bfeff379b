"""From the stored timings to one table."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

from rich import box
from rich.console import Console
from rich.table import Table

from bench.shared.results import Bar
from tisfm.runtime import cpu_lanes
from tisfm.settings import Preset

HEAD = (
    "kernel",
    "size",
    "model",
    "solver",
    "lanes",
    "threads",
    "ns/px",
    "IQR",
    "GB/s",
    "stream",
    "NumPy ns/px",
    "ratio",
)
TEXT_COLUMNS = 4
NOTES = (
    "ns/px: median time of a call over the pixels of the image, with the interquartile range; the "
    "call includes the launch of the kernel. A dash: timed once.",
    "GB/s: the bytes a kernel must move (bench/kernels/traffic.py), each array counted once; "
    "stream: as a share of the stream bandwidth on the same number of threads, out of the caches: "
    "above 100% where a size stays in them.",
    "NumPy: the reference, float64, BLAS on one thread, in the same process; its answer agreed "
    "with the kernel's before the kernel was timed. image_to_lanes stands beside a padded copy, "
    "lanes_to_images and relayout beside a copy.",
    "sweep_unfused: one pass over memory for each color, where that of the library makes one for "
    "both; GB/s counts what each pass moves. matching_cost and aggregate: of 16 hypotheses.",
    "pair: coarse to fine to the end of its iterations (paper: 5 outer iterations of sweeps, "
    "balanced: 3 for each linearisation), beside the reference on the same pyramids. Where the "
    "reference was not run, agreement was checked on the same scene at 240x320.",
)


@dataclass(frozen=True)
class Row:
    """One timed kernel or pair. Times are in ns per pixel; None where there is no figure.

    `lanes` is 0 where a kernel works on plain images.
    """

    kernel: str
    size: tuple[int, int]
    model: str
    solver: str
    lanes: int
    threads: int
    time: float
    iqr: float | None
    bandwidth: float | None  # GB/s
    share: float | None
    numpy: float | None

    @property
    def ratio(self) -> float | None:
        return None if self.numpy is None else self.numpy / self.time

    @property
    def over_floor(self) -> float | None:
        """Time over that in which the stream moves as many bytes."""
        return None if self.share is None else 1 / self.share

    def cells(self) -> list[str]:
        """Return the row as text, in the order of `HEAD`."""
        height, width = self.size
        return [
            self.kernel,
            f"{height}x{width}",
            self.model,
            self.solver,
            str(self.lanes or "–"),
            str(self.threads),
            f"{self.time:.2f}",
            _text(self.iqr, ".2f"),
            _text(self.bandwidth, ".1f"),
            _text(self.share, ".0%"),
            _text(self.numpy, ".1f"),
            _text(self.ratio, ".1f"),
        ]


@dataclass(frozen=True)
class Results:
    """What one run measured.

    Attributes
    ----------
    machine : dict
        As pytest-benchmark describes it, with the versions of NumPy and Taichi.
    rows : list of Row
    streams : dict
        (threads, name) → GB/s.
    lexicographic : dict
        Size → ns per pixel of the reference's plain loop.
    memory : dict
        Preset → float32 per pixel at the peak.
    """

    machine: dict[str, Any]
    rows: list[Row]
    streams: dict[tuple[int, str], float]
    lexicographic: dict[str, float]
    memory: dict[str, float]


def collect(reports: list[dict], memory: dict[str, float]) -> Results:
    """Merge the reports of pytest-benchmark, one per number of threads."""
    by_side: dict[str, list[dict]] = {"stream": [], "numpy": [], "taichi": []}
    for report in reports:
        for entry in report["benchmarks"]:
            by_side[entry["extra_info"]["implementation"]].append(entry)
    streams = {}
    for entry in by_side["stream"]:
        info = entry["extra_info"]
        bandwidth = info["bytes"] / entry["stats"]["median"] / 1e9
        streams[info["threads"], info["kernel"]] = bandwidth
    numpy = {_key(entry): _per_pixel(entry, "median") for entry in by_side["numpy"]}
    rows = [_row(entry, numpy, streams) for entry in by_side["taichi"]]
    order = ("size", "kernel", "model", "solver", "threads", "lanes")
    return Results(
        machine=reports[0]["machine_info"] if reports else {},
        rows=sorted(rows, key=lambda row: [getattr(row, name) for name in order]),
        streams=streams,
        lexicographic={
            f"{size[0]}x{size[1]}": time
            for (kernel, size, _, _), time in numpy.items()
            if kernel == "sweep_lexicographic"
        },
        memory=memory,
    )


def best_stream(streams: dict[tuple[int, str], float], threads: int) -> float | None:
    """Return the best bandwidth on a number of threads, GB/s."""
    return max((v for (count, _), v in streams.items() if count == threads), default=None)


def _row(entry: dict, numpy: dict[tuple, float], streams: dict[tuple[int, str], float]) -> Row:
    info = entry["extra_info"]
    time = _per_pixel(entry, "median")
    bandwidth = info["bytes_per_pixel"] / time if "bytes_per_pixel" in info else None
    stream = best_stream(streams, info["threads"])
    return Row(
        **{name: info[name] for name in ("kernel", "model", "solver", "lanes", "threads")},
        size=tuple(info["size"]),
        time=time,
        iqr=_per_pixel(entry, "iqr") if entry["stats"]["rounds"] > 1 else None,
        bandwidth=bandwidth,
        share=bandwidth / stream if bandwidth and stream else None,
        numpy=numpy.get(_key(entry)),
    )


def _key(entry: dict) -> tuple:
    info = entry["extra_info"]
    return info["kernel"], tuple(info["size"]), info["model"], info["threads"]


def _per_pixel(entry: dict, statistic: str) -> float:
    height, width = entry["extra_info"]["size"]
    return entry["stats"][statistic] / (height * width) * 1e9


def _text(value: float | None, form: str) -> str:
    return "–" if value is None else format(value, form)


def describe(results: Results) -> list[str]:
    """Return the lines that say where and beside what the table was measured."""
    lines = []
    if machine := results.machine:
        cpu = machine.get("cpu", {})
        lines.append(
            f"{cpu.get('brand_raw', machine['machine'])}, {cpu.get('count', '?')} cores, "
            f"{machine['system']}; Python {machine['python_version']}, "
            f"NumPy {machine['numpy']}, Taichi {machine['taichi']}"
        )
        if (arch := machine.get("arch", "cpu")) != "cpu":
            lines.append(f"Kernels on {arch}: {machine.get('gpu') or 'a GPU without a name'}")
    for threads in sorted({count for count, _ in results.streams}):
        names = {n: v for (count, n), v in results.streams.items() if count == threads}
        lines.append(
            f"Stream bandwidth, threads = {threads}: {max(names.values()):.1f} GB/s, the best of "
            + ", ".join(f"{name} {value:.1f}" for name, value in names.items())
        )
    for size, time in results.lexicographic.items():
        lines.append(f"Reference, lexicographic sweep, rigid, {size}: {time:.0f} ns/px")
    for preset, floats in results.memory.items():
        lines.append(f"Peak memory at 1080x1920, preset {preset}: {floats:.1f} float32 per pixel")
    return lines


def show(results: Results, console: Console) -> None:
    """Print the table."""
    for line in describe(results):
        console.print(line, highlight=False)
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for index, name in enumerate(HEAD):
        table.add_column(name, justify="left" if index < TEXT_COLUMNS else "right", no_wrap=True)
    for row in results.rows:
        table.add_row(*row.cells())
    console.print(table)


def write_markdown(results: Results, path: Path, notes: Sequence[str] = ()) -> None:
    """Write the same table as Markdown, with further notes."""
    rules = ["---"] * TEXT_COLUMNS + ["---:"] * (len(HEAD) - TEXT_COLUMNS)
    cells = [HEAD, rules, *(row.cells() for row in results.rows)]
    lines = [f"- {line}" for line in describe(results)]
    lines += ["", *("| " + " | ".join(row) + " |" for row in cells)]
    lines += ["", *(f"- {note}" for note in (*notes, *NOTES)), ""]
    path.write_text("\n".join([f"# Benchmark {path.stem}", "", *lines]), encoding="utf-8")


SIZE, LARGE, THREADS, LANES = (480, 640), (1080, 1920), 2, cpu_lanes()
MOST_NS_PER_PIXEL = 12.0
MOST_NS_PER_PIXEL_JOINT = 6.0
LEAST_RATIO = 70.0
MOST_OVER_FLOOR = 1.3  # of a sweep in two passes: time over that of its bytes at stream bandwidth
PAIR_SIZE, LEAST_PAIR_RATIO = (240, 320), 50.0
MOST_FLOATS_PER_PIXEL = 60.0
# The paper's regulariser has a weight for each unknown on each edge, 12 numbers per pixel where
# the others have 2, and its cycles keep coarser levels of the whole system.
UNBOUNDED = "paper"

# What a run has to measure for these.
_AT_PAIR_SIZE = f"{PAIR_SIZE[0]}x{PAIR_SIZE[1]}"
SELECTION = (
    f"(sweep and (rigid or lexicographic) and not {_AT_PAIR_SIZE}) or "
    f"(pair and balanced and rigid and not cholesky and {_AT_PAIR_SIZE})"
)


def bars(results: Results) -> Iterator[Bar]:
    """Yield every bar with the run's figure."""
    conditions = f"{THREADS} threads, {LANES} lanes"
    row = _find_row(results, "sweep separate", "cholesky", SIZE)
    sweep = f"rigid sweep, edges separate, Cholesky, {SIZE[0]}x{SIZE[1]}, {conditions}"
    yield Bar(f"{sweep}, ns/px", row.time if row else None, MOST_NS_PER_PIXEL)
    yield Bar(
        f"{sweep}, ratio to sweep_red_black", row.ratio if row else None, LEAST_RATIO, at_most=False
    )
    row = _find_row(results, "sweep joint", "closed_form", LARGE)
    sweep = f"rigid sweep, edges joint, closed form, {LARGE[0]}x{LARGE[1]}, {conditions}"
    yield Bar(f"{sweep}, ns/px", row.time if row else None, MOST_NS_PER_PIXEL_JOINT)
    yield Bar(f"{sweep}, time over memory floor", row.over_floor if row else None, None)
    row = _find_row(results, "sweep_unfused joint", "closed_form", LARGE)
    name = f"unfused {sweep}, time over memory floor"
    yield Bar(name, row.over_floor if row else None, MOST_OVER_FLOOR)
    row = _find_row(results, "pair balanced", "closed_form", PAIR_SIZE)
    name = f"pair, balanced, {_AT_PAIR_SIZE}, {conditions}, ratio to the reference"
    yield Bar(name, row.ratio if row else None, LEAST_PAIR_RATIO, at_most=False)
    for preset in get_args(Preset):
        name = f"memory at 1080x1920, {preset}, float32 per pixel"
        bound = None if preset == UNBOUNDED else MOST_FLOATS_PER_PIXEL
        yield Bar(name, results.memory.get(preset), bound)


def _find_row(results: Results, kernel: str, solver: str, size: tuple[int, int]) -> Row | None:
    sought = kernel, "rigid", solver, size, THREADS, LANES
    for row in results.rows:
        if (row.kernel, row.model, row.solver, row.size, row.threads, row.lanes) == sought:
            return row
    return None
