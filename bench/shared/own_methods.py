"""tisfm's own methods, as they take part in a contest."""

import time
from collections.abc import Callable
from dataclasses import dataclass

from numpy.typing import NDArray

import tisfm
from bench.shared.contest import Call, MethodFailure
from bench.shared.sequences import FlowPair
from tisfm.horn_schunck import horn_schunck
from tisfm.settings import Preset, Settings


@dataclass(frozen=True)
class Own:
    """A function of tisfm, on frames as they were read."""

    name: str
    estimate: Callable[[NDArray, NDArray], NDArray]

    def run(self, pair: FlowPair) -> Call:
        """Return the flow of a pair, or raise `MethodFailure`."""
        used, started = time.process_time(), time.perf_counter()
        try:
            flow = self.estimate(pair.frame0, pair.frame1)
        except Exception as error:  # one failure must not lose the others' figures
            raise MethodFailure(f"{type(error).__name__}: {error}") from error
        seconds, cpu = time.perf_counter() - started, time.process_time() - used
        return Call(flow=flow, seconds=seconds, cpu=cpu)


def interpretation(name: str, settings: Settings) -> Own:
    """Return `tisfm.interpret` with settings; its time includes depth, motion and confidence."""
    return Own(name, lambda *frames: tisfm.interpret(*frames, settings=settings).flow)


def preset(name: Preset) -> Own:
    """Return a preset of `tisfm.interpret`."""
    return interpretation(f"tisfm {name}", Settings.preset(name))


def baseline() -> Own:
    """Return tisfm's Horn and Schunck."""
    return Own("tisfm Horn–Schunck", horn_schunck)
