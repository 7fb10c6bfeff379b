"""A report: its contents, and the file with its HTML page.

The page has its styles, its script and its pictures inside. The template is
``tisfm/templates/report.html``.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from markupsafe import Markup

from tisfm.errors import InputError
from tisfm.folders.files import MARK, REPORT, is_report
from tisfm.formats import atomic_write
from tisfm.report.pictures import Legend
from tisfm.report.tables import SettingRow, StatusCount, status_color
from tisfm.templates import render
from tisfm.version import __version__

# Smallest size of a picture, if the screen has this space. Set by hand.
_MIN_PICTURE_WIDTH = 200  # px
_MIN_PICTURE_HEIGHT = 110  # px


@dataclass(frozen=True, kw_only=True)
class Picture:
    """A picture of a slide: its title and its data URL; `url` is None for a missing picture."""

    title: str
    url: str | None


@dataclass(frozen=True, kw_only=True)
class Slide:
    """The pictures and the status of one frame; `shape` is its height and width, px."""

    name: str
    number: int
    status: str
    grade: str
    message: str
    shape: tuple[int, int]
    pictures: Sequence[Picture]

    @property
    def min_width(self) -> int:
        """Smallest width of a picture on the page, px."""
        height, width = self.shape
        return max(_MIN_PICTURE_WIDTH, round(_MIN_PICTURE_HEIGHT * width / height))


@dataclass(frozen=True, kw_only=True)
class Report:
    """The contents of a page, as plain texts; the template escapes them."""

    title: str
    kind: str  # the kind of result, in a sentence
    summary: Sequence[tuple[str, str]]  # sequence of (str, str): names and values
    statuses: Sequence[StatusCount]
    # sequence of (float, float, str): consecutive frames with one status: begin and end as shares
    # of the sequence, and the code
    spans: Sequence[tuple[float, float, str]]
    # (word, count, meaning) of the grades that occur, the best first
    grades: Sequence[tuple[str, int, str]]
    grade_spans: Sequence[tuple[float, float, str]]  # as `spans`, with the words of grades
    unit: str  # the counted items: "frame" or "pair"
    drawing: Markup  # paths or curves as ``svg`` elements; empty without paths or curves
    drawing_title: str
    drawing_text: str
    slides: Sequence[Slide]
    slides_text: str  # a sentence above the slides
    legends: Sequence[Legend]
    # sequence of (str, sequence of str, sequence of sequences of str): titles, headings and rows of
    # further tables
    tables: Sequence[tuple[str, Sequence[str], Sequence[Sequence[str]]]]
    preset: str  # name of the preset with the fewest different settings
    settings: Sequence[SettingRow]

    @property
    def picture_titles(self) -> set[str]:
        """Titles of the pictures that exist; the page shows only the legends of these pictures."""
        pictures = (picture for slide in self.slides for picture in slide.pictures)
        return {picture.title for picture in pictures if picture.url is not None}

    @property
    def changed_setting_count(self) -> int:
        """Number of settings that differ from the preset."""
        return sum(row.preset_value is not None for row in self.settings)

    @property
    def setting_cells(self) -> list[tuple[str, str, str]]:
        """Cells of the table of settings."""
        return [(row.name, row.value, row.preset_value or "") for row in self.settings]


def check_report(folder: Path) -> Path:
    """Return the path of the report of a folder, if tisfm may write it.

    Raises ValueError if the report would replace a file that tisfm did not write.
    """
    path = folder / REPORT
    if path.exists() and not is_report(path):
        raise InputError(
            f"{path} is not a report of tisfm, and would be replaced: give another folder with -o"
        )
    return path


def write_report(path: Path, report: Report) -> None:
    """Write the page of a report atomically.

    Characters that UTF-8 cannot encode become question marks.
    """
    page = render(
        "report.html",
        report=report,
        mark=Markup(MARK),
        status_color=status_color,
        version=__version__,
    )
    with atomic_write(path) as file:
        file.write(page.encode("utf-8", "replace"))
