"""Text that is safe to print on a terminal."""

import re

# Control characters (ESC and some above 0x7f begin commands of a terminal), separators of lines and
# paragraphs, and characters that change the direction of writing.
_COMMANDS = re.compile("[\x00-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069]")


def printable(text: str) -> str:
    r"""Return text in one line in which a terminal finds no commands.

    Names of files, and texts that a file supplies, may hold any character. A character that could
    be a command is written as in Python's literals; lone surrogates become question marks.

    Parameters
    ----------
    text : str

    Returns
    -------
    str

    Examples
    --------
    >>> from tisfm.machine.terminal import printable
    >>> print(printable("a\x1b[31mb.png"))
    a\x1b[31mb.png
    """
    whole = text.encode("utf-8", "replace").decode("utf-8")
    return _COMMANDS.sub(lambda found: found[0].encode("unicode_escape").decode(), whole)
