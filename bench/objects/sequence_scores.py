"""Errors of the labels and paths of moving objects in a sequence, and their tables."""

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import fmean

import numpy as np
from numpy.typing import NDArray

from bench.objects.clips import Clip
from bench.objects.mask_scores import ObjectDepthScore, boundary_f, object_depth_score, union_iou
from bench.objects.sequence_methods import ClipLabels
from bench.shared.results import EMPTY_CELL, Table
from tisfm.metrics import LabelScores, ObjectPathErrors, label_scores, object_path_errors

MIN_DEPTH_SHARE = 0.5  # share of the pixels of a label that have depth


@dataclass(frozen=True, kw_only=True)
class ClipScore:
    method: str
    variant: str
    clip: str
    group: str
    iou: float = 0.0  # mean over frames, then over objects; 0 if the method failed
    # Share of the frames with an object in which a label follows it, over all objects.
    followed: float = 0.0
    switches: int = 0
    union: float = 0.0  # region similarity of all labels and all objects
    boundary: float = 0.0  # boundary F of all labels and all objects
    # Share of the frames of labels in which half of the label has depth; None without depth.
    with_depth: float | None = None
    # of rendered clips with labels: as for `ObjectDepthScore`
    depth: float | None = None
    order: float | None = None
    seconds: float = 0.0  # per frame
    # Errors for each true object; None without a label or a known path.
    paths: tuple[ObjectPathErrors | None, ...] = ()
    failure: str = ""


def score_clip(method: str, clip: Clip, result: ClipLabels) -> ClipScore:
    scores = label_scores(result.labels, clip.truth)
    present = sum(item.present for item in scores.objects)
    depth = _depth(clip, result)
    return ClipScore(
        method=method,
        variant=result.variant,
        clip=clip.name,
        group=clip.group,
        iou=scores.iou,
        followed=sum(item.followed for item in scores.objects) / present,
        switches=scores.switches,
        union=union_iou(result.labels, clip.truth),
        boundary=boundary_f(result.labels, clip.truth),
        with_depth=_share_with_depth(result),
        depth=None if depth is None else _known(depth.error),
        order=None if depth is None else _known(depth.order),
        seconds=result.seconds / len(clip.frames),
        paths=_paths(clip, result, scores),
    )


def _depth(clip: Clip, result: ClipLabels) -> ObjectDepthScore | None:
    """Compare the depth of objects on the ground with the true one, if both are known.

    Boxes that fly have no contact, so no scale.
    """
    is_known = clip.film is not None and clip.body_poses is None and result.depth is not None
    if not is_known or not any(np.any(labels) for labels in result.labels):
        return None
    assert clip.film is not None and result.depth is not None
    return object_depth_score(result.depth, result.labels, clip.film.depth, clip.truth)


def _known(value: float) -> float | None:
    return None if np.isnan(value) else value


def _share_with_depth(result: ClipLabels) -> float | None:
    """Return the share of the frames of labels in which half of the label has depth, or None."""
    if result.deviation is None:
        return None
    has_depth = [
        bool(np.isfinite(deviation[labels == number]).mean() >= MIN_DEPTH_SHARE)
        for labels, deviation in zip(result.labels, result.deviation, strict=True)
        for number in np.unique(labels[labels > 0])
    ]
    return fmean(has_depth) if has_depth else None


def _paths(
    clip: Clip, result: ClipLabels, scores: LabelScores
) -> tuple[ObjectPathErrors | None, ...]:
    """Compare the path of each object with the true one, if both are known."""
    if clip.film is None or clip.body_poses is None or result.cameras is None:
        return ()
    by_id = {estimate.id: estimate for estimate in result.objects}
    errors: list[ObjectPathErrors | None] = []
    for item in scores.objects:
        estimate = None if item.label is None else by_id.get(item.label)
        if estimate is None:
            errors.append(None)
            continue
        poses = np.full((len(clip.frames), 4, 4), np.nan)
        poses[list(estimate.frames)] = estimate.poses
        truth: NDArray[np.float64] = clip.body_poses[item.object_id - 1]
        errors.append(object_path_errors(poses, truth, result.cameras, clip.film.poses))
    return tuple(errors)


def best(scores: Sequence[ClipScore]) -> list[ClipScore]:
    """Return the scores of one method in its variant with the best mean IoU."""
    variants = list(dict.fromkeys(s.variant for s in scores))

    def mean(variant: str) -> float:
        return fmean(s.iou for s in scores if s.variant == variant)

    best_variant = max(variants, key=mean)
    return [s for s in scores if s.variant == best_variant]


