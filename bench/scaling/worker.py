"""Process of `bench.scaling` that times whole pairs with a given number of threads.

It reads one line of JSON from standard input and prints one. OpenCV's DIS is timed in the same
process, with the same threads, in the same rounds.
"""

import contextlib
import importlib
import json
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np

import tisfm
from bench.shared.contest import FAST_CALL, measure_time
from bench.shared.peer_worker import dis
from tisfm import runtime

PEER = "OpenCV DIS medium"

# Module, function and name of each stage of a pair. Its time excludes other stages that it calls.
STAGES = (
    ("tisfm.prepared_pair", "grey_pair", "grey levels"),
    ("tisfm.solver.image_pyramid", "ImagePyramid.__init__", "pyramids and splines"),
    ("tisfm.solver.coarse_to_fine", "unknowns_on", "start of a level"),
    ("tisfm.solver.coarse_to_fine", "data_term_on", "start of a level"),
    ("tisfm.solver.coarse_to_fine", "minimiser_on", "start of a level"),
    ("tisfm.solver.coarse_to_fine", "_estimate_level", "warp, derivatives, constraints"),
    ("tisfm.solver.half_quadratic", "HalfQuadratic.update", "iterations"),
    ("tisfm.solver.half_quadratic", "HalfQuadratic.minimise", "iterations"),
    ("tisfm.solver.unknowns", "Unknowns.precision", "read-out"),
    ("tisfm.motion.field", "resize_to_finest", "read-out"),
    ("tisfm.motion.field", "_read_out", "read-out"),
    ("tisfm.pair", "pyramid_occlusion", "occlusion"),
    ("tisfm.pair", "confidence", "confidence"),
    ("tisfm.pair", "interpret", "all else"),
)


class Stopwatch:
    """Adds up the time of stages; a stage excludes the stages that run within it."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._inside: list[float] = []

    @contextlib.contextmanager
    def watching(self) -> Iterator[None]:
        originals = []
        for module, path, label in STAGES:
            owner: Any = importlib.import_module(module)
            *outer, name = path.split(".")
            for part in outer:
                owner = getattr(owner, part)
            originals.append((owner, name, getattr(owner, name)))
            setattr(owner, name, self._timed(originals[-1][2], label))
        try:
            yield
        finally:
            for owner, name, original in originals:
                setattr(owner, name, original)

    def _timed(self, function: Callable[..., Any], label: str) -> Callable[..., Any]:
        def timed(*arguments: Any, **options: Any) -> Any:
            self._inside.append(0.0)
            start_time = time.perf_counter()
            try:
                return function(*arguments, **options)
            finally:
                elapsed = time.perf_counter() - start_time
                inside = self._inside.pop()
                self.seconds[label] = self.seconds.get(label, 0.0) + elapsed - inside
                if self._inside:
                    self._inside[-1] += elapsed

        return timed


def measure(request: dict[str, Any]) -> dict[str, Any]:
    """Return the times of every pair and of the peer in every round, and the shares of stages."""
    runtime.start(threads=request["threads"])
    settings = tisfm.Settings.preset(request["preset"])
    pairs = {}
    for name, path in request["pairs"].items():
        with np.load(path) as file:
            camera = tisfm.Camera(focal=float(file["focal"]))
            pairs[name] = (file["frame0"], file["frame1"], camera)

    def interpret(name: str) -> None:
        from tisfm import pair  # the stopwatch replaces functions of this module

        frame0, frame1, camera = pairs[name]
        pair.interpret(frame0, frame1, camera=camera, settings=settings)

    frames, peer = pairs[request["peer"]][:2], dis("MEDIUM")
    calls: dict[str, Callable[[], Any]] = {}
    for name in pairs:
        calls[name] = partial(interpret, name)
        if name == request["peer"]:
            calls[PEER] = partial(peer, *frames)
    times = measure_in_turns(calls, request["rounds"])
    peer_times = {"name": PEER, "size": request["peer"], "times": times.pop(PEER)}
    shares = {}
    for name in pairs:
        watch = Stopwatch()
        with watch.watching():
            for _ in range(request["rounds"]):
                interpret(name)
        total = sum(watch.seconds.values())
        shares[name] = {label: seconds / total for label, seconds in watch.seconds.items()}
    return {"times": times, "shares": shares, "peer": peer_times, "lanes": runtime.lanes()}


def measure_in_turns(calls: dict[str, Callable[[], Any]], rounds: int) -> dict[str, list[float]]:
    """Return the times of every call, s; each call runs once per round.

    As in `bench.shared.contest`, a quick call also runs once untimed before.
    """
    for call in calls.values():  # compiles kernels
        call()
    pace = {name: measure_time(call)[1] for name, call in calls.items()}
    times: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(rounds):
        for name, call in calls.items():
            if pace[name] < FAST_CALL:
                call()
            times[name].append(measure_time(call)[1])
    return times


if __name__ == "__main__":
    print(json.dumps(measure(json.loads(sys.stdin.readline()))))
