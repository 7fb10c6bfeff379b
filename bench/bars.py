"""The figures the project holds itself to, read from one run."""

from collections.abc import Iterator
from typing import get_args

from bench.report import Results, Row
from bench.shared.bar import Bar
from tisfm.runtime import cpu_lanes
from tisfm.settings import Preset

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
    row = _row(results, "sweep separate", "cholesky", SIZE)
    sweep = f"rigid sweep, edges separate, Cholesky, {SIZE[0]}x{SIZE[1]}, {conditions}"
    yield Bar(f"{sweep}, ns/px", row.time if row else None, MOST_NS_PER_PIXEL)
    yield Bar(
        f"{sweep}, ratio to sweep_red_black", row.ratio if row else None, LEAST_RATIO, at_most=False
    )
    row = _row(results, "sweep joint", "closed_form", LARGE)
    sweep = f"rigid sweep, edges joint, closed form, {LARGE[0]}x{LARGE[1]}, {conditions}"
    yield Bar(f"{sweep}, ns/px", row.time if row else None, MOST_NS_PER_PIXEL_JOINT)
    yield Bar(f"{sweep}, time over memory floor", row.over_floor if row else None, None)
    row = _row(results, "sweep_unfused joint", "closed_form", LARGE)
    name = f"unfused {sweep}, time over memory floor"
    yield Bar(name, row.over_floor if row else None, MOST_OVER_FLOOR)
    row = _row(results, "pair balanced", "closed_form", PAIR_SIZE)
    name = f"pair, balanced, {_AT_PAIR_SIZE}, {conditions}, ratio to the reference"
    yield Bar(name, row.ratio if row else None, LEAST_PAIR_RATIO, at_most=False)
    for preset in get_args(Preset):
        name = f"memory at 1080x1920, {preset}, float32 per pixel"
        bound = None if preset == UNBOUNDED else MOST_FLOATS_PER_PIXEL
        yield Bar(name, results.memory.get(preset), bound)


def _row(results: Results, kernel: str, solver: str, size: tuple[int, int]) -> Row | None:
    sought = kernel, "rigid", solver, size, THREADS, LANES
    for row in results.rows:
        if (row.kernel, row.model, row.solver, row.size, row.threads, row.lanes) == sought:
            return row
    return None
