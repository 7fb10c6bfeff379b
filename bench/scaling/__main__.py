"""``python -m bench.scaling``: time and memory of a pair, and of its stages, over its size.

Pairs are renderings of one scene, whose motion grows with the image. Each preset and number of
threads has its own process. There, the sizes are timed in turns, and for one size also OpenCV's
DIS.
"""

import argparse
import json
import math
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from statistics import median
from typing import Any

import cv2
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator

from bench.pair_memory import measure_in_process
from bench.shared.command import options_parser, output_name
from bench.shared.figures import BLUE, GREEN, PURPLE, VERMILION, tidy
from bench.shared.results import (
    RESULTS,
    ROOT,
    Bar,
    Table,
    cell,
    exit_code,
    machine,
    markdown_page,
    write_results,
)
from tisfm.scenes import two_blocks

SIZES = ("120x160", "240x320", "480x640", "1080x1920", "2160x3840")
SMOKE_SIZES = ("48x64", "96x128")
COLOURS = {"fast": GREEN, "balanced": BLUE, "accurate": VERMILION, "paper": PURPLE}


def parse(arguments: list[str] | None) -> argparse.Namespace:
    presets = ["fast", "balanced", "accurate"]
    parser = options_parser(
        "scaling", __doc__, "preset", "rounds", "smoke", "output", preset=presets
    )
    parser.add_argument("--sizes", nargs="+", default=list(SIZES), metavar="HxW")
    parser.add_argument("--threads", nargs="+", type=int, default=[1, 2], metavar="N")
    options = parser.parse_args(arguments)
    if options.smoke:
        options.sizes, options.preset, options.rounds = list(SMOKE_SIZES), ["fast"], 1
    return options


def render(sizes: list[str], folder: Path) -> dict[str, str]:
    """Write the pair of every size to a file; return size → path."""
    paths = {}
    for size in sizes:
        pair = two_blocks(*size_of(size), samples=1)
        paths[size] = str(folder / f"{size}.npz")
        np.savez(paths[size], frame0=pair.frame0, frame1=pair.frame1, focal=pair.camera.focal)
    return paths


def run(preset: str, threads: int, pairs: dict[str, str], rounds: int) -> dict[str, Any]:
    """Return the times of a preset with a number of threads, and the shares of its stages."""
    peer = PEER_SIZE if PEER_SIZE in pairs else list(pairs)[-1]
    request = {"preset": preset, "threads": threads, "pairs": pairs, "rounds": rounds, "peer": peer}
    answer = subprocess.run(
        [sys.executable, "-m", "bench.scaling.worker"],
        input=json.dumps(request) + "\n",
        cwd=ROOT,
        check=True,
        stdout=subprocess.PIPE,
        text=True,
    )
    return {"preset": preset, "threads": threads, **json.loads(answer.stdout)}


FLOAT = 4  # bytes
GIB = 2**30  # bytes
MIDDLE = "480x640"
LARGE = "1080x1920"
LARGEST = "2160x3840"
PEER_SIZE = MIDDLE  # size of the pair for OpenCV's DIS
# Preset and size → maximum time over the peer's. None: the time is so close to its former bound
# that chance would decide; `bench.regression` shows whether the time has grown.
MAX_OVER_PEER = {("balanced", LARGE): 57.0, ("fast", PEER_SIZE): None}
MAX_GROWTH = 1.15  # of the time per pixel from MIDDLE to LARGE; set by hand
MAX_MEMORY = 3.0  # GiB, peak memory of a pair of LARGEST; set by hand


def size_of(text: str) -> tuple[int, int]:
    """Return (height, width) of a size HxW."""
    height, _, width = text.partition("x")
    return int(height), int(width)


def per_pixel(entry: dict[str, Any], size: str) -> float:  # median time, ns
    return median(entry["times"][size]) / math.prod(size_of(size)) * 1e9


def ratio_to_peer(entry: dict[str, Any], size: str) -> float:
    """Return the median over the rounds of the time of a pair over the peer's."""
    return median_ratio(entry["times"][size], entry["peer"]["times"])


def median_ratio(times: list[float], others: list[float]) -> float:
    """Return the median of the ratios of times in the same rounds."""
    return median(time / other for time, other in zip(times, others, strict=True))


def gib(floats: float, size: str) -> float:
    """Return the memory of a number of float32 per pixel, GiB."""
    return floats * FLOAT * math.prod(size_of(size)) / GIB


def bars(figures: dict[str, Any]) -> Iterator[Bar]:
    """Yield the bars of the figures that were measured with the most threads."""
    threads = max(entry["threads"] for entry in figures["runs"])
    for entry in figures["runs"]:
        if entry["threads"] != threads:
            continue
        preset = entry["preset"]
        for (bounded_preset, size), bound in MAX_OVER_PEER.items():
            if (
                bounded_preset == preset
                and size in entry["times"]
                and entry["peer"]["size"] == PEER_SIZE
            ):
                name = (
                    f"{preset}, {size}, {threads} threads, time over {entry['peer']['name']}'s at "
                )
                yield Bar(name + PEER_SIZE, ratio_to_peer(entry, size), bound)
        if {MIDDLE, LARGE} <= set(entry["times"]):
            growth = median_ratio(entry["times"][LARGE], entry["times"][MIDDLE])
            growth *= math.prod(size_of(MIDDLE)) / math.prod(size_of(LARGE))
            name = f"{preset}, {threads} threads, growth of time per pixel, {MIDDLE} to {LARGE}"
            yield Bar(name, growth, MAX_GROWTH)
        if LARGEST in figures["memory"].get(preset, {}):
            memory = gib(figures["memory"][preset][LARGEST], LARGEST)
            yield Bar(f"{preset}, {LARGEST}, peak memory, GiB", memory, MAX_MEMORY)


