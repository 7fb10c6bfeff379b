"""A line of the doctor's table, and the table."""

import json
import textwrap
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Literal

Verdict = Literal["ok", "warning", "wrong", "absent"]
_VERDICT_TEXTS: dict[Verdict, str] = {
    "ok": "ok",
    "warning": "warning",
    "wrong": "WRONG",
    "absent": "-",
}
_LINE_WIDTH = 100


@dataclass(frozen=True)
class Finding:
    """The result of one examination."""

    name: str  # what was examined, such as "Cores"
    verdict: Verdict  # "absent" is an optional part that is not installed
    text: str  # the result in words
    advice: str = ""  # what to do; empty if there is nothing to do


def is_well(findings: Sequence[Finding]) -> bool:
    """Return whether nothing is broken."""
    return all(finding.verdict != "wrong" for finding in findings)


def as_text(findings: Sequence[Finding]) -> str:
    """Return findings as a table in plain words, with a line at the end that sums them up."""
    name_width = max((len(finding.name) for finding in findings), default=0)
    margin = " " * (9 + name_width + 2)
    lines = []
    for finding in findings:
        head = f"{_VERDICT_TEXTS[finding.verdict]:<9}{finding.name:<{name_width}}  "
        lines += _wrap_text(finding.text, head, margin)
        if finding.advice:
            lines += _wrap_text(f"→ {finding.advice}", margin, margin + "  ")
    wrong_count = sum(finding.verdict == "wrong" for finding in findings)
    warning_count = sum(finding.verdict == "warning" for finding in findings)
    summary = (
        "All is well."
        if not wrong_count
        else f"{wrong_count} {'is' if wrong_count == 1 else 'are'} wrong."
    )
    if warning_count:
        summary += f" {warning_count} warning{'s' * (warning_count != 1)}."
    return "\n".join([*lines, "", summary])


def as_json(findings: Sequence[Finding]) -> str:
    """Return findings as JSON: ``ok``, and ``findings`` with all that each has."""
    record = {"ok": is_well(findings), "findings": [asdict(finding) for finding in findings]}
    return json.dumps(record, indent=2, ensure_ascii=False)


def _wrap_text(text: str, head: str, margin: str) -> list[str]:
    lines = textwrap.wrap(
        " ".join(text.split()),
        _LINE_WIDTH,
        initial_indent=head,
        subsequent_indent=margin,
        break_long_words=False,
        break_on_hyphens=False,
    )
    return lines or [head.rstrip()]