def table(scores: Sequence[ClipScore]) -> Table:
    """Return the table of one group: a row for every method, in its best variant."""
    clips = list(dict.fromkeys(s.clip for s in scores))
    several = len(clips) > 1
    head = ["method", *(f"{clip} IoU" for clip in clips), *(["mean"] if several else [])]
    head += ["union", "F", "followed, %", "switches", "with depth, %", "s/frame"]
    depths = any(s.depth is not None for s in scores)
    head += ["depth, %", "order, %"] if depths else []
    paths = any(s.paths for s in scores)
    head += ["path, %", "turn, °"] if paths else []
    rows = []
    for method in dict.fromkeys(s.method for s in scores):
        best_scores = best([s for s in scores if s.method == method])
        successful = [s for s in best_scores if not s.failure]
        by_clip = {s.clip: s for s in best_scores}
        name = method + (f" ({best_scores[0].variant})" if best_scores[0].variant else "")
        row = [name, *(_iou(by_clip.get(clip)) for clip in clips)]
        if several:
            row.append(
                f"{fmean(s.iou for s in successful):.3f}"
                if len(successful) == len(clips)
                else EMPTY_CELL
            )
        if successful:
            row += [
                f"{fmean(s.union for s in successful):.3f}",
                f"{fmean(s.boundary for s in successful):.3f}",
                f"{100 * fmean(s.followed for s in successful):.0f}",
                str(sum(s.switches for s in successful)),
                _percent_mean([s.with_depth for s in successful if s.with_depth is not None]),
                f"{fmean(s.seconds for s in successful):#.3g}",
            ]
        else:
            row += [EMPTY_CELL] * 6
        if depths:
            row.append(_percent_mean([s.depth for s in successful if s.depth is not None]))
            row.append(_percent_mean([s.order for s in successful if s.order is not None]))
        if paths:
            row += _path_cells([error for s in successful for error in s.paths])
        rows.append(row)
    return Table(head, rows)


def every_clip(scores: Sequence[ClipScore]) -> Table:
    """Return a row for every clip and every method, in its best variant in the clip's group."""
    rows = []
    for method, group in dict.fromkeys((s.method, s.group) for s in scores if not s.failure):
        of_method = [s for s in scores if (s.method, s.group) == (method, group) and not s.failure]
        rows += [
            [
                s.clip,
                method,
                *(f"{value:.3f}" for value in (s.iou, s.union, s.boundary)),
                *(
                    _percent_mean([] if share is None else [share])
                    for share in (s.with_depth, s.depth, s.order)
                ),
            ]
            for s in best(of_method)
        ]
    head = ["clip", "method", "IoU", "union", "F", "with depth, %", "depth, %", "order, %"]
    return Table(head, rows)


def details(scores: Sequence[ClipScore]) -> Table:
    """Return a row for every variant, with the mean IoU of each group."""
    groups = list(dict.fromkeys(s.group for s in scores))
    rows = []
    for method, variant in dict.fromkeys((s.method, s.variant) for s in scores if not s.failure):
        rows_of_variant = [
            s for s in scores if (s.method, s.variant) == (method, variant) and not s.failure
        ]
        row = [method, variant or EMPTY_CELL]
        for group in groups:
            group_scores = [s for s in rows_of_variant if s.group == group]
            row += (
                [
                    f"{fmean(s.iou for s in group_scores):.3f}",
                    str(sum(s.switches for s in group_scores)),
                ]
                if group_scores
                else [EMPTY_CELL] * 2
            )
        rows.append(row)
    head = [word for group in groups for word in (f"{group} IoU", f"{group} switches")]
    return Table(["method", "variant", *head], rows)


def _percent_mean(shares: Sequence[float]) -> str:
    return f"{100 * fmean(shares):.1f}" if shares else EMPTY_CELL


def _iou(score: ClipScore | None) -> str:
    return EMPTY_CELL if score is None or score.failure else f"{score.iou:.3f}"


def _path_cells(errors: Sequence[ObjectPathErrors | None]) -> list[str]:
    known_errors = [error for error in errors if error is not None]
    shares = [100 * error.share for error in known_errors if error.share is not None]
    if not shares:
        return [EMPTY_CELL] * 2
    missing_count = len(errors) - len(known_errors)
    note = f" ({missing_count} not found)" if missing_count else ""
    return [f"{fmean(shares):.1f}{note}", f"{fmean(error.rotation for error in known_errors):.1f}"]
