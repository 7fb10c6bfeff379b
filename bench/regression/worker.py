"""Interprets pairs with the tisfm of the working folder.

An interpreter gets the code by ``-c``, so that the working folder comes first on its path, not the
folder of this file. The code uses only NumPy and documented names of tisfm, so it also runs in
older checkouts. Argument: the number of threads.

It prints a line of JSON when it is ready, and then one for each request on standard input,
``{"pair": PATH, "settings": {"name": PRESET, …}, "pose": BOOL, "answer": PATH or null, "times":
N}``. The answer has the wall and processor time of the last of N calls, the processor time of the
process, and the status. The status of a failed call is its exception.
"""

import json
import os
import sys
import time
import warnings
from pathlib import Path
from typing import Any

# The finder of an editable installation would load the kernels of another checkout.
sys.meta_path[:] = [f for f in sys.meta_path if getattr(f, "__name__", "") != "_EditableFinder"]

_start_cpu, _start_time = time.process_time(), time.perf_counter()
import tisfm  # noqa: E402

IMPORT = (
    time.perf_counter() - _start_time,
    time.process_time() - _start_cpu,
)  # includes the import of NumPy

import numpy as np  # noqa: E402


def read(path: str) -> dict[str, Any]:
    """Return a pair as arguments of `tisfm.interpret`, and the pose separately."""
    with np.load(path) as stored:
        focal, *center = stored["camera"].tolist()
        pair = {name: stored[name] for name in ("frame0", "frame1", "pose") if name in stored}
    return pair | {"camera": tisfm.Camera(focal=focal, center=tuple(center))}


def answer(pair: dict[str, Any], request: dict[str, Any]) -> dict[str, Any]:
    """Interpret a pair, store the result if a path is given, and return times and status."""
    settings = tisfm.Settings.preset(**request["settings"])
    arguments = {name: value for name, value in pair.items() if name != "pose" or request["pose"]}
    try:
        for _ in range(request["times"]):
            start_cpu, start_time = time.process_time(), time.perf_counter()
            result = tisfm.interpret(**arguments, settings=settings)
            seconds, cpu = time.perf_counter() - start_time, time.process_time() - start_cpu
    except Exception as error:  # of any kind: checkouts may raise different ones
        return {"status": " ".join(f"{type(error).__name__}: {error}".split())}
    if request["answer"]:
        fields = ("flow", "inverse_depth", "confidence", "occlusion", "labels")
        values = {name: getattr(result, name) for name in fields}
        arrays = {name: value for name, value in values.items() if value is not None}
        np.savez(request["answer"], **arrays)
    return {
        "status": str(result.status),
        "seconds": seconds,
        "cpu": cpu,
        "process": time.process_time(),
    }


def serve(threads: int) -> None:
    """Answer requests until standard input ends."""
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # the output of libraries must not mix with the answers
    warnings.simplefilter("ignore")
    tisfm.runtime.start(threads=threads)
    loaded = [m for name, m in list(sys.modules.items()) if name.partition(".")[0] == "tisfm"]
    files = sorted(str(Path(m.__file__).resolve()) for m in loaded if m.__file__)
    ready = {"files": files, "version": tisfm.__version__, "import": IMPORT}
    print(json.dumps(ready), file=answers, flush=True)
    pairs: dict[str, dict[str, Any]] = {}
    for line in sys.stdin:
        request = json.loads(line)
        if request["pair"] not in pairs:
            pairs[request["pair"]] = read(request["pair"])
        print(json.dumps(answer(pairs[request["pair"]], request)), file=answers, flush=True)


if __name__ == "__main__":
    serve(int(sys.argv[1]))
