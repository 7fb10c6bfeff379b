"""Methods on sequences, each in its own process, and their scores."""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from statistics import median
from typing import Any, Protocol

import numpy as np

from bench.sequences.entries import MAX_DEPTH, Entry
from bench.sequences.stored import StoredResult, store
from bench.shared.contest import MethodFailure
from bench.shared.peer_process import THREAD_VARIABLES
from bench.shared.results import ROOT
from bench.shared.worker import MESSAGE_LINES
from tisfm.camera import Camera
from tisfm.datasets import LoadedSequence
from tisfm.evaluation.sequences import SequenceEvaluation, as_record, compare_sequence
from tisfm.formats import read_image, write_png
from tisfm.lens import undistort
from tisfm.settings import Preset

COLMAP_WORKER = Path(__file__).with_name("colmap_worker.py")
TIMEOUT = 3600.0  # s for a method on a sequence


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """One run of a method: name of a result → NAME of `StoredResult`, s, and peak memory in bytes.

    `focal` is an estimated focal length, px: value, standard deviation, and whether it is reliable.
    """

    results: dict[str, str]
    seconds: float
    peak: int
    focal: tuple[float, float, bool] | None = None


class Method(Protocol):
    @property
    def name(self) -> str:
        """Name in the tables."""

    def run(self, loaded: LoadedSequence, camera: Camera, output: Path) -> Outcome:
        """Write results to an empty folder, or raise MethodFailure."""


@dataclass(frozen=True, kw_only=True)
class OwnMethod:
    """`tisfm.reconstruct`, or chained pairs, in its own process.

    `poses_given`: whether it gets the true poses; `camera_given`: whether it gets the camera.
    """

    preset: Preset
    threads: int
    method: str = "reconstruct"  # or "chain"
    poses_given: bool = False
    camera_given: bool = True

    @property
    def name(self) -> str:
        if self.method == "chain":
            return f"chained pairs, {self.preset}"
        changes = ", poses given" * self.poses_given + ", camera unknown" * (not self.camera_given)
        return f"tisfm {self.preset}{changes}"

    def run(self, loaded: LoadedSequence, camera: Camera, output: Path) -> Outcome:
        if self.poses_given and not loaded.posed.all():
            raise MethodFailure("not all poses are known")
        if not self.camera_given and camera.distortion is not None:
            raise MethodFailure("its lens has distortion, which is not estimated")
        answer = _request(
            [sys.executable, "-m", "bench.sequences.worker"],
            {
                "method": self.method,
                "preset": self.preset,
                "threads": self.threads,
                "frames": list(map(str, loaded.frames)),
                "camera": asdict(camera),
                "camera_given": self.camera_given,
                "poses": loaded.poses.tolist() if self.poses_given else None,
                "output": str(output),
            },
            self.threads,
        )
        results = {
            self.name if not name else f"{name}, {self.preset}": file
            for name, file in answer["results"].items()
        }
        focal = None if self.camera_given else answer["focal"]
        return Outcome(results=results, seconds=answer["seconds"], peak=answer["peak"], focal=focal)


@dataclass(frozen=True, kw_only=True)
class Colmap:
    """pycolmap, with an interpreter that has it."""

    python: Path
    threads: int
    name: str = "pycolmap"
    poses_given: bool = False

    def run(self, loaded: LoadedSequence, camera: Camera, output: Path) -> Outcome:
        """Start the process on frames without distortion, and wait for it."""
        images = output / "images"
        images.mkdir()
        names = [f"{index:06d}.png" for index in range(len(loaded.frames))]
        for name, path in zip(names, loaded.frames, strict=True):
            picture = undistort(read_image(path), camera)
            write_png(images / name, picture)
        answer = _request(
            [self.python, COLMAP_WORKER],
            {
                "images": str(images),
                "output": str(output),
                "camera": [camera.focal, *camera.center_for(*picture.shape[:2])],
                "names": names,
                "threads": self.threads,
            },
            self.threads,
        )
        poses = [np.full((4, 4), np.nan) if p is None else np.array(p) for p in answer["poses"]]
        piece = answer["piece"]
        status = ["mapped" if number >= 0 else "no pose" for number in piece]
        store(output, "result", poses=np.array(poses), piece=piece, status=status)
        return Outcome(
            results={self.name: "result"}, seconds=answer["seconds"], peak=answer["peak"]
        )


@dataclass(frozen=True, kw_only=True)
class Score:
    method: str
    sequence: str
    evaluation: SequenceEvaluation | None = None  # of the first round; None if the method failed
    seconds: tuple[float, ...] = ()  # of every round, for the whole sequence
    peak: int | None = None  # peak resident memory of its process, bytes
    # Estimated focal length: error and standard deviation, as shares of the true focal length, and
    # whether it is reliable.
    focal: tuple[float, float, bool] | None = None
    failure: str = ""

    @property
    def per_frame(self) -> float | None:
        """Median over the rounds of the seconds per frame."""
        if not self.seconds or self.evaluation is None:
            return None
        return median(self.seconds) / self.evaluation.frames

    def as_json(self) -> dict[str, Any]:
        """Return everything as plain values, without the folder."""
        record = None
        if self.evaluation is not None:
            record = as_record(self.evaluation)
            del record["folder"]
        return vars(self) | {"evaluation": record, "per_frame": self.per_frame}


