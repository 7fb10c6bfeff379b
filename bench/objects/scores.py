"""Errors of labels, depth and motion of moving objects in rendered scenes."""

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import fmean, median

import numpy as np
from numpy.typing import NDArray

from bench.depth.pairs import STATIC_LABELS
from bench.depth.scores import limit_depth
from bench.shared.results import EMPTY_CELL, Table
from tisfm.metrics import depth_errors, pose_errors
from tisfm.rigid import pose_matrix
from tisfm.scenes import SyntheticPair


@dataclass(frozen=True, kw_only=True)
class SceneObject:
    """Errors of one object of a scene; the first object is the background."""

    # Intersection over union with the label that overlaps it most; None without labels.
    iou: float | None
    abs_rel: float  # depth error in the scale of the object
    direction: float | None  # as in `tisfm.metrics.PoseErrors`, degrees


@dataclass(frozen=True, kw_only=True)
class Score:
    method: str
    group: str
    pair: str
    seconds: float
    objects: tuple[SceneObject, ...] = ()  # empty if the method failed
    labels: int | None = None  # number of labels; None without labels
    one_scale: float | None = None  # abs-rel over the whole image, for a method with one scale
    threshold: float | None = None  # of the essential matrix, px
    failure: str = ""

    @property
    def complete(self) -> bool:
        """Whether the numbers of labels and objects are equal."""
        return self.labels == len(self.objects)


def true_objects(pair: SyntheticPair) -> NDArray[np.intp]:
    """Return the object of every pixel: 0 for the static scene, then the blocks."""
    return np.maximum(pair.labels - STATIC_LABELS + 1, 0)


def compare_objects(
    pair: SyntheticPair,
    depth: NDArray,  # (H, W); NaN without a depth
    motions: NDArray,  # (K, 4, 4); motion of each label
    labels: NDArray | None,  # (H, W) int; None if one motion serves the whole image
) -> tuple[SceneObject, ...]:
    true = true_objects(pair)
    errors = []
    for number in range(int(true.max()) + 1):
        mask = true == number
        best_label, iou = (0, None) if labels is None else _best_label(labels, mask)
        is_counted = mask & pair.visible
        if labels is not None:
            is_counted &= labels == best_label
        truth = pose_matrix(pair.motions[0 if number == 0 else STATIC_LABELS + number - 1])
        errors.append(
            SceneObject(
                iou=iou,
                abs_rel=_abs_rel(depth, pair.depth, is_counted),
                direction=pose_errors(motions[best_label], truth).direction,
            )
        )
    return tuple(errors)


def best(scores: Sequence[Score]) -> list[Score]:
    """Return the scores at the threshold with the least mean error of objects, if there is one."""
    thresholds = sorted({s.threshold for s in scores if s.threshold is not None})
    if not thresholds:
        return list(scores)

    def error(threshold: float) -> float:
        scores_at = [s for s in scores if s.threshold == threshold]
        return (
            fmean(t.abs_rel for s in scores_at for t in s.objects)
            if all(s.objects for s in scores_at)
            else 1e9
        )

    best_threshold = min(thresholds, key=error)
    return [s for s in scores if s.threshold in (best_threshold, None)]


def table(scores: Sequence[Score]) -> Table:
    """Return the table of one group: a row for every method, at its best threshold."""
    head = (
        "method", "complete", "IoU lowest", "mean", "abs-rel background, mean", "objects, mean",
        "worst", "direction background, °", "objects, mean °", "one scale, mean", "s",
    )  # fmt: skip
    rows = []
    for method in dict.fromkeys(s.method for s in scores):
        best_scores = best([s for s in scores if s.method == method])
        scenes = [s for s in best_scores if s.objects]
        static_objects = [s.objects[0] for s in scenes]
        moving_objects = [item for s in scenes for item in s.objects[1:]]
        ious = [t.iou for t in (*static_objects, *moving_objects) if t.iou is not None]
        one_scale = [s.one_scale for s in scenes if s.one_scale is not None]
        threshold = next((s.threshold for s in best_scores if s.threshold is not None), None)
        rows.append(
            [
                method if threshold is None else f"{method} ({threshold:g} px)",
                f"{sum(s.complete for s in best_scores)} of {len(best_scores)}"
                if ious
                else EMPTY_CELL,
                f"{min(ious):.3f}" if ious else EMPTY_CELL,
                f"{fmean(ious):.3f}" if ious else EMPTY_CELL,
                *(
                    [
                        f"{fmean(t.abs_rel for t in static_objects):.4f}",
                        f"{fmean(t.abs_rel for t in moving_objects):.4f}",
                        f"{max(t.abs_rel for t in moving_objects):.4f}",
                        _directions(static_objects, 2),
                        _directions(moving_objects, 1),
                    ]
                    if scenes
                    else [EMPTY_CELL] * 5
                ),
                f"{fmean(one_scale):.3f}" if one_scale else EMPTY_CELL,
                f"{median(s.seconds for s in best_scores):#.3g}",
            ]
        )
    return Table(head, rows)


def details(scores: Sequence[Score]) -> Table:
    """Return a row for every scene and method with labels; the background comes first."""
    rows = [
        [
            s.pair,
            s.method,
            str(s.labels),
            " ".join(f"{item.iou:.3f}" for item in s.objects),
            " ".join(f"{item.abs_rel:.4f}" for item in s.objects),
            " ".join(_directions([item], 1) for item in s.objects),
            f"{s.seconds:#.3g}",
        ]
        for s in scores
        if s.labels is not None
    ]
    return Table(["scene", "method", "labels", "IoU", "abs-rel", "direction, °", "s"], rows)


def _directions(objects: Sequence[SceneObject], digits: int) -> str:
    directions = [item.direction for item in objects if item.direction is not None]
    return f"{fmean(directions):.{digits}f}" if directions else EMPTY_CELL


def _best_label(labels: NDArray, mask: NDArray) -> tuple[int, float]:
    """Return the label that overlaps an object most, and the intersection over union."""
    overlaps = [
        float(((labels == k) & mask).sum() / ((labels == k) | mask).sum())
        for k in range(int(labels.max()) + 1)
    ]
    best_label = int(np.argmax(overlaps))
    return best_label, overlaps[best_label]


def _abs_rel(depth: NDArray, truth: NDArray, is_counted: NDArray) -> float:
    """Return abs-rel of an object in its own scale; 1 if no pixel of it has a depth."""
    part = np.where(is_counted, depth, np.nan)
    if not np.isfinite(part).any():
        return 1.0
    return depth_errors(limit_depth(part), truth, is_counted).abs_rel
