"""One line for what the parser refuses, with what was meant."""

import re
from collections.abc import Iterable, Sequence
from itertools import takewhile

from tisfm.cli.known_options import OF_TISFM, Help, known_options
from tisfm.cli.nearest import nearest

_FRAME = " │|╭╰─╮╯"
_CHOICE = re.compile(r"invalid choice '(.*?)' for argument '(.*?)'\. Expected one of \((.*?)\)")


def explained(arguments: Sequence[str], said: str, parse: Help) -> str:
    """Return a line that says what is wrong with arguments.

    Parameters
    ----------
    arguments : sequence of str
        What was refused.
    said : str
        What the parser printed.
    parse : callable
        As for `known_options`.
    """
    given = arguments[0] if arguments else ""
    known = known_options(parse, command=given)
    listed = ", ".join(known.commands)
    if not arguments:
        return f"a command is missing: give one of {listed}; tisfm demo is a good beginning"
    if given.startswith("-"):
        name = given.partition("=")[0]
        if name in OF_TISFM:
            return f"{name} stands alone, or with what it takes after a space; see tisfm --help"
        return f"tisfm has no option {name}{_meant(name, OF_TISFM)}; see tisfm --help"
    if given not in known.commands:
        return f"tisfm has no command {given}{_meant(given, known.commands)}; expected {listed}"
    options = known.options[given]
    for word in takewhile(lambda one: one != "--", arguments[1:]):
        name = word.partition("=")[0]
        # The parser takes underscores for dashes.
        if name.startswith("--") and name.replace("_", "-") not in options:
            return f"tisfm {given} has no option {name}{_meant(name, options)}; {_see(given)}"
    text = _unframed(said)
    choice = _CHOICE.search(text)
    if choice is not None:
        word, name = choice[1], choice[2]
        values = options.get(name.partition("/")[0]) or re.findall(r"'(.*?)'", choice[3])
        return f"{name} is {word!r}{_meant(word, values)}; expected one of {', '.join(values)}"
    missing = re.match(r"Missing from tisfm (\w+): (.*?) (?:[A-Z][a-z]|A ).*", text)
    if missing is not None:
        return f"tisfm {given} needs {missing[2]}; {_see(given)}"
    return f"{text or 'these options are wrong'}; {_see(given)}"


def _see(command: str) -> str:
    return f"see tisfm {command} --help"


def _meant(word: str, known: Iterable[str]) -> str:
    found = nearest(word, known)
    return "" if found is None else f": did you mean {found}?"


def _unframed(said: str) -> str:
    """Return the first part of what the parser printed, without its frame, as one line."""
    parts: list[list[str]] = [[]]
    for line in re.sub(r"\x1b\[[0-9;]*m", "", said).splitlines():
        content = line.strip(_FRAME)
        if line.startswith(("╭", "╰")) or not content.strip("-"):
            parts.append([])
        else:
            parts[-1].append(content)
    filled = [part for part in parts if part]
    if "╭" not in said:  # the first is the title
        del filled[:1]
    return " ".join(filled[0]).rstrip(".") if filled else ""
