"""Texts of the page as HTML: legend, reading of a pixel, distance, status.

The templates, ``tisfm/templates/view.html``, escape all texts. Only `set_html` gives HTML to the
page.
"""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from markupsafe import Markup

from tisfm.errors import InputTypeError
from tisfm.grade import COLORS, describe_grade
from tisfm.results.frame import PixelReading, ResultFrame
from tisfm.results.result_frames import ResultFrames
from tisfm.status import STATUSES, UNKNOWN_STATUS_ADVICE
from tisfm.templates import macro
from tisfm.view.colors import Legend

_TEMPLATE = "view.html"
NOTHING = Markup()


def set_html(control: Any, content: Markup) -> None:
    """Show HTML in a control of viser, which does not escape it.

    Raises TypeError if it is plain text, whose characters are not escaped.
    """
    if not isinstance(content, Markup):
        raise InputTypeError(f"content is {content!r}: expected Markup, in which texts are escaped")
    control.content = content.encode("utf-8", "replace").decode()  # names may have lone surrogates


def legend_html(legend: Legend | None) -> Markup:
    """Return a legend: a bar with numbers, or a patch of colour for each label."""
    return NOTHING if legend is None else macro(_TEMPLATE, "legend", legend)


def reading_html(reading: PixelReading | None, unit: str) -> Markup:
    """Return the values of a pixel with deviations, a line for each quantity."""
    if reading is None:
        return _text("Click a point, or a pixel of the picture in the frustum.")
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
        rows.append(("object", f"object {reading.label}" if reading.label else "at rest"))
    if reading.hidden:
        rows.append(("", "not visible in the next frame"))
    return macro(_TEMPLATE, "reading", rows)


def outside_html(row: int, column: int, shape: tuple[int, int]) -> Markup:
    """Return a note that a pixel lies outside the frame, with the size of the frame."""
    height, width = shape
    text = f"Column {column}, row {row} is outside: the frame has {height} × {width}"
    return _lines("outside", [f"{text}, rows by columns."])


def status_html(
    result: ResultFrames, frame: ResultFrame | None, number: int, fault: str = ""
) -> Markup:
    """Return name, number, time, grade and status of a frame, with advice or a fault's reason."""
    lines = [f", {number + 1} of {len(result.names)}"]
    grade, error = result.grades[number], result.depth_errors[number]
    badge = describe_grade(grade, error)
    time = result.times[number]
    if time is not None:
        lines.append(f"{time:.3f} s")
    if fault:
        lines.append(fault)
    elif frame is not None:
        status = frame.status
        lines.append(str(status))
        if status not in STATUSES:
            lines.append(UNKNOWN_STATUS_ADVICE)
        if str(status) != "converged" and status.message:
            lines.append(status.message)
        if result.focal_note:
            lines.append(result.focal_note)
        if result.has_one_scale and result.piece[number] < 0:
            lines.append("it has no pose: it is shown at the origin")
    return macro(_TEMPLATE, "status", lines, result.names[number], badge, COLORS[str(grade)])


def note_html(text: str) -> Markup:
    """Return a note below a control."""
    return _lines("note", [text]) if text else NOTHING


def waiting_html(reason: str, progress: str = "", *, is_running: bool = True) -> Markup:
    """Return the reason of waiting, the progress of the run, and whether it goes on."""
    lines = ["", f"{progress}."] if progress else [""]
    if is_running:
        lines.append("This page shows the result as soon as there is one.")
    else:
        lines.append("This page has ended.")
    return _lines("waiting", lines, bold=f"{reason}.")


def progress_html(done: int, total: int) -> Markup:
    """Return how many pictures of a film are drawn."""
    return _text(f"picture {done} of {total}")


def distance_html(points: list[np.ndarray], scale: float, unit: str) -> Markup:
    """Return the distance of two points of the scene, in the unit of the result."""
    if not points:
        return _text("Click two points.")
    if len(points) == 1:
        return _text("Click the second point.")
    distance = float(np.linalg.norm(points[1] - points[0])) / scale
    return _lines("distance", [f"distance {distance:.4g} ({unit})"])


def foot_html(legend: Markup, caption: str) -> Markup:
    """Return the legend and the caption at the foot of a page that plays by itself."""
    return macro(_TEMPLATE, "foot", legend, caption)


def _vector(values: Iterable[float] | None, deviations: Iterable[float] | None, unit: str) -> str:
    if values is None:
        return "not known"
    return f"{_with_deviation(values, deviations)} {unit}"


def _with_deviation(values: Iterable[float], deviations: Iterable[float | None] | None) -> str:
    values = list(values)
    known_deviations = [None] * len(values) if deviations is None else list(deviations)
    texts = [
        f"{value:.4g}" if deviation is None else f"{value:.4g} ± {deviation:.2g}"
        for value, deviation in zip(values, known_deviations, strict=True)
    ]
    return texts[0] if len(texts) == 1 else f"({', '.join(texts)})"


def _text(line: str) -> Markup:
    return macro(_TEMPLATE, "text", line)


def _lines(name: str, lines: Sequence[str], *, bold: str = "") -> Markup:
    """Return lines below one another, in an element that tests find by a name."""
    return macro(_TEMPLATE, "lines", name, lines, bold)
