"""A figure that a run measured, and the bar it is held to."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Bar:
    """A figure and its bar; `value` is None where the run did not measure it.

    `bound` is None for a figure that stands beside others and has no bar.
    """

    name: str
    value: float | None
    bound: float | None
    at_most: bool = True

    @property
    def met(self) -> bool:
        """Whether the figure was measured and keeps to its bar."""
        if self.value is None:
            return False
        if self.bound is None:
            return True
        return self.value <= self.bound if self.at_most else self.value >= self.bound

    def __str__(self) -> str:
        value = "not measured"
        if self.value is not None:
            value = f"{self.value:.{1 if self.value >= 10 else 2}f}"
        if self.bound is None:
            return f"{'also' if self.met else 'FAIL'}  {self.name}: {value}"
        words = "at most" if self.at_most else "at least"
        return f"{'pass' if self.met else 'FAIL'}  {self.name}: {value} ({words} {self.bound:g})"
