"""The calls between modules during an interpretation, with and without repeated calls."""

import json
import subprocess
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

TRACER = Path(__file__).with_name("tracer.py")
LONGEST = 40  # calls in a repeated sequence, at most
INDENT = "  "


@dataclass(frozen=True)
class Call:
    """A call from one module into another, with the calls that it makes."""

    module: str
    inner: tuple["Call | Loop", ...] = ()


@dataclass(frozen=True)
class Loop:
    """A sequence of calls that is repeated; loops with other numbers of repeats count as equal."""

    body: tuple["Call | Loop", ...]
    times: int = field(compare=False)


Calls = Sequence["Call | Loop"]


@dataclass(frozen=True)
class Way:
    """The calls of one interpretation between modules; repeated calls may be folded to a loop.

    A stop is a change of the executing module: by a call, or by the return to a caller.
    """

    calls: Calls

    def walk(self, calls: Calls | None = None) -> Iterator[Call]:
        """Yield every call."""
        for call in self.calls if calls is None else calls:
            if isinstance(call, Call):
                yield call
            yield from self.walk(call.inner if isinstance(call, Call) else call.body)

    @property
    def entered(self) -> Counter[str]:
        """Module → number of calls from other modules."""
        return Counter(call.module for call in self.walk())

    @property
    def back(self) -> int:
        """Number of returns to a caller."""
        return self.entered.total() - 1

    @property
    def stops(self) -> int:
        """Number of stops."""
        return self.entered.total() + self.back

    def without(self, hidden: Callable[[str], bool]) -> "Way":
        """Return unfolded calls in which code of some modules counts as part of their callers."""
        return Way(_shown(self.calls, "", hidden))

    def folded(self) -> "Way":
        """Return the calls with every loop counted once."""
        return Way(fold(self.calls))

    def lines(self, short: Callable[[str], str]) -> Iterator[str]:
        """Yield a line for every call, indented below its caller."""
        yield from _lines(self.calls, short, "")


def trace(folder: Path, python: Path, motion: str) -> Way:
    """Trace one interpretation with the code of a checkout, in its own process."""
    code = TRACER.read_text(encoding="utf-8")
    done = subprocess.run(
        [python, "-c", code, motion], cwd=folder, capture_output=True, text=True, check=False
    )
    if done.returncode != 0:
        last = " ".join(done.stderr.strip().splitlines()[-3:])
        raise RuntimeError(f"{folder} interprets nothing with motion={motion!r}: {last}")
    return from_stops(json.loads(done.stdout))


def from_stops(stops: Iterable[tuple[str, bool]]) -> Way:
    """Return the calls of a list of stops: module, and whether it was called or returned to."""
    open_calls: list[tuple[str, list[Call]]] = [("", [])]
    for module, called in stops:
        if called:
            open_calls.append((module, []))
        else:
            _close(open_calls)
    while len(open_calls) > 1:
        _close(open_calls)
    return Way(open_calls[0][1])


def _close(open_calls: list[tuple[str, list[Call]]]) -> None:
    module, inner = open_calls.pop()
    open_calls[-1][1].append(Call(module, tuple(inner)))


def _shown(calls: Calls, caller: str, hidden: Callable[[str], bool]) -> tuple[Call, ...]:
    found: list[Call] = []
    for call in calls:
        if not isinstance(call, Call):
            raise TypeError("the way is folded: leave modules out before")
        if hidden(call.module) or call.module == caller:
            found += _shown(call.inner, caller, hidden)
        else:
            found.append(Call(call.module, _shown(call.inner, call.module, hidden)))
    return tuple(found)


def fold(calls: Calls) -> tuple["Call | Loop", ...]:
    """Return calls folded to loops: short loops first, then loops of loops."""
    folded: Calls = [
        Call(call.module, fold(call.inner)) if isinstance(call, Call) else call for call in calls
    ]
    length = 0
    while length < min(LONGEST, len(folded) // 2):
        length += 1
        shorter = _fold_once(folded, length)
        if len(shorter) < len(folded):
            folded, length = shorter, 0
    return tuple(folded)


def _fold_once(calls: Calls, length: int) -> Calls:
    found: list[Call | Loop] = []
    at = 0
    while at < len(calls):
        body = tuple(calls[at : at + length])
        times = 1
        while tuple(calls[at + times * length : at + (times + 1) * length]) == body:
            times += 1
        if times == 1:
            found.append(calls[at])
            at += 1
            continue
        found.append(Loop(body, times))
        at += times * length
    return found


def _lines(calls: Calls, short: Callable[[str], str], indent: str) -> Iterator[str]:
    for call in calls:
        if isinstance(call, Call):
            yield indent + short(call.module)
            yield from _lines(call.inner, short, indent + INDENT)
        elif len(call.body) == 1 and isinstance(only := call.body[0], Call):
            yield f"{indent}{short(only.module)} ×{call.times}"
            yield from _lines(only.inner, short, indent + INDENT)
        else:
            yield f"{indent}×{call.times}:"
            yield from _lines(call.body, short, indent + INDENT)
