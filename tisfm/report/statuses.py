"""What statuses mean, in a line each, and how they are coloured.

`docs/trust.md` says more of each.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from tisfm.status import UNKNOWN, Status

MEANINGS = {
    "converged": "The iterations converged.",
    "iteration_limit": "The iterations ran out before the result was exact: depth is less exact.",
    "no_motion": "Frames are alike, or move no more than noise: there is no depth.",
    "no_texture": "Too little is to be seen by which motion could be told: there is no depth.",
    "little_parallax": "The camera hardly changed its place: there is no depth.",
    "pure_rotation": "The camera only turned: there is no depth.",
    "aperture": "The frame varies along one direction only, such as stripes do.",
    "unrelated": "Frames show different scenes, such as at a cut, or the motion was missed.",
    "two_motions": "Two motions explain the frames alike; depth follows from one of them.",
    "behind_camera": "Much of the scene would lie behind the camera: depth is wrong in part.",
    "unexplained": "Motion and depth do not make the frames alike: depth is wrong in part.",
    "uncertain": "There is little parallax, or depth has a large deviation: it is rough.",
    "pose_mismatch": "The given pose contradicts the images.",
    "diverged": "The motion grew beyond all bounds: the result is of no use.",
}
# The colours of Okabe and Ito, which the colour-blind tell apart as well.
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
_WRONG = "#d55e00"
_MOST_NAMED, _LONGEST = 4, 600  # frames; characters of a message


@dataclass(frozen=True, kw_only=True)
class StatusCount:
    """How many frames have a status, which, and what to do.

    Attributes
    ----------
    code, meaning, advice : str
        The code, what it means, and the message of the first frame that has it.
    count : int
    names : str
        The first frames that have it, in words.
    """

    code: str
    meaning: str
    advice: str
    count: int
    names: str


def color_of(code: str) -> str:
    """Return the colour of a status."""
    return _COLORS.get(code, _WRONG)


def counted(
    statuses: Sequence[Status], names: Sequence[str], *, converged: str = MEANINGS["converged"]
) -> list[StatusCount]:
    """Return what statuses there are, the most frequent first; `converged` is what that means."""
    meanings = {**MEANINGS, "converged": converged}
    counts = Counter(map(str, statuses))
    found = []
    for code, count in sorted(counts.items(), key=lambda item: (-item[1], item[0])):
        mine = [index for index, status in enumerate(statuses) if status == code]
        shown = ", ".join(names[index] for index in mine[:_MOST_NAMED])
        more = count - _MOST_NAMED
        # The message of "converged" says no more than its meaning.
        message = "" if code == "converged" else statuses[mine[0]].message
        found.append(
            StatusCount(
                code=code,
                meaning=meanings.get(code, UNKNOWN),
                advice=shortened(message),
                count=count,
                names="all" if count == len(statuses) else shown + f" and {more} more" * (more > 0),
            )
        )
    return found


def shortened(text: str) -> str:
    """Return a text in one line, cut off where it is very long."""
    line = " ".join(text.split())
    return line if len(line) <= _LONGEST else line[: _LONGEST - 1] + "…"


def spans(codes: Sequence[str], most: int = 500) -> list[tuple[float, float, str]]:
    """Return begin and end, as shares of the whole, of frames in a row with one status.

    Where there are more than `most` frames, each of so many parts has the rarest status in it.
    """
    frequency = Counter(codes)
    parts = min(most, len(codes))
    edges = [len(codes) * part // parts for part in range(parts + 1)] if parts else [0]
    told = [
        min(codes[begin:end], key=lambda code: (frequency[code], code))
        for begin, end in pairwise(edges)
    ]
    found: list[tuple[float, float, str]] = []
    for part, code in enumerate(told):
        begin = part / parts
        if found and found[-1][2] == code:
            begin = found.pop()[0]
        found.append((begin, (part + 1) / parts, code))
    return found
