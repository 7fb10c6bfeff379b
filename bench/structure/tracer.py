"""Follows one interpretation through the modules of the checkout in the working folder.

An interpreter gets the code by ``-c``, with the motion as its argument. The code uses documented
names of tisfm only. It prints JSON: the modules of tisfm in the order of execution, each with true
for a call and false for the return to a caller.
"""

import json
import os
import sys
from pathlib import Path
from types import FrameType
from typing import Any

# The finder of an editable installation would load the kernels of another checkout.
sys.meta_path[:] = [f for f in sys.meta_path if getattr(f, "__name__", "") != "_EditableFinder"]

import tisfm  # noqa: E402

SIZE = (120, 160)
ROOTS = {"tisfm": "tisfm", "kernels": "tisfm.kernels"}


def modules() -> dict[str, str]:
    """Return file → name of every module of the checkout."""
    found = {}
    for folder, package in ROOTS.items():
        root = Path.cwd() / folder
        for path in root.rglob("*.py"):
            parts = path.relative_to(root).with_suffix("").parts
            found[str(path)] = ".".join((package, *(p for p in parts if p != "__init__")))
    return found


class Trace:
    """Records the executing module; code outside tisfm counts as part of its caller."""

    def __init__(self, names: dict[str, str]) -> None:
        self.steps: list[tuple[str, bool]] = []
        self._names, self._stack = names, [""]

    def __call__(self, frame: FrameType, event: str, argument: Any) -> None:
        """Record an event of `sys.setprofile`."""
        if event == "call":
            module = self._names.get(frame.f_code.co_filename, self._stack[-1])
            if module != self._stack[-1]:
                self.steps.append((module, True))
            self._stack.append(module)
        elif event == "return" and len(self._stack) > 1:
            left = self._stack.pop()
            if self._stack[-1] not in ("", left):
                self.steps.append((self._stack[-1], False))


def trace(motion: str) -> list[tuple[str, bool]]:
    """Return the calls of the second of two interpretations; the first one compiles kernels."""
    scene = tisfm.scenes.two_blocks(*SIZE)
    frames, settings = (
        (scene.frame0, scene.frame1),
        tisfm.Settings.preset("balanced", motion=motion),
    )
    tisfm.interpret(*frames, camera=scene.camera, settings=settings)
    recorded = Trace(modules())
    sys.setprofile(recorded)
    try:
        kept = tisfm.interpret(*frames, camera=scene.camera, settings=settings)
    finally:
        sys.setprofile(None)
    del kept  # freed only here: freeing is not part of the interpretation
    return recorded.steps


if __name__ == "__main__":
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # the output of libraries must not mix with the answer
    print(json.dumps(trace(sys.argv[1])), file=answers, flush=True)
