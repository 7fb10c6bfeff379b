"""Options, choices, progress and peers of the commands."""

import argparse
import contextlib
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar, get_args

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from bench.shared.contest import Contest, Method, run_contest
from bench.shared.peer_process import Peer, Survey, find_peers
from bench.shared.sequences import FlowPair, data_folder, find_pairs, scene_pairs
from tisfm.settings import Preset

SMOKE_SIZE = (96, 128)  # px, height and width of scenes in a smoke run
SCENE_SIZE = (480, 640)  # px, of scenes without a folder of sequences
POSITIVE_OPTIONS = ("threads", "rounds", "repetitions", "frames")  # options that are 1 or more

# Option → arguments for argparse.
OPTIONS: dict[str, dict[str, Any]] = {
    "data": {"type": Path, "metavar": "DIR", "help": "sequences; default: TISFM_DATA"},
    "pairs": {"nargs": "+", "metavar": "WORD", "help": "pairs with a WORD in the name"},
    "only": {"nargs": "+", "metavar": "WORD", "help": "methods with a WORD in the name"},
    "preset": {"nargs": "+", "choices": get_args(Preset), "metavar": "PRESET"},
    "threads": {"type": int, "default": 2, "metavar": "N"},
    "rounds": {"type": int, "default": 5, "metavar": "N", "help": "timed calls of each"},
    "smoke": {"action": "store_true", "help": "a small and quick run"},
    "output": {"metavar": "NAME", "help": "name of the files in bench/results"},
    "peer-python": {"type": Path, "metavar": "PATH", "help": "the peers' interpreter"},
}
ALIASES = {"only": ("--methods",)}
T = TypeVar("T")


def options_parser(module: str, text: str | None, *names: str, **defaults: Any) -> "Parser":
    """Return the parser of ``python -m bench.MODULE`` with some of `OPTIONS`."""
    parser = Parser(prog=f"python -m bench.{module}", description=text)
    for name in names:
        parser.add_argument(f"--{name}", *ALIASES.get(name, ()), **OPTIONS[name])
    parser.set_defaults(**defaults)
    return parser


class Parser(argparse.ArgumentParser):
    """A parser that refuses counts below 1."""

    def parse_args(self, *arguments: Any, **keywords: Any) -> Any:
        options = super().parse_args(*arguments, **keywords)
        for name in POSITIVE_OPTIONS:
            value = getattr(options, name, None)
            min_value = min(value) if isinstance(value, list) else value
            if min_value is not None and min_value < 1:
                self.error(f"--{name} is {min_value}: expected at least 1")
        return options


def command_text(module: str, options: argparse.Namespace, names: Sequence[str]) -> str:
    """Return the command of a run; folders and interpreters appear as DIR and PATH."""
    words = [f"python -m bench.{module}"]
    for name in names:
        value = getattr(options, name.replace("-", "_"))
        if value is None or value is False or value == []:
            continue
        words.append(f"--{name}")
        if isinstance(value, Path) or (isinstance(value, list) and isinstance(value[0], Path)):
            words.append(OPTIONS[name]["metavar"] if name in OPTIONS else "DIR")
        elif isinstance(value, list):
            words += map(str, value)
        elif value is not True:
            words.append(str(value))
    return f"`{' '.join(words)}`"


def output_name(options: argparse.Namespace, name: str) -> str:
    """Return the name of the files of a run: as given, or by default NAME or smoke-NAME."""
    return options.output or (f"smoke-{name}" if options.smoke else name)


@dataclass(frozen=True)
class Pairs:
    """The pairs of a run, why others are missing, and a note on their source."""

    pairs: list[FlowPair]
    missing: dict[str, str]
    source: str


def load_pairs(options: argparse.Namespace) -> Pairs:
    """Return the pairs that the options name; rendered scenes if no folder is named."""
    if options.smoke:
        pairs = Pairs(scene_pairs(*SMOKE_SIZE), {}, "small rendered scenes")
    elif (folder := data_folder(options.data)) is None:
        pairs = Pairs(scene_pairs(*SCENE_SIZE), {}, "rendered scenes: no folder of sequences named")
    else:
        pairs = Pairs(*find_pairs(folder), "real sequences")
        if not pairs.pairs:
            raise ValueError(f"{folder} has none of the sequences: {', '.join(pairs.missing)}")
    chosen = choose(pairs.pairs, options.pairs, kind="pair", name=lambda pair: pair.name)
    return Pairs(chosen, pairs.missing, pairs.source)


def choose(items: Sequence[T], words: Sequence[str] | None, *, kind: str, name: Any) -> list[T]:
    """Return the items with one of the words in their names, or all if no words are given."""
    if words is None:
        return list(items)
    lower_words = [word.lower() for word in words]
    matches = [item for item in items if any(word in name(item).lower() for word in lower_words)]
    if not matches:
        names = ", ".join(name(item) for item in items)
        raise ValueError(f"no {kind} has {' or '.join(words)} in its name: there are {names}")
    return matches


@contextlib.contextmanager
def progress(total: int) -> Iterator[Callable[[str], None]]:
    """Show a progress bar on standard error; yield a function that names the next step."""
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("", total=total)
        yield lambda text: bar.update(task, description=text, advance=1)


def run_with_progress(
    methods: Sequence[Method], pairs: Pairs, options: argparse.Namespace, **details: Any
) -> Contest:
    rounds = 1 if options.smoke else options.rounds
    with progress(len(methods) * (1 + (rounds + 1) * len(pairs.pairs))) as step:
        return run_contest(methods, pairs.pairs, rounds=rounds, step=step, **details)


@dataclass(frozen=True)
class Peers:
    """Running methods of other libraries."""

    methods: list[Peer]
    survey: Survey  # of all methods of the interpreter
    folder: Path  # temporary folder of exchanged files

    @property
    def versions(self) -> str:
        return ", ".join(f"{name} {number}" for name, number in self.survey.versions.items())


@contextlib.contextmanager
def running_peers(
    options: argparse.Namespace, names: Sequence[str] | None = None
) -> Iterator[Peers]:
    """Yield the named methods of other libraries, or all, if they can run here."""
    python, survey = find_peers(options.peer_python)
    if names is not None:
        reasons = {
            name: reason for name, reason in survey.reasons.items() if name in (*names, "all peers")
        }
        survey = Survey(survey.versions, reasons)
    with contextlib.ExitStack() as stack:
        temporary = stack.enter_context(tempfile.TemporaryDirectory(prefix="tisfm-peers-"))
        folder, methods = Path(temporary), []
        for name in survey.available if names is None else names:
            if name in survey.available:
                methods.append(Peer(name, python=python, threads=options.threads, folder=folder))
                stack.callback(methods[-1].close)
        yield Peers(methods, survey, folder)
