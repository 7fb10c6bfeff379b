"""Output of commands: lines, tables and progress bars."""

import os
import re
import signal
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

from rich.console import Console, ConsoleOptions
from rich.measure import Measurement
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

from tisfm import runtime
from tisfm.grade import COLORS
from tisfm.machine.text import printable
from tisfm.machine.vulkan import vulkan_device
from tisfm.runtime import Arch


def tell(line: str) -> None:
    """Print one line on standard error, unwrapped and without markup."""
    Console(stderr=True, highlight=False).print(Text(printable(line)), soft_wrap=True)


def tell_grade(line: str) -> None:
    """Print a line with a grade after the word "Grade", in its colour on a terminal."""
    text = Text(printable(line))
    if sentence := re.search(r"Grade [^.;]*", text.plain):
        for word in re.finditer("|".join(COLORS), sentence.group()):
            start, end = (sentence.start() + k for k in word.span())
            text.stylize(f"bold {COLORS[word.group()]}", start, end)
    Console(stderr=True, highlight=False).print(text, soft_wrap=True)


def tell_error(text: str) -> None:
    """Print an error of the command in one line on standard error."""
    print(f"tisfm: {printable(' '.join(text.split()))}", file=sys.stderr)


@contextmanager
def print_source_notes() -> Iterator[None]:
    """Print each `SourceWarning` of the block as one line that begins with "note:"."""
    from tisfm.sources.frame_reader import SourceWarning

    def show(
        message: Warning | str, category: type[Warning], *arguments: Any, **options: Any
    ) -> None:
        if issubclass(category, SourceWarning):
            tell(f"note: {message}")
        else:
            original(message, category, *arguments, **options)

    with warnings.catch_warnings():
        warnings.simplefilter("always", SourceWarning)
        original, warnings.showwarning = warnings.showwarning, show
        yield


def print_full_width(table: Table) -> None:
    """Print a table with all its columns, even if it is wider than the terminal."""
    console = Console(markup=False, emoji=False)
    width_needed = Measurement.get(console, console.options.update(max_width=1000), table).maximum
    width = max(console.width, width_needed)
    Console(width=width, markup=False, emoji=False).print(_Printable(table))


class _Printable:
    """A table whose texts are made printable."""

    def __init__(self, table: Table) -> None:
        self._table = table

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterator[Segment]:
        for text, style, control in console.render(self._table, options):
            lines = "\n".join(map(printable, text.split("\n")))
            yield Segment(lines, style, control)


def start_kernels(arch: Arch | None, *, threads: int | None) -> None:
    """Start Taichi as `tisfm.runtime.start` does, and print the device of Vulkan."""
    tell_device(arch)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", runtime.SoftwareVulkanWarning)  # tell_device printed it
        runtime.start(arch, threads=threads)


def tell_device(arch: Arch | None) -> None:
    """Print the device of Vulkan, if kernels run on Vulkan."""
    if (arch or os.environ.get("TI_ARCH")) != "vulkan":
        return
    device = vulkan_device()
    if device is not None and device.is_software:
        tell(runtime.software_vulkan_message(device.name))
    elif device is not None:
        tell(f"vulkan runs on {device.name}")


@contextmanager
def watch_interrupt(is_watched: bool) -> Iterator[Callable[[], bool]]:
    """Yield a function that returns whether Ctrl-C was pressed.

    If `is_watched`, the first Ctrl-C interrupts nothing.
    """
    was_pressed = False

    def receive(number: int, frame: FrameType | None) -> None:
        nonlocal was_pressed
        was_pressed = True
        signal.signal(signal.SIGINT, earlier_handler)

    earlier_handler = signal.getsignal(signal.SIGINT) or signal.default_int_handler
    if is_watched:
        signal.signal(signal.SIGINT, receive)
    try:
        yield lambda: was_pressed
    finally:
        if is_watched:
            signal.signal(signal.SIGINT, earlier_handler)
