"""``python -m bench.pair_memory PRESET [HxW]``: peak memory of one interpretation.

Memory that the process holds after a first interpretation of a tiny pair (libraries, compiled
kernels) and the two uint8 frames do not count; the result counts.
"""

import contextlib
import gc
import json
import resource
import subprocess
import sys
from pathlib import Path
from typing import cast

import cv2
import numpy as np

import tisfm
from bench.shared.results import ROOT, process_memory
from tisfm.settings import Preset

SIZE = (1080, 1920)  # px, height and width
FLOAT = 4  # bytes
CLEAR = Path("/proc/self/clear_refs")  # writing 5 resets the peak of resident memory


def peak() -> int:
    """Return the peak of resident memory since `reset_peak`, or of the process, bytes."""
    if (size := process_memory("VmHWM")) is not None:
        return int(size)
    max_resident = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return max_resident if sys.platform == "darwin" else max_resident * 1024


def reset_peak() -> None:
    """Reset the peak to the present resident memory, if the system permits."""
    # Without permission, the peak of the tiny interpretation is subtracted as well.
    with contextlib.suppress(OSError):
        CLEAR.write_text("5")


def measure(preset: Preset, height: int, width: int) -> float:
    """Return the peak memory of interpreting a pair, float32 per pixel."""
    settings, camera = tisfm.Settings.preset(preset), tisfm.Camera(focal=float(width))
    # Frames are not rendered: the interpretation would reuse memory that rendering has freed.
    blobs = np.random.default_rng(0).integers(0, 256, (height // 8, width // 8), dtype=np.uint8)
    frame0 = cv2.resize(blobs, (width, height))
    frame1 = np.roll(frame0, 2, axis=1)
    tiny = blobs[:32, :32].copy()
    tisfm.interpret(tiny, np.roll(tiny, 1, axis=1), settings=settings)
    gc.collect()
    reset_peak()
    initial_peak = peak()
    result = tisfm.interpret(frame0, frame1, camera=camera, settings=settings)
    return (peak() - initial_peak) / (FLOAT * result.rho[0].size)


def measure_in_process(preset: Preset, size: str = "") -> float:
    """Return `measure` from a process of its own; the size is HxW."""
    command = [sys.executable, "-m", "bench.pair_memory", preset, *filter(None, [size])]
    output = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True)
    return json.loads(output.stdout)["floats_per_pixel"]


if __name__ == "__main__":
    preset, *sizes = sys.argv[1:]
    size = tuple(map(int, sizes[0].split("x"))) if sizes else SIZE
    print(json.dumps({"preset": preset, "floats_per_pixel": measure(cast(Preset, preset), *size)}))
