"""A comparison of depth as tables: one that sums it up, one of each group, one of thresholds."""

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from statistics import fmean, median

from rich.console import Console

from bench.depth.contest import DepthContest, Group, mean_median_worst
from bench.depth.pairs import (
    BLOCK_MATCHER,
    HAND_HELD,
    HARDLY_MOVED,
    MOVING,
    RENDERED_STUDIO,
    ROOMS,
    STEREO,
    WIDES,
)
from bench.depth.scores import HORIZON, Score
from bench.shared.contest_report import NOTHING, Cells

STATIC = "scenes, all static ones"
HALF = 0.5  # relative error
PARALLAX = 3.0  # px
COMMON = ", with depth by every method"
_STATIC_PREFIX = "scenes, "
TITLES = {"rooms": "Depth in bare rooms, beside two stages"}  # of files of some of the pairs

Reduce = Callable[[Sequence[float]], float]

# Of the summary: title, group, what is averaged, how, and digits.
SUMMARY: tuple[tuple[str, str, str, Reduce, int], ...] = (
    ("scenes abs-rel, mean", STATIC, "abs_rel", fmean, 4),
    ("direction, mean °", STATIC, "direction", fmean, 2),
    ("rotation, mean °", STATIC, "rotation", fmean, 4),
    ("two blocks abs-rel, mean", MOVING, "abs_rel", fmean, 3),
    ("7-Scenes abs-rel, median", HAND_HELD, "abs_rel", median, 3),
    ("raw map", HAND_HELD, "abs_rel_raw", median, 3),
    ("direction, median °", HAND_HELD, "direction", median, 2),
    ("New Tsukuba direction, median °", RENDERED_STUDIO, "direction", median, 2),
    ("rotation, median °", RENDERED_STUDIO, "rotation", median, 4),
    ("stereo abs-rel, mean", STEREO, "abs_rel", fmean, 3),
    ("KITTI stereo", BLOCK_MATCHER, "abs_rel", fmean, 3),
    *((f"{room}, all pixels, median", room, "abs_rel_all", median, 3) for room in ROOMS),
    *((f"{wide} abs-rel, median", wide, "abs_rel", median, 4) for wide in WIDES),
)


def groups(contest: DepthContest) -> list[Group]:
    """Return the groups, all static scenes together before them.

    A group of which a method says of some pairs that they show no depth is followed by what is
    left of it without these: there, all methods are averaged over the same pairs.
    """
    found = []
    for group in _whole_groups(contest):
        found.append(group)
        if 0 < len(common(contest, group).pairs) < len(group.pairs):
            found.append(common(contest, group))
    return found


def common(contest: DepthContest, group: Group) -> Group:
    """Return a group without the pairs that show no depth in the words of a method."""
    declined = {
        score.pair
        for method in contest.methods
        for score in contest.best(method, group)
        if score.without_depth
    }
    kept = tuple(pair for pair in group.pairs if pair not in declined)
    return Group(name=group.name + COMMON, pairs=kept) if declined else group


def _whole_groups(contest: DepthContest) -> list[Group]:
    static = [group for group in contest.groups if group.name.startswith(_STATIC_PREFIX)]
    together = Group(name=STATIC, pairs=tuple(pair for group in static for pair in group.pairs))
    return [together, *contest.groups] if len(static) > 1 else list(contest.groups)


def summary(contest: DepthContest) -> Cells:
    """Return a row for every method, at its best threshold; all over the same pairs."""
    found = {group.name: common(contest, group) for group in _whole_groups(contest)}
    columns = [column for column in SUMMARY if column[1] in found]
    rows = []
    for method in contest.methods:
        row = [_title(contest, method)]
        for _, group, name, reduce, digits in columns:
            values = _values(contest.best(method, found[group]), name)
            row.append(f"{reduce(values):.{digits}f}" if values else NOTHING)
        rows.append(row)
    return Cells(["method", *(column[0] for column in columns)], rows)


def details(contest: DepthContest) -> dict[str, Cells]:
    """Return group → table of all errors, a row for every method at its best threshold."""
    return {group.name: _detail(contest, group) for group in groups(contest)}


def thresholds(contest: DepthContest) -> Cells:
    """Return what every threshold of the essential matrix gives."""
    rows = []
    for method in contest.methods:
        best = contest.best_threshold(method)
        for threshold in contest.thresholds(method):
            direction, abs_rel = contest.typical_errors(method, threshold)
            mark = "best" if threshold == best else ""
            rows.append([method, f"{threshold:g}", f"{direction:.3f}", f"{abs_rel:.4f}", mark])
    return Cells(["method", "threshold, px", "direction error, °", "abs-rel, limited", ""], rows)


