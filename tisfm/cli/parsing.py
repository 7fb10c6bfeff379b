"""Parsing of arguments by tyro, with an error of one line if tyro refuses an argument.

The errors are made from the events of `tyro._errors`, a private module, and help texts are joined
by a function of `tyro._strings`: pyproject.toml bounds tyro by its minor version, and
tests/cli/test_wrong_options.py and test_help.py check both.
"""

import inspect
import shutil
import sys
import textwrap
import types
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import fields, is_dataclass
from functools import partial
from itertools import takewhile
from typing import (
    Annotated,
    Any,
    Literal,
    NoReturn,
    TypeVar,
    Union,
    get_args,
    get_origin,
    get_type_hints,
)

import tyro
from tyro import _errors, _strings

from tisfm.checks import find_similar_word
from tisfm.errors import InputError

T = TypeVar("T")
LIST_OPTIONS = {"export": ("--to",), "run": ("--outputs",)}
"""Options that may have several values with commas between, by commands."""
_MAX_LISTED_CHOICES = 12  # an error with a suggestion lists no more values than this; set by hand


class WrongOptionError(InputError):
    """The arguments of a command are not those that it takes."""


def parse(name: str, command: type[T], arguments: Sequence[str], default: T | None = None) -> T:
    """Return a command with the values of its arguments.

    Parameters
    ----------
    name : str
        Name of the command on the command line.
    command : type
        Its dataclass.
    arguments : sequence of str
        The arguments after the name.
    default : command, optional
        Values of options that are not given, instead of the defaults of the dataclass.

    Raises
    ------
    WrongOptionError
        If an argument is wrong, or one is missing.
    SystemExit
        After the help text, if --help is given.
    """
    words = _split_commas(arguments, LIST_OPTIONS.get(name, ()))
    options = option_types(command)
    _refuse_unknown(name, words, options)

    def refuse(event: _errors.ParseErrorEvent) -> NoReturn:
        raise WrongOptionError(f"{_explain(name, event, words)}; see tisfm {name} --help")

    defaults: dict[str, Any] = {} if default is None else {"default": default}
    text = inspect.cleandoc(command.__doc__ or "")
    with _errors.on_parse_error(refuse), wrapped_help(text) as description:
        return tyro.cli(
            command, prog=f"tisfm {name}", args=words, description=description, **defaults
        )


@contextmanager
def wrapped_help(text: str) -> Iterator[str]:
    """Yield a description wrapped for the terminal; let tyro join the lines of the help of options.

    By itself, tyro wraps no description, and keeps the line breaks of indented docstrings.
    """
    width = shutil.get_terminal_size().columns

    def join_lines(lines: str, width: int = sys.maxsize) -> str:
        fill = partial(textwrap.fill, width=width, break_on_hyphens=False)
        return "\n\n".join(map(fill, map(inspect.cleandoc, lines.split("\n\n"))))

    description = join_lines(text, width)
    original = _strings.remove_single_line_breaks
    _strings.remove_single_line_breaks = lambda helptext: (
        helptext if helptext == description else join_lines(helptext)
    )
    try:
        yield description
    finally:
        _strings.remove_single_line_breaks = original


def _marker(annotated: Any) -> Any:
    """Return the marker of tyro in an annotated type."""
    return annotated.__metadata__[0]


def option_types(command: type) -> dict[str, Any]:
    """Return the names of the options of a command, such as "--preset", with their types."""
    options: dict[str, Any] = {"--help": bool, "-h": bool}
    for field in fields(command):
        kind = get_type_hints(command, include_extras=True)[field.name]
        markers = list(get_args(kind)[1:]) if get_origin(kind) is Annotated else []
        kind = get_args(kind)[0] if markers else kind
        if is_dataclass(kind):
            options |= option_types(kind)  # type: ignore[arg-type]  # it is a class
            continue
        if _marker(tyro.conf.Positional[int]) in markers:
            continue
        labels = [marker for marker in markers if hasattr(marker, "aliases")]
        option_name = next((label.name for label in labels if label.name), field.name).replace(
            "_", "-"
        )
        options[f"--{option_name}"] = kind
        if kind is bool and _marker(tyro.conf.FlagCreatePairsOff[bool]) not in markers:
            options[f"--no-{option_name}"] = kind
        options |= {alias: kind for label in labels for alias in label.aliases or ()}
    return options


def suggestion(word: str, words: Iterable[str]) -> str:
    """Return ": did you mean …?" with the nearest known word; "" if none is similar."""
    known_word = find_similar_word(word, words)
    return "" if known_word is None else f": did you mean {known_word}?"


