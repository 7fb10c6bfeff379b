"""The grade of a result: how far its depth is expected to be off, in a plain word."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import TypeVar

import numpy as np

from tisfm.status import Status

Value = TypeVar("Value")


@dataclass(frozen=True, kw_only=True)
class GradeSettings:
    """Limits of the grades, and what the expected error of depth consists of."""

    max_good: float = 0.03  # expected relative error of depth; set by hand
    max_fair: float = 0.10  # expected relative error of depth; set by hand
    # median error over standard deviation: of the normal distribution
    median_ratio: float = 0.6745
    # relative error of depth over relative error of a focal length; an experiment had 0 to 0.3 in
    # the scenes that chose it, and up to 0.7 in others
    focal_effect: float = 0.25
    # relative deviation of a guessed focal length: cameras have 0.5 to 2 longer sides
    guessed_focal_deviation: float = 0.5
    max_error: float = 1.0  # an error of the whole depth or more is stored as this number
    max_pixels: int = 40000  # pixels of a frame that are used; for speed


GRADES = GradeSettings()

COLORS = {
    "good": "#009e73",
    "fair": "#66a61e",
    "poor": "#e69f00",
    "no depth": "#0072b2",
    "no pose": "#999999",
    "contradicted": "#d55e00",
}
"""Colours of the grades, which people with a colour vision deficiency can distinguish."""

# Statuses that say that pose or depth are wrong.
_WRONG = ("contradicted", "diverged", "pose_mismatch", "behind_camera", "unexplained", "unrelated")
# Wrong statuses of frames without a pose: such a frame without depth is not contradicted.
_WRONG_DEPTH = ("diverged", "unrelated")
# Statuses that do not say that depth is doubtful.
_RIGHT = ("converged", "iteration_limit")


class Grade(str, Enum):
    """How far the depth of a frame or a pair can be trusted, in a plain word.

    - ``"good"``: half of the depth is expected to be off by at most 3 %.
    - ``"fair"``: by at most 10 %.
    - ``"poor"``: by more, or by an unknown amount; or the status says that depth is rough.
    - ``"no depth"``: depth is unknown, or was not requested; a frame of a sequence has a pose, or
      an orientation where the camera only turns.
    - ``"no pose"``: a frame of a sequence has neither pose nor depth.
    - ``"contradicted"``: the images contradict the pose or the depth, as the status says.

    The order of the list is from the best to the worst. A grade compares equal to its word.

    Examples
    --------
    >>> import tisfm
    >>> result = tisfm.Reconstruction.load("walk")
    >>> str(result.grade(0)), result.grade(0).is_green
    ('good', True)
    """

    GOOD = "good"
    FAIR = "fair"
    POOR = "poor"
    NO_DEPTH = "no depth"
    NO_POSE = "no pose"
    CONTRADICTED = "contradicted"

    def __str__(self) -> str:
        """Return the word."""
        return self.value

    @property
    def is_green(self) -> bool:
        """Whether pose and depth can be trusted: good or fair."""
        return self in (Grade.GOOD, Grade.FAIR)

    @property
    def rank(self) -> int:
        """Place in the order from the best, 0, to the worst."""
        return list(Grade).index(self)


def depth_error(
    inverse_depth: np.ndarray,  # (H, W)
    # (H, W): standard deviation; infinite for a pixel that has no depth, or whose depth is filled
    deviation: np.ndarray,
    # relative standard deviation of the focal length; infinite for a guess
    focal_deviation: float = 0.0,
    # relative error of depth over relative error of the focal length; None for the usual effect
    focal_effect: float | None = None,
    # by how much the residual of the path exceeds that of the motion that fits the images best
    residual_factor: float = 1.0,
) -> tuple[float, float]:
    """Return the expected relative error of the depth of a frame, and the share of good pixels.

    The expected error is the median over pixels of the relative deviation, as a median error, with
    what an uncertain focal length adds. If a path fits the images worse than another motion does,
    its deviations are multiplied by the ratio of the residuals. The expected error is at most 1,
    and NaN without depth. The share is that of pixels whose expected error is at most 10 %. A pixel
    without depth has an infinite deviation. Pixels whose depth is filled from their surroundings do
    not count.
    """
    step = 1 + int(np.sqrt(inverse_depth.size / GRADES.max_pixels))
    inverse_depth, deviation = inverse_depth[::step, ::step], deviation[::step, ::step]
    has_depth = np.isfinite(inverse_depth) & (inverse_depth > 0)
    if not has_depth.any():
        return float("nan"), 0.0
    has_deviation = has_depth & np.isfinite(deviation)
    relative = np.full(inverse_depth.shape, np.inf)
    np.divide(deviation, inverse_depth, out=relative, where=has_deviation)
    focal_deviation = min(focal_deviation, GRADES.guessed_focal_deviation)
    expected = np.hypot(
        GRADES.median_ratio * residual_factor * relative[has_deviation | ~has_depth],
        (GRADES.focal_effect if focal_effect is None else focal_effect) * focal_deviation,
    )
    if not has_deviation.any():
        return GRADES.max_error, 0.0
    middle = float(np.partition(expected, expected.size // 2)[expected.size // 2])
    return min(middle, GRADES.max_error), float((expected <= GRADES.max_fair).mean())


def grade_depth(status: Status, error: float) -> Grade:
    """Return the grade of a depth, from its status and its expected relative error."""
    if status in _WRONG and not (status in _WRONG_DEPTH and np.isnan(error)):
        return Grade.CONTRADICTED
    if np.isnan(error):
        return Grade.NO_DEPTH
    if status not in _RIGHT or error > GRADES.max_fair:
        return Grade.POOR
    return Grade.GOOD if error <= GRADES.max_good else Grade.FAIR


def upper_median(ordered: Sequence[Value]) -> Value:
    """Return the middle of a sorted sequence with at least one value; of two, the later one.

    Grades and errors are sorted from the best to the worst. So this median of grades is a grade
    that occurs, and no median is better than half of the frames. All medians of grades and of
    expected errors follow this rule.
    """
    return ordered[len(ordered) // 2]


@dataclass(frozen=True, kw_only=True)
class GradeSummary:
    """The grades of a result, the median and the worst."""

    counts: Mapping[Grade, int]  # by grade, the best first; only grades that occur
    median: Grade
    worst: Grade
    # expected relative errors of depth, over frames with depth that nothing contradicts; NaN if
    # there are none
    median_error: float
    worst_error: float

    @classmethod
    def of(cls, grades: Sequence[Grade], errors: Sequence[float] | None = None) -> "GradeSummary":
        """Return the summary of grades and expected errors, one for each frame; at least one."""
        ordered = sorted(grades, key=lambda grade: grade.rank)
        known_errors = sorted(
            error
            for grade, error in zip(grades, errors or [np.nan] * len(grades), strict=True)
            if grade != Grade.CONTRADICTED and not np.isnan(error)
        )
        return cls(
            counts=Counter(ordered),
            median=upper_median(ordered),
            worst=ordered[-1],
            median_error=upper_median(known_errors) if known_errors else float("nan"),
            worst_error=known_errors[-1] if known_errors else float("nan"),
        )

    @property
    def text(self) -> str:
        """The median and the worst grade, and the expected errors, in words."""
        text = f"{self.median}" + (f", worst {self.worst}" if self.worst != self.median else "")
        return f"{text}{self.error_text}"

    @property
    def error_text(self) -> str:
        """The expected errors in words; "" without depth."""
        if np.isnan(self.median_error):
            return ""
        return (
            f"; depth is expected to be off by {percent(self.median_error)} (median), "
            f"{percent(self.worst_error)} (worst)"
        )

    @property
    def counts_text(self) -> str:
        """The number of frames of each grade, the best first, in words."""
        return ", ".join(f"{count} {grade}" for grade, count in self.counts.items())


def summarise_grades(
    grades: Sequence[Grade],
    statuses: Sequence[str],
    errors: Sequence[float],  # expected relative errors of depth; NaN where unknown
) -> GradeSummary:
    """Return the summary of the grades of frames or pairs; at least one.

    Frames whose depth was not requested do not count if other frames have depth.
    """
    chosen = list(range(len(grades)))
    if not np.isnan(np.asarray(errors)).all():
        chosen = [k for k in chosen if grades[k] != Grade.NO_DEPTH or statuses[k] != "converged"]
    return GradeSummary.of([grades[k] for k in chosen], [errors[k] for k in chosen])


def warn_of_grades(
    grades: Sequence[Grade],
    statuses: Sequence[Status],
    errors: Sequence[float],  # expected relative errors of depth
    frames: Iterable[int] | None = None,  # by default all
) -> str:
    """Return a warning of contradicted frames, or else of poor depth; "" without such frames."""
    chosen = range(len(grades)) if frames is None else list(frames)
    if wrong := [k for k in chosen if grades[k] == Grade.CONTRADICTED]:
        text = f"Grade contradicted, {len(wrong)} of {len(chosen)} frames"
        message = statuses[wrong[0]].message
        return f"{text}: {message}" if message else text
    if rough := [k for k in chosen if grades[k] == Grade.POOR]:
        known_errors = [errors[k] for k in rough if not np.isnan(errors[k])]
        text = f", expected to be off by up to {percent(max(known_errors))}" if known_errors else ""
        return f"Grade poor, depth of {len(rough)} of {len(chosen)} frames{text}"
    return ""


def describe_grade(grade: Grade, error: float) -> str:
    """Return the word of a grade, with the expected relative error of depth if it is known."""
    if grade == Grade.CONTRADICTED or np.isnan(error):
        return str(grade)
    return f"{grade}, off by {percent(error)}"


def percent(share: float) -> str:
    """Return a share in percent, with two significant digits below 10 %."""
    return f"{100 * share:.2g} %" if share < 0.0995 else f"{100 * share:.0f} %"
