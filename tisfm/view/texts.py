"""What the page says, as HTML: the legend, the reading of a pixel, a distance, the status."""

import html
from collections.abc import Iterable

import numpy as np

from tisfm.view.colors import Legend, Quantity, Ranges, legend
from tisfm.view.frame import PixelReading, ViewFrame
from tisfm.view.result import Result

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


def legend_html(legend: Legend | None) -> str:
    """Return a legend: a bar with numbers, or a patch for each thing."""
    if legend is None:
        return ""
    title = f"<div>{html.escape(legend.title)}</div>"
    ticks = [html.escape(tick) for tick in legend.ticks]
    if legend.is_bar:
        bar = f"height:0.8em;background:linear-gradient(to right,{','.join(legend.colors)})"
        spans = "".join(f"<span>{tick}</span>" for tick in ticks)
        row = f'<div style="display:flex;justify-content:space-between">{spans}</div>'
        return _block(f'{title}<div style="{bar}"></div>{row}')
    patch = "display:inline-block;width:0.8em;height:0.8em;margin-right:0.4em;background:"
    rows = "".join(
        f'<div><span style="{patch}{color}"></span>{tick}</div>'
        for color, tick in zip(legend.colors, ticks, strict=True)
    )
    return _block(title + rows)


def reading_html(reading: PixelReading | None, unit: str) -> str:
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
    cells = "".join(
        f'<tr><td style="padding-right:0.7em;vertical-align:top"><b>{name}</b></td>'
        f"<td>{html.escape(value)}</td></tr>"
        for name, value in rows
    )
    return _block(f'<table data-testid="reading">{cells}</table>')


def outside_html(row: int, column: int, shape: tuple[int, int]) -> str:
    """Return that there is no such pixel, and how many rows and columns the frame has."""
    height, width = shape
    text = f"Column {column}, row {row} is outside: the frame has {height} × {width}"
    return _block(f'<div data-testid="outside">{text}, rows by columns.</div>')


def status_html(result: Result, frame: ViewFrame | None, number: int, fault: str = "") -> str:
    """Return which frame is looked at, its time, its status, and where it is of no use why."""
    name = html.escape(result.names[number])
    parts = [f"<b>{name}</b>, {number + 1} of {len(result.names)}"]
    time = result.times[number]
    if time is not None:
        parts.append(f"{time:.3f} s")
    if fault:
        parts.append(html.escape(fault))
    elif frame is not None:
        status = frame.status
        parts.append(str(status))
        if str(status) != "converged" and status.message:
            parts.append(html.escape(status.message))
        if result.has_one_scale and result.piece[number] < 0:
            parts.append("it has no pose: it is shown at the origin")
    return _block(f'<div data-testid="status">{"<br>".join(parts)}</div>')


def note_html(text: str) -> str:
    """Return a note below a control."""
    return _block(f'<div data-testid="note">{html.escape(text)}</div>') if text else ""


def waiting_html(reason: str, how_far: str = "", *, is_going_on: bool = True) -> str:
    """Return why there is nothing to look at yet, or will not be, and how far it is."""
    parts = [f"<b>{html.escape(reason)}.</b>"]
    if how_far:
        parts.append(f"{html.escape(how_far)}.")
    if is_going_on:
        parts.append("This page shows it as soon as it is there.")
    else:
        parts.append("This page has ended.")
    return _block(f'<div data-testid="waiting">{"<br>".join(parts)}</div>')


def distance_html(points: list[np.ndarray], scale: float, unit: str) -> str:
    """Return the distance of two points in the scene, in the unit of the result."""
    if not points:
        return _block("Click two points.")
    if len(points) == 1:
        return _block("Click the second point.")
    distance = float(np.linalg.norm(points[1] - points[0])) / scale
    text = f"distance {distance:.4g} ({html.escape(unit)})"
    return _block(f'<div data-testid="distance">{text}</div>')


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


def _block(text: str) -> str:
    return f'<div style="{_BLOCK}">{text}</div>'
