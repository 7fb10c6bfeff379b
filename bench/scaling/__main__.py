"""``python -m bench.scaling``: time and memory of a whole pair over its size, and where it goes.

Pairs are renderings of one scene, whose motion grows with the image. Every preset runs on every
number of threads in a process of its own; sizes take turns within it, and with them OpenCV's DIS
on the pair of one size.
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
from typing import Any, get_args

import cv2
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator

from bench.shared.figures import BLUE, GREEN, PURPLE, VERMILION
from bench.shared.results import RESULTS, ROOT, Bar, machine
from tisfm.scenes import two_blocks
from tisfm.settings import Preset

SIZES = ("120x160", "240x320", "480x640", "1080x1920", "2160x3840")
SMOKE_SIZES = ("48x64", "96x128")
COLOURS = {"fast": GREEN, "balanced": BLUE, "accurate": VERMILION, "paper": PURPLE}


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(prog="python -m bench.scaling", description=__doc__)
    parser.add_argument("--sizes", nargs="+", default=list(SIZES), metavar="HxW")
    presets = ["fast", "balanced", "accurate"]
    parser.add_argument("--preset", nargs="+", choices=get_args(Preset), default=presets)
    parser.add_argument("--threads", nargs="+", type=int, default=[1, 2], metavar="N")
    parser.add_argument("--rounds", type=int, default=5, metavar="N", help="timed calls of each")
    parser.add_argument("--smoke", action="store_true", help="two small sizes, one preset, a round")
    parser.add_argument("--output", metavar="NAME", help="name of the files in bench/results")
    options = parser.parse_args(arguments)
    if options.smoke:
        options.sizes, options.preset, options.rounds = list(SMOKE_SIZES), ["fast"], 1
    if options.rounds < 1 or min(options.threads) < 1:
        parser.error("--rounds and --threads take numbers of at least 1")
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
    """Return times and shares of a preset on so many threads."""
    peer = PEER_SIZE if PEER_SIZE in pairs else list(pairs)[-1]
    request = {
        "preset": preset,
        "threads": threads,
        "pairs": pairs,
        "rounds": rounds,
        "peer": peer,
    }
    answer = subprocess.run(
        [sys.executable, "-m", "bench.scaling.worker"],
        input=json.dumps(request) + "\n",
        cwd=ROOT,
        check=True,
        stdout=subprocess.PIPE,
        text=True,
    )
    return {"preset": preset, "threads": threads, **json.loads(answer.stdout)}


def memory(preset: str, size: str) -> float:
    """Return the float32 per pixel that a pair takes at its peak."""
    command = [sys.executable, "-m", "bench.pair_memory", preset, size]
    output = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True)
    return json.loads(output.stdout)["floats_per_pixel"]


FLOAT = 4  # bytes
GIB = 2**30
MIDDLE, LARGE, LARGEST = "480x640", "1080x1920", "2160x3840"
PEER_SIZE = MIDDLE  # of the pair that OpenCV's DIS is timed on
# None: its time is as long as the bar was, so that passing would be chance; `bench.regression`
# tells whether it has grown.
MOST_OVER_PEER = {("balanced", LARGE): 57.0, ("fast", PEER_SIZE): None}
MOST_GROWTH = 1.15
MOST_GIB = 3.0


def size_of(text: str) -> tuple[int, int]:
    """Return (height, width) of a size as the command line has it."""
    height, _, width = text.partition("x")
    return int(height), int(width)


def per_pixel(entry: dict[str, Any], size: str) -> float:
    """Return the median time of a run's pair, ns per pixel."""
    return median(entry["times"][size]) / math.prod(size_of(size)) * 1e9


def over_peer(entry: dict[str, Any], size: str) -> float:
    """Return the time of a run's pair over that of the peer in the same round, the median."""
    return over(entry["times"][size], entry["peer"]["times"])


def over(times: list[float], others: list[float]) -> float:
    """Return the median of the ratios of times in the same rounds."""
    return median(time / other for time, other in zip(times, others, strict=True))


def gib(floats: float, size: str) -> float:
    """Return the GiB of so many float32 per pixel."""
    return floats * FLOAT * math.prod(size_of(size)) / GIB


def bars(found: dict[str, Any]) -> Iterator[Bar]:
    """Yield the bars of what the run has measured, on the most threads."""
    most = max(entry["threads"] for entry in found["runs"])
    for entry in found["runs"]:
        if entry["threads"] != most:
            continue
        preset = entry["preset"]
        for (held, size), bound in MOST_OVER_PEER.items():
            if held == preset and size in entry["times"] and entry["peer"]["size"] == PEER_SIZE:
                name = f"{preset}, {size}, {most} threads, time over {entry['peer']['name']}'s at "
                yield Bar(name + PEER_SIZE, over_peer(entry, size), bound)
        if {MIDDLE, LARGE} <= set(entry["times"]):
            growth = over(entry["times"][LARGE], entry["times"][MIDDLE])
            growth *= math.prod(size_of(MIDDLE)) / math.prod(size_of(LARGE))
            name = f"{preset}, {most} threads, growth of time per pixel, {MIDDLE} to {LARGE}"
            yield Bar(name, growth, MOST_GROWTH)
        if LARGEST in found["memory"].get(preset, {}):
            used = gib(found["memory"][preset][LARGEST], LARGEST)
            yield Bar(f"{preset}, {LARGEST}, peak memory, GiB", used, MOST_GIB)


