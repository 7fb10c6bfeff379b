"""The page: one HTML text with its styles, its script and its pictures inside."""

from collections.abc import Container, Sequence
from dataclasses import dataclass, field
from html import escape

from tisfm.reconstruction.report_file import MARK
from tisfm.report.settings_table import SettingRow
from tisfm.report.statuses import StatusCount, color_of
from tisfm.report.style import SCRIPT, STYLE
from tisfm.version import __version__

_NARROWEST, _LOWEST = 200, 110  # px: a picture is no smaller, where a screen has room for it
_LONG = 60  # characters: a value of more has a line of its own


@dataclass(frozen=True, kw_only=True)
class View:
    """A picture of a slide: its title, and its address, None where there is none."""

    title: str
    url: str | None


@dataclass(frozen=True, kw_only=True)
class Slide:
    """What is shown of one frame, whose height and width are `shape`, px."""

    name: str
    number: int
    status: str
    message: str
    shape: tuple[int, int]
    views: Sequence[View]


@dataclass(frozen=True, kw_only=True)
class Page:
    """What a report says; texts are plain, and drawings are ``svg`` elements.

    Attributes
    ----------
    title : str
    kind : str
        What it is the report of.
    summary : sequence of (str, str)
        Names and values.
    statuses : sequence of StatusCount
    spans : sequence of (float, float, str)
        Begin, end and code of frames in a row with one status, as shares of the whole.
    unit : str
        What is counted: "frame" or "pair".
    drawing, drawing_title, drawing_text : str
        A path or curves; empty if there are none.
    slides : sequence of Slide
    slides_text : str
        What is said of them.
    legends : sequence of (str, str, str)
        Titles of views, titles of their legends, and HTML that this package made.
    tables : sequence of (str, sequence of str, sequence of sequences of str)
        Titles, headings and rows of further tables.
    preset : str
    settings : sequence of SettingRow
    timings : sequence of (str, str)
    """

    title: str
    kind: str
    summary: Sequence[tuple[str, str]]
    statuses: Sequence[StatusCount]
    spans: Sequence[tuple[float, float, str]]
    unit: str
    drawing: str = ""
    drawing_title: str = ""
    drawing_text: str = ""
    slides: Sequence[Slide] = ()
    slides_text: str = ""
    legends: Sequence[tuple[str, str, str]] = ()
    tables: Sequence[tuple[str, Sequence[str], Sequence[Sequence[str]]]] = ()
    preset: str = ""
    settings: Sequence[SettingRow] = ()
    timings: Sequence[tuple[str, str]] = field(default_factory=tuple)


def html(page: Page) -> str:
    """Return a page as HTML."""
    drawing = _section(page.drawing_title, _drawing_part(page)) if page.drawing else ""
    slides = _section(f"{page.unit.capitalize()}s", _slides_part(page))
    parts = [
        _section("Summary", _pairs(page.summary)),
        _section("Statuses", _status_part(page)),
        *((drawing, slides) if page.unit == "frame" else (slides, drawing)),
        *(_section(title, _table(head, rows)) for title, head, rows in page.tables if rows),
        _section("Timings", _pairs(page.timings)) if page.timings else "",
        _section("Settings", _settings_part(page)) if page.settings else "",
    ]
    title = escape(page.title)
    return "\n".join(
        [
            "<!DOCTYPE html>",
            f'<html lang="en"><head><meta charset="utf-8">{MARK}',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            '<meta name="color-scheme" content="light dark">',
            f"<title>{title} – tisfm</title>",
            f"<style>{STYLE}</style>",
            "<noscript><style>.slide[hidden]{display:block}.control{display:none}</style></noscript>",
            "</head><body>",
            f"<header><p>{escape(page.kind)}</p><h1>{title}</h1></header>",
            "<main>",
            *filter(None, parts),
            "</main>",
            f"<footer>tisfm {escape(__version__)}</footer>",
            f"<script>{SCRIPT}</script>",
            "</body></html>",
            "",
        ]
    )


def color_bar(colors: Sequence[Sequence[int]], low: str, high: str) -> str:
    """Return a bar of colours with words at its ends, as HTML."""
    stops = ", ".join(f"rgb({r},{g},{b})" for r, g, b in colors)
    return (
        f'<span>{escape(low)}</span><span class="bar" '
        f'style="background:linear-gradient(to right, {stops})"></span>'
        f"<span>{escape(high)}</span>"
    )


