"""The machine that a run is measured on, and where in the checkout its results go."""

import platform
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
