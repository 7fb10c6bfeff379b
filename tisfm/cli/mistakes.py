"""One line for what the parser refuses, with what was meant."""

import re
from collections.abc import Iterable, Sequence
from itertools import takewhile

from tisfm.checks import nearest
from tisfm.cli.known_options import OF_TISFM, Help, known_options

_FRAME = " │|╭╰─╮╯"
_NUMBERS = re.compile(r"\b(?:INT|FLOAT)\b")
_REFUSED = re.compile(r"Error parsing (-\S+):")
_SHAPE = re.compile(r"no type matching (.*?) could be instantiated")
_NO_VALUE = re.compile(r"Missing value for argument '(.*?)'\. Expected (\d+)")
_NO_PLACE = re.compile(r"Unrecognized options: (.*)")
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
    refused = _REFUSED.match(text) or _NO_VALUE.match(text)
    if refused is not None and refused[1].startswith("-"):
        names = refused[1].split("/")
        found = _SHAPE.search(text)
        shapes = [known.shapes[given].get(name, "") for name in names]
        expected = _expected(found[1] if found else max(shapes, key=len))
        words = _after(names, arguments)
        if not words:
            return f"{refused[1]} stands without its value: expected {expected}; {_see(given)}"
        told, values = " ".join(words), known.options[given].get(names[0], ())
        return f"{refused[1]} is {told!r}{_meant(told, values)}; expected {expected}"
    if refused is not None and refused.re is _NO_VALUE:
        return f"tisfm {given} takes {refused[2]} {refused[1]}; {_see(given)}"
    extra = _NO_PLACE.match(text)
    if extra is not None:
        return f"tisfm {given} has no place for {extra[1]}; {_see(given)}"
    missing = re.match(r"Missing from tisfm (\w+): (.*?) (?:[A-Z][a-z]|A ).*", text)
    if missing is not None:
        return f"tisfm {given} needs {missing[2]}; {_see(given)}"
    return f"{text or 'these options are wrong'}; {_see(given)}"


def _expected(shape: str) -> str:
    """Return in words what an option takes, by its shape in the help, such as ``{None}|INT``."""
    numbers = _NUMBERS.findall(shape)
    if not numbers:
        return shape or "a value"
    kind = "whole number" if set(numbers) == {"INT"} else "number"
    told = f"a {kind}" if len(numbers) == 1 else f"{len(numbers)} {kind}s"
    words = [word for part in re.findall(r"\{([^{} ]+)\}", shape) for word in part.split(",")]
    return " or ".join([told, *(word for word in words if word not in ("None", *numbers))])


def _after(names: Sequence[str], arguments: Sequence[str]) -> list[str]:
    """Return the words that are given to an option, where it is given last."""
    words: list[str] = []
    is_taken = False
    for argument in arguments:
        name, equals, value = argument.partition("=")
        if name.replace("_", "-") in names:
            words, is_taken = [value] if equals else [], not equals
        elif re.match(r"-{1,2}[A-Za-z]", argument):
            is_taken = False
        elif is_taken:
            words.append(argument)
    return words


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
