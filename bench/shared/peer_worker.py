"""Process that runs one method of another library in an environment of its own.

It needs NumPy and the library of the method, but neither tisfm nor the rest of the bench. OpenCV's
contrib build has the same name cv2 as the plain build, so a process cannot load both.

``peer_worker.py survey`` prints the methods that can run, as JSON. ``peer_worker.py serve NAME
THREADS`` prints ``{"ready": true}``, then answers each line of JSON on standard input,
``{"frames": [PATH, PATH], "flow": PATH}``, with a line: the flow is written to its path, and the
line has the wall and processor time of the call, or an error. Frames are (H, W) uint8 in
.npy files.
"""

import importlib
import json
import os
import platform
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np

Method = Callable[[np.ndarray, np.ndarray], np.ndarray]
Prepare = Callable[[np.ndarray], np.ndarray]


def as_given(frame: np.ndarray) -> np.ndarray:
    """Return the frame: uint8, as OpenCV's methods take it."""
    return frame


def in_three_channels(frame: np.ndarray) -> np.ndarray:
    """Return the frame three times, (H, W, 3), as OpenCV's RLOF takes it."""
    return np.repeat(frame[..., None], 3, axis=2)


def to_unit_range(frame: np.ndarray) -> np.ndarray:
    """Return grey levels in [0, 1], the range scikit-image's defaults are made for."""
    return frame.astype(np.float32) / 255


def dense(solver: Any) -> Method:
    """Return the method of one of OpenCV's cv::DenseOpticalFlow, without an initial flow."""
    return lambda frame0, frame1: solver.calc(frame0, frame1, None)


def dis(preset: str) -> Method:
    """Return OpenCV's dense inverse search with a preset."""
    import cv2

    return dense(cv2.DISOpticalFlow.create(getattr(cv2, f"DISOPTICAL_FLOW_PRESET_{preset}")))


def farneback() -> Method:
    """Return OpenCV's polynomial expansion with its class's defaults."""
    import cv2

    return dense(cv2.FarnebackOpticalFlow.create())


def contrib(name: str) -> Method:
    """Return a method of OpenCV's contrib module optflow with its defaults."""
    import cv2

    if not hasattr(cv2, "optflow"):
        raise ImportError(f"OpenCV {cv2.__version__} is built without its contrib modules")
    create = getattr(cv2.optflow, f"createOptFlow_{name}", None)
    if create is None:
        raise ImportError(f"OpenCV {cv2.__version__} has no cv2.optflow.createOptFlow_{name}")
    return dense(create())


def skimage_tvl1() -> Method:
    """Return scikit-image's TV-L1 with its defaults; it gives rows before columns."""
    from skimage.registration import optical_flow_tvl1

    return lambda frame0, frame1: np.stack(optical_flow_tvl1(frame0, frame1)[::-1], axis=-1)


METHODS: dict[str, tuple[Callable[[], Method], Prepare]] = {
    "OpenCV DIS ultrafast": (lambda: dis("ULTRAFAST"), as_given),
    "OpenCV DIS fast": (lambda: dis("FAST"), as_given),
    "OpenCV DIS medium": (lambda: dis("MEDIUM"), as_given),
    "OpenCV Farneback": (farneback, as_given),
    "OpenCV DeepFlow": (lambda: contrib("DeepFlow"), as_given),
    "OpenCV TV-L1": (lambda: contrib("DualTVL1"), as_given),
    "OpenCV DenseRLOF": (lambda: contrib("DenseRLOF"), in_three_channels),
    "OpenCV PCAFlow": (lambda: contrib("PCAFlow"), as_given),
    "scikit-image TV-L1": (skimage_tvl1, to_unit_range),
}
VERSIONS = {"OpenCV": "cv2", "scikit-image": "skimage", "SciPy": "scipy", "NumPy": "numpy"}


def survey() -> dict[str, dict[str, str]]:
    """Return the libraries' versions, and for each method the reason why it is missing, or ""."""
    versions = {"Python": platform.python_version()}
    for library, module in VERSIONS.items():
        try:
            versions[library] = importlib.import_module(module).__version__
        except ImportError:
            continue
    reasons = {}
    for name, (create, _) in METHODS.items():
        try:
            create()
            reasons[name] = ""
        except (ImportError, AttributeError) as error:
            reasons[name] = str(error)
    return {"versions": versions, "reasons": reasons}


def limit_threads(threads: int) -> None:
    """Bound OpenCV's threads; the environment bounds the threads of BLAS and OpenMP."""
    try:
        import cv2
    except ImportError:
        return
    cv2.setNumThreads(threads)


def serve(name: str, threads: int) -> None:
    """Answer requests until standard input ends."""
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # the output of libraries must not mix with the answers
    limit_threads(threads)
    create, prepare = METHODS[name]
    method = create()

    def answer(content: dict) -> None:
        answers.write(json.dumps(content) + "\n")
        answers.flush()

    answer({"ready": True})
    loaded: list[str] = []
    frames: list[np.ndarray] = []
    for line in sys.stdin:
        request = json.loads(line)
        if request["frames"] != loaded:
            loaded = request["frames"]
            frames = [prepare(np.load(path)) for path in loaded]
        try:
            start_cpu, start_time = time.process_time(), time.perf_counter()
            flow = method(*frames)
            seconds, cpu = time.perf_counter() - start_time, time.process_time() - start_cpu
        except Exception as error:  # of any kind
            answer({"error": f"{type(error).__name__}: {error}"})
            continue
        np.save(request["flow"], np.asarray(flow, np.float32))
        answer({"seconds": seconds, "cpu": cpu})


if __name__ == "__main__":
    if sys.argv[1] == "survey":
        print(json.dumps(survey()))
    else:
        serve(sys.argv[2], int(sys.argv[3]))
