"""Peak memory of one interpretation, in a process of its own.

``python -m bench.pair_memory PRESET [HxW]`` prints it.

What the process holds after a first interpretation of a tiny pair (libraries, compiled kernels)
and the two frames, uint8, exist before and do not count; the result does.
"""

import contextlib
import gc
import json
import resource
import sys
from pathlib import Path
from typing import cast

import cv2
import numpy as np

import tisfm
from tisfm.settings import Preset

SIZE = (1080, 1920)
FLOAT = 4  # bytes
STATUS, CLEAR = Path("/proc/self/status"), Path("/proc/self/clear_refs")


def peak() -> int:
    """Return the greatest resident memory since `restart`, or of the process, bytes."""
    if STATUS.exists():
        line = next(row for row in STATUS.read_text().splitlines() if row.startswith("VmHWM"))
        return int(line.split()[1]) * 1024
    used = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return used if sys.platform == "darwin" else used * 1024


def restart() -> None:
    """Let the peak begin at what is resident now, where the system permits."""
    # If not, what the tiny interpretation needed beyond what it left is taken off, too.
    with contextlib.suppress(OSError):
        CLEAR.write_text("5")


def measure(preset: Preset, height: int, width: int) -> float:
    """Return the float32 per pixel that interpreting a pair takes at its peak."""
    settings, camera = tisfm.Settings.preset(preset), tisfm.Camera(focal=float(width))
    # No rendered scene: what rendering frees would be there for the interpretation to reuse.
    blobs = np.random.default_rng(0).integers(0, 256, (height // 8, width // 8), dtype=np.uint8)
    frame0 = cv2.resize(blobs, (width, height))
    frame1 = np.roll(frame0, 2, axis=1)
    tiny = blobs[:32, :32].copy()
    tisfm.interpret(tiny, np.roll(tiny, 1, axis=1), settings=settings)
    gc.collect()
    restart()
    before = peak()
    result = tisfm.interpret(frame0, frame1, camera=camera, settings=settings)
    return (peak() - before) / (FLOAT * result.rho[0].size)


if __name__ == "__main__":
    preset, *sizes = sys.argv[1:]
    size = tuple(map(int, sizes[0].split("x"))) if sizes else SIZE
    print(json.dumps({"preset": preset, "floats_per_pixel": measure(cast(Preset, preset), *size)}))
