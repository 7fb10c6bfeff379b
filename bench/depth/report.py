"""Tables of a comparison of depth: a summary, a table of each group, and one of thresholds."""

from collections.abc import Callable, Sequence
from pathlib import Path
from statistics import fmean, median

from rich.console import Console

from bench.depth.contest import DepthContest, Group, mean_median_worst
from bench.depth.pairs import (
    BLOCK_MATCHER,
    HAND_HELD,
    LITTLE_MOTION,
    RENDERED_STUDIO,
    ROOMS,
    STEREO,
    TWO_BLOCKS,
    WIDE_BASELINES,
)
from bench.depth.scores import MAX_RELATIVE_DEPTH, Score
from bench.shared.results import (
    EMPTY_CELL,
    Table,
    markdown_page,
    missing_sections,
    print_missing,
    write_results,
)

STATIC = "scenes, all static ones"
WRONG_DEPTH_ERROR = 0.5  # relative error of a pair that counts as wrong
MIN_PARALLAX = 3.0  # px, median parallax of a pair above which depth is expected; set by hand
COMMON_SUFFIX = ", with depth by every method"
_STATIC_PREFIX = "scenes, "
TITLES = {"rooms": "Depth in bare rooms, compared with two stages"}  # by name of the output

HEAD = (
    "method", "abs-rel mean", "median", "limited, mean", "raw map, median", "all pixels, median",
    "most certain pixels, median", "converged but wrong", "depth with parallax",
    "static pixels, mean", "moving objects, mean", "δ < 1.25, %", "density, %", "direction, °",
    "rotation, °", "within σ, %", "no depth", "s", "time / field",
)  # fmt: skip

Reduce = Callable[[Sequence[float]], float]

# Columns of the summary: title, group, name of the error, average, digits.
SUMMARY: tuple[tuple[str, str, str, Reduce, int], ...] = (
    ("scenes abs-rel, mean", STATIC, "abs_rel", fmean, 4),
    ("direction, mean °", STATIC, "direction", fmean, 2),
    ("rotation, mean °", STATIC, "rotation", fmean, 4),
    ("two blocks abs-rel, mean", TWO_BLOCKS, "abs_rel", fmean, 3),
    ("7-Scenes abs-rel, median", HAND_HELD, "abs_rel", median, 3),
    ("raw map", HAND_HELD, "abs_rel_raw", median, 3),
    ("direction, median °", HAND_HELD, "direction", median, 2),
    ("New Tsukuba direction, median °", RENDERED_STUDIO, "direction", median, 2),
    ("rotation, median °", RENDERED_STUDIO, "rotation", median, 4),
    ("stereo abs-rel, mean", STEREO, "abs_rel", fmean, 3),
    ("KITTI stereo", BLOCK_MATCHER, "abs_rel", fmean, 3),
    *((f"{room}, all pixels, median", room, "abs_rel_all", median, 3) for room in ROOMS),
    *((f"{wide} abs-rel, median", wide, "abs_rel", median, 4) for wide in WIDE_BASELINES),
)


def groups(contest: DepthContest) -> list[Group]:
    """Return a group of all static scenes, and then the single groups.

    If a method reports no depth for some pairs of a group, the group without these pairs is added,
    so that all methods are averaged over the same pairs.
    """
    result = []
    for group in _whole_groups(contest):
        result.append(group)
        if 0 < len(common_pairs(contest, group).pairs) < len(group.pairs):
            result.append(common_pairs(contest, group))
    return result


def common_pairs(contest: DepthContest, group: Group) -> Group:
    """Return a group without the pairs for which a method reports no depth."""
    pairs_without_depth = {
        score.pair
        for method in contest.methods
        for score in contest.best(method, group)
        if score.without_depth
    }
    remaining = tuple(pair for pair in group.pairs if pair not in pairs_without_depth)
    return Group(name=group.name + COMMON_SUFFIX, pairs=remaining) if pairs_without_depth else group


def _whole_groups(contest: DepthContest) -> list[Group]:
    static = [group for group in contest.groups if group.name.startswith(_STATIC_PREFIX)]
    static_group = Group(name=STATIC, pairs=tuple(pair for group in static for pair in group.pairs))
    return [static_group, *contest.groups] if len(static) > 1 else list(contest.groups)


def summary(contest: DepthContest) -> Table:
    """Return a row for every method, at its best threshold, over the same pairs."""
    common_groups = {group.name: common_pairs(contest, group) for group in _whole_groups(contest)}
    columns = [column for column in SUMMARY if column[1] in common_groups]
    rows = []
    for method in contest.methods:
        row = [_title(contest, method)]
        for _, group, name, reduce, digits in columns:
            values = _values(contest.best(method, common_groups[group]), name)
            row.append(f"{reduce(values):.{digits}f}" if values else EMPTY_CELL)
        rows.append(row)
    return Table(["method", *(column[0] for column in columns)], rows)


