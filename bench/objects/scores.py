"""How well things that move on their own are told apart, and their depth and motion found."""

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import fmean, median

import numpy as np
from numpy.typing import NDArray

from bench.depth.pairs import AT_REST
from bench.depth.scores import limited
from bench.shared.contest_report import NOTHING, Cells
from tisfm.metrics import depth_errors, pose_errors
from tisfm.rigid import pose_matrix
from tisfm.scenes import SyntheticPair


@dataclass(frozen=True, kw_only=True)
class Thing:
    """One thing of a scene; the first is the background.

    Attributes
    ----------
    iou : float or None
        With the label that overlaps it most; None of a method without labels.
    abs_rel : float
        In its own scale.
    direction : float or None
        As in `tisfm.metrics.PoseErrors`, degrees.
    """

    iou: float | None
    abs_rel: float
    direction: float | None


@dataclass(frozen=True, kw_only=True)
class Score:
    """A method on a scene.

    Attributes
    ----------
    method, group, pair : str
    seconds : float
    things : tuple of Thing
        None where the method failed.
    labels : int or None
        How many there are; None of a method without labels.
    one_scale : float or None
        abs-rel over the whole image, of a method that gives it one scale.
    threshold : float or None
        Of the essential matrix, px.
    failure : str
    """

    method: str
    group: str
    pair: str
    seconds: float
    things: tuple[Thing, ...] = ()
    labels: int | None = None
    one_scale: float | None = None
    threshold: float | None = None
    failure: str = ""

    @property
    def complete(self) -> bool:
        """Whether there are as many labels as things."""
        return self.labels == len(self.things)


def true_things(pair: SyntheticPair) -> NDArray[np.intp]:
    """Return which thing a pixel is of: 0 for all that is at rest, then the blocks."""
    return np.maximum(pair.labels - AT_REST + 1, 0)


def compared(
    pair: SyntheticPair, depth: NDArray, motions: NDArray, labels: NDArray | None
) -> tuple[Thing, ...]:
    """Compare every thing of a scene with what was found there.

    Parameters
    ----------
    pair : SyntheticPair
    depth : (H, W) array
        NaN where there is none.
    motions : (K, 4, 4) array
        Of each label.
    labels : (H, W) int array or None
        None where there is one motion for all.
    """
    true = true_things(pair)
    found = []
    for thing in range(int(true.max()) + 1):
        mine = true == thing
        partner, iou = (0, None) if labels is None else _partner(labels, mine)
        counted = mine & pair.visible
        if labels is not None:
            counted &= labels == partner
        truth = pose_matrix(pair.motions[0 if thing == 0 else AT_REST + thing - 1])
        found.append(
            Thing(
                iou=iou,
                abs_rel=_abs_rel(depth, pair.depth, counted),
                direction=pose_errors(motions[partner], truth).direction,
            )
        )
    return tuple(found)


def best(scores: Sequence[Score]) -> list[Score]:
    """Return the scores at the threshold of the least mean error of things, or all if none."""
    thresholds = sorted({s.threshold for s in scores if s.threshold is not None})
    if not thresholds:
        return list(scores)

    def error(threshold: float) -> float:
        at = [s for s in scores if s.threshold == threshold]
        return fmean(t.abs_rel for s in at for t in s.things) if all(s.things for s in at) else 1e9

    chosen = min(thresholds, key=error)
    return [s for s in scores if s.threshold in (chosen, None)]


def table(scores: Sequence[Score]) -> Cells:
    """Return a row for every method on scores of one group, each at its best threshold."""
    head = [
        "method",
        "found",
        "IoU least",
        "mean",
        "abs-rel background, mean",
        "things, mean",
        "worst",
        "direction background, °",
        "things, mean °",
        "one scale, mean",
        "s",
    ]
    rows = []
    for method in dict.fromkeys(s.method for s in scores):
        chosen = best([s for s in scores if s.method == method])
        scenes = [s for s in chosen if s.things]
        at_rest = [s.things[0] for s in scenes]
        moving = [thing for s in scenes for thing in s.things[1:]]
        ious = [t.iou for t in (*at_rest, *moving) if t.iou is not None]
        whole = [s.one_scale for s in scenes if s.one_scale is not None]
        threshold = next((s.threshold for s in chosen if s.threshold is not None), None)
        rows.append(
            [
                method if threshold is None else f"{method} ({threshold:g} px)",
                f"{sum(s.complete for s in chosen)} of {len(chosen)}" if ious else NOTHING,
                f"{min(ious):.3f}" if ious else NOTHING,
                f"{fmean(ious):.3f}" if ious else NOTHING,
                *(
                    [
                        f"{fmean(t.abs_rel for t in at_rest):.4f}",
                        f"{fmean(t.abs_rel for t in moving):.4f}",
                        f"{max(t.abs_rel for t in moving):.4f}",
                        _directions(at_rest, 2),
                        _directions(moving, 1),
                    ]
                    if scenes
                    else [NOTHING] * 5
                ),
                f"{fmean(whole):.3f}" if whole else NOTHING,
                f"{median(s.seconds for s in chosen):#.3g}",
            ]
        )
    return Cells(head, rows)


def details(scores: Sequence[Score]) -> Cells:
    """Return a row for every scene and method with labels: the background first, then things."""
    rows = [
        [
            s.pair,
            s.method,
            str(s.labels),
            " ".join(f"{thing.iou:.3f}" for thing in s.things),
            " ".join(f"{thing.abs_rel:.4f}" for thing in s.things),
            " ".join(_directions([thing], 1) for thing in s.things),
            f"{s.seconds:#.3g}",
        ]
        for s in scores
        if s.labels is not None
    ]
    return Cells(["scene", "method", "labels", "IoU", "abs-rel", "direction, °", "s"], rows)


def _directions(things: Sequence[Thing], digits: int) -> str:
    """Return the mean error of the directions that there are."""
    known = [thing.direction for thing in things if thing.direction is not None]
    return f"{fmean(known):.{digits}f}" if known else NOTHING


def _partner(labels: NDArray, mine: NDArray) -> tuple[int, float]:
    """Return the label that overlaps a thing most, and the intersection over union."""
    overlaps = [
        float(((labels == k) & mine).sum() / ((labels == k) | mine).sum())
        for k in range(int(labels.max()) + 1)
    ]
    partner = int(np.argmax(overlaps))
    return partner, overlaps[partner]


def _abs_rel(depth: NDArray, truth: NDArray, counted: NDArray) -> float:
    """Return abs-rel of a part in its own scale; 1 where nothing of it has a depth."""
    part = np.where(counted, depth, np.nan)
    if not np.isfinite(part).any():
        return 1.0
    return depth_errors(limited(part), truth, counted).abs_rel