def notes(contest: DepthContest) -> list[str]:
    """Return what a reader of the tables has to know."""
    lines = [
        "abs-rel: mean of |ΔZ|/Z after scaling every pair by the median; its pixels are those with "
        "a positive depth, whose share is the density. Limited: after depth beyond "
        f"{HORIZON:g} medians, or behind the camera, was put there, so that all pixels count. "
        "δ: share of pixels off by a factor below 1.25.",
        "All pixels: the same over every pixel of known depth, limited to [0.1 min Z, 10 max Z]; "
        "one without has the latter, a pair without depth counts as 1, and truth beyond 40 m "
        "is left out. The most certain: the 40% of the pixels with the least relative deviation, "
        "in the unit of the given pose, each limited to 3. Converged, off by half: pairs that say "
        "converged at an error over all pixels above 0.5. Depth where parallax: pairs with a "
        "depth, of those whose median displacement is more than 3 px beside that of the rotation.",
        "Direction: angle between the translations, 180° if opposite. Rotation: angle left between "
        "the rotations. Mean / median / worst over the pairs. Where the pose is given, it is given "
        "to every method.",
        "Within σ: share of the visible pixels whose inverse depth, in the scale of the others, is "
        "off by less than its standard deviation; 68% of a normal error are.",
        "No depth: pairs of which the method itself says that the parallax is too little for "
        "depth, of all. They have no direction and no depth, and enter none of these means. "
        "Two stages have no such status; where some pairs of a group have none, a second table has "
        "the others, and so has the first table of all.",
        "Seconds: median over the pairs of a group of the median over rounds; of two stages, all "
        "of them together. Time over that of the field: over the flow field of the same preset, "
        "which the two stages start from that are named after it.",
        "Essential matrix: OpenCV's findEssentialMat (USAC, MAGSAC) on a regular grid of about "
        "4800 correspondences, the smaller of its two rotations, the sign of t by positive depth, "
        "linear triangulation. Its threshold is, for each flow, the best for it of those in the "
        "last table: of the least product of the geometric means over pairs of the two errors "
        "there. Pairs with a given pose or a camera that hardly moved do not count in it.",
    ]
    silent = [
        f"{method}: {', '.join(names)}"
        for method in contest.methods
        if (names := _without_depth(contest, method))
    ]
    if silent:
        lines.append("Reported as too little parallax by " + "; ".join(silent) + ".")
    return lines


def show(contest: DepthContest, console: Console) -> None:
    """Print the summary, and what is missing or failed."""
    console.print(summary(contest).rich())
    for title, entries in (("missing", contest.missing), ("FAILED", contest.failures())):
        for name, reason in entries.items():
            console.print(f"{title}: {name}: {reason}", highlight=False, markup=False)


def write(contest: DepthContest, path: Path, *, remarks: Sequence[str] = ()) -> None:
    """Write PATH.md and PATH.json."""
    title = TITLES.get(path.stem, "Depth and motion of the camera, beside two stages")
    lines = [f"# {title}", ""]
    lines += [f"- {name}: {value}" for name, value in contest.conditions.items()]
    lines += ["", *summary(contest).markdown(), ""]
    lines += [f"- {note}" for note in (*remarks, *notes(contest))]
    for heading, entries in (("Missing", contest.missing), ("Failed", contest.failures())):
        if entries:
            lines += ["", f"## {heading}", ""]
            lines += [f"- {name}: {reason}" for name, reason in entries.items()]
    for group in groups(contest):
        lines += ["", f"## {_heading(group)}", "", *_detail(contest, group).markdown()]
    table = thresholds(contest)
    if table.rows:
        lines += ["", "## Thresholds of the essential matrix", "", *table.markdown()]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.with_suffix(".md").write_text("\n".join([*lines, ""]), encoding="utf-8")
    content = json.dumps(contest.as_json(), indent=1, ensure_ascii=False)
    path.with_suffix(".json").write_text(content + "\n", encoding="utf-8")


def _detail(contest: DepthContest, group: Group) -> Cells:
    """Return a group's table without the columns that no method fills."""
    head = [
        "method",
        "abs-rel mean",
        "median",
        "limited, mean",
        "raw map, median",
        "all pixels, median",
        "the most certain, median",
        "converged, off by half",
        "depth where parallax",
        "at rest, mean",
        "movers, mean",
        "δ < 1.25, %",
        "density, %",
        "direction, °",
        "rotation, °",
        "within σ, %",
        "no depth",
        "s",
        "time / field",
    ]
    rows = [
        [_title(contest, method), *_cells(contest, method, group)] for method in contest.methods
    ]
    filled = [k for k in range(len(head)) if any(row[k] != NOTHING for row in rows)]
    return Cells([head[k] for k in filled], [[row[k] for k in filled] for row in rows])


