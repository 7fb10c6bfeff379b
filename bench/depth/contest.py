"""Methods of depth that run on the same pairs in turns, and their scores."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from statistics import fmean, median
from typing import Any

import numpy as np

from bench.depth.methods import Method
from bench.depth.pairs import LITTLE_MOTION, DepthPair, Entry
from bench.depth.scores import Score, score
from bench.shared.contest import MethodFailure
from tisfm.rigid import pose_matrix
from tisfm.scenes import static_scene

WARM_UP_SIZE = (96, 128)  # px
MIN_ERROR = 1e-6  # lower limit of errors before their logarithm is taken
# Error that a failure counts as in the choice of a threshold: degrees, and a share.
FAILURE_ERROR = {"direction": 90.0, "abs_rel_limited": 1.0}


@dataclass(frozen=True, kw_only=True)
class Group:
    """Pairs whose errors are averaged together."""

    name: str
    pairs: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class DepthContest:
    conditions: dict[str, Any]  # machine, versions and options
    methods: tuple[str, ...]
    groups: tuple[Group, ...]
    scores: tuple[Score, ...]
    missing: dict[str, str] = field(default_factory=dict)  # missing method or group → the reason

    def thresholds(self, method: str) -> list[float]:
        """Return the thresholds of a method's essential matrix; none for a method without one."""
        return sorted({s.threshold for s in self._scores_of(method) if s.threshold is not None})

    def best_threshold(self, method: str) -> float | None:
        """Return the threshold with the least product of `typical_errors`."""
        candidates = self.thresholds(method)
        if not candidates:
            return None
        return min(candidates, key=lambda t: float(np.prod(self.typical_errors(method, t))))

    def typical_errors(self, method: str, threshold: float | None) -> tuple[float, float]:
        """Return the geometric means over pairs of direction error, degrees, and of abs-rel.

        Two groups of pairs do not count: pairs with a given pose have no essential matrix, and the
        direction is uncertain if the camera moved very little.
        """
        scores = [s for s in self._scores_at(method, threshold) if s.group != LITTLE_MOTION]
        pairs_with_pose = {s.pair for s in self.scores if s.direction is not None}
        pairs_with_depth = {
            s.pair for s in self.scores if s.abs_rel_limited is not None
        } & pairs_with_pose
        return (
            _geometric_mean([_value(s, "direction") for s in scores if s.pair in pairs_with_pose]),
            _geometric_mean(
                [_value(s, "abs_rel_limited") for s in scores if s.pair in pairs_with_depth]
            ),
        )

    def best(self, method: str, group: Group) -> list[Score]:
        """Return the scores of a method on a group, at its best threshold."""
        threshold = self.best_threshold(method)
        return [s for s in self._scores_at(method, threshold) if s.pair in group.pairs]

    def failures(self) -> dict[str, str]:
        """Return "method on pair" → failure, at the best thresholds."""
        return {
            f"{s.method} on {s.pair}": s.failure
            for method in self.methods
            for s in self._scores_at(method, self.best_threshold(method))
            if s.failure
        }

    def as_json(self) -> dict[str, Any]:
        best = {name: self.best_threshold(name) for name in self.methods}
        return asdict(self) | {"best_thresholds": best}

    def _scores_at(self, method: str, threshold: float | None) -> list[Score]:
        """Return the scores at a threshold, also the scores of calls that failed earlier."""
        return [s for s in self._scores_of(method) if s.threshold in (threshold, None)]

    def _scores_of(self, method: str) -> list[Score]:
        return [s for s in self.scores if s.method == method]


def run_contest(
    methods: Sequence[Method],
    entries: Sequence[Entry],
    *,
    # Timed calls of each method and pair; the first is scored. Before the first pair, every method
    # runs on small scenes, to compile its kernels.
    rounds: int,
    conditions: dict[str, Any],  # as in `DepthContest`
    missing: dict[str, str],
    # Called before every call with the name of the pair and the method.
    step: Callable[[str], None] = lambda text: None,
) -> DepthContest:
    """Run every method on every pair, in turns: in each round, each method once.

    Raise ValueError if there is no pair, or no method can run.
    """
    if not entries:
        raise ValueError("there is no pair to measure on")
    missing, ready_methods = dict(missing), []
    for method in methods:
        step(f"{method.name}: first calls")
        try:
            for pair in _small_pairs():
                method.run(pair)
            ready_methods.append(method)
        except MethodFailure as failure:
            missing[method.name] = str(failure)
    if not ready_methods:
        reasons = "; ".join(f"{name}: {reason}" for name, reason in missing.items())
        raise ValueError(f"no method can run: {reasons}")
    scores: list[Score] = []
    pairs_by_group: dict[str, list[str]] = {}
    for entry in entries:
        pair = entry.load()
        pairs_by_group.setdefault(entry.group, []).append(entry.name)
        scores += _measure(ready_methods, pair, rounds, step)
    return DepthContest(
        conditions=conditions,
        methods=tuple(method.name for method in ready_methods),
        groups=tuple(
            Group(name=name, pairs=tuple(pairs)) for name, pairs in pairs_by_group.items()
        ),
        scores=tuple(scores),
        missing=missing,
    )


def mean_median_worst(values: Sequence[float]) -> tuple[float, float, float] | None:
    """Return mean, median and worst value; None without values."""
    return (fmean(values), median(values), max(values)) if values else None


def _measure(
    methods: Sequence[Method], pair: DepthPair, rounds: int, step: Callable[[str], None]
) -> list[Score]:
    scores_by_key: dict[tuple[str, float | None], Score] = {}
    times: dict[tuple[str, float | None], list[tuple[float, float | None]]] = {}
    for turn in range(rounds):
        for method in methods:
            step(f"{pair.name}: {method.name}")
            try:
                estimates = method.run(pair)
            except MethodFailure as failure:
                score_ = Score(
                    method=method.name, pair=pair.name, group=pair.group, failure=str(failure)
                )
                scores_by_key.setdefault((method.name, None), score_)
                continue
            for estimate in estimates:
                key = (estimate.method, estimate.threshold)
                if turn == 0:
                    scores_by_key[key] = score(estimate, pair)
                times.setdefault(key, []).append((estimate.seconds, estimate.flow_seconds))
    return [_add_times(score_, times.get(key, [])) for key, score_ in scores_by_key.items()]


def _add_times(score_: Score, times: list[tuple[float, float | None]]) -> Score:
    flows = [flow for _, flow in times if flow is not None]
    return replace(
        score_,
        seconds=median(s for s, _ in times) if times else None,
        flow_seconds=median(flows) if flows else None,
    )


def _small_pairs() -> list[DepthPair]:
    """Return a scene without a given pose, and the same scene with it."""
    scene = static_scene("sideways+rotation", *WARM_UP_SIZE)
    pair = DepthPair(
        name="warm-up",
        group="",
        frame0=scene.frame0,
        frame1=scene.frame1,
        camera=scene.camera,
        depth=scene.depth,
        pose=pose_matrix(scene.motions[0]),
    )
    return [pair, replace(pair, pose_given=True)]


def _value(score_: Score, name: str) -> float:
    value = getattr(score_, name)
    return FAILURE_ERROR[name] if value is None else max(value, MIN_ERROR)


def _geometric_mean(values: Sequence[float]) -> float:
    return float(np.exp(np.mean(np.log(values)))) if values else 1.0
