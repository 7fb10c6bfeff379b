"""Errors of a pair, and means of the errors of many pairs."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Any, Generic, TypeVar

import numpy as np

from tisfm.camera import Camera
from tisfm.datasets import DatasetPair
from tisfm.metrics import DepthErrors, FlowErrors, OcclusionScores, PoseErrors

LITTLE_PARALLAX_STATUSES = ("little_parallax", "pure_rotation", "no_motion")
"""Statuses of too little parallax to measure depth and the direction of translation."""


@dataclass(frozen=True, kw_only=True)
class PairEvaluation:
    """The errors of one pair, or the reason why there are none.

    Attributes
    ----------
    pair : DatasetPair
        The pair and its files.
    fault : str or None
        The reason why the pair has no errors, in one line; None if it was evaluated.
    size : (int, int) or None
        Height and width, px.
    camera : Camera or None
        The camera of the interpretation.
    status, message : str
        Status of the interpretation and advice; empty without an interpretation.
    seconds : float or None
        Time of the interpretation, without reading files, compiling kernels, comparing and writing.
    errors : FlowErrors or None
        Errors of the flow where the truth is known; None without a true flow.
    visible : FlowErrors or None
        The same errors without pixels that are occluded in frame 1, if the dataset marks them.
    without_sky : FlowErrors or None
        The same errors without the sky, if the dataset marks it.
    occlusion : OcclusionScores or None
        Agreement of the occlusion map with the truth, where the true flow is known. In the truth,
        pixels are occluded if the dataset marks them or if they leave the image. None if the
        dataset has no map. If no pixel is occluded, the count of marked pixels is the number of
        false alarms.
    depth : DepthErrors or None
        Errors of the depth, scaled by the median, where the truth is known; None without a true
        depth or an estimated depth.
    without_depth : bool
        Whether the dataset has true depth but the interpretation has none: its status reports too
        little parallax, or no pixel of known depth has depth.
    pose : PoseErrors or None
        Errors of the motion of the scene relative to the camera; None without a true pose, if the
        pose was given to the interpretation, or if the interpretation has no single motion. With
        too little parallax, its direction is None.

    Examples
    --------
    >>> from tisfm.datasets import find_pairs
    >>> from tisfm.evaluation import PairEvaluation
    >>> (pair,) = find_pairs("calibrated", step=8)
    >>> record = PairEvaluation(pair=pair, fault="the file is damaged")  # `evaluate` makes it
    >>> record.depth is None
    True
    """

    pair: DatasetPair
    fault: str | None = None
    size: tuple[int, int] | None = None
    camera: Camera | None = None
    status: str = ""
    message: str = ""
    seconds: float | None = None
    errors: FlowErrors | None = None
    visible: FlowErrors | None = None
    without_sky: FlowErrors | None = None
    occlusion: OcclusionScores | None = None
    depth: DepthErrors | None = None
    without_depth: bool = False
    pose: PoseErrors | None = None

    @property
    def label(self) -> str:
        """Dataset and name."""
        return f"{self.pair.dataset}/{self.pair.name}"

    @property
    def little_parallax(self) -> bool:
        """Whether the interpretation reports too little parallax for depth."""
        return self.status in LITTLE_PARALLAX_STATUSES


_Errors = TypeVar("_Errors", FlowErrors, DepthErrors, PoseErrors)


@dataclass(frozen=True, kw_only=True)
class ErrorSummary(Generic[_Errors]):
    """Mean and median of one kind of errors over pairs."""

    pairs: int  # pairs with such errors
    # mean, median: mean and median of each error over the pairs that have it; None if `pairs` is 0
    mean: _Errors | None
    median: _Errors | None


@dataclass(frozen=True, kw_only=True)
class DepthMeans(ErrorSummary[DepthErrors]):
    """Errors of depth over pairs."""

    # Pairs with a true depth but without an estimated depth. `pairs` does not count them.
    without_depth: int


@dataclass(frozen=True, kw_only=True)
class PoseMeans(ErrorSummary[PoseErrors]):
    """Errors of pose over pairs."""

    without_direction: int  # pairs among `pairs` without a direction of translation to compare


@dataclass(frozen=True, kw_only=True)
class MeanErrors:
    """Means over pairs. Pairs of all sizes have the same weight (except in `occlusion`)."""

    pairs: int  # evaluated pairs
    seconds: float  # mean time of their interpretations
    flow_pairs: int = 0  # pairs among these with a true flow
    # Means over the pairs with a true flow; `pixels` is the total of all pairs. None without such
    # pairs.
    errors: FlowErrors | None = None
    # visible, without_sky: as in `PairEvaluation`. None unless every pair with a true flow has
    # them, because means over different sets of pairs cannot be compared.
    visible: FlowErrors | None = None
    without_sky: FlowErrors | None = None
    # Scores of the pixels of all pairs together, not a mean: false alarms in pairs without
    # occlusion count as well. None unless every pair with a true flow has scores.
    occlusion: OcclusionScores | None = None
    # means over the pairs with a true depth; None without such pairs
    depth: DepthMeans | None = None
    # means over the pairs whose pose is compared; None without such pairs
    pose: PoseMeans | None = None


def mean_errors(pairs: Sequence[PairEvaluation]) -> MeanErrors | None:
    """Return means over the evaluated pairs; None without such pairs."""
    evaluated_pairs = [pair for pair in pairs if pair.seconds is not None]
    if not evaluated_pairs:
        return None
    pairs_with_flow = [pair for pair in evaluated_pairs if pair.errors is not None]
    return MeanErrors(
        pairs=len(evaluated_pairs),
        seconds=float(np.mean([pair.seconds for pair in evaluated_pairs])),
        flow_pairs=len(pairs_with_flow),
        errors=_mean_flow([pair.errors for pair in pairs_with_flow]),
        visible=_mean_flow([pair.visible for pair in pairs_with_flow]),
        without_sky=_mean_flow([pair.without_sky for pair in pairs_with_flow]),
        occlusion=_total_scores([pair.occlusion for pair in pairs_with_flow]),
        depth=_depth_means(evaluated_pairs),
        pose=_pose_means(evaluated_pairs),
    )


def _depth_means(pairs: Sequence[PairEvaluation]) -> DepthMeans | None:
    pairs_with_truth = [pair for pair in pairs if pair.depth is not None or pair.without_depth]
    errors = [pair.depth for pair in pairs_with_truth if pair.depth is not None]
    if not pairs_with_truth:
        return None
    return DepthMeans(
        pairs=len(errors),
        without_depth=len(pairs_with_truth) - len(errors),
        mean=_reduce_errors(DepthErrors, errors, np.mean) if errors else None,
        median=_reduce_errors(DepthErrors, errors, np.median) if errors else None,
    )


def _pose_means(pairs: Sequence[PairEvaluation]) -> PoseMeans | None:
    errors = [pair.pose for pair in pairs if pair.pose is not None]
    if not errors:
        return None
    return PoseMeans(
        pairs=len(errors),
        without_direction=sum(error.direction is None for error in errors),
        mean=_reduce_errors(PoseErrors, errors, np.mean),
        median=_reduce_errors(PoseErrors, errors, np.median),
    )


def _mean_flow(errors: Sequence[FlowErrors | None]) -> FlowErrors | None:
    """Return the mean of every error; None if a pair has no errors, or there is no pair."""
    known_errors = [error for error in errors if error is not None]
    if not known_errors or len(known_errors) < len(errors):
        return None
    return _reduce_errors(
        FlowErrors, known_errors, np.mean, pixels=sum(error.pixels for error in known_errors)
    )


def _reduce_errors(
    error_class: type[_Errors],
    errors: Sequence[_Errors],
    reduce: Callable[[list[Any]], Any],
    **fixed_values: Any,
) -> _Errors:
    """Reduce each error separately over the pairs that have it, except for fixed values."""
    reduced_errors: dict[str, Any] = {}
    for field in fields(error_class):
        values = [getattr(error, field.name) for error in errors]
        known_values = [value for value in values if value is not None]
        reduced_errors[field.name] = float(reduce(known_values)) if known_values else None
    return error_class(**{**reduced_errors, **fixed_values})


def _total_scores(scores: Sequence[OcclusionScores | None]) -> OcclusionScores | None:
    """Return the scores of all maps together; None if a map is missing, or there is no map."""
    known_scores = [score for score in scores if score is not None]
    if not known_scores or len(known_scores) < len(scores):
        return None
    names = ("hits", "marked", "occluded", "pixels")
    counts = {name: sum(getattr(score, name) for score in known_scores) for name in names}
    return OcclusionScores.from_counts(**counts)
