"""Results of a run: tables, figures with their bounds, and files in bench/results."""

import json
import platform
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table as RichTable

ROOT = Path(__file__).resolve().parents[2]
RESULTS = ROOT / "bench" / "results"
EMPTY_CELL = "–"  # cell of a figure that was not measured
TABLE_WIDTH = 160  # columns of a console that is not a terminal


@dataclass(frozen=True)
class Table:
    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    text_columns: int = 1  # number of columns that are aligned to the left; the others hold figures

    def markdown(self) -> list[str]:
        figures = len(self.head) - self.text_columns
        rules = ["---"] * self.text_columns + ["---:"] * figures
        lines = (self.head, rules, *self.rows)
        return ["|" + "".join(f" {text} |" if text else " |" for text in line) for line in lines]

    def rich(self) -> RichTable:
        table = RichTable(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
        for index, name in enumerate(self.head):
            side = "left" if index < self.text_columns else "right"
            table.add_column(escape(name), justify=side, no_wrap=index == 0)  # type: ignore[arg-type]
        for row in self.rows:
            table.add_row(*map(escape, row))
        return table

    def without_empty_columns(self) -> "Table":
        """Return the table without the columns in which every cell is empty."""
        filled_columns = [
            k for k in range(len(self.head)) if any(row[k] != EMPTY_CELL for row in self.rows)
        ]
        return Table(
            [self.head[k] for k in filled_columns],
            [[row[k] for k in filled_columns] for row in self.rows],
        )


@dataclass(frozen=True)
class Bar:
    """A figure and its bound."""

    name: str
    value: float | None  # None if the run did not measure the figure
    bound: float | None  # None if the figure is only reported
    at_most: bool = True  # whether the bound is an upper one

    @property
    def is_met(self) -> bool:
        """Whether the figure was measured and is within its bound."""
        if self.value is None:
            return False
        if self.bound is None:
            return True
        return self.value <= self.bound if self.at_most else self.value >= self.bound

    def __str__(self) -> str:
        value = "not measured"
        if self.value is not None:
            value = f"{self.value:.{1 if self.value >= 10 else 2}f}"
        if self.bound is None:
            return f"{'also' if self.is_met else 'FAIL'}  {self.name}: {value}"
        words = "at most" if self.at_most else "at least"
        return f"{'pass' if self.is_met else 'FAIL'}  {self.name}: {value} ({words} {self.bound:g})"


def exit_code(bars: Iterable[Bar]) -> int:
    """Return the exit code of a run: 0 if every bound is met, else 1."""
    return 0 if all(bar.is_met for bar in bars) else 1


def cell(value: float | None, form: str) -> str:
    """Return a formatted figure, or the empty cell for None."""
    return EMPTY_CELL if value is None else format(value, form)


def markdown_page(*blocks: str | Mapping[str, Any] | Sequence[str] | Table) -> str:
    """Return a Markdown page of blocks, separated by empty lines.

    A string is a heading or a paragraph, a mapping a list of ``name: value``, and another sequence
    a list of its lines. Empty blocks are left out.
    """
    parts = []
    for block in blocks:
        if isinstance(block, Table):
            parts.append("\n".join(block.markdown()))
        elif isinstance(block, str):
            parts.append(block)
        elif isinstance(block, Mapping):
            parts.append("\n".join(f"- {name}: {value}" for name, value in block.items()))
        else:
            parts.append("\n".join(f"- {line}" for line in block))
    return "\n\n".join(part for part in parts if part) + "\n"


def write_results(path: Path, text: str, record: Any = None) -> None:
    """Write PATH.md and, if there is a record of all figures, PATH.json."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.with_suffix(".md").write_text(text, encoding="utf-8")
    if record is not None:
        content = json.dumps(record, indent=1, ensure_ascii=False)
        path.with_suffix(".json").write_text(content + "\n", encoding="utf-8")


def missing_sections(
    missing: Mapping[str, str], failures: Mapping[str, str]
) -> list[str | Mapping[str, str]]:
    """Return the sections of a report on missing and failed methods or pairs."""
    sections = (("## Missing", missing), ("## Failed", failures))
    return [block for section in sections if section[1] for block in section]


def print_missing(
    console: Console, missing: Mapping[str, str], failures: Mapping[str, str] | None = None
) -> None:
    for title, entries in (("missing", missing), ("FAILED", failures or {})):
        for name, reason in entries.items():
            console.print(f"{title}: {name}: {reason}", highlight=False, markup=False)


def wide_console() -> Console:
    """Return a console in which tables keep their columns."""
    console = Console()
    return Console(width=max(console.width, TABLE_WIDTH))


def machine() -> dict[str, Any]:
    """Return the properties of the machine and the process that times depend on."""
    import numpy
    import taichi

    import tisfm

    return {
        "processor": _processor(),
        "system": platform.system(),
        "Python": platform.python_version(),
        "tisfm": tisfm.__version__,
        "NumPy": numpy.__version__,
        "Taichi": ".".join(map(str, taichi.__version__)),
    }


def process_memory(name: str, process: int | str = "self") -> float | None:
    """Return a size that Linux reports of a process, bytes; None if the system does not.

    `name` is VmRSS for resident memory, or VmHWM for its peak.
    """
    try:
        status = Path(f"/proc/{process}/status").read_text(encoding="utf-8")
    except OSError:
        return None
    match = re.search(rf"^{name}:\s+(\d+) kB", status, re.MULTILINE)
    return int(match[1]) * 1024 if match else None


def _processor() -> str:
    cpu_file = Path("/proc/cpuinfo")
    if cpu_file.exists():
        for line in cpu_file.read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()
