"""Which commands and options there are, read from the help that the parser prints."""

import contextlib
import io
import os
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field

OF_TISFM = ("--help", "--version", "--completion")
SHELLS = ("bash", "zsh", "fish", "tcsh")
_WIDE = "400"  # columns: no option is broken over two lines
_BRACES = re.compile(r"\{([^{} ]+)\}")
_LINE = re.compile(r"[│| ] (-{1,2}[a-z].*)")  # in a frame of lines, or of ASCII
_OPTION = re.compile(r"(?<!\S)(--?[a-z][\w-]*)(?: ([^,]+(?:,[^ ,][^,]*)*))?")
_ANY = {"None", "INT", "FLOAT", "STR"}
_FORMATS = (
    "tum", "kitti", "ply", "glb", "mesh-ply", "mesh-glb", "gltf-camera", "chan", "colmap",
    "colmap-text", "nerfstudio", "undistortion", "undistortion-tiff", "depth-tum", "depth-kitti",
    "depth-exr", "depth-tiff", "depth-pfm", "depth-dpt", "masks", "video-depth", "video-flow",
    "video-side-by-side", "video-anaglyph", "video-wiggle",
)  # fmt: skip
_OUTPUTS = ("depth", "depth16", "flow", "anaglyph", "figure", "ply", "pose", "npz")
LISTS: Mapping[str, Mapping[str, tuple[str, ...]]] = {
    "export": {"--to": _FORMATS},
    "run": {"--outputs": _OUTPUTS},
}
"""Options that take several words, with commas, and which: the help has them in no braces."""

Help = Callable[[list[str]], object]


@dataclass(frozen=True, kw_only=True)
class Known:
    """Commands, and their options.

    Attributes
    ----------
    options : mapping of str to (mapping of str to tuple of str)
        Of every command, its options and the values that each takes; none where any will do.
    shapes : mapping of str to (mapping of str to str)
        Of every command, what each option takes, as the help has it, such as ``{None}|INT``.
    """

    options: Mapping[str, Mapping[str, tuple[str, ...]]] = field(default_factory=dict)
    shapes: Mapping[str, Mapping[str, str]] = field(default_factory=dict)

    @property
    def commands(self) -> tuple[str, ...]:
        """The commands, in the order of the help."""
        return tuple(self.options)


def known_options(parse: Help, *, command: str | None = None) -> Known:
    """Return all commands, and the options of all, or of one alone.

    Parameters
    ----------
    parse : callable
        Takes arguments, and prints help where they ask for it.
    command : str, optional
    """
    usage = _printed(parse, ["--help"])
    found = _BRACES.search(usage)
    commands = found[1].split(",") if found else []
    shapes = {
        name: dict(_read(_printed(parse, [name, "--help"]))) if command in (None, name) else {}
        for name in commands
    }
    options = {
        name: {option: values_in(shape) for option, shape in taken.items()}
        for name, taken in shapes.items()
    }
    return Known(options=options, shapes=shapes)


def values_in(shape: str) -> tuple[str, ...]:
    """Return the values that an option takes; none where any will do."""
    values = [value for part in _BRACES.findall(shape) for value in part.split(",")]
    return tuple(value for value in dict.fromkeys(values) if value not in _ANY)


def takes_numbers(shape: str) -> bool:
    """Return whether an option takes numbers."""
    return re.search(r"\b(?:INT|FLOAT)\b", shape) is not None


def _read(text: str) -> Iterator[tuple[str, str]]:
    """Yield options and what they take, from the help of a command."""
    for line in text.splitlines():
        found = _LINE.match(line)
        if found is None:
            continue
        head = found[1].rstrip(" │|").split("  ")[0]
        yield from _OPTION.findall(head)


def _printed(parse: Help, arguments: list[str]) -> str:
    """Return what is printed where help is asked for."""
    text = io.StringIO()
    with _columns(), contextlib.redirect_stdout(text), contextlib.suppress(SystemExit):
        parse(arguments)
    return re.sub(r"\x1b\[[0-9;]*m", "", text.getvalue())


@contextmanager
def _columns() -> Iterator[None]:
    before = os.environ.get("COLUMNS")
    os.environ["COLUMNS"] = _WIDE
    try:
        yield
    finally:
        if before is None:
            del os.environ["COLUMNS"]
        else:
            os.environ["COLUMNS"] = before
