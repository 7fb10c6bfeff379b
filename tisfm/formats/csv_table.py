"""Tables for people, as CSV."""

import csv
import io
from collections.abc import Iterable, Sequence
from typing import Any

# A spreadsheet takes a cell that begins with one of these as a formula.
_FORMULA_STARTS = ("=", "+", "-", "@", "\t", "\r", "\n", "＝", "＋", "－", "＠")
_QUOTE = "'"  # at the beginning of a cell: spreadsheets then read the cell as text


def csv_table(
    columns: Sequence[str],
    rows: Iterable[Sequence[Any]],  # texts, numbers, and None for an empty cell
) -> str:
    """Return rows as CSV in which a spreadsheet reads no text as a formula.

    A text that begins like a formula, or with ``'``, gets a ``'`` in front: remove this ``'`` to
    get the original text. Numbers stay as they are.
    """
    return "".join(_format_line([_quote(cell) for cell in row]) for row in (columns, *rows))


def _format_line(cells: Sequence[Any]) -> str:
    """Return a line that ends in a line feed; cells with a line break are quoted."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\r\n").writerow(cells)
    return text.getvalue().removesuffix("\r\n") + "\n"


def _quote(cell: Any) -> Any:
    needs_quote = isinstance(cell, str) and cell.startswith((*_FORMULA_STARTS, _QUOTE))
    return f"{_QUOTE}{cell}" if needs_quote else cell
