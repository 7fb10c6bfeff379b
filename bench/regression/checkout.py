"""A checkout of the project, and the processes that run its code."""

import os
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench.shared.worker import Worker

WORKER = Path(__file__).with_name("worker.py")
Sample = tuple[float, float]  # wall time and that of the processor, s
CACHE = "TI_OFFLINE_CACHE_FILE_PATH"  # where Taichi keeps compiled kernels


@dataclass(frozen=True, kw_only=True)
class Checkout:
    """A folder with the project's code, and the interpreter that runs it."""

    name: str
    folder: Path
    python: Path

    def worker(self, threads: int, exchange: Path, *, cache: Path | None = None) -> Worker:
        """Return a worker that has not started yet.

        Parameters
        ----------
        threads : int
        exchange : Path
            Folder for its messages.
        cache : Path, optional
            Where it keeps compiled kernels; by default where Taichi does.
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
        """Raise RuntimeError unless all that a worker has loaded of tisfm is this checkout's."""
        worker.start()
        folder = self.folder.resolve()
        strange = [file for file in worker.ready["files"] if not Path(file).is_relative_to(folder)]
        if strange:
            raise RuntimeError(
                f"{self.python} in {self.folder} loads {strange[0]}: expected the code of this "
                "folder; name an interpreter of its own"
            )

    def start(self, request: dict[str, Any], **options: Any) -> tuple[Sample, Sample]:
        """Return what the import took in a fresh process, and all to its first answer."""
        started = time.perf_counter()
        worker = self.worker(**options)
        try:
            answer = worker.ask(request)
            seconds = time.perf_counter() - started
        finally:
            worker.close()
        if "seconds" not in answer:
            raise RuntimeError(f"{self.name}: {answer['status']}")
        return worker.ready["import"], (seconds, answer["process"])