def report(figures: dict[str, Any]) -> str:
    """Return all figures as Markdown."""
    sizes, runs = figures["sizes"], figures["runs"]
    rows = []
    for entry in runs:
        previous_time = None
        for size in sizes:
            times, time = entry["times"][size], per_pixel(entry, size)
            spread = f"{median(times):.3g} [{min(times):.3g}–{max(times):.3g}]"
            growth = cell(None if previous_time is None else time / previous_time, ".2f")
            name = [entry["preset"], str(entry["threads"]), size]
            rows.append([*name, spread, f"{time:.0f}", growth])
            previous_time = time
    blocks: list[str | list[str] | Table] = [
        "`two_blocks` at every size; its motion grows with the size. Median of the rounds, in "
        "brackets the lowest and the highest. Growth: time per pixel over the previous size's.",
        Table(["preset", "threads", "size", "s", "ns/px", "growth"], rows),
        f"## Time over the time of {runs[0]['peer']['name']} at {runs[0]['peer']['size']}, in the "
        "same rounds",
        Table(
            ["preset", "threads", "its time, s", *sizes],
            [
                [
                    entry["preset"],
                    str(entry["threads"]),
                    f"{median(entry['peer']['times']):.3g}",
                    *(f"{ratio_to_peer(entry, size):.2f}" for size in sizes),
                ]
                for entry in runs
            ],
        ),
    ]
    threads = sorted({entry["threads"] for entry in runs})
    if len(threads) > 1:
        rows = []
        for preset in figures["presets"]:
            one, two = (_find_run(figures, preset, threads[k])["times"] for k in (0, -1))
            rows.append([preset, *(f"{median(one[s]) / median(two[s]):.2f}" for s in sizes)])
        title = f"## Speed-up from {threads[0]} to {threads[-1]} threads"
        blocks += [title, Table(["preset", *sizes], rows)]
    rows = [
        [preset, size, f"{floats:.1f}", f"{gib(floats, size):.2f}"]
        for preset, by_size in figures["memory"].items()
        for size, floats in by_size.items()
    ]
    head = ["preset", "size", "float32 per pixel", "GiB"]
    blocks += ["## Peak memory", Table(head, rows, text_columns=2)]
    blocks.append(f"## Time of each stage, % of a pair ({threads[-1]} threads)")
    for preset in figures["presets"]:
        shares = _find_run(figures, preset, threads[-1])["shares"]
        labels = dict.fromkeys(label for size in sizes for label in shares[size])
        rows = [
            [label, *(f"{100 * shares[size].get(label, 0):.1f}" for size in sizes)]
            for label in labels
        ]
        blocks += [f"### {preset}", Table(["stage", *sizes], rows)]
    if bar_lines := list(map(str, bars(figures))):
        blocks += ["## Bars", bar_lines]
    return markdown_page("# Scaling of a whole pair", figures["conditions"], *blocks)


def _find_run(figures: dict[str, Any], preset: str, threads: int) -> dict[str, Any]:
    return next(
        entry
        for entry in figures["runs"]
        if (entry["preset"], entry["threads"]) == (preset, threads)
    )


def draw(figures: dict[str, Any], path: Path) -> None:
    figure = Figure(figsize=(6.5, 4.2), dpi=150, layout="constrained")
    axes = figure.add_subplot()
    pixels = [math.prod(size_of(size)) for size in figures["sizes"]]
    threads = max(entry["threads"] for entry in figures["runs"])
    for entry in figures["runs"]:
        axes.plot(
            pixels,
            [per_pixel(entry, size) for size in figures["sizes"]],
            color=COLOURS[entry["preset"]],
            linestyle="-" if entry["threads"] == threads else ":",
            marker="o",
            markersize=3.5,
            label=f"{entry['preset']}, {entry['threads']} thread{'s' * (entry['threads'] > 1)}",
        )
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xticks(pixels, [size.replace("x", "×") for size in figures["sizes"]], minor=False)
    axes.minorticks_off()
    axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axes.yaxis.set_major_formatter("{x:g}")
    axes.set_ylabel("ns per pixel of a whole pair")
    tidy(axes)
    figure.legend(loc="outside lower center", ncols=3, fontsize=8)
    figure.savefig(path)


def main(arguments: list[str] | None = None) -> int:
    """Return 0, or 1 if a bar was missed."""
    options = parse(arguments)
    with tempfile.TemporaryDirectory(prefix="tisfm-scaling-") as name:
        pairs = render(options.sizes, Path(name))
        runs = [
            run(preset, threads, pairs, options.rounds)
            for preset in options.preset
            for threads in options.threads
        ]
    figures = {
        "conditions": {
            **machine(),
            "OpenCV": cv2.__version__,
            "lanes": runs[0]["lanes"],
            "rounds": options.rounds,
        },
        "sizes": options.sizes,
        "presets": options.preset,
        "runs": runs,
        "memory": {
            preset: {size: measure_in_process(preset, size) for size in options.sizes[-2:]}
            for preset in options.preset
        },
    }
    path = RESULTS / output_name(options, "scaling")
    write_results(path, report(figures), figures)
    draw(figures, path.with_suffix(".png"))
    print(report(figures))
    return exit_code(bars(figures))


if __name__ == "__main__":
    sys.exit(main())
