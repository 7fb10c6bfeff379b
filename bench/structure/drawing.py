"""A drawing of the packages of a checkout: boxes in layers, and an arrow for each import."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, Rectangle

from bench.structure.source import Graph, Source, cycles, reachable, storeys

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PREFIX = "tisfm."
ROWS = 10  # modules in a column of a box, at most
LINE, LETTER, TITLE, MARGIN = 0.15, 0.066, 0.52, 0.1  # inches
GAP, STAIRS = 0.35, 1.1  # inches between boxes, and between layers
SWEEPS = 8  # over the layers, to put boxes above the boxes that they import
COLOURS = ("#35618f", "#4d8b57", "#a8622d", "#7b4f9e", "#5f6b73", "#b08a1e", "#2f8c8c", "#8c4a5a")
IN_CYCLE = "#c22121"


@dataclass
class Room:
    """A box with the modules of a package; `x` is its centre and `y` its lower edge, inches."""

    name: str
    modules: list[str]
    lines: int
    x: float = 0.0
    y: float = 0.0

    @property
    def title(self) -> str:
        """Text above the modules."""
        return self.name.removeprefix(PREFIX)

    @property
    def columns(self) -> int:
        """Number of columns of modules."""
        return math.ceil(len(self.modules) / ROWS)

    @property
    def column_width(self) -> float:
        """Width of a column, inches."""
        return LETTER * max(map(len, self.modules)) + MARGIN

    @property
    def width(self) -> float:
        """Width of the box, inches."""
        head = LETTER * 1.25 * max(len(self.title), len(self.subtitle))
        return max(self.columns * self.column_width, head) + 2 * MARGIN

    @property
    def height(self) -> float:
        """Height of the box, inches."""
        rows = math.ceil(len(self.modules) / self.columns)
        return TITLE + rows * LINE + MARGIN

    @property
    def subtitle(self) -> str:
        """Numbers of modules and lines."""
        many = len(self.modules) > 1
        return f"{len(self.modules)} module{'s' * many}, {self.lines} lines"


def rooms_of(source: Source) -> dict[str, Room]:
    """Return the boxes of a checkout, without positions."""
    found: dict[str, Room] = {}
    for name, room in source.rooms.items():
        module = source.modules[name]
        inner = name.removeprefix(module.package).lstrip(".") or "__init__"
        found.setdefault(room, Room(room, [], 0))
        found[room].modules.append(inner)
        found[room].lines += module.lines
    return found


def place(rooms: dict[str, Room], graph: Graph) -> float:
    """Set the position of every box; return the width of the drawing, inches."""
    levels = storeys(graph)
    order: dict[int, list[Room]] = {}
    for name in sorted(rooms):
        order.setdefault(levels[name], []).append(rooms[name])

    def width(storey: list[Room]) -> float:
        return sum(room.width for room in storey) + GAP * (len(storey) - 1)

    widest = max(map(width, order.values()))
    near = {
        name: graph[name] | {other for other in graph if name in graph[other]} for name in graph
    }
    for _ in range(SWEEPS):
        for storey in order.values():
            wishes = {
                room.name: sum(rooms[other].x for other in near[room.name])
                / max(len(near[room.name]), 1)
                for room in storey
            }
            storey.sort(key=lambda room: wishes[room.name])
            spare = (widest - width(storey)) / (len(storey) + 1)
            left = spare
            for room in storey:
                room.x = left + room.width / 2
                left += room.width + spare + GAP
            shift = (widest - (left - GAP)) / 2 - spare / 2
            for room in storey:
                room.x += shift
    floor = 0.0
    for level in sorted(order):
        for room in order[level]:
            room.y = floor
        floor += max(room.height for room in order[level]) + STAIRS
    return widest


def draw(source: Source, path: Path, title: str) -> None:
    """Write the drawing as PNG."""
    graph = source.grouped(source.rooms)
    rooms = rooms_of(source)
    width = place(rooms, graph)
    height = max(room.y + room.height for room in rooms.values())
    figure = Figure(figsize=(width + 0.6, height + 1.2), dpi=80)
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set_xlim(-0.3, width + 0.3)
    axes.set_ylim(-0.4, height + 0.8)
    axes.set_axis_off()
    axes.text(0, height + 0.5, title, fontsize=13, weight="bold", va="center")
    legend = (
        "An arrow points to what is imported, in the colour of the room that imports it; it is "
        "thin where another path leads there, too, and red in a cycle of packages."
    )
    axes.text(0, height + 0.22, legend, fontsize=8, color="#444444", va="center")
    colours = {name: COLOURS[k % len(COLOURS)] for k, name in enumerate(sorted(rooms))}
    circle = cycles(graph)
    for name in graph:
        for other in graph[name]:
            red = any({name, other} <= cycle for cycle in circle)
            implied = any(other in reachable(graph, third) for third in graph[name] - {other})
            _arrow(axes, rooms[name], rooms[other], IN_CYCLE if red else colours[name], implied)
    for name, room in rooms.items():
        _room(axes, room, colours[name])
    figure.savefig(path)


def _room(axes: "Axes", room: Room, colour: str) -> None:
    left, top = room.x - room.width / 2, room.y + room.height
    corner = (left, room.y)
    axes.add_patch(
        Rectangle(corner, room.width, room.height, facecolor="white", edgecolor=colour, lw=1.6)
    )
    axes.text(room.x, top - 0.13, room.title, fontsize=9, weight="bold", ha="center", va="center")
    axes.text(room.x, top - 0.29, room.subtitle, fontsize=7, color=colour, ha="center", va="center")
    rows = math.ceil(len(room.modules) / room.columns)
    for index, name in enumerate(room.modules):
        column, row = divmod(index, rows)
        axes.text(
            left + MARGIN + column * room.column_width,
            top - TITLE - row * LINE,
            name,
            fontsize=7,
            va="center",
        )


def _arrow(axes: "Axes", room: Room, other: Room, colour: str, implied: bool) -> None:
    if room.y == other.y:  # both in one layer, so in one cycle
        start = (room.x, room.y + room.height)
        end = (other.x, other.y + other.height)
        bend = "arc3,rad=-0.3" if room.x < other.x else "arc3,rad=0.15"
    else:
        lean = max(-0.4, min(0.4, (other.x - room.x) / 12))
        start = (room.x + lean * room.width, room.y)
        end = (other.x - lean * other.width, other.y + other.height)
        bend = "arc3,rad=0"
    axes.add_patch(
        FancyArrowPatch(
            start,
            end,
            arrowstyle="-|>",
            connectionstyle=bend,
            mutation_scale=8,
            shrinkA=0,
            shrinkB=0,
            color=colour,
            lw=0.7 if implied else 1.5,
            alpha=0.35 if implied else 0.9,
            zorder=0.5,
        )
    )