def details(contest: DepthContest) -> dict[str, Table]:
    """Return group → table of all errors, a row for every method at its best threshold."""
    return {group.name: _detail(contest, group) for group in groups(contest)}


def thresholds(contest: DepthContest) -> Table:
    """Return the errors at every threshold of the essential matrix."""
    rows = []
    for method in contest.methods:
        best = contest.best_threshold(method)
        for threshold in contest.thresholds(method):
            direction, abs_rel = contest.typical_errors(method, threshold)
            mark = "best" if threshold == best else ""
            rows.append([method, f"{threshold:g}", f"{direction:.3f}", f"{abs_rel:.4f}", mark])
    return Table(["method", "threshold, px", "direction error, °", "abs-rel, limited", ""], rows)


def notes(contest: DepthContest) -> list[str]:
    lines = [
        "abs-rel: mean of |ΔZ|/Z after scaling every pair by the median, over the pixels with a "
        "positive depth; their share is the density. Limited: depth behind the camera or beyond "
        f"{MAX_RELATIVE_DEPTH:g} medians is set to this limit, so that all pixels count. "
        "δ: share of pixels off by a factor below 1.25.",
        "All pixels: the same over every pixel of known depth, limited to [0.1 min Z, 10 max Z]; "
        "a pixel without depth counts as 10 max Z, a pair without depth as 1, and truth beyond 40 "
        "m is left out. Most certain pixels: the 40% of the pixels with the least relative "
        "deviation, in the unit of the given pose, each limited to 3. Converged but wrong: pairs "
        "with the status converged and an error over all pixels above 0.5. Depth with parallax: "
        "pairs with a depth, of the pairs whose median parallax is above 3 px.",
        "Direction: angle between the translations, 180° if opposite. Rotation: angle between the "
        "estimated and the true rotation. Mean / median / worst over the pairs. A given pose is "
        "given to every method.",
        "Within σ: share of the visible pixels whose error of inverse depth, in the common scale, "
        "is below the standard deviation; 68% for a normal distribution.",
        "No depth: pairs for which the method itself reports too little parallax for depth. They "
        "have no direction and no depth, and do not count in these means. Two stages have no such "
        "status. If some pairs of a group have no depth, a second table and the summary are of "
        "the other pairs.",
        "Seconds: median over the pairs of a group of the median over rounds; two stages include "
        "the flow. Time / field: time over that of the flow field of the same preset.",
        "Essential matrix: OpenCV's findEssentialMat (USAC, MAGSAC) on a regular grid of about "
        "4800 correspondences, the smaller of its two rotations, the sign of t by positive depth, "
        "linear triangulation. Each flow has its best threshold of the last table: the threshold "
        "with the lowest product of the two errors there, which are geometric means over pairs. "
        "Pairs with a given pose, or with a camera that moved very little, do not count.",
    ]
    pairs_without_depth = [
        f"{method}: {', '.join(names)}"
        for method in contest.methods
        if (names := _without_depth(contest, method))
    ]
    if pairs_without_depth:
        lines.append("Reported as too little parallax by " + "; ".join(pairs_without_depth) + ".")
    return lines


def show(contest: DepthContest, console: Console) -> None:
    console.print(summary(contest).rich())
    print_missing(console, contest.missing, contest.failures())


def write(contest: DepthContest, path: Path, *, remarks: Sequence[str] = ()) -> None:
    title = TITLES.get(path.stem, "Depth and motion of the camera, compared with two stages")
    blocks: list[str | Table] = []
    for group in groups(contest):
        blocks += [f"## {_heading(group)}", _detail(contest, group)]
    table = thresholds(contest)
    if table.rows:
        blocks += ["## Thresholds of the essential matrix", table]
    text = markdown_page(
        f"# {title}",
        contest.conditions,
        summary(contest),
        [*remarks, *notes(contest)],
        *missing_sections(contest.missing, contest.failures()),
        *blocks,
    )
    write_results(path, text, contest.as_json())


def _detail(contest: DepthContest, group: Group) -> Table:
    rows = [
        [_title(contest, method), *_cells(contest, method, group)] for method in contest.methods
    ]
    return Table(HEAD, rows).without_empty_columns()


