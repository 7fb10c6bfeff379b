"""Checkouts of the project, the processes that run their code, and their times in turns."""

import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bench.shared.contest import FAST_CALL
from bench.shared.worker import Worker

WORKER = Path(__file__).with_name("worker.py")
Sample = tuple[float, float]  # wall and processor time, s
CACHE = "TI_OFFLINE_CACHE_FILE_PATH"  # environment variable of Taichi's folder of compiled kernels


@dataclass(frozen=True, kw_only=True)
class Checkout:
    """A folder with the project's code, and the interpreter that runs it."""

    name: str
    folder: Path
    python: Path

    def worker(self, threads: int, exchange: Path, *, cache: Path | None = None) -> Worker:
        """Return a worker that has not started yet.

        `exchange` is the folder for its messages, `cache` that of compiled kernels, by default
        Taichi's.
        """
        code = WORKER.read_text(encoding="utf-8")
        environment = {**os.environ, "PYTHONPATH": ""}
        if cache is not None:
            environment[CACHE] = str(cache)
        return Worker(
            [self.python, "-c", code, str(threads)],
            environment=environment,
            messages=exchange / f"{self.name}.txt",
            folder=self.folder,
        )

    def check(self, worker: Worker) -> None:
        """Raise RuntimeError if a worker has loaded code of tisfm from another folder."""
        worker.start()
        folder = self.folder.resolve()
        foreign_files = [
            file for file in worker.ready["files"] if not Path(file).is_relative_to(folder)
        ]
        if foreign_files:
            raise RuntimeError(
                f"{self.python} in {self.folder} loads {foreign_files[0]}: expected the code of "
                "this folder; name an interpreter of its own"
            )

    def start(self, request: dict[str, Any], **options: Any) -> tuple[Sample, Sample]:
        """Return the times of the import in a fresh process, and until its first answer."""
        start_time = time.perf_counter()
        worker = self.worker(**options)
        try:
            answer = worker.ask(request)
            seconds = time.perf_counter() - start_time
        finally:
            worker.close()
        if "seconds" not in answer:
            raise RuntimeError(f"{self.name}: {answer['status']}")
        return worker.ready["import"], (seconds, answer["process"])


Sides = tuple[float, float]  # before, after


@dataclass(frozen=True, kw_only=True)
class PairedTimes:
    """Wall and processor time of one call: (before, after) in s, for each round."""

    name: str
    seconds: Sequence[Sides]
    cpu: Sequence[Sides]

    @classmethod
    def of(cls, name: str, samples: Sequence[tuple[Sample, Sample]]) -> "PairedTimes":
        """Return the times of both sides, (before, after) in each round."""
        wall, cpu = (tuple((before[k], after[k]) for before, after in samples) for k in (0, 1))
        return cls(name=name, seconds=wall, cpu=cpu)

    @property
    def medians(self) -> Sides:
        before, after = np.median(self.seconds, axis=0)
        return float(before), float(after)

    def ratios(self, *, cpu: bool = False) -> tuple[float, float, float]:
        """Return lower quartile, median and upper quartile of after / before over the rounds."""
        times = np.array(self.cpu if cpu else self.seconds)
        low, middle, high = np.quantile(times[:, 1] / times[:, 0], (0.25, 0.5, 0.75))
        return float(low), float(middle), float(high)


def measure_in_turns(rounds: int, measure: Callable[[int], Any]) -> list[tuple[Any, Any]]:
    """Measure sides 0 and 1 in each round, in the order 0 1, 1 0, 0 1, …; return both values."""
    samples = []
    for turn in range(rounds):
        first = turn % 2
        values = {side: measure(side) for side in (first, 1 - first)}
        samples.append((values[0], values[1]))
    return samples


def measure_interpretation(
    name: str, workers: Sequence[Worker], request: dict[str, Any], rounds: int
) -> PairedTimes:
    """Time one request of two running workers.

    A quick request also runs once untimed before each timed call, so that caches are warm.
    """

    def ask(side: int, times: int = 1) -> Sample:
        answer = workers[side].ask(request | {"answer": None, "times": times})
        if "seconds" not in answer:
            raise RuntimeError(f"{name}: {answer['status']}")
        return answer["seconds"], answer["cpu"]

    max_seconds = max(ask(side, times=2)[0] for side in (0, 1))  # the first call compiles kernels
    times = 2 if max_seconds < FAST_CALL else 1
    samples = measure_in_turns(rounds, lambda side: ask(side, times))
    return PairedTimes.of(name, samples)


def measure_starts(
    checkouts: Sequence[Checkout], request: dict[str, Any], rounds: int, **options: Any
) -> list[PairedTimes]:
    """Time fresh processes: the import, and the first answer of a cold and of a warm start.

    Each cold start has an empty folder for compiled kernels; the following warm start uses these
    kernels.
    """
    exchange = options["exchange"]
    turns = [0, 0]

    def measure(side: int) -> tuple[Sample, Sample, Sample]:
        turns[side] += 1
        cache = exchange / f"cache-{side}-{turns[side]}"
        _, cold = checkouts[side].start(request, cache=cache, **options)
        import_times, warm = checkouts[side].start(request, cache=cache, **options)
        return import_times, cold, warm

    samples = measure_in_turns(rounds, measure)
    return [
        PairedTimes.of(name, [(before[k], after[k]) for before, after in samples])
        for k, name in enumerate(("import tisfm", "cold start", "warm start"))
    ]
