"""The page: one HTML text with its styles, its script and its pictures inside.

Markup is written as literals of `markupsafe.Markup`, whose ``format`` and ``join`` escape every
plain text that is put into them.
"""

from collections.abc import Container, Sequence
from dataclasses import dataclass

from markupsafe import Markup

from tisfm.folders.side_files import MARK
from tisfm.report.setting_rows import SettingRow
from tisfm.report.statuses import StatusCount, color_of
from tisfm.report.style import SCRIPT, STYLE
from tisfm.version import __version__

_NARROWEST, _LOWEST = 200, 110  # px: a picture is no smaller, where a screen has room for it
_NONE = Markup()
_LONG = 60  # characters: a value of more has a line of its own
_PAGE = Markup(
    """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8">{mark}
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<title>{title} – tisfm</title>
<style>{style}</style>
<noscript><style>.slide[hidden]{{display:block}}.control{{display:none}}</style></noscript>
</head><body>
<header><p>{kind}</p><h1>{title}</h1></header>
<main>
{sections}
</main>
<footer>tisfm {version}</footer>
<script>{script}</script>
</body></html>
"""
)


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
    """What a report says: plain texts, which are escaped, and HTML that this package made.

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
    drawing : Markup
        A path or curves, an ``svg`` element; empty if there are none.
    drawing_title, drawing_text : str
    slides : sequence of Slide
    slides_text : str
        What is said of them.
    legends : sequence of (str, str, Markup)
        Titles of views, titles of their legends, and the legends.
    tables : sequence of (str, sequence of str, sequence of sequences of str)
        Titles, headings and rows of further tables.
    preset : str
    settings : sequence of SettingRow
    """

    title: str
    kind: str
    summary: Sequence[tuple[str, str]]
    statuses: Sequence[StatusCount]
    spans: Sequence[tuple[float, float, str]]
    unit: str
    drawing: Markup = _NONE
    drawing_title: str = ""
    drawing_text: str = ""
    slides: Sequence[Slide] = ()
    slides_text: str = ""
    legends: Sequence[tuple[str, str, Markup]] = ()
    tables: Sequence[tuple[str, Sequence[str], Sequence[Sequence[str]]]] = ()
    preset: str = ""
    settings: Sequence[SettingRow] = ()


def html(page: Page) -> str:
    """Return a page as HTML."""
    drawing = _section(page.drawing_title, _drawing_part(page)) if page.drawing else _NONE
    slides = _section(f"{page.unit.capitalize()}s", _slides_part(page))
    parts = [
        _section("Summary", _pairs(page.summary)),
        _section("Statuses", _status_part(page)),
        *((drawing, slides) if page.unit == "frame" else (slides, drawing)),
        *(_section(title, _table(head, rows)) for title, head, rows in page.tables if rows),
        _section("Settings", _settings_part(page)) if page.settings else _NONE,
    ]
    text = _PAGE.format(
        mark=Markup(MARK),
        title=page.title,
        style=Markup(STYLE),
        kind=page.kind,
        sections=Markup("\n").join(filter(None, parts)),
        version=__version__,
        script=Markup(SCRIPT),
    )
    return str(text)


def color_bar(colors: Sequence[Sequence[int]], low: str, high: str) -> Markup:
    """Return a bar of colours with words at its ends, as HTML."""
    stops = ", ".join(f"rgb({r},{g},{b})" for r, g, b in colors)
    return Markup(
        '<span>{}</span><span class="bar" style="background:linear-gradient(to right, {})"></span>'
        "<span>{}</span>"
    ).format(low, stops, high)


def _section(title: str, content: Markup) -> Markup:
    return Markup("<section><h2>{}</h2>\n{}\n</section>").format(title, content)


def _pairs(pairs: Sequence[tuple[str, str]]) -> Markup:
    rows = Markup().join(
        Markup("<div{}><dt>{}</dt><dd>{}</dd></div>").format(
            " class=long" if len(value) > _LONG else "", name, value
        )
        for name, value in pairs
    )
    return Markup("<dl>{}</dl>").format(rows)


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> Markup:
    heading = Markup().join(Markup("<th>{}</th>").format(name) for name in head)
    body = Markup().join(
        Markup("<tr>{}</tr>").format(
            Markup().join(Markup("<td>{}</td>").format(cell) for cell in row)
        )
        for row in rows
    )
    return Markup(
        '<div class="wide"><table><thead><tr>{}</tr></thead><tbody>{}</tbody></table></div>'
    ).format(heading, body)


