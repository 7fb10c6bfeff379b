"""A line of the doctor's table, and the table."""

import json
import textwrap
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Literal

Verdict = Literal["ok", "warning", "wrong", "absent"]
_SHOWN: dict[Verdict, str] = {"ok": "ok", "warning": "warning", "wrong": "WRONG", "absent": "-"}
_WIDTH = 100


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
    widest = max((len(finding.name) for finding in findings), default=0)
    margin = " " * (9 + widest + 2)
    lines = []
    for finding in findings:
        head = f"{_SHOWN[finding.verdict]:<9}{finding.name:<{widest}}  "
        lines += _wrapped(finding.text, head, margin)
        if finding.advice:
            lines += _wrapped(f"→ {finding.advice}", margin, margin + "  ")
    wrong = sum(finding.verdict == "wrong" for finding in findings)
    warned = sum(finding.verdict == "warning" for finding in findings)
    told = "All is well." if not wrong else f"{wrong} {'is' if wrong == 1 else 'are'} wrong."
    if warned:
        told += f" {warned} warning{'s' * (warned != 1)}."
    return "\n".join([*lines, "", told])


def as_json(findings: Sequence[Finding]) -> str:
    """Return findings as JSON: ``ok``, and ``findings`` with all that each has."""
    about = {"ok": is_well(findings), "findings": [asdict(finding) for finding in findings]}
    return json.dumps(about, indent=2, ensure_ascii=False)


def _wrapped(text: str, head: str, margin: str) -> list[str]:
    wrapped = textwrap.wrap(
        " ".join(text.split()),
        _WIDTH,
        initial_indent=head,
        subsequent_indent=margin,
        break_long_words=False,
        break_on_hyphens=False,
    )
    return wrapped or [head.rstrip()]
