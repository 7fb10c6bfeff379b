"""Output of commands: lines and progress on standard error, tables on standard output.

Texts from files go through `printable` here. Rich does not read markup in them.
"""

import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from rich.console import Console, ConsoleOptions
from rich.measure import Measurement
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

from tisfm.machine.terminal import printable


def tell(line: str) -> None:
    """Print one line on standard error, as it is."""
    Console(stderr=True, highlight=False).print(Text(printable(line)), soft_wrap=True)


def tell_error(text: str) -> None:
    """Print an error of the command in one line on standard error."""
    print(f"tisfm: {printable(' '.join(text.split()))}", file=sys.stderr)


@contextmanager
def notes_as_lines() -> Iterator[None]:
    """Print each `SourceWarning` of the block as one line that begins with "note:"."""
    from tisfm.sources.frame_reader import SourceWarning

    def show(message: Warning | str, category: type[Warning], *about: Any, **more: Any) -> None:
        if issubclass(category, SourceWarning):
            tell(f"note: {message}")
        else:
            others(message, category, *about, **more)

    with warnings.catch_warnings():
        warnings.simplefilter("always", SourceWarning)
        others, warnings.showwarning = warnings.showwarning, show
        yield


def print_whole(table: Table) -> None:
    """Print a table with all its columns, were it wider than the terminal."""
    console = Console(markup=False, emoji=False)
    wanted = Measurement.get(console, console.options.update(max_width=1000), table).maximum
    width = max(console.width, wanted)
    Console(width=width, markup=False, emoji=False).print(_Printable(table))


def progress_bar() -> Progress:
    """Return a progress bar on standard error, which a log gets nothing of."""
    console = Console(stderr=True)
    return Progress(
        _Description(),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=console,
        transient=True,
        disable=not console.is_terminal,  # it would leave blank lines in a log
    )


class _Description(ProgressColumn):
    """The task of a progress bar, or its last finished item, made printable."""

    def render(self, task: Task) -> Text:
        return Text(printable(task.description))


class _Printable:
    """A table whose texts are made printable."""

    def __init__(self, table: Table) -> None:
        self._table = table

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterator[Segment]:
        for text, style, control in console.render(self._table, options):
            lines = "\n".join(map(printable, text.split("\n")))
            yield Segment(lines, style, control)
