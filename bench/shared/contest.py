"""Methods of flow that are timed and scored on the same pairs, in turns.

The speed of the machine drifts; in turns, a drift affects all methods equally.
"""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from statistics import median
from typing import Any, Protocol, TypeVar

from numpy.typing import NDArray

import tisfm
from bench.shared.sequences import FlowPair
from tisfm.horn_schunck import horn_schunck
from tisfm.metrics import angular_error, endpoint_error, outlier_rate
from tisfm.settings import Preset, Settings

WARM_UP_SIZE = (96, 128)  # px, of the first call of every method
# A method of shorter calls runs once untimed before each timed call, so that caches are warm.
FAST_CALL = 0.5  # s
SLOW_CALL = 3.0  # s: a slower call has no warm-up on each pair
MAX_SLOW_ROUNDS = 3  # rounds of a slow method

T = TypeVar("T")


def measure_time(function: Callable[..., T], *arguments: Any, **options: Any) -> tuple[T, float]:
    """Return the result of a function, and its wall time, s."""
    start_time = time.perf_counter()
    result = function(*arguments, **options)
    return result, time.perf_counter() - start_time


class MethodFailure(Exception):  # noqa: N818 (the error is the method's)
    """A method gave no flow; the text is the reason."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Call:
    """Result of one call of a method: (H, W, 2) flow, wall and processor time in s."""

    flow: NDArray
    seconds: float
    cpu: float


class Method(Protocol):
    @property
    def name(self) -> str:
        """Name in the tables."""

    def run(self, pair: FlowPair) -> Call:
        """Return the flow of a pair, or raise `MethodFailure`."""


@dataclass(frozen=True, kw_only=True)
class Timing:
    """One timed call: its round, wall and processor time in s."""

    round: int
    seconds: float
    cpu: float


@dataclass(frozen=True, kw_only=True)
class Measurement:
    """A method on a pair: errors (px, degrees, share) and times, or the failure."""

    method: str
    pair: str
    epe: float | None = None
    aae: float | None = None
    outliers: float | None = None
    timings: tuple[Timing, ...] = ()
    failure: str = ""

    @property
    def seconds(self) -> float | None:
        return median(t.seconds for t in self.timings) if self.timings else None


@dataclass(frozen=True, kw_only=True)
class PairInfo:
    """A pair, without its pixels."""

    name: str
    group: str
    size: tuple[int, int]
    note: str


@dataclass(frozen=True, kw_only=True)
class Contest:
    conditions: dict[str, Any]  # machine, threads and versions
    reference: str  # the method whose time is the unit of the ratios
    methods: tuple[str, ...]
    pairs: tuple[PairInfo, ...]
    measurements: tuple[Measurement, ...]
    missing: dict[str, str] = field(default_factory=dict)  # missing method or pair → the reason

    def measurement(self, method: str, pair: str) -> Measurement | None:
        return next((m for m in self.measurements if (m.method, m.pair) == (method, pair)), None)

    def failures(self) -> dict[str, str]:
        """Return "method on pair" → failure."""
        return {f"{m.method} on {m.pair}": m.failure for m in self.measurements if m.failure}

    def as_json(self) -> dict[str, Any]:
        return asdict(self)


def run_contest(
    methods: Sequence[Method],
    pairs: Sequence[FlowPair],
    *,
    reference: str,  # the method whose time is the unit of the ratios
    # Timed calls of each method and pair, after one untimed call; slow methods have fewer, see
    # `SLOW_CALL`. The flow of the first call is scored.
    rounds: int,
    conditions: dict[str, Any],  # as in `Contest`
    missing: dict[str, str],
    # Called before every call with the name of the pair and the method.
    step: Callable[[str], None] = lambda text: None,
) -> Contest:
    """Run every method on every pair, in turns: in each round, each method once."""
    if not pairs:
        raise ValueError("there is no pair to measure on")
    missing, ready_methods = dict(missing), []
    seconds_per_pixel: dict[str, float] = {}  # s per pixel
    small_pair = pairs[0].crop(*WARM_UP_SIZE)
    for method in methods:
        step(f"{method.name}: first call")
        try:
            method.run(small_pair)
            seconds_per_pixel[method.name] = method.run(small_pair).seconds / math.prod(
                small_pair.size
            )
            ready_methods.append(method)
        except MethodFailure as failure:
            missing[method.name] = str(failure)
    measurements: list[Measurement] = []
    for pair in pairs:
        measurements += _measure(ready_methods, pair, rounds, seconds_per_pixel, step)
    return Contest(
        conditions=conditions,
        reference=reference,
        methods=tuple(method.name for method in ready_methods),
        pairs=tuple(PairInfo(name=p.name, group=p.group, size=p.size, note=p.note) for p in pairs),
        measurements=tuple(measurements),
        missing=missing,
    )


def _measure(
    methods: Sequence[Method],
    pair: FlowPair,
    rounds: int,
    seconds_per_pixel: dict[str, float],
    step: Callable[[str], None],
) -> list[Measurement]:
    """Measure all methods on one pair; `seconds_per_pixel`, s per pixel, is updated."""
    pixels = math.prod(pair.size)
    scores: dict[str, Measurement] = {}
    timings: dict[str, list[Timing]] = {method.name: [] for method in methods}
    failures: dict[str, str] = {}
    slow_methods = {
        method.name for method in methods if seconds_per_pixel[method.name] * pixels > SLOW_CALL
    }
    for turn in range(rounds + 1):  # the 0th is the warm-up
        for method in methods:
            name = method.name
            if name in failures or (name in slow_methods and not 1 <= turn <= MAX_SLOW_ROUNDS):
                continue
            step(f"{pair.name}: {name}")
            try:
                if turn > 0 and seconds_per_pixel[name] * pixels < FAST_CALL:
                    method.run(pair)
                call = method.run(pair)
                if name not in scores:
                    scores[name] = score(call.flow, pair, name)
            except MethodFailure as failure:
                failures[name] = str(failure)
                continue
            seconds_per_pixel[name] = max(seconds_per_pixel[name], call.seconds / pixels)
            if turn > 0:
                timings[name].append(Timing(round=turn, seconds=call.seconds, cpu=call.cpu))
    return [
        Measurement(method=name, pair=pair.name, failure=failures[name])
        if (name := method.name) in failures
        else replace(scores[name], timings=tuple(timings[name]))
        for method in methods
    ]


def score(flow: NDArray, pair: FlowPair, method: str) -> Measurement:
    """Return the errors of a method's flow; raise `MethodFailure` if it cannot be scored."""
    try:
        return Measurement(
            method=method,
            pair=pair.name,
            epe=endpoint_error(flow, pair.truth),
            aae=angular_error(flow, pair.truth),
            outliers=outlier_rate(flow, pair.truth),
        )
    except ValueError as error:
        raise MethodFailure(f"its flow cannot be scored: {error}") from None


@dataclass(frozen=True)
class OwnMethod:
    """A method of tisfm, on frames as they were read."""

    name: str
    estimate: Callable[[NDArray, NDArray], NDArray]

    def run(self, pair: FlowPair) -> Call:
        start_cpu, start_time = time.process_time(), time.perf_counter()
        try:
            flow = self.estimate(pair.frame0, pair.frame1)
        except Exception as error:  # a failure must not lose the figures of the other methods
            raise MethodFailure(f"{type(error).__name__}: {error}") from error
        seconds, cpu = time.perf_counter() - start_time, time.process_time() - start_cpu
        return Call(flow=flow, seconds=seconds, cpu=cpu)


def interpretation(name: str, settings: Settings) -> OwnMethod:
    """Return `tisfm.interpret` with settings; its time includes depth, motion and confidence."""
    return OwnMethod(name, lambda *frames: tisfm.interpret(*frames, settings=settings).flow)


def preset(name: Preset) -> OwnMethod:
    return interpretation(f"tisfm {name}", Settings.preset(name))


def baseline() -> OwnMethod:
    return OwnMethod("tisfm Horn–Schunck", horn_schunck)
