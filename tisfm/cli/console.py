"""What commands print: lines and progress on standard error, tables on standard output."""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from rich.console import Console
from rich.measure import Measurement
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Table


def as_text(name: str) -> str:
    """Return a name of a file as text: a question mark for what the system has that is none."""
    return name.encode("utf-8", "replace").decode("utf-8")


def tell(line: str) -> None:
    """Print one line on standard error, as it is."""
    console = Console(stderr=True, emoji=False)  # or :v: in a name would be a sign
    console.print(as_text(line), highlight=False, markup=False, soft_wrap=True)


@contextmanager
def notes_as_lines() -> Iterator[None]:
    """Print each `SourceWarning` of the block as one line that begins with "note:"."""
    from tisfm.sources.notes import SourceWarning

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
    console = Console()
    wanted = Measurement.get(console, console.options.update(max_width=1000), table).maximum
    Console(width=max(console.width, wanted)).print(table)


def progress_bar() -> Progress:
    """Return a progress bar on standard error, which a log gets nothing of."""
    console = Console(stderr=True)
    return Progress(
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=console,
        transient=True,
        disable=not console.is_terminal,  # it would leave blank lines in a log
    )
