"""Durations and sizes in words, and text that is safe to print on a terminal."""

import re


def as_duration(seconds: float) -> str:
    """Return a time in words, to two digits or more."""
    if seconds < 10:
        return f"{seconds:.2f} s"
    if seconds < 99.5:
        return f"{seconds:.0f} s"
    if seconds < 595:
        minutes, rest = divmod(10 * round(seconds / 10), 60)
        return f"{minutes} min {rest} s" if rest else f"{minutes} min"
    minutes = round(seconds / 60)
    if minutes < 100:
        return f"{minutes} min"
    return f"{minutes // 60} h {minutes % 60} min" if minutes % 60 else f"{minutes // 60} h"


def as_size(count: float) -> str:
    """Return a number of bytes in words."""
    return f"{count / 1e9:.1f} GB" if count >= 1e9 else f"{count / 1e6:.0f} MB"


# Control characters (ESC and some above 0x7f begin commands of a terminal), separators of lines and
# paragraphs, and characters that change the direction of writing.
_COMMANDS = re.compile("[\x00-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069]")


def printable(text: str) -> str:
    r"""Return text in one line in which a terminal finds no commands.

    Names of files, and texts that a file supplies, may hold any character. A character that could
    be a command is written as in Python's literals; lone surrogates become question marks.

    Examples
    --------
    >>> from tisfm.machine.text import printable
    >>> print(printable("a\x1b[31mb.png"))
    a\x1b[31mb.png
    """
    valid_text = text.encode("utf-8", "replace").decode("utf-8")
    return _COMMANDS.sub(lambda match: match[0].encode("unicode_escape").decode(), valid_text)
