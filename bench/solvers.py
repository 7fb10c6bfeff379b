"""``python -m bench.solvers``: convergence of the linear system.

The system is the first one at a single scale: the paper's data term, edge weights from the image,
and ρ̂ = 0. The energy after some work is compared with the minimum.
"""

import itertools
import math
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median
from typing import Any

import cv2
from matplotlib.figure import Figure

from bench.shared.command import options_parser, output_name
from bench.shared.contest import measure_time
from bench.shared.figures import CURVES, tidy
from bench.shared.results import RESULTS, Table, machine, markdown_page, write_results
from bench.shared.sequences import FlowPair, data_folder, find_pairs, scene_pairs
from tisfm import runtime
from tisfm.camera import Camera
from tisfm.frames import grey_pair
from tisfm.kernels.layout.lanes import LaneGrid
from tisfm.kernels.solve.linear_system import LinearSystem
from tisfm.settings import PAPER_SMOOTHNESS
from tisfm.solver.data_term import Constancy, DataTerm
from tisfm.solver.multigrid import Multigrid
from tisfm.solver.sampling import spline_taps
from tisfm.solver.smoothness import image_driven_factor, mean_step
from tisfm.solver.unknowns import Unknowns

SIZES = ((120, 160), (240, 320), (480, 640), (1080, 1920))  # px, height and width
ALPHA = PAPER_SMOOTHNESS  # λ̂
IMAGE_EDGES = 2.0  # κ of the weights of edges
FOCAL = 600 / 640  # as a share of the width
RELAXATIONS = (1.0, 1.5, 1.9, 1.95)
SWEEPS = (1, 2, 4, 8, 12, 16, 20, 24, 32, 40, 50, 64, 80, 100, 128, 160, 200)
CYCLES = 12  # of multigrid
CONVERGED_CYCLES = 30  # cycles with conjugate gradients that give the minimum
GAPS = (1e-2, 1e-3, 1e-4, 1e-5)
BUDGET = 16.0  # sweeps
ROUNDS = 9  # timed calls of each step
MIN_GAP = 1e-8  # of the picture: rounding to single precision decides smaller gaps
MAX_WORK = 130.0  # sweeps, end of the axis

# Work is counted in sweeps of the finest grid, by the words that are moved: a sweep moves 29 words
# per pixel. Every level has a quarter of the pixels of the finer level, and takes two sweeps, a
# residual with its restriction (25 words, a sweep) and a correction (14 words, half a sweep).
LEVELS = 4 / 3  # pixels of all levels over the pixels of the finest
CYCLE = LEVELS * 3.5  # sweeps per cycle
SET_UP = 1.0  # coarse tensors and weights, 23 words, on all levels
PLANE = 2.5  # conjugate gradients, added to a cycle: 35 words for the scalars, 36 for the step
CONSTANCY = Constancy(brightness=1.0, gradient=0.0, normalization=None, derivatives="cube")


@dataclass(frozen=True)
class EnergyCurve:
    pair: str
    method: str
    size: tuple[int, int]
    work: list[float]  # sweeps of the finest grid
    gap: list[float]  # (E − E*)/(E(0) − E*) after that work

    def work_to(self, gap: float) -> float:
        """Return the work after which the gap is at most `gap`; infinity if it stays larger."""
        return next((w for w, g in zip(self.work, self.gap, strict=True) if g <= gap), math.inf)


class System:
    """The linear system of a pair, resized."""

    def __init__(self, pair: FlowPair, size: tuple[int, int]) -> None:
        height, width = size
        is_smaller = width < pair.frame0.shape[1]
        interpolation = cv2.INTER_AREA if is_smaller else cv2.INTER_LINEAR
        frame0, frame1 = (
            cv2.resize(grey, (width, height), interpolation=interpolation)
            for grey in grey_pair(pair.frame0, pair.frame1)
        )
        grid = LaneGrid(height, width, runtime.lanes())
        self.unknowns = Unknowns(grid, Camera(FOCAL * width), 6)
        self.unknowns.edges = image_driven_factor(grid, frame0, IMAGE_EDGES)
        term = DataTerm(grid, frame0, frame1, spline_taps(frame1), CONSTANCY, mean_step(frame0))
        self.system = LinearSystem(
            grid=grid,
            tensor=grid.allocate(6),
            weights=grid.allocate(2),
            x_hat=self.unknowns.x_hat,
            y_hat=self.unknowns.y_hat,
            alpha=ALPHA,
            stiffness=(1.0,) * 6,
        )
        term.bind_linearise(grid.allocate(2), self.system.tensor)()
        self._update = self.system.bind_weight_update(
            self.unknowns.rho,
            grid.allocate(6),
            term.constraints,
            self.unknowns.edges,
            contrast=math.inf,
            scales=term.scales,
        )
        self.energy()  # also sets the edge weights

    def energy(self) -> float:
        return self._update().energy

    def sweep(self, relaxation: float, sweeps: int = 1) -> None:
        self.system.sweep(self.unknowns.rho, relaxation=relaxation, sweeps=sweeps)

    def multigrid(self) -> Multigrid:
        multigrid = Multigrid(self.unknowns, self.system, solver="cholesky")
        multigrid.coarsen()
        return multigrid


