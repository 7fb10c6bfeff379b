"""Tables of `bench.trust`."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from bench.shared.results import EMPTY_CELL, Table, cell, markdown_page
from bench.trust.judge import (
    MAX_DEPTH,
    MAX_DIRECTION,
    MAX_PATH,
    MAX_ROTATION,
    OUTCOMES,
)
from tisfm.reconstruction.result.path_check import LIMITS

Record = dict[str, Any]  # a case: its name, kind, half and verdict

# Check → number of `judge.check_numbers`, name of its limit, and whether a right path is below.
CHECKS = {
    "excess": ("excess", "max_excess", True),
    "residual": ("residual_ratio", "max_residual_ratio", True),
    "direction, °": ("direction", "max_direction", True),
    "rank": ("rank", "min_rank", False),
    "behind": ("behind", "max_behind", True),
    "zoom per frame": ("zoom_per_frame", "max_zoom_per_frame", True),
    "zoom, gain": ("zoom_gain", "min_zoom_gain", True),
    "fixed": ("fixed_share", "max_fixed_share", True),
}
INTRODUCTION = f"""A result is wrong if a piece of its path is off by more than {MAX_ROTATION:g}° in
rotation (largest of its frames), {100 * MAX_PATH:g} % of its length in position (root mean square
after the best similarity), or {MAX_DIRECTION:g}° in the direction of motion in the axes of the
camera, or if the median of its depth is off by more than {100 * MAX_DEPTH:g} % (each frame in
its own scale; masked pixels, whose depth is filled and has an infinite deviation, do not
count). A camera that only turns has no depth: stated depth is wrong then. A frame is green if
its status is `converged` and its grade is good or fair; other frames are flagged. A sequence is
wrong and green if a frame of a wrong piece is green. It is right and flagged if no piece is
wrong and less than half of its frames are green; refused if no piece is wrong and less than
half of its frames have depth. Clean inputs have nothing wrong: one that is refused counts as
right and flagged. A flag is due where the camera only turns, and for a pair of one plane that a
second motion explains as well. A right result of an input with a wrong focal length, a zoom or
a lens may be flagged if the message names the camera. A result is told if it is wrong and green
because of such a fault, and its message says that it depends on the stated focal length, which
the image motion does not show. The true positions of sevenscenes are inexact: COLMAP differs
from them by 5.8 mm, 2.4 % of the length of the path, and from tisfm by 1.3 mm. The limit of
that path is 3.2 %, the root of the sum of the squares.""".replace("\n", " ")
# Faults of the camera that a message may name, and the words that name them.
CAMERA_FAULTS = ("focal", "zoom", "lens")
NAMES_CAMERA = (
    "contradicts the camera", "focal length that is", "fit a zoom", "focal length changes",
    "lens distorts",
)  # fmt: skip
NAMES_FOCAL = "depends on the stated focal length"


def settle(record: Record) -> str:
    """Return the outcome of a case; "wrong, told" if the result is green but names its cause."""
    is_told = record["kind"] in CAMERA_FAULTS and any(NAMES_FOCAL in m for m in record["messages"])
    is_missed = record["outcome"] == "wrong, green"
    return "wrong, told" if is_missed and is_told else str(record["outcome"])


def is_false_alarm(record: Record) -> bool:
    """Return whether a right result is flagged, or a clean input refused."""
    outcome = record["outcome"]
    names_fault = record["kind"] in CAMERA_FAULTS and any(
        text in message for text in NAMES_CAMERA for message in record["messages"]
    )
    if record["flag due"] or record.get("two motions") or names_fault:
        return False
    return outcome == "right, flagged" or (outcome == "refused" and record["clean"])


def is_missed(record: Record) -> bool:
    """Return whether a wrong result is green."""
    return settle(record) == "wrong, green"


def count_table(records: Sequence[Record], key: str = "outcome") -> Table:
    """Return the numbers of cases by half and outcome."""
    records = [
        {**record, "outcome": settle(record | {"outcome": record[key]})} for record in records
    ]
    rows = []
    for task in ("sequence", "pair"):
        for half in ("A", "B", "both"):
            chosen = [r for r in records if r["task"] == task and half in (r["half"], "both")]
            if not chosen:
                continue
            counts = Counter(r["outcome"] for r in chosen)
            alarms = sum(map(is_false_alarm, chosen))
            right = counts["right, green"] + alarms
            rows.append(
                [
                    f"{task}s, {half}",
                    str(len(chosen)),
                    *(str(counts[outcome]) for outcome in OUTCOMES),
                    f"{alarms} ({100 * alarms / max(right, 1):.0f} %)",
                ]
            )
    return Table(["", "cases", *OUTCOMES, "of right ones flagged or refused"], rows)


def margin_table(records: Sequence[Record]) -> Table:
    """Return, for each check, its extreme values among right and wrong pieces, and its limit."""
    limits = asdict(LIMITS)
    rows = []
    for name, (number, limit_name, is_below) in CHECKS.items():
        cells = [name, cell(limits.get(limit_name), ".4g")]
        for half in ("A", "B"):
            values: dict[bool, list[float]] = {False: [], True: []}
            for record in records:
                for piece in record.get("pieces", ()) if record["half"] == half else ():
                    value = piece["check"].get(number)
                    if value is not None and value == value:  # not NaN
                        values[bool(piece["faults"])].append(
                            abs(value) if number == "zoom_per_frame" else value
                        )
            worst_right = _extreme(values[False], max if is_below else min)
            least_wrong = _extreme(values[True], min if is_below else max)
            limit = limits.get(limit_name)
            caught, alarms = (
                EMPTY_CELL
                if limit is None
                else f"{sum((v > limit) == is_below for v in values[key])} of {len(values[key])}"
                for key in (True, False)
            )
            cells += [worst_right, alarms, least_wrong, caught]
        rows.append(cells)
    head = ["check", "limit"]
    for half in ("A", "B"):
        head += [f"{half}: right, worst", "beyond", "wrong, least", "beyond"]
    return Table(head, rows)


def _extreme(values: Sequence[float], which: Any) -> str:
    return f"{which(values):.4g}" if values else EMPTY_CELL


def case_table(records: Sequence[Record], code: str) -> Table:
    """Return a row for each case, the worst first; a star marks results of other code."""
    order = {outcome: k for k, outcome in enumerate(OUTCOMES)}
    rows = []
    for record in sorted(records, key=lambda r: (order[settle(r)], r["name"])):
        piece = _worst_piece(record)
        errors = piece.get("errors", record.get("errors", {}))
        statuses, grades = (
            ", ".join(f"{n} {word}" for word, n in record.get(key, {}).items())
            for key in ("statuses", "grades")
        )
        rows.append(
            [
                record["name"] + " \\*" * (record.get("code") != code),
                record["half"],
                settle(record),
                ", ".join(piece.get("faults", record.get("faults", ()))) or EMPTY_CELL,
                statuses,
                grades,
                ", ".join(piece.get("check", {}).get("objections", ())) or EMPTY_CELL,
                cell(errors.get("rotation"), ".2f"),
                _percent(errors.get("path"), 2),
                cell(errors.get("direction"), ".1f"),
                _percent(errors.get("depth"), 1),
                _percent(piece.get("expected", record.get("expected")), 1),
                _percent(_focal_error(record), 1),
            ]
        )
    head = [
        "case", "half", "outcome", "wrong", "statuses", "grades", "objections", "rotation, °",
        "path, %", "direction, °", "depth, %", "expected depth, %", "focal length, %",
    ]  # fmt: skip
    return Table(head, rows, text_columns=7)


def deviation_table(records: Sequence[Record]) -> Table:
    """Return how often the stated deviations hold, in results that are not wrong."""
    rows = []
    for title, is_real in (("rendered", False), ("real", True)):
        for half in ("A", "B"):
            chosen = [
                record
                for record in records
                if record["half"] == half
                and record.get("real") == is_real
                and record["task"] == "sequence"
                and record["outcome"].startswith("right")
            ]
            depth = [record["within"] for record in chosen if record.get("within")]
            focal = [
                abs(record["focal"] - record["true focal"]) / record["focal deviation"]
                for record in chosen
                if record.get("focal deviation")
            ]
            poses = [
                [record[f"{name} within"] for record in chosen if f"{name} within" in record]
                for name in ("position", "rotation")
            ]
            shares = [sum(z <= k for z in focal) for k in (1, 2)]
            rows.append(
                [
                    f"{title}, {half}",
                    str(len(depth)),
                    *_shares(depth, np.median),
                    str(len(poses[0])),
                    *_shares(poses[0], np.mean),
                    *_shares(poses[1], np.mean),
                    str(len(focal)),
                    *(str(share) for share in shares),
                    cell(max(focal, default=None), ".1f"),
                ]
            )
    head = [
        "", "depth: films", "within 1σ, %", "2σ, %", "poses: films", "position within 1σ, %",
        "2σ, %", "rotation within 1σ, %", "2σ, %", "focal length: films", "within 1σ", "2σ",
        "largest, σ",
    ]  # fmt: skip
    return Table(head, rows)


def _shares(shares: Sequence[Sequence[float]], average: Any) -> list[str]:
    """Return an average over films of the shares within one and two deviations, in percent."""
    if not shares:
        return [EMPTY_CELL] * 2
    return [_percent(float(average(part)), 0) for part in zip(*shares, strict=True)]


def _worst_piece(record: Record) -> Mapping[str, Any]:
    """Return the wrong piece with the most frames, or else the largest piece."""
    pieces = record.get("pieces", ())
    if not pieces:
        return {}
    return max(pieces, key=lambda piece: (bool(piece["faults"]), piece["frames"]))


def _focal_error(record: Record) -> float | None:
    if not record.get("true focal"):
        return None
    return float(record["focal"] / record["true focal"] - 1)


def _percent(value: float | None, digits: int) -> str:
    return EMPTY_CELL if value is None else f"{100 * value:.{digits}f}"


def _listed(records: Sequence[Record]) -> list[str]:
    lines = []
    for record in records:
        faults = ", ".join(_worst_piece(record).get("faults", record.get("faults", ())))
        words = [record["name"], *[faults] * bool(faults)]
        if record["outcome"] != "wrong, green" and record["messages"]:
            words.append(record["messages"][0])
        lines.append(": ".join(words))
    return lines


def report(records: Sequence[Record], conditions: Mapping[str, Any], missing: Sequence[str]) -> str:
    """Return the page."""
    judged = [record for record in records if "failure" not in record]
    failed = [f"{r['name']}: {r['failure']}" for r in records if "failure" in r]
    blocks: list[Any] = [
        "# Right or flagged",
        conditions,
        INTRODUCTION,
        "## Counts",
        "The halves are chosen by the names of scenes: limits are chosen on A, and B is reported.",
        count_table(judged),
        "If the status alone decided, without the grade:",
        count_table(judged, "outcome by status"),
        "## Wrong and green",
        _listed([r for r in judged if is_missed(r)]) or "None.",
        "## Right and flagged",
        _listed([r for r in judged if is_false_alarm(r)]) or "None.",
        "## Margins of the checks",
        "Medians over the pairs of a piece. Right, worst: the value of a right piece that is "
        "nearest to the limit or farthest beyond it; wrong, least: of a wrong piece that is "
        "farthest from being found; beyond: pieces beyond the limit. No check finds everything: "
        "each is for a cause.",
        margin_table(judged),
        "## Deviations",
        "Of sequences that are not wrong: the share of pixels whose inverse depth is off by at "
        "most one and two of its standard deviations, the median over films, each frame in its "
        "own scale; the share of positions and rotations, each frame and axis, the mean over "
        "films, after the best alignment of the largest piece, where the true poses are exact; "
        "and the number of estimated focal lengths that are off by as much.",
        deviation_table(judged),
    ]
    for task in ("sequence", "pair"):
        chosen = [record for record in judged if record["task"] == task]
        if chosen:
            blocks += [f"## Every {task}", case_table(chosen, conditions.get("code", ""))]
    for title, lines in (("## Failed", failed), ("## Missing", list(missing))):
        if lines:
            blocks += [title, lines]
    return markdown_page(*blocks)
