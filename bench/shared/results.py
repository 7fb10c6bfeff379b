"""The machine that a run is measured on, and where in the checkout its results go."""

import platform
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
RESULTS = ROOT / "bench" / "results"


def machine() -> dict[str, Any]:
    """Return what the times depend on, of this machine and process."""
    import numpy
    import taichi

    import tisfm

    return {
        "processor": _processor(),
        "system": platform.system(),
        "Python": platform.python_version(),
        "tisfm": tisfm.__version__,
        "NumPy": numpy.__version__,
        "Taichi": ".".join(map(str, taichi.__version__)),
    }


def _processor() -> str:
    listed = Path("/proc/cpuinfo")
    if listed.exists():
        for line in listed.read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()


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