def _split_commas(arguments: Sequence[str], list_options: Sequence[str]) -> list[str]:
    """Return the arguments with ``--to a,b`` written as ``--to a --to b``."""
    words: list[str] = []
    remaining = iter(arguments)
    for word in remaining:
        name, equals, value = word.partition("=")
        if name not in list_options:
            words.append(word)
            continue
        text = value if equals else next(remaining, "")
        values = [value for value in text.replace(" ", "").split(",") if value] or [text]
        words += [part for value in values for part in (name, value)] if text else [name]
    return words


def _refuse_unknown(name: str, words: Sequence[str], options: dict[str, Any]) -> None:
    for word in takewhile(lambda argument: argument != "--", words):
        option = word.partition("=")[0]
        # tyro accepts underscores instead of dashes.
        if option.startswith("--") and option.replace("_", "-") not in options:
            raise WrongOptionError(
                f"tisfm {name} has no option {option}{suggestion(option, options)}; see tisfm "
                f"{name} --help"
            )


def _explain(name: str, event: _errors.ParseErrorEvent, words: Sequence[str]) -> str:
    """Return the reason, in words, why tyro refuses the arguments of a command."""
    if isinstance(event, _errors.InvalidChoice):
        choices = [choice for choice in _choices(event.argument) if choice != "None"]
        hint_text = suggestion(event.value, choices)
        option = event.argument.display_name()
        if hint_text and len(choices) > _MAX_LISTED_CHOICES:
            return f"{option} is {event.value!r}{hint_text}"
        return f"{option} is {event.value!r}{hint_text}; expected one of {', '.join(choices)}"
    if isinstance(event, _errors.BadValue) and event.argument.is_positional():
        count, label = event.argument.lowered.nargs, event.argument.lowered.metavar
        return f"tisfm {name} takes {count} {event.argument.field.intern_name}: give {label}"
    if isinstance(event, (_errors.BadValue, _errors.InstantiationFailure)) and event.argument:
        argument = event.argument
        option, expected = argument.display_name(), _expected_values(argument)
        given_values = _given_values(argument.lowered.name_or_flags, words)
        if not given_values:
            return f"{option} has no value: expected {expected}"
        text = " ".join(given_values)
        return f"{option} is {text!r}{suggestion(text, _literals(argument))}; expected {expected}"
    if isinstance(event, _errors.UnrecognizedArgs):
        return f"tisfm {name} does not take {' '.join(event.tokens)}"
    if isinstance(event, _errors.MissingArgs):
        missing_names = [
            missing.arg.lowered.metavar
            if missing.arg.is_positional()
            else f"{missing.arg.lowered.name_or_flags[0]} {missing.arg.lowered.metavar}"
            for missing in event.missing_arguments
        ]
        return f"tisfm {name} needs {', '.join(map(str, missing_names))}"
    message = getattr(event, "message", "these options are wrong")
    return " ".join(str(message).split())


def _choices(argument: Any) -> list[str]:
    """Return the values of an option in the order of its declaration."""
    declared = _literals(argument)
    return declared or [str(choice) for choice in argument.lowered.choices or ()]


def _literals(argument: Any) -> list[str]:
    values = [
        str(value)
        for kind in _alternatives(argument.field.type_stripped)
        if get_origin(kind) is Literal
        for value in get_args(kind)
    ]
    return list(dict.fromkeys(values))


def _alternatives(kind: Any) -> list[Any]:
    """Return the types of a union, or of the items of a tuple of any length, without None."""
    if get_origin(kind) in (Union, types.UnionType):
        return [alternative for part in get_args(kind) for alternative in _alternatives(part)]
    if get_origin(kind) is tuple and get_args(kind)[-1] is Ellipsis:
        return _alternatives(get_args(kind)[0])
    return [] if kind is type(None) else [kind]


def _expected_values(argument: Any) -> str:
    """Return in words the values that an option takes, such as "a whole number"."""
    texts: list[str] = []
    for kind in _alternatives(argument.field.type_stripped):
        parts = get_args(kind) if get_origin(kind) is tuple else (kind,)
        if get_origin(kind) is Literal:
            choices = list(map(str, get_args(kind)))
            texts += choices[:_MAX_LISTED_CHOICES] + ["…"] * (len(choices) > _MAX_LISTED_CHOICES)
        elif set(parts) <= {int, float}:
            noun = "whole number" if set(parts) == {int} else "number"
            texts.append(f"a {noun}" if len(parts) == 1 else f"{len(parts)} {noun}s")
        else:
            texts.append(str(argument.lowered.metavar or "a value"))
    return " or ".join(dict.fromkeys(texts))


def _given_values(names: Sequence[str], words: Sequence[str]) -> list[str]:
    """Return the values of an option at its last occurrence."""
    values: list[str] = []
    is_open = False
    for word in words:
        name, equals, value = word.partition("=")
        if name.replace("_", "-") in names:
            values, is_open = [value] if equals else [], not equals
        elif word.startswith("-") and word.lstrip("-")[:1].isalpha():
            is_open = False
        elif is_open:
            values.append(word)
    return values
