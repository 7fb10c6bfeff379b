"""Processes that run methods of other libraries, and their environment."""

import json
import os
import subprocess
import sys
import venv
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from bench.shared.contest import Call, MethodFailure
from bench.shared.sequences import FlowPair
from bench.shared.worker import MESSAGE_LINES, Worker, WorkerDied

WORKER = Path(__file__).with_name("peer_worker.py")
PACKAGES = ("opencv-contrib-python-headless", "scikit-image", "numpy")
# Environment variables that bound the threads of OpenMP and of BLAS.
THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def make_environment(folder: Path) -> Path:
    """Make a virtual environment with the peers' libraries; return its interpreter."""
    if folder.exists() and any(folder.iterdir()) and not (folder / "pyvenv.cfg").exists():
        raise FileExistsError(f"{folder} is not empty: name a new folder for the environment")
    venv.create(folder, with_pip=True)
    scripts = "Scripts" if sys.platform == "win32" else "bin"
    python = folder / scripts / ("python.exe" if sys.platform == "win32" else "python")
    subprocess.run([python, "-m", "pip", "install", "--quiet", *PACKAGES], check=True)
    return python


@dataclass(frozen=True)
class Survey:
    """Methods of an interpreter: library → version, and method → why it cannot run, or ""."""

    versions: dict[str, str]
    reasons: dict[str, str]

    @property
    def available(self) -> list[str]:
        return [name for name, reason in self.reasons.items() if not reason]

    @property
    def missing(self) -> dict[str, str]:
        """Method → reason, of the methods that cannot run."""
        return {name: reason for name, reason in self.reasons.items() if reason}


def survey(python: Path) -> Survey:
    """Return the methods that an interpreter can run; raise RuntimeError if the worker fails."""
    return Survey(**run_survey(python, WORKER))


def run_survey(python: Path, worker: Path) -> dict[str, Any]:
    """Return what a worker reports of its libraries; raise RuntimeError if it fails."""
    command: list[str | Path] = [python, worker, "survey"]
    try:
        process_result = subprocess.run(
            command, capture_output=True, text=True, check=True, timeout=120
        )
        answer: dict[str, Any] = json.loads(process_result.stdout.splitlines()[-1])
        return answer
    except (OSError, subprocess.TimeoutExpired, ValueError, IndexError) as error:
        raise RuntimeError(f"{python} does not run {worker.name}: {error}") from None
    except subprocess.CalledProcessError as error:
        words = " ".join(error.stderr.split("\n")[-1 - MESSAGE_LINES :])
        raise RuntimeError(f"{python} does not run {worker.name}: {words}") from None


def find_peers(python: Path | None) -> tuple[Path, Survey]:
    """Return an interpreter, by default this one, and its methods; no methods if it fails."""
    python = python or Path(sys.executable)
    try:
        return python, survey(python)
    except RuntimeError as error:
        return python, Survey({}, {"all peers": str(error)})


class Peer:
    """A method of another library. Its worker starts when needed, and again after a crash."""

    def __init__(
        self,
        name: str,  # one of `Survey.available`
        *,
        python: Path,  # the interpreter it runs in
        threads: int,  # bound on OpenCV's, OpenMP's and BLAS's threads
        folder: Path,  # folder of exchanged frames and flows
        timeout: float = 900.0,  # s; a call that takes longer ends the worker
    ) -> None:
        self.name = name
        self._folder = folder
        self._worker = Worker(
            [python, WORKER, "serve", name, str(threads)],
            environment=os.environ | dict.fromkeys(THREAD_VARIABLES, str(threads)),
            messages=folder / f"{_file_name(name)}.txt",
            timeout=timeout,
        )

    def run(self, pair: FlowPair) -> Call:
        """Return the flow of a pair, or raise `MethodFailure`; frames are given in grey."""
        flow = self._folder / f"{_file_name(self.name)}.npy"
        frames = [_store_grey(self._folder, pair, index) for index in (0, 1)]
        try:
            answer = self._worker.ask({"frames": [str(path) for path in frames], "flow": str(flow)})
        except WorkerDied as death:
            raise MethodFailure(str(death)) from None
        if "error" in answer:
            raise MethodFailure(answer["error"])
        return Call(flow=np.load(flow), seconds=answer["seconds"], cpu=answer["cpu"])

    def close(self) -> None:
        self._worker.close()


def _store_grey(folder: Path, pair: FlowPair, index: int) -> Path:
    path = folder / f"{pair.name}-{index}.npy"
    if not path.exists():
        frame = (pair.frame0, pair.frame1)[index]
        if frame.ndim == 3:
            frame = cv2.cvtColor(np.ascontiguousarray(frame), cv2.COLOR_RGB2GRAY)
        np.save(path, np.ascontiguousarray(frame))
    return path


def _file_name(name: str) -> str:
    return name.replace(" ", "-")