def sweeps_of(system: System, relaxation: float) -> Iterator[tuple[float, float]]:
    finished_sweeps = 0
    for count in SWEEPS:
        system.sweep(relaxation, count - finished_sweeps)
        finished_sweeps = count
        yield float(count), system.energy()


def cycles_of(system: System, *, conjugate: bool) -> Iterator[tuple[float, float]]:
    multigrid = system.multigrid()
    for count in range(1, CYCLES + 1):
        if conjugate:
            multigrid.descend()
        else:
            multigrid.cycle()
        yield SET_UP + count * (CYCLE + PLANE * conjugate), system.energy()


def methods() -> dict[str, Callable[[System], Iterator[tuple[float, float]]]]:
    """Return name → function that yields work and energy."""
    result: dict[str, Callable[[System], Iterator[tuple[float, float]]]] = {}
    for relaxation in RELAXATIONS:
        name = "Gauss–Seidel" if relaxation == 1 else f"over-relaxation {relaxation:g}"
        result[name] = lambda system, value=relaxation: sweeps_of(system, value)  # type: ignore[misc]
    result["multigrid"] = lambda system: cycles_of(system, conjugate=False)
    result["multigrid + CG"] = lambda system: cycles_of(system, conjugate=True)
    return result


def energy_curves(pair: FlowPair, size: tuple[int, int]) -> list[EnergyCurve]:
    """Return the energy of every method over its work, on one system."""
    system = System(pair, size)
    start_energy = system.energy()
    multigrid = system.multigrid()
    for _ in range(CONVERGED_CYCLES):
        multigrid.descend()
    min_energy = system.energy()
    points_of: dict[str, list[tuple[float, float]]] = {}
    for name, method in methods().items():
        system.unknowns.rho[...] = 0
        points_of[name] = list(method(system))
        min_energy = min(min_energy, *(energy for _, energy in points_of[name]))
    return [
        EnergyCurve(
            pair=pair.name,
            method=name,
            size=size,
            work=[work for work, _ in points],
            gap=[(energy - min_energy) / (start_energy - min_energy) for _, energy in points],
        )
        for name, points in points_of.items()
    ]


def wall_times(pair: FlowPair, size: tuple[int, int]) -> dict[str, float]:
    """Return the median time of each step over the time of a sweep in the same turn."""
    system = System(pair, size)
    multigrid = system.multigrid()
    steps: dict[str, Callable[[], object]] = {
        "sweep": lambda: system.sweep(1.0),
        "V-cycle": multigrid.cycle,
        "V-cycle + CG": multigrid.descend,
        "set-up": multigrid.coarsen,
    }
    seconds: dict[str, list[float]] = {name: [] for name in steps}
    for turn in range(ROUNDS + 1):
        for name, step in steps.items():
            _, seconds_of_step = measure_time(step)
            if turn:  # the first turn compiles kernels
                seconds[name].append(seconds_of_step)
    ratios = {
        name: median(a / b for a, b in zip(times, seconds["sweep"], strict=True))
        for name, times in seconds.items()
    }
    return ratios | {"sweep, ns/px": 1e9 * median(seconds["sweep"]) / math.prod(size)}


