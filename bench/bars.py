"""The figures the project holds itself to, read from one run."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import get_args

from bench.report import Results, Row
from tisfm.runtime import cpu_lanes
from tisfm.settings import Preset

SIZE, LARGE, THREADS, LANES = (480, 640), (1080, 1920), 2, cpu_lanes()
MOST_NS_PER_PIXEL = 12.0
MOST_NS_PER_PIXEL_JOINT = 6.0
LEAST_RATIO = 70.0
MOST_FLOATS_PER_PIXEL = 60.0

# What a run has to measure for these.
SELECTION = "sweep and (rigid or lexicographic)"


@dataclass(frozen=True)
class Bar:
    """A figure and its bar; `value` is None where the run did not measure it."""

    name: str
    value: float | None
    bound: float
    at_most: bool = True

    @property
    def met(self) -> bool:
        """Whether the figure was measured and keeps to its bar."""
        if self.value is None:
            return False
        return self.value <= self.bound if self.at_most else self.value >= self.bound

    def __str__(self) -> str:
        value = "not measured" if self.value is None else f"{self.value:.1f}"
        words = "at most" if self.at_most else "at least"
        return f"{'pass' if self.met else 'FAIL'}  {self.name}: {value} ({words} {self.bound:g})"


def bars(results: Results) -> Iterator[Bar]:
    """Yield every bar with the run's figure."""
    conditions = f"{THREADS} threads, {LANES} lanes"
    row = _sweep(results, "separate", "cholesky", SIZE)
    sweep = f"rigid sweep, edges separate, Cholesky, {SIZE[0]}x{SIZE[1]}, {conditions}"
    yield Bar(f"{sweep}, ns/px", row and row.time, MOST_NS_PER_PIXEL)
    yield Bar(f"{sweep}, ratio to sweep_red_black", row and row.ratio, LEAST_RATIO, at_most=False)
    row = _sweep(results, "joint", "closed_form", LARGE)
    sweep = f"rigid sweep, edges joint, closed form, {LARGE[0]}x{LARGE[1]}, {conditions}"
    yield Bar(f"{sweep}, ns/px", row and row.time, MOST_NS_PER_PIXEL_JOINT)
    for preset in get_args(Preset):
        name = f"memory at 1080x1920, {preset}, float32 per pixel"
        yield Bar(name, results.memory.get(preset), MOST_FLOATS_PER_PIXEL)


def _sweep(results: Results, edges: str, solver: str, size: tuple[int, int]) -> Row | None:
    for row in results.rows:
        if (row.kernel, row.model, row.solver) == (f"sweep {edges}", "rigid", solver) and (
            row.size,
            row.threads,
            row.lanes,
        ) == (size, THREADS, LANES):
            return row
    return None
