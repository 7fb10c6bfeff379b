"""Distance to the least energy over work, as a picture."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import Any

from matplotlib.figure import Figure

from bench.shared.curves import CURVES

LEAST = 1e-8  # of gaps: below, single precision decides
MOST_WORK = 130.0


def draw(found: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Write the picture of courses, as `bench.solvers.Course` has them; medians over pairs."""
    sizes = list(dict.fromkeys(course["size"] for course in found))
    names = list(dict.fromkeys(course["method"] for course in found))
    figure = Figure(figsize=(3.4 * len(sizes) + 0.4, 4.2), dpi=130, layout="constrained")
    grid = figure.subplots(1, len(sizes), sharex=True, sharey=True, squeeze=False)[0]
    for axes, size in zip(grid, sizes, strict=True):
        for name, colour in zip(names, CURVES, strict=False):
            mine = [
                course for course in found if (course["size"], course["method"]) == (size, name)
            ]
            points = [
                (work, max(median(gaps), LEAST))
                for work, *gaps in zip(mine[0]["work"], *(c["gap"] for c in mine), strict=True)
                if work <= MOST_WORK
            ]
            axes.plot(
                *zip(*points, strict=True),
                color=colour,
                marker="o",
                markersize=3,
                linewidth=1.3,
                label=name,
            )
        axes.set_title(f"{size[0]}×{size[1]}", fontsize=10)
        axes.set_xlabel("work, sweeps of the finest grid", fontsize=9)
        axes.set_yscale("log")
        axes.axhline(1e-3, color="0.6", linewidth=0.8, linestyle=":")
        axes.axvline(16, color="0.6", linewidth=0.8, linestyle=":")
        axes.grid(alpha=0.25, linewidth=0.6)
        axes.spines[["top", "right"]].set_visible(False)
        axes.tick_params(labelsize=8)
    grid[0].set_ylabel("(E − E*) / (E(0) − E*)", fontsize=9)
    handles, labels = grid[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(names), fontsize=9)
    figure.savefig(path)
