"""Colours and axes of figures, and the figure of a contest: accuracy over time."""

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from matplotlib.transforms import Bbox

from bench.shared.contest import Contest
from bench.shared.contest_report import STANDARD_SIZE, Column, measured_columns, standard_time
from tisfm.show.palette import as_hex, category_colors

# Dark colours first; without yellow, which is too faint for a line. The palette of `tisfm.show` can
# also be read by people with a colour vision deficiency.
BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY = (
    as_hex(category_colors(8)[k]) for k in (5, 6, 3, 7, 1, 2)
)
CURVES = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY)
OWN_COLOUR = VERMILION
PEER_COLOUR = BLUE
LABEL_DIRECTIONS = 16  # directions from a mark in which its label is tried
LABEL_DISTANCES = (7, 10, 14, 20, 28, 38, 50)  # points, at which a label is tried
MIN_LEADER_LENGTH = 14  # points: a label at this distance or more has a line to its mark
MIN_LOGARITHMIC_RATIO = 4  # ratio of largest to smallest error: above, the axis is logarithmic


def tidy(axes: Axes) -> None:
    """Give axes a faint grid and no frame at the top and the right."""
    axes.grid(alpha=0.25, which="major", linewidth=0.6)
    axes.spines[["top", "right"]].set_visible(False)


@dataclass(frozen=True)
class Mark:
    """A method in the plot: its time, s, and its error."""

    name: str
    time: float
    error: float

    @property
    def colour(self) -> str:
        return OWN_COLOUR if self.name.startswith("tisfm") else PEER_COLOUR


def marks(contest: Contest, column: Column) -> list[Mark]:
    """Return the methods that have both a time and an error."""
    result = []
    for method in contest.methods:
        time, error = standard_time(contest, method), column.value(contest, method)
        if time is not None and error is not None:
            result.append(Mark(method, time.median, error))
    return result


def contest_figure(contest: Contest) -> Figure:
    """Return the picture of the contest's first column over time."""
    column = measured_columns(contest)[0]
    methods = marks(contest, column)
    if not methods:
        raise ValueError("no method has both a time and an error: there is nothing to draw")
    figure = Figure(figsize=(8, 5), dpi=150, layout="constrained")
    axes = figure.add_subplot()
    height, width = STANDARD_SIZE
    axes.set_xlabel(f"seconds per {width}×{height} pair, {contest.conditions['threads']} threads")
    axes.set_ylabel(column.title)
    tidy(axes)
    for mark in methods:
        axes.plot(mark.time, mark.error, "o", color=mark.colour, markersize=6)
    _scale(axes, methods)
    figure.draw_without_rendering()
    figure.set_layout_engine("none")  # the axes must not move once labels have positions
    _label(axes, methods)
    return figure


def _scale(axes: Axes, methods: list[Mark]) -> None:
    axes.set_xscale("log")
    plain = FuncFormatter(lambda value, _: f"{value:g}")
    axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axes.xaxis.set_major_formatter(plain)
    axes.xaxis.set_minor_formatter(NullFormatter())
    errors = [mark.error for mark in methods]
    if max(errors) > MIN_LOGARITHMIC_RATIO * min(errors):
        axes.set_yscale("log")
        axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 3, 5)))
        axes.yaxis.set_major_formatter(plain)
        axes.yaxis.set_minor_formatter(NullFormatter())
    axes.margins(x=0.14, y=0.12)


def _label(axes: Axes, methods: list[Mark]) -> None:
    """Put each name beside its mark, where it overlaps no mark, no other name and no edge."""
    pixels = axes.figure.dpi / 72
    positions = {mark: axes.transData.transform((mark.time, mark.error)) for mark in methods}
    occupied_boxes = [Bbox.from_bounds(x - 8, y - 8, 16, 16) for x, y in positions.values()]
    inside = axes.get_window_extent()
    for mark in sorted(methods, key=lambda mark: positions[mark][0]):
        text = axes.annotate(
            mark.name,
            (mark.time, mark.error),
            xytext=(0, 0),
            textcoords="offset points",
            color=mark.colour,
            fontsize=8.5,
        )
        size = text.get_window_extent()
        x, y = positions[mark]
        for dx, dy in _offsets():
            # The label's nearest corner or side is put at the offset.
            left = x + dx * pixels - (0 if dx > 1 else size.width if dx < -1 else size.width / 2)
            low = y + dy * pixels - (0 if dy > 1 else size.height if dy < -1 else size.height / 2)
            bounds = Bbox.from_bounds(left, low, size.width, size.height)
            if bounds.count_overlaps(occupied_boxes) == 0 and _is_within(bounds, inside):
                break
        occupied_boxes.append(bounds)
        text.set_position(((left - x) / pixels, (low - y) / pixels))
        if math.hypot(dx, dy) >= MIN_LEADER_LENGTH:
            start, end = axes.transData.inverted().transform(
                [(x, y), (x + dx * pixels, y + dy * pixels)]
            )
            axes.plot(*zip(start, end, strict=True), color=mark.colour, linewidth=0.6, alpha=0.6)


def _offsets() -> Iterator[tuple[float, float]]:
    """Yield offsets in points: near ones first, and among these the right first."""
    for distance, turn in itertools.product(LABEL_DISTANCES, range(LABEL_DIRECTIONS)):
        half = (turn + 1) // 2 * (-1) ** turn  # 0, -1, 1, -2, 2 … sixteenths of a turn
        angle = 2 * math.pi * half / LABEL_DIRECTIONS
        yield distance * math.cos(angle), distance * math.sin(angle)


def _is_within(bounds: Bbox, frame: Bbox) -> bool:
    return bool(
        bounds.x0 >= frame.x0
        and bounds.x1 <= frame.x1
        and bounds.y0 >= frame.y0
        and bounds.y1 <= frame.y1
    )
