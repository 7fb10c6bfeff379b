"""Errors of many pairs in a few numbers."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Any, Generic, TypeVar

import numpy as np

from tisfm.evaluation.record import PairEvaluation
from tisfm.metrics import DepthErrors, FlowErrors, OcclusionScores, PoseErrors

_Errors = TypeVar("_Errors", FlowErrors, DepthErrors, PoseErrors)


@dataclass(frozen=True, kw_only=True)
class ErrorSummary(Generic[_Errors]):
    """Errors of a kind over pairs.

    Attributes
    ----------
    pairs : int
        Pairs that have such errors.
    mean, median : FlowErrors, DepthErrors or PoseErrors, or None
        Of every error on its own, over the pairs that have it; None if `pairs` is 0.
    """

    pairs: int
    mean: _Errors | None
    median: _Errors | None


@dataclass(frozen=True, kw_only=True)
class DepthMeans(ErrorSummary[DepthErrors]):
    """Errors of depth over pairs.

    Attributes
    ----------
    without_depth : int
        Pairs whose true depth is known but whose interpretation has none. They are not among
        `pairs`.
    """

    without_depth: int


@dataclass(frozen=True, kw_only=True)
class PoseMeans(ErrorSummary[PoseErrors]):
    """Errors of pose over pairs.

    Attributes
    ----------
    without_direction : int
        Those of `pairs` with no direction of translation to compare.
    """

    without_direction: int


@dataclass(frozen=True, kw_only=True)
class MeanErrors:
    """Means over pairs, each pair counting the same whatever its size (but see `occlusion`).

    Attributes
    ----------
    pairs : int
        Pairs without a fault.
    seconds : float
        Mean time of an interpretation of these.
    flow_pairs : int
        Those of them whose true flow is known.
    errors : FlowErrors or None
        Of these, where the truth is known. Its `pixels` are those of all pairs together. None if
        there are none.
    visible, without_sky : FlowErrors or None
        As in `PairEvaluation`; None unless every one of these pairs has them, because a mean over
        other pairs could not be compared with that of the column beside it.
    occlusion : OcclusionScores or None
        Not a mean: of the pixels of all pairs together, so that a false alarm counts where nothing
        is occluded. None unless every one of these pairs has them.
    depth : DepthMeans or None
        Over the pairs whose true depth is known; None if there are none.
    pose : PoseMeans or None
        Over the pairs whose pose is compared with the true one; None if there are none.
    """

    pairs: int
    seconds: float
    flow_pairs: int = 0
    errors: FlowErrors | None = None
    visible: FlowErrors | None = None
    without_sky: FlowErrors | None = None
    occlusion: OcclusionScores | None = None
    depth: DepthMeans | None = None
    pose: PoseMeans | None = None


def mean_errors(pairs: Sequence[PairEvaluation]) -> MeanErrors | None:
    """Return means over the pairs without a fault, or None if there is none."""
    good = [pair for pair in pairs if pair.seconds is not None]
    if not good:
        return None
    flows = [pair for pair in good if pair.errors is not None]
    return MeanErrors(
        pairs=len(good),
        seconds=float(np.mean([pair.seconds for pair in good])),
        flow_pairs=len(flows),
        errors=_mean_flow([pair.errors for pair in flows]),
        visible=_mean_flow([pair.visible for pair in flows]),
        without_sky=_mean_flow([pair.without_sky for pair in flows]),
        occlusion=_together([pair.occlusion for pair in flows]),
        depth=_depth_means(good),
        pose=_pose_means(good),
    )


def _depth_means(pairs: Sequence[PairEvaluation]) -> DepthMeans | None:
    known = [pair for pair in pairs if pair.depth is not None or pair.without_depth]
    errors = [pair.depth for pair in known if pair.depth is not None]
    if not known:
        return None
    return DepthMeans(
        pairs=len(errors),
        without_depth=len(known) - len(errors),
        mean=_summary(DepthErrors, errors, np.mean) if errors else None,
        median=_summary(DepthErrors, errors, np.median) if errors else None,
    )


def _pose_means(pairs: Sequence[PairEvaluation]) -> PoseMeans | None:
    errors = [pair.pose for pair in pairs if pair.pose is not None]
    if not errors:
        return None
    return PoseMeans(
        pairs=len(errors),
        without_direction=sum(error.direction is None for error in errors),
        mean=_summary(PoseErrors, errors, np.mean),
        median=_summary(PoseErrors, errors, np.median),
    )


def _mean_flow(errors: Sequence[FlowErrors | None]) -> FlowErrors | None:
    """Return the mean of every error, or None if one is missing or there are none."""
    present = [error for error in errors if error is not None]
    if not present or len(present) < len(errors):
        return None
    return _summary(FlowErrors, present, np.mean, pixels=sum(error.pixels for error in present))


def _summary(
    kind: type[_Errors],
    errors: Sequence[_Errors],
    reduce: Callable[[list[Any]], Any],
    **given: Any,
) -> _Errors:
    """Reduce each error on its own over the pairs that have it, but for those that are given."""
    reduced: dict[str, Any] = {}
    for field in fields(kind):
        values = [getattr(error, field.name) for error in errors]
        known = [value for value in values if value is not None]
        reduced[field.name] = float(reduce(known)) if known else None
    return kind(**{**reduced, **given})


def _together(scores: Sequence[OcclusionScores | None]) -> OcclusionScores | None:
    """Return the scores of all maps together, or None if one is missing or there are none."""
    present = [score for score in scores if score is not None]
    if not present or len(present) < len(scores):
        return None
    names = ("hits", "marked", "occluded", "pixels")
    counts = {name: sum(getattr(score, name) for score in present) for name in names}
    return OcclusionScores.from_counts(**counts)