def gap_table(curves: Sequence[EnergyCurve]) -> Table:
    """Return the remaining gap after `BUDGET` sweeps, and the work to reach each gap."""
    sizes = list(dict.fromkeys(curve.size for curve in curves))
    names = list(dict.fromkeys(curve.method for curve in curves))
    head = ["", "", f"gap after {BUDGET:g}", *(f"to {gap:g}" for gap in GAPS)]
    rows = []
    for size, name in itertools.product(sizes, names):
        group = [c for c in curves if (c.size, c.method) == (size, name)]
        remaining = median(
            min((g for w, g in zip(c.work, c.gap, strict=True) if w <= BUDGET), default=1.0)
            for c in group
        )
        works = [median(curve.work_to(gap) for curve in group) for gap in GAPS]
        limit = f"> {group[0].work[-1]:.0f}"
        cells = [f"{remaining:.1e}", *(f"{w:.1f}" if w < math.inf else limit for w in works)]
        rows.append([f"{size[0]}×{size[1]}", name, *cells])
    return Table(head, rows, text_columns=2)


def time_table(times: dict[tuple[int, int], dict[str, float]]) -> Table:
    names = list(next(iter(times.values())))[1:]
    rows = [
        [f"{height}×{width}", *(f"{values[name]:.2f}" for name in names)]
        for (height, width), values in times.items()
    ]
    return Table(["", *names], rows)


def draw(curves: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Write the picture of the gap over the work, medians over pairs."""
    sizes = list(dict.fromkeys(curve["size"] for curve in curves))
    names = list(dict.fromkeys(curve["method"] for curve in curves))
    figure = Figure(figsize=(3.4 * len(sizes) + 0.4, 4.2), dpi=130, layout="constrained")
    grid = figure.subplots(1, len(sizes), sharex=True, sharey=True, squeeze=False)[0]
    for axes, size in zip(grid, sizes, strict=True):
        for name, colour in zip(names, CURVES, strict=False):
            group = [curve for curve in curves if (curve["size"], curve["method"]) == (size, name)]
            points = [
                (work, max(median(gaps), MIN_GAP))
                for work, *gaps in zip(group[0]["work"], *(c["gap"] for c in group), strict=True)
                if work <= MAX_WORK
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
        tidy(axes)
        axes.tick_params(labelsize=8)
    grid[0].set_ylabel("(E − E*) / (E(0) − E*)", fontsize=9)
    handles, labels = grid[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(names), fontsize=9)
    figure.savefig(path)


def main(arguments: list[str] | None = None) -> int:
    names = ("data", "threads", "smoke", "output")
    options = options_parser("solvers", __doc__, *names).parse_args(arguments)
    runtime.start(threads=options.threads)
    folder = data_folder(options.data)
    pairs = [pair for pair in find_pairs(folder)[0] if pair.group == "middlebury"] if folder else []
    pairs = pairs or scene_pairs(240, 320)
    sizes = SIZES[:1] if options.smoke else SIZES
    curves = [curve for size in sizes for pair in pairs for curve in energy_curves(pair, size)]
    times = {size: wall_times(pairs[0], size) for size in sizes}
    conditions = {
        "pairs": ", ".join(pair.name for pair in pairs) + ", resized; medians over them",
        "system": f"brightness, cube derivatives, λ̂ = {ALPHA:.0f}, β = 1, weights of edges by the "
        f"image (κ = {IMAGE_EDGES:g}) and fixed, f = {FOCAL:g} of the width, from ρ̂ = 0",
        "threads": options.threads,
        **machine(),
    }
    path = RESULTS / output_name(options, "solvers")
    tables = (
        gap_table(curves),
        "Gap: (E − E*)/(E(0) − E*). Work is in sweeps of the finest grid, by the memory to be "
        "moved: a cycle of multigrid is two sweeps, a residual (counted as a sweep) and a "
        f"correction (half) on every level, {CYCLE:.2f} in all; its set-up, once, {SET_UP:g}; "
        f"conjugate gradients {PLANE:g} more a cycle.",
        "Time over the time of one sweep (ω = 1) in the same turn, medians:",
        time_table(times),
    )
    print(markdown_page(*tables))
    picture = f"![Energy over work]({path.stem}.png)"
    records = [asdict(curve) for curve in curves]
    text = markdown_page("# Solvers of the linear system", conditions, *tables, picture)
    write_results(path, text, {**conditions, "courses": records})
    draw(records, path.with_suffix(".png"))
    return 0


if __name__ == "__main__":
    sys.exit(main())