def report(found: dict[str, Any]) -> str:
    """Return the Markdown of all figures."""
    sizes, conditions = found["sizes"], found["conditions"]
    lines = ["# Scaling of a whole pair", ""]
    lines += [f"- {name}: {value}" for name, value in conditions.items()]
    lines += [
        "- two_blocks at every size, whose motion grows with it. Median of the rounds, and in "
        "brackets the least and the most; growth is that of time per pixel from the size before.",
        "",
        "| preset | threads | size | s | ns/px | growth |",
        "| --- | ---: | --- | ---: | ---: | ---: |",
    ]
    for entry in found["runs"]:
        before = None
        for size in sizes:
            times = entry["times"][size]
            each = per_pixel(entry, size)
            growth = "–" if before is None else f"{each / before:.2f}"
            spread = f"{median(times):.3g} [{min(times):.3g}–{max(times):.3g}]"
            lines.append(
                f"| {entry['preset']} | {entry['threads']} | {size} | {spread} | {each:.0f} "
                f"| {growth} |"
            )
            before = each
    peer = found["runs"][0]["peer"]
    lines += ["", f"## Time over that of {peer['name']} at {peer['size']}, in the same rounds", ""]
    lines += ["| preset | threads | its time, s | " + " | ".join(sizes) + " |"]
    lines += ["| --- |" + " ---: |" * (2 + len(sizes))]
    for entry in found["runs"]:
        cells = [f"{over_peer(entry, size):.2f}" for size in sizes]
        unit = f"{median(entry['peer']['times']):.3g}"
        head = f"| {entry['preset']} | {entry['threads']} | {unit} | "
        lines.append(head + " | ".join(cells) + " |")
    threads = sorted({entry["threads"] for entry in found["runs"]})
    if len(threads) > 1:
        least, most = threads[0], threads[-1]
        lines += ["", f"## Speed-up from {least} to {most} threads", ""]
        lines += ["| preset | " + " | ".join(sizes) + " |", "| --- |" + " ---: |" * len(sizes)]
        for preset in found["presets"]:
            one, two = (_of(found, preset, count)["times"] for count in (least, most))
            cells = [f"{median(one[size]) / median(two[size]):.2f}" for size in sizes]
            lines.append(f"| {preset} | " + " | ".join(cells) + " |")
    lines += ["", "## Peak memory", "", "| preset | size | float32 per pixel | GiB |"]
    lines += ["| --- | --- | ---: | ---: |"]
    for preset, by_size in found["memory"].items():
        for size, floats in by_size.items():
            lines.append(f"| {preset} | {size} | {floats:.1f} | {gib(floats, size):.2f} |")
    lines += ["", f"## Where the time goes, % of a pair ({threads[-1]} threads)"]
    for preset in found["presets"]:
        shares = _of(found, preset, threads[-1])["shares"]
        labels = list(dict.fromkeys(label for size in sizes for label in shares[size]))
        lines += ["", f"### {preset}", "", "| stage | " + " | ".join(sizes) + " |"]
        lines += ["| --- |" + " ---: |" * len(sizes)]
        for label in labels:
            cells = [f"{100 * shares[size].get(label, 0):.1f}" for size in sizes]
            lines.append(f"| {label} | " + " | ".join(cells) + " |")
    if checked := list(bars(found)):
        lines += ["", "## Bars", "", *(f"- {bar}" for bar in checked)]
    return "\n".join(lines) + "\n"


def _of(found: dict[str, Any], preset: str, threads: int) -> dict[str, Any]:
    return next(
        entry for entry in found["runs"] if (entry["preset"], entry["threads"]) == (preset, threads)
    )


def draw(found: dict[str, Any], path: Path) -> None:
    """Write the picture of time per pixel over the size."""
    figure = Figure(figsize=(6.5, 4.2), dpi=150, layout="constrained")
    axes = figure.add_subplot()
    pixels = [math.prod(size_of(size)) for size in found["sizes"]]
    most = max(entry["threads"] for entry in found["runs"])
    for entry in found["runs"]:
        axes.plot(
            pixels,
            [per_pixel(entry, size) for size in found["sizes"]],
            color=COLOURS[entry["preset"]],
            linestyle="-" if entry["threads"] == most else ":",
            marker="o",
            markersize=3.5,
            label=f"{entry['preset']}, {entry['threads']} thread{'s' * (entry['threads'] > 1)}",
        )
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xticks(pixels, [size.replace("x", "×") for size in found["sizes"]], minor=False)
    axes.minorticks_off()
    axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axes.yaxis.set_major_formatter("{x:g}")
    axes.set_ylabel("ns per pixel of a whole pair")
    axes.grid(alpha=0.25, linewidth=0.6)
    axes.spines[["top", "right"]].set_visible(False)
    figure.legend(loc="outside lower center", ncols=3, fontsize=8)
    figure.savefig(path)


def main(arguments: list[str] | None = None) -> int:
    """Return 0, or 1 where a bar was missed; whatever else fails raises."""
    options = parse(arguments)
    with tempfile.TemporaryDirectory(prefix="tisfm-scaling-") as name:
        pairs = render(options.sizes, Path(name))
        runs = [
            run(preset, threads, pairs, options.rounds)
            for preset in options.preset
            for threads in options.threads
        ]
    found = {
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
            preset: {size: memory(preset, size) for size in options.sizes[-2:]}
            for preset in options.preset
        },
    }
    path = RESULTS / (options.output or ("smoke-scaling" if options.smoke else "scaling"))
    RESULTS.mkdir(exist_ok=True)
    path.with_suffix(".json").write_text(json.dumps(found, indent=1), encoding="utf-8")
    path.with_suffix(".md").write_text(report(found), encoding="utf-8")
    draw(found, path.with_suffix(".png"))
    print(report(found))
    return 0 if all(bar.met for bar in bars(found)) else 1


if __name__ == "__main__":
    sys.exit(main())
