"""Statuses and settings as rows of a report."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Any, get_args

from tisfm.grade import COLORS as GRADE_COLORS
from tisfm.grade import GradeSummary
from tisfm.settings import Preset, Settings
from tisfm.status import UNKNOWN_STATUS_ADVICE, Status

MEANINGS = {
    "converged": "The iterations converged.",
    "iteration_limit": "The iterations ended before they converged: depth is less accurate.",
    "no_motion": "The frames are equal up to noise: there is no depth.",
    "no_texture": "The frames have too little texture to measure motion: there is no depth.",
    "little_parallax": "The camera hardly moved: there is no depth.",
    "pure_rotation": "The camera only turned: there is an orientation, and no depth.",
    "aperture": "The frame varies in one direction only, like stripes.",
    "unrelated": "The frames show different scenes, as at a cut, or the motion was not found.",
    "two_motions": "Two motions explain the frames equally well; depth follows from one of them.",
    "behind_camera": "Much of the scene would lie behind the camera: depth is wrong in part.",
    "unexplained": "Motion and depth do not explain the frames: depth is wrong in part.",
    "uncertain": "There is little parallax, or depth has a large deviation: depth is rough.",
    "pose_mismatch": "The given pose contradicts the images.",
    "contradicted": "The image motion contradicts the camera or the path: depth is probably wrong.",
    "noise": "Noise hides the motion: there is no pose.",
    "fixed_pattern": "A pattern that is fixed on the sensor hides the motion: there is no pose.",
    "changing_light": "The light changes from frame to frame: there is no pose.",
    "repeated_texture": "The texture repeats itself: there is no pose.",
    "one_plane": "The scene is one plane, and the focal length is unknown: there is no pose.",
    "diverged": "The iterations diverged: the result is useless.",
}
GRADE_MEANINGS = {
    "good": "Half of the depth is expected to be off by at most 3 %.",
    "fair": "Half of the depth is expected to be off by at most 10 %.",
    "poor": "The depth is expected to be off by more than 10 %, or by an unknown amount.",
    "no depth": "Depth is unknown, or was not requested.",
    "no pose": "There is neither pose nor depth.",
    "contradicted": "The images contradict the pose or the depth.",
}
# Colours of Okabe and Ito: people with a colour vision deficiency can distinguish them.
_COLORS = {
    "converged": "#009e73",
    "iteration_limit": "#56b4e9",
    "uncertain": "#e69f00",
    "two_motions": "#f0e442",
    "little_parallax": "#0072b2",
    "pure_rotation": "#0072b2",
    "no_motion": "#999999",
    "no_texture": "#999999",
    "aperture": "#999999",
    "unrelated": "#cc79a7",
}
_FAILURE_COLOR = "#d55e00"  # colour of all other statuses
_MAX_NAMES = 4  # names of frames with a status; set by hand
_MAX_MESSAGE_LENGTH = 600  # characters; set by hand


@dataclass(frozen=True, kw_only=True)
class StatusCount:
    """The number of frames with a status, and advice."""

    code: str
    meaning: str  # meaning of the code
    advice: str  # message of the first frame with this status
    count: int
    names: str  # names of the first frames with the status


def status_color(code: str) -> str:
    """Return the colour of a status or of the word of a grade."""
    return (_COLORS | GRADE_COLORS).get(code, _FAILURE_COLOR)


def count_grades(summary: GradeSummary) -> list[tuple[str, int, str]]:
    """Return word, count and meaning of the grades that occur, the best first."""
    return [
        (str(grade), count, GRADE_MEANINGS[str(grade)]) for grade, count in summary.counts.items()
    ]


def count_statuses(
    statuses: Sequence[Status], names: Sequence[str], *, converged: str = MEANINGS["converged"]
) -> list[StatusCount]:
    """Return the counts of statuses, the most frequent first.

    `converged` is the meaning of the status of this name.
    """
    meanings = {**MEANINGS, "converged": converged}
    counts = Counter(map(str, statuses))
    result = []
    for code, count in sorted(counts.items(), key=lambda item: (-item[1], item[0])):
        indices = [index for index, status in enumerate(statuses) if status == code]
        name_text = ", ".join(names[index] for index in indices[:_MAX_NAMES])
        further_count = count - _MAX_NAMES
        # The message of "converged" only repeats its meaning.
        message = "" if code == "converged" else statuses[indices[0]].message
        result.append(
            StatusCount(
                code=code,
                meaning=meanings.get(code, UNKNOWN_STATUS_ADVICE),
                advice=shorten(message),
                count=count,
                names="all"
                if count == len(statuses)
                else name_text + f" and {further_count} more" * (further_count > 0),
            )
        )
    return result


def shorten(text: str) -> str:
    """Return a text in one line; a very long text is cut off."""
    line = " ".join(text.split())
    return line if len(line) <= _MAX_MESSAGE_LENGTH else line[: _MAX_MESSAGE_LENGTH - 1] + "…"


def status_spans(codes: Sequence[str], max_parts: int = 500) -> list[tuple[float, float, str]]:
    """Return begin, end (shares of the sequence) and code of consecutive frames with one status.

    A longer sequence is divided into `max_parts` parts; each part has the rarest of its statuses.
    """
    frequency = Counter(codes)
    part_count = min(max_parts, len(codes))
    edges = (
        [len(codes) * part // part_count for part in range(part_count + 1)] if part_count else [0]
    )
    part_codes = [
        min(codes[begin:end], key=lambda code: (frequency[code], code))
        for begin, end in pairwise(edges)
    ]
    result: list[tuple[float, float, str]] = []
    for part, code in enumerate(part_codes):
        begin = part / part_count
        if result and result[-1][2] == code:
            begin = result.pop()[0]
        result.append((begin, (part + 1) / part_count, code))
    return result


@dataclass(frozen=True, kw_only=True)
class SettingRow:
    """A setting: name, value, and the value of the preset if it differs."""

    name: str
    value: str
    preset_value: str | None


def nearest_preset(settings: Settings) -> str:
    """Return the preset with the fewest different settings."""
    values = asdict(settings)

    def difference_count(name: Preset) -> int:
        preset = asdict(Settings.preset(name, motion=settings.motion))
        return sum(preset[key] != value for key, value in values.items())

    return min(("balanced", *get_args(Preset)), key=difference_count)


def setting_rows(settings: Settings) -> list[SettingRow]:
    """Return a row for every setting; settings that differ from the nearest preset come first."""
    preset = asdict(Settings.preset(nearest_preset(settings), motion=settings.motion))  # type: ignore[arg-type]
    rows = [
        SettingRow(
            name=name,
            value=_value_text(value),
            preset_value=None if preset[name] == value else _value_text(preset[name]),
        )
        for name, value in asdict(settings).items()
    ]
    return sorted(rows, key=lambda row: row.preset_value is None)


def _value_text(value: Any) -> str:
    if isinstance(value, tuple):
        return ", ".join(map(_value_text, value))
    if isinstance(value, bool) or value is None:
        return {True: "yes", False: "no", None: "none"}[value]
    return f"{value:.4g}" if isinstance(value, float) else str(value)