@dataclass(frozen=True, kw_only=True)
class SequenceContest:
    conditions: dict[str, Any]
    scores: tuple[Score, ...]
    missing: dict[str, str] = field(default_factory=dict)

    @property
    def failures(self) -> dict[str, str]:
        """Method on sequence → failure."""
        return {f"{s.method} on {s.sequence}": s.failure for s in self.scores if s.failure}

    def as_json(self) -> dict[str, Any]:
        return {
            "conditions": self.conditions,
            "missing": self.missing,
            "scores": [score.as_json() for score in self.scores],
        }


def run_contest(
    methods: Sequence[Method],
    entries: Sequence[Entry],
    *,
    rounds: int,  # runs of each method; the first run is scored, all runs are timed
    conditions: dict[str, Any],  # as in `SequenceContest`
    missing: dict[str, str],
    # Called before every run with the names of sequence and method.
    step: Callable[[str], None] = lambda text: None,
    # Called after every sequence with all scores so far, so that a crash loses none.
    keep: Callable[[list[Score]], None] = lambda scores: None,
) -> SequenceContest:
    """Run every method on every sequence, in turns: in each round, each method once.

    Raise ValueError if there is no sequence, or no method.
    """
    if not entries or not methods:
        raise ValueError("there is no sequence or no method to measure")
    scores: list[Score] = []
    for entry in entries:
        loaded = entry.load()
        if loaded.camera is None:
            missing = missing | {entry.name: "its camera is unknown"}
            continue
        entry_scores: dict[str, Score] = {}
        for turn in range(rounds):
            for method in methods:
                step(f"{entry.name}: {method.name}")
                for score in _scores(method, entry, loaded, loaded.camera, is_scored=turn == 0):
                    entry_scores[score.method] = _merge_rounds(
                        entry_scores.get(score.method), score
                    )
        scores += entry_scores.values()
        keep(scores)
    return SequenceContest(conditions=conditions, scores=tuple(scores), missing=missing)


def _scores(
    method: Method, entry: Entry, loaded: LoadedSequence, camera: Camera, *, is_scored: bool
) -> list[Score]:
    """Run a method once; return a score for each of its results."""
    with tempfile.TemporaryDirectory(prefix="tisfm-sequences-") as folder:
        output = Path(folder)
        try:
            outcome = method.run(loaded, camera, output)
        except MethodFailure as failure:
            return [Score(method=method.name, sequence=entry.name, failure=str(failure))]
        scores = []
        for name, file in outcome.results.items():
            evaluation = None
            if is_scored:
                stored = StoredResult(output, file)
                evaluation = compare_sequence(
                    entry.sequence,
                    loaded,
                    stored,
                    camera=camera,
                    step=entry.step,
                    poses_given=getattr(method, "poses_given", False),
                    max_depth=MAX_DEPTH,
                    with_depth=stored.has_depth,
                    is_truth_blurred=entry.is_truth_blurred,
                )
            scores.append(
                Score(
                    method=name,
                    sequence=entry.name,
                    evaluation=evaluation,
                    seconds=(outcome.seconds,),
                    peak=outcome.peak,
                    focal=_relative_focal(outcome.focal, camera.focal),
                )
            )
        return scores


def _merge_rounds(earlier_score: Score | None, new_score: Score) -> Score:
    """Return the score of the first round with the times of the next one."""
    if earlier_score is None or new_score.failure:
        return new_score
    peak = max(earlier_score.peak or 0, new_score.peak or 0)
    return replace(
        earlier_score, seconds=earlier_score.seconds + new_score.seconds, peak=peak, failure=""
    )


def _relative_focal(
    focal: tuple[float, float, bool] | None, true: float
) -> tuple[float, float, bool] | None:
    if focal is None:
        return None
    estimate, deviation, reliable = focal
    return estimate / true - 1, deviation / true, reliable


def _request(command: list[str | Path], question: dict[str, Any], threads: int) -> dict[str, Any]:
    """Send one request to a process, and return its answer."""
    try:
        process_result = subprocess.run(
            command,
            input=json.dumps(question) + "\n",
            capture_output=True,
            text=True,
            cwd=ROOT,
            env=os.environ | dict.fromkeys(THREAD_VARIABLES, str(threads)),
            timeout=TIMEOUT,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise MethodFailure(str(error)) from None
    lines = process_result.stdout.splitlines()
    if process_result.returncode or not lines:
        words = " ".join(process_result.stderr.strip().splitlines()[-MESSAGE_LINES:])
        raise MethodFailure(f"its process ended with status {process_result.returncode}: {words}")
    answer: dict[str, Any] = json.loads(lines[-1])
    return answer