def _cells(contest: DepthContest, method: str, group: Group) -> list[str]:
    scores = contest.best(method, group)
    pairs_without_depth = sum(score.without_depth for score in scores)
    failed_count = sum(bool(score.failure) for score in scores)
    has_status = any(score.status for score in scores)
    return [
        _reduce(scores, "abs_rel", fmean, ".4f"),
        _reduce(scores, "abs_rel", median, ".4f"),
        _reduce(scores, "abs_rel_limited", fmean, ".4f"),
        _reduce(scores, "abs_rel_raw", median, ".4f"),
        _reduce(scores, "abs_rel_all", median, ".4f"),
        _reduce(scores, "abs_rel_certain", median, ".4f"),
        *_count_trusted(scores),
        _reduce(scores, "abs_rel_rest", fmean, ".4f"),
        _reduce(scores, "abs_rel_movers", fmean, ".4f"),
        _reduce(scores, "delta1", fmean, ".1%"),
        _reduce(scores, "density", fmean, ".2%"),
        _format_three(scores, "direction", 2),
        _format_three(scores, "rotation", 4),
        _reduce(scores, "within", fmean, ".0%"),
        (f"{pairs_without_depth} of {len(scores)}" if has_status else EMPTY_CELL)
        + (f", {failed_count} failed" if failed_count else ""),
        _reduce(scores, "seconds", median, "#.3g"),
        _time_ratio(contest, method, group, scores),
    ]


def _count_trusted(scores: list[Score]) -> tuple[str, str]:
    """Return two counts: converged pairs with wrong depth, and pairs with parallax that have depth.

    Both are empty for methods without a status, and if no true depth is known.
    """
    scores_with_truth = [
        score for score in scores if score.status and score.abs_rel_all is not None
    ]
    if not scores_with_truth:
        return EMPTY_CELL, EMPTY_CELL
    converged = [score for score in scores_with_truth if score.status == "converged"]
    wrong_count = sum((score.abs_rel_all or 0) > WRONG_DEPTH_ERROR for score in converged)
    visible = [s for s in scores_with_truth if s.parallax is not None and s.parallax > MIN_PARALLAX]
    with_depth = sum(not score.without_depth for score in visible)
    return (
        f"{wrong_count} of {len(scores_with_truth)}",
        f"{with_depth} of {len(visible)}" if visible else EMPTY_CELL,
    )


def _time_ratio(contest: DepthContest, method: str, group: Group, scores: list[Score]) -> str:
    """Return the median time over the time of the preset's field on the same pair."""
    fields: dict[str, float] = {}
    preset = method.partition(",")[0]
    for other in contest.methods:
        if other.startswith(f"{preset} + "):
            fields = {s.pair: s.flow_seconds for s in contest.best(other, group) if s.flow_seconds}
    ratios = [s.seconds / fields[s.pair] for s in scores if s.seconds and s.pair in fields]
    return f"{median(ratios):#.3g}" if ratios else EMPTY_CELL


def _title(contest: DepthContest, method: str) -> str:
    threshold = contest.best_threshold(method)
    return method if threshold is None else f"{method} ({threshold:g} px)"


def _heading(group: Group) -> str:
    count = f"{len(group.pairs)} pairs" if len(group.pairs) > 1 else "1 pair"
    kind = {
        HAND_HELD: "a hand-held depth camera; the truth is approximate: its map registered to "
        "the picture, or its raw map",
        LITTLE_MOTION: "the same camera, which moved very little",
        RENDERED_STUDIO: "only poses are known",
        TWO_BLOCKS: "moving objects, and a moving camera",
        BLOCK_MATCHER: "the true depth is that of a block matcher",
        **dict.fromkeys(
            WIDE_BASELINES, "a wide baseline; true depth: matched points and the true poses"
        ),
    }.get(group.name)
    return f"{group.name} ({count}{'; ' + kind if kind else ''})"


def _without_depth(contest: DepthContest, method: str) -> list[str]:
    all_pairs = Group(name="", pairs=tuple(p for group in contest.groups for p in group.pairs))
    return [f"{s.pair} ({s.status})" for s in contest.best(method, all_pairs) if s.without_depth]


def _values(scores: Sequence[Score], name: str) -> list[float]:
    values = (getattr(score, name) for score in scores)
    return [value for value in values if value is not None]


def _reduce(scores: Sequence[Score], name: str, reduce: Reduce, form: str) -> str:
    values = _values(scores, name)
    return format(reduce(values), form).rstrip("%").rstrip(".") if values else EMPTY_CELL


def _format_three(scores: Sequence[Score], name: str, digits: int) -> str:
    values = mean_median_worst(_values(scores, name))
    return EMPTY_CELL if values is None else " / ".join(f"{value:.{digits}f}" for value in values)
