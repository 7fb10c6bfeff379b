"""What the commands of the contests have in common: options, pairs, progress."""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar, get_args

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from bench.shared.contest import Contest, Method, hold
from bench.shared.sequences import FlowPair, data_folder, find_pairs, scene_pairs
from tisfm.settings import Preset

SMOKE_SIZE, SCENE_SIZE = (96, 128), (480, 640)
TABLE_WIDTH = 160  # columns, where the output is no terminal

T = TypeVar("T")


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that all contests have."""
    parser.add_argument("--data", type=Path, metavar="DIR", help="sequences; default: TISFM_DATA")
    parser.add_argument("--pairs", nargs="+", metavar="WORD", help="pairs with a WORD in the name")
    parser.add_argument(
        "--only", "--methods", nargs="+", metavar="WORD", help="methods with a WORD in the name"
    )
    parser.add_argument("--threads", type=int, default=2, metavar="N")
    parser.add_argument("--rounds", type=int, default=5, metavar="N", help="timed calls of each")
    parser.add_argument("--smoke", action="store_true", help="small scenes, one round, no data")
    parser.add_argument("--output", metavar="NAME", help="name of the files in bench/results")


def add_method_options(parser: argparse.ArgumentParser) -> None:
    """Add which presets of tisfm take part, and where the flows of others come from."""
    parser.add_argument(
        "--preset", nargs="+", choices=get_args(Preset), default=["balanced"], metavar="PRESET"
    )
    add_peer_option(parser)


def add_peer_option(parser: argparse.ArgumentParser) -> None:
    """Add where other libraries are."""
    parser.add_argument("--peer-python", type=Path, metavar="PATH", help="the peers' interpreter")


@dataclass(frozen=True)
class Pairs:
    """The pairs to measure on, why others are missing, and a word on where they come from."""

    pairs: list[FlowPair]
    missing: dict[str, str]
    source: str


def load_pairs(options: argparse.Namespace) -> Pairs:
    """Return the pairs that the options ask for; rendered scenes where no data are named."""
    if options.smoke:
        found = Pairs(scene_pairs(*SMOKE_SIZE), {}, "small rendered scenes")
    elif (folder := data_folder(options.data)) is None:
        found = Pairs(scene_pairs(*SCENE_SIZE), {}, "rendered scenes: no folder of sequences named")
    else:
        found = Pairs(*find_pairs(folder), "real sequences")
        if not found.pairs:
            raise ValueError(f"{folder} has none of the sequences: {', '.join(found.missing)}")
    chosen = choose(found.pairs, options.pairs, what="pair", name=lambda pair: pair.name)
    return Pairs(chosen, found.missing, found.source)


def choose(items: Sequence[T], words: Sequence[str] | None, *, what: str, name: Any) -> list[T]:
    """Return the items with one of the words in their names, or all where no words are given."""
    if words is None:
        return list(items)
    lowered = [word.lower() for word in words]
    chosen = [item for item in items if any(word in name(item).lower() for word in lowered)]
    if not chosen:
        names = ", ".join(name(item) for item in items)
        raise ValueError(f"no {what} has {' or '.join(words)} in its name: there are {names}")
    return chosen


def hold_with_progress(
    methods: Sequence[Method], found: Pairs, options: argparse.Namespace, **details: Any
) -> Contest:
    """Hold a contest, and show what it is at."""
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    rounds = 1 if options.smoke else options.rounds
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        calls = len(methods) * (1 + (rounds + 1) * len(found.pairs))
        task = progress.add_task("", total=calls)

        def step(text: str) -> None:
            progress.update(task, description=text, advance=1)

        return hold(methods, found.pairs, rounds=rounds, step=step, **details)


def wide_console() -> Console:
    """Return a console in which the tables keep their columns."""
    console = Console()
    return Console(width=max(console.width, TABLE_WIDTH))


def check_counts(parser: argparse.ArgumentParser, options: argparse.Namespace) -> None:
    """Refuse counts below 1."""
    for name in ("threads", "rounds"):
        if getattr(options, name) < 1:
            parser.error(f"--{name} is {getattr(options, name)}: expected at least 1")
