"""The table of stored timings, and the bounds of the figures of a run."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

from rich.console import Console

from bench.shared.results import Bar, Table, cell, markdown_page, write_results
from tisfm.runtime import cpu_lanes
from tisfm.settings import Preset

HEAD = (
    "kernel", "size", "model", "solver", "lanes", "threads", "ns/px", "IQR", "GB/s", "stream",
    "NumPy ns/px", "ratio",
)  # fmt: skip
SIZE = (480, 640)  # px, height and width of the pair for the bounds
LARGE = (1080, 1920)  # px
PAIR_SIZE = (240, 320)  # px, of the pair that the reference also solves
THREADS = 2  # of the figures with bounds
LANES = cpu_lanes()
# Bounds of figures, set by hand from measurements of earlier states.
MAX_NS_PER_PIXEL = 12.0  # ns per pixel of a sweep, edges separate, Cholesky
MAX_NS_PER_PIXEL_JOINT = 6.0  # ns per pixel of a sweep, edges joint, closed form
MIN_RATIO = 70.0  # time of the reference's sweep over the kernel's
MAX_OVER_FLOOR = 1.3  # time of a sweep in two passes over the time of its bytes at stream bandwidth
MIN_PAIR_RATIO = 50.0  # time of the reference's pair over the library's
MAX_FLOATS_PER_PIXEL = 60.0  # float32 per pixel, peak memory
# This preset has no bound of memory: its regulariser has 12 weights per pixel, other presets have
# 2, and its cycles keep coarser levels of the whole system.
PRESET_WITHOUT_MEMORY_BOUND = "paper"

# Value of pytest -k that selects the benchmarks with bounds.
_AT_PAIR_SIZE = f"{PAIR_SIZE[0]}x{PAIR_SIZE[1]}"
SELECTION = (
    f"(sweep and (rigid or lexicographic) and not {_AT_PAIR_SIZE}) or "
    f"(pair and balanced and rigid and not cholesky and {_AT_PAIR_SIZE})"
)
NOTES = (
    "ns/px: median time of a call over the number of pixels, with the interquartile range (a dash: "
    "timed once); the call includes the launch of the kernel.",
    "GB/s: the bytes that a kernel must move (bench/kernels/traffic.py), each array counted once. "
    "Stream: as a share of the stream bandwidth of the memory with the same number of threads; "
    "above 100% if the arrays stay in the caches.",
    "NumPy: the reference, float64, BLAS on one thread, in the same process; its answer was "
    "compared with the kernel's before timing. image_to_lanes is compared with a padded "
    "copy, lanes_to_images and relayout with a copy.",
    "sweep_unfused: one pass over memory for each color, where the library makes one pass for "
    "both; GB/s counts the bytes of each pass. matching_cost and aggregate: of 16 hypotheses.",
    "pair: coarse to fine to the end of its iterations (paper: 5 outer iterations of sweeps, "
    "balanced: 3 for each linearisation), beside the reference on the same pyramids. Where the "
    "reference was not run, agreement was checked on the same scene at 240x320.",
)


@dataclass(frozen=True)
class Row:
    """One timed kernel or pair. Times are in ns per pixel; None for a missing figure.

    `lanes` is 0 for a kernel on plain images.
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
        """Time over the time of as many bytes at stream bandwidth."""
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
            cell(self.iqr, ".2f"),
            cell(self.bandwidth, ".1f"),
            cell(self.share, ".0%"),
            cell(self.numpy, ".1f"),
            cell(self.ratio, ".1f"),
        ]


@dataclass(frozen=True)
class Results:
    # As in the JSON of pytest-benchmark, with the versions of NumPy and Taichi.
    machine: dict[str, Any]
    rows: list[Row]
    streams: dict[tuple[int, str], float]  # (threads, name) → GB/s
    lexicographic: dict[str, float]  # size → ns per pixel of the reference's plain loop
    memory: dict[str, float]  # preset → float32 per pixel at the peak


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


def describe(results: Results) -> list[str]:
    """Return lines on the machine, and figures that are not in the table."""
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


def table_of(results: Results) -> Table:
    return Table(HEAD, [row.cells() for row in results.rows], text_columns=4)


def show(results: Results, console: Console) -> None:
    for line in describe(results):
        console.print(line, highlight=False)
    console.print(table_of(results).rich())


def write_markdown(results: Results, path: Path, notes: Sequence[str] = ()) -> None:
    """Write the table as Markdown, with further notes."""
    title = f"# Benchmark {path.stem}"
    write_results(
        path, markdown_page(title, describe(results), table_of(results), [*notes, *NOTES])
    )


def bars(results: Results) -> Iterator[Bar]:
    """Yield every bar with the figure of the run."""
    conditions = f"{THREADS} threads, {LANES} lanes"
    row = _find_row(results, "sweep separate", "cholesky", SIZE)
    sweep = f"rigid sweep, edges separate, Cholesky, {SIZE[0]}x{SIZE[1]}, {conditions}"
    yield Bar(f"{sweep}, ns/px", row.time if row else None, MAX_NS_PER_PIXEL)
    yield Bar(
        f"{sweep}, ratio to sweep_red_black", row.ratio if row else None, MIN_RATIO, at_most=False
    )
    row = _find_row(results, "sweep joint", "closed_form", LARGE)
    sweep = f"rigid sweep, edges joint, closed form, {LARGE[0]}x{LARGE[1]}, {conditions}"
    yield Bar(f"{sweep}, ns/px", row.time if row else None, MAX_NS_PER_PIXEL_JOINT)
    yield Bar(f"{sweep}, time over memory floor", row.over_floor if row else None, None)
    row = _find_row(results, "sweep_unfused joint", "closed_form", LARGE)
    name = f"unfused {sweep}, time over memory floor"
    yield Bar(name, row.over_floor if row else None, MAX_OVER_FLOOR)
    row = _find_row(results, "pair balanced", "closed_form", PAIR_SIZE)
    name = f"pair, balanced, {_AT_PAIR_SIZE}, {conditions}, ratio to the reference"
    yield Bar(name, row.ratio if row else None, MIN_PAIR_RATIO, at_most=False)
    for preset in get_args(Preset):
        name = f"memory at 1080x1920, {preset}, float32 per pixel"
        bound = None if preset == PRESET_WITHOUT_MEMORY_BOUND else MAX_FLOATS_PER_PIXEL
        yield Bar(name, results.memory.get(preset), bound)


def _find_row(results: Results, kernel: str, solver: str, size: tuple[int, int]) -> Row | None:
    key = kernel, "rigid", solver, size, THREADS, LANES
    for row in results.rows:
        if (row.kernel, row.model, row.solver, row.size, row.threads, row.lanes) == key:
            return row
    return None