def _section(title: str, content: str) -> str:
    return f"<section><h2>{escape(title)}</h2>\n{content}\n</section>"


def _pairs(pairs: Sequence[tuple[str, str]]) -> str:
    rows = "".join(
        f"<div{' class=long' * (len(value) > _LONG)}><dt>{escape(name)}</dt>"
        f"<dd>{escape(value)}</dd></div>"
        for name, value in pairs
    )
    return f"<dl>{rows}</dl>"


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    heading = "".join(f"<th>{escape(name)}</th>" for name in head)
    body = "".join(
        "<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows
    )
    return (
        f'<div class="wide"><table><thead><tr>{heading}</tr></thead>'
        f"<tbody>{body}</tbody></table></div>"
    )


def _chip(code: str) -> str:
    return f'<span class="chip" style="--c:{color_of(code)}">{escape(code)}</span>'


def _status_part(page: Page) -> str:
    strip = "".join(
        f'<i style="left:{100 * begin:.3f}%;width:{100 * (end - begin):.3f}%;'
        f'background:{color_of(code)}" title="{escape(code)}"></i>'
        for begin, end, code in page.spans
    )
    rows = "".join(
        f"<tr><td>{_chip(status.code)}</td><td>{status.count}</td>"
        f"<td>{escape(status.meaning)}{_advice(status.advice)}</td>"
        f"<td>{escape(status.names)}</td></tr>"
        for status in page.statuses
    )
    plural = f"{page.unit.capitalize()}s"
    return (
        f'<div class="strip" role="img" aria-label="Statuses over the {page.unit}s">{strip}</div>'
        f'<div class="wide"><table><thead><tr><th>Status</th><th>{plural}</th>'
        f"<th>What it means, and what to try</th><th>Which</th></tr></thead>"
        f"<tbody>{rows}</tbody></table></div>"
    )


def _advice(text: str) -> str:
    return f'<p class="advice">{escape(text)}</p>' if text else ""


def _drawing_part(page: Page) -> str:
    return f'<p>{escape(page.drawing_text)}</p><div class="drawing">{page.drawing}</div>'


def _slides_part(page: Page) -> str:
    if not page.slides:
        return f"<p>{escape(page.slides_text)}</p>"
    # What no slide has is left out, and its legend.
    there = {view.title for slide in page.slides for view in slide.views if view.url is not None}
    slides = "".join(_slide(slide, index, there) for index, slide in enumerate(page.slides))
    legends = "".join(
        f'<p class="legend"><b>{escape(title)}</b>{content}</p>'
        for view, title, content in page.legends
        if view in there
    )
    return (
        f"<p>{escape(page.slides_text)}</p>"
        '<div class="control"><button type="button" id="play" aria-label="Play">▶</button>'
        f'<input type="range" id="at" min="0" max="{len(page.slides) - 1}" value="0" '
        f'aria-label="{page.unit}"></div>'
        f'<div id="slides">{slides}</div>{legends}'
    )


def _slide(slide: Slide, index: int, there: Container[str]) -> str:
    views = "".join(
        f"<figure>{_picture(view, slide)}<figcaption>{escape(view.title)}</figcaption></figure>"
        for view in slide.views
        if view.title in there
    )
    width = max(_NARROWEST, round(_LOWEST * slide.shape[1] / slide.shape[0]))
    return (
        f'<div class="slide"{" hidden" if index else ""}>'
        f"<p><b>{escape(slide.name)}</b> <span>number {slide.number}</span> {_chip(slide.status)} "
        f'<span class="said">{escape(slide.message)}</span></p>'
        f'<div class="views" style="--w:{width}px">{views}</div></div>'
    )


def _picture(view: View, slide: Slide) -> str:
    if view.url is None:
        height, width = slide.shape
        return f'<div class="none" style="aspect-ratio:{width}/{height}">none here</div>'
    alt = escape(f"{view.title} of {slide.name}")
    return f'<img src="{view.url}" alt="{alt}" decoding="async">'


def _settings_part(page: Page) -> str:
    changed = sum(row.preset_value is not None for row in page.settings)
    told = f"Those of the preset {page.preset}"
    if changed:
        told += f", but for {changed}, which stand first"
    rows = [
        (row.name, row.value, "" if row.preset_value is None else row.preset_value)
        for row in page.settings
    ]
    table = _table(("Setting", "Value", "In the preset, where it differs"), rows)
    return f"<p>{escape(told)}.</p><details><summary>All settings</summary>{table}</details>"