def _cells(contest: DepthContest, method: str, group: Group) -> list[str]:
    scores = contest.best(method, group)
    silent = sum(score.without_depth for score in scores)
    failed = sum(bool(score.failure) for score in scores)
    speaks = any(score.status for score in scores)
    return [
        _reduced(scores, "abs_rel", fmean, ".4f"),
        _reduced(scores, "abs_rel", median, ".4f"),
        _reduced(scores, "abs_rel_limited", fmean, ".4f"),
        _reduced(scores, "abs_rel_raw", median, ".4f"),
        _reduced(scores, "abs_rel_all", median, ".4f"),
        _reduced(scores, "abs_rel_certain", median, ".4f"),
        *_trusted(scores),
        _reduced(scores, "abs_rel_rest", fmean, ".4f"),
        _reduced(scores, "abs_rel_movers", fmean, ".4f"),
        _reduced(scores, "delta1", fmean, ".1%"),
        _reduced(scores, "density", fmean, ".2%"),
        _three(scores, "direction", 2),
        _three(scores, "rotation", 4),
        _reduced(scores, "within", fmean, ".0%"),
        (f"{silent} of {len(scores)}" if speaks else NOTHING)
        + (f", {failed} failed" if failed else ""),
        _reduced(scores, "seconds", median, "#.3g"),
        _time_ratio(contest, method, group, scores),
    ]


def _trusted(scores: list[Score]) -> tuple[str, str]:
    """Return how many say that they converged and are wrong, and have depth where it can be seen.

    Both only of methods that have a status, where depth is known.
    """
    known = [score for score in scores if score.status and score.abs_rel_all is not None]
    if not known:
        return NOTHING, NOTHING
    converged = [score for score in known if score.status == "converged"]
    wrong = sum((score.abs_rel_all or 0) > HALF for score in converged)
    visible = [s for s in known if s.parallax is not None and s.parallax > PARALLAX]
    found = sum(not score.without_depth for score in visible)
    return f"{wrong} of {len(known)}", f"{found} of {len(visible)}" if visible else NOTHING


def _time_ratio(contest: DepthContest, method: str, group: Group, scores: list[Score]) -> str:
    """Return the median of the time over that of the preset's field on the same pair."""
    fields: dict[str, float] = {}
    preset = method.partition(",")[0]
    for other in contest.methods:
        if other.startswith(f"{preset} + "):
            fields = {s.pair: s.flow_seconds for s in contest.best(other, group) if s.flow_seconds}
    ratios = [s.seconds / fields[s.pair] for s in scores if s.seconds and s.pair in fields]
    return f"{median(ratios):#.3g}" if ratios else NOTHING


def _title(contest: DepthContest, method: str) -> str:
    threshold = contest.best_threshold(method)
    return method if threshold is None else f"{method} ({threshold:g} px)"


def _heading(group: Group) -> str:
    many = f"{len(group.pairs)} pairs" if len(group.pairs) > 1 else "1 pair"
    kind = {
        HAND_HELD: "a hand-held depth camera: approximate truth, of its map brought to the picture "
        "and of the raw map",
        HARDLY_MOVED: "frames in which the same camera had hardly moved",
        RENDERED_STUDIO: "poses only",
        MOVING: "things that move on their own, beside a moving camera",
        BLOCK_MATCHER: "the truth is a block matcher's",
        **dict.fromkeys(
            WIDES, "a wide baseline; the truth is that of matched points, by the true poses"
        ),
    }.get(group.name)
    return f"{group.name} ({many}{'; ' + kind if kind else ''})"


def _without_depth(contest: DepthContest, method: str) -> list[str]:
    everything = Group(name="", pairs=tuple(p for group in contest.groups for p in group.pairs))
    return [f"{s.pair} ({s.status})" for s in contest.best(method, everything) if s.without_depth]


def _values(scores: Sequence[Score], name: str) -> list[float]:
    values = (getattr(score, name) for score in scores)
    return [value for value in values if value is not None]


def _reduced(scores: Sequence[Score], name: str, reduce: Reduce, form: str) -> str:
    values = _values(scores, name)
    return format(reduce(values), form).rstrip("%").rstrip(".") if values else NOTHING


def _three(scores: Sequence[Score], name: str, digits: int) -> str:
    found = mean_median_worst(_values(scores, name))
    return NOTHING if found is None else " / ".join(f"{value:.{digits}f}" for value in found)
