"""What the page says, as HTML: the legend, the reading of a pixel, a distance, the status.

Markup is written as literals of `markupsafe.Markup`, whose ``format`` and ``join`` escape every
plain text that is put into them. `set_html` alone gives it to the page.
"""

from collections.abc import Iterable
from typing import Any

import numpy as np
from markupsafe import Markup

from tisfm.errors import InputTypeError
from tisfm.results.frame import PixelReading, ViewFrame
from tisfm.results.result import Result
from tisfm.status import STATUSES, UNKNOWN
from tisfm.view.colors import Legend, Quantity, Ranges, legend

_BLOCK = "font-size:0.8em;padding:0.1em 0.75em 0.3em;line-height:1.35"


def things_in(frame: ViewFrame) -> set[int]:
    """Return the labels of things that are seen in a frame."""
    return set() if frame.labels is None else {int(k) for k in np.unique(frame.labels) if k}


def legend_of(
    result: Result, quantity: Quantity, ranges: Ranges, things: set[int]
) -> Legend | None:
    """Return what colours of a quantity mean in a result.

    Parameters
    ----------
    result : Result
    quantity : str
    ranges : Ranges
    things : set of int
        Labels that are seen, for a result that does not name its things.
    """
    named = tuple(thing.id for thing in result.objects) or tuple(sorted(things))
    own = "harmonic mean depths of the frame"
    return legend(quantity, ranges, result.unit if result.has_one_scale else own, named)


def set_html(control: Any, content: Markup) -> None:
    """Show HTML in a control of viser, which does not escape it.

    Raises
    ------
    TypeError
        If it is plain text: its characters are not escaped.
    """
    if not isinstance(content, Markup):
        raise InputTypeError(f"content is {content!r}: expected Markup, in which texts are escaped")
    control.content = content.encode("utf-8", "replace").decode()  # names may have lone surrogates


def legend_html(legend: Legend | None) -> Markup:
    """Return a legend: a bar with numbers, or a patch for each thing."""
    if legend is None:
        return Markup()
    title = Markup("<div>{}</div>").format(legend.title)
    if legend.is_bar:
        return _block(
            title,
            Markup(
                '<div style="height:0.8em;background:linear-gradient(to right,{})"></div>'
            ).format(",".join(legend.colors)),
            Markup('<div style="display:flex;justify-content:space-between">{}</div>').format(
                Markup().join(Markup("<span>{}</span>").format(tick) for tick in legend.ticks)
            ),
        )
    rows = (
        Markup(
            '<div><span style="display:inline-block;width:0.8em;height:0.8em;margin-right:0.4em;'
            'background:{}"></span>{}</div>'
        ).format(color, tick)
        for color, tick in zip(legend.colors, legend.ticks, strict=True)
    )
    return _block(title, *rows)


def reading_html(reading: PixelReading | None, unit: str) -> Markup:
    """Return what is known of a pixel, a line for each quantity, with deviations."""
    if reading is None:
        return _block("Click a point, or a pixel of the picture in the frustum.")
    rows = [("pixel", f"column {reading.column}, row {reading.row}")]
    if reading.depth is None:
        rows.append(("Z", "no depth"))
    else:
        rows.append(("Z", f"{_with_deviation([reading.depth], [reading.depth_std])} ({unit})"))
    rows.append(("τ", _vector(reading.tau, reading.tau_std, "1/frame")))
    rows.append(("ω", _vector(reading.omega, None, "rad/frame")))
    rows.append(("flow", _vector(reading.flow, reading.flow_std, "px/frame")))
    if reading.confidence is not None:
        rows.append(("confidence", f"{reading.confidence:.3f}"))
    if reading.label is not None:
        rows.append(("object", f"thing {reading.label}" if reading.label else "at rest"))
    if reading.hidden:
        rows.append(("", "not visible in the next frame"))
    cells = Markup().join(
        Markup(
            '<tr><td style="padding-right:0.7em;vertical-align:top"><b>{}</b></td><td>{}</td></tr>'
        ).format(name, value)
        for name, value in rows
    )
    return _block(Markup('<table data-testid="reading">{}</table>').format(cells))


def outside_html(row: int, column: int, shape: tuple[int, int]) -> Markup:
    """Return that there is no such pixel, and how many rows and columns the frame has."""
    height, width = shape
    text = f"Column {column}, row {row} is outside: the frame has {height} × {width}"
    return _marked("outside", f"{text}, rows by columns.")


def status_html(result: Result, frame: ViewFrame | None, number: int, fault: str = "") -> Markup:
    """Return which frame is looked at, its time, its status, and where it is of no use why."""
    parts: list[str] = [
        Markup("<b>{}</b>, {} of {}").format(result.names[number], number + 1, len(result.names))
    ]
    time = result.times[number]
    if time is not None:
        parts.append(f"{time:.3f} s")
    if fault:
        parts.append(fault)
    elif frame is not None:
        status = frame.status
        parts.append(str(status))
        if status not in STATUSES:
            parts.append(UNKNOWN)
        if str(status) != "converged" and status.message:
            parts.append(status.message)
        if result.has_one_scale and result.piece[number] < 0:
            parts.append("it has no pose: it is shown at the origin")
    return _marked("status", *parts)


def note_html(text: str) -> Markup:
    """Return a note below a control."""
    return _marked("note", text) if text else Markup()


def waiting_html(reason: str, how_far: str = "", *, is_going_on: bool = True) -> Markup:
    """Return why there is nothing to look at yet, or will not be, and how far it is."""
    parts: list[str] = [Markup("<b>{}.</b>").format(reason)]
    if how_far:
        parts.append(f"{how_far}.")
    if is_going_on:
        parts.append("This page shows it as soon as it is there.")
    else:
        parts.append("This page has ended.")
    return _marked("waiting", *parts)


def progress_html(done: int, total: int) -> Markup:
    """Return how many pictures of a film are drawn."""
    return Markup("<div>picture {} of {}</div>").format(done, total)


def distance_html(points: list[np.ndarray], scale: float, unit: str) -> Markup:
    """Return the distance of two points in the scene, in the unit of the result."""
    if not points:
        return _block("Click two points.")
    if len(points) == 1:
        return _block("Click the second point.")
    distance = float(np.linalg.norm(points[1] - points[0])) / scale
    return _marked("distance", f"distance {distance:.4g} ({unit})")


def _vector(values: Iterable[float] | None, deviations: Iterable[float] | None, unit: str) -> str:
    if values is None:
        return "not known"
    return f"{_with_deviation(values, deviations)} {unit}"


def _with_deviation(values: Iterable[float], deviations: Iterable[float | None] | None) -> str:
    values = list(values)
    known = [None] * len(values) if deviations is None else list(deviations)
    shown = [
        f"{value:.4g}" if deviation is None else f"{value:.4g} ± {deviation:.2g}"
        for value, deviation in zip(values, known, strict=True)
    ]
    return shown[0] if len(shown) == 1 else f"({', '.join(shown)})"


def _marked(name: str, *lines: str) -> Markup:
    """Return lines below each other, in an element of this name for tests."""
    text = Markup("<br>").join(lines)
    return _block(Markup('<div data-testid="{}">{}</div>').format(name, text))


def _block(*parts: str) -> Markup:
    return Markup('<div style="{}">{}</div>').format(_BLOCK, Markup().join(parts))