def _chip(code: str) -> Markup:
    return Markup('<span class="chip" style="--c:{}">{}</span>').format(color_of(code), code)


def _status_part(page: Page) -> Markup:
    strip = Markup().join(
        Markup('<i style="left:{:.3f}%;width:{:.3f}%;background:{}" title="{}"></i>').format(
            100 * begin, 100 * (end - begin), color_of(code), code
        )
        for begin, end, code in page.spans
    )
    rows = Markup().join(
        Markup("<tr><td>{}</td><td>{}</td><td>{}{}</td><td>{}</td></tr>").format(
            _chip(status.code),
            status.count,
            status.meaning,
            _advice(status.advice),
            status.names,
        )
        for status in page.statuses
    )
    return Markup(
        '<div class="strip" role="img" aria-label="Statuses over the {unit}s">{strip}</div>'
        '<div class="wide"><table><thead><tr><th>Status</th><th>{units}</th>'
        "<th>What it means, and what to try</th><th>Which</th></tr></thead>"
        "<tbody>{rows}</tbody></table></div>"
    ).format(unit=page.unit, units=f"{page.unit.capitalize()}s", strip=strip, rows=rows)


def _advice(text: str) -> Markup:
    return Markup('<p class="advice">{}</p>').format(text) if text else _NONE


def _drawing_part(page: Page) -> Markup:
    return Markup('<p>{}</p><div class="drawing">{}</div>').format(page.drawing_text, page.drawing)


def _slides_part(page: Page) -> Markup:
    said = Markup("<p>{}</p>").format(page.slides_text)
    if not page.slides:
        return said
    # A view that no slide has is left out, and its legend.
    there = {view.title for slide in page.slides for view in slide.views if view.url is not None}
    legends = Markup().join(
        Markup('<p class="legend"><b>{}</b>{}</p>').format(title, content)
        for view, title, content in page.legends
        if view in there
    )
    return said + Markup(
        '<div class="control"><button type="button" id="play" aria-label="Play">▶</button>'
        '<input type="range" id="at" min="0" max="{last}" value="0" aria-label="{unit}"></div>'
        '<div id="slides">{slides}</div>{legends}'
    ).format(
        last=len(page.slides) - 1,
        unit=page.unit,
        slides=Markup().join(_slide(slide, k, there) for k, slide in enumerate(page.slides)),
        legends=legends,
    )


def _slide(slide: Slide, index: int, there: Container[str]) -> Markup:
    views = Markup().join(
        Markup("<figure>{}<figcaption>{}</figcaption></figure>").format(
            _picture(view, slide), view.title
        )
        for view in slide.views
        if view.title in there
    )
    width = max(_NARROWEST, round(_LOWEST * slide.shape[1] / slide.shape[0]))
    return Markup(
        '<div class="slide"{hidden}><p><b>{name}</b> <span>number {number}</span> {chip} '
        '<span class="said">{message}</span></p>'
        '<div class="views" style="--w:{width}px">{views}</div></div>'
    ).format(
        hidden=" hidden" if index else "",
        name=slide.name,
        number=slide.number,
        chip=_chip(slide.status),
        message=slide.message,
        width=width,
        views=views,
    )


def _picture(view: View, slide: Slide) -> Markup:
    if view.url is None:
        height, width = slide.shape
        return Markup('<div class="none" style="aspect-ratio:{}/{}">none here</div>').format(
            width, height
        )
    return Markup('<img src="{}" alt="{} of {}" decoding="async">').format(
        view.url, view.title, slide.name
    )


def _settings_part(page: Page) -> Markup:
    changed = sum(row.preset_value is not None for row in page.settings)
    told = f"Those of the preset {page.preset}"
    if changed:
        told += f", but for {changed}, which stand first"
    rows = [
        (row.name, row.value, "" if row.preset_value is None else row.preset_value)
        for row in page.settings
    ]
    table = _table(("Setting", "Value", "In the preset, where it differs"), rows)
    return Markup("<p>{}.</p><details><summary>All settings</summary>{}</details>").format(
        told, table
    )
