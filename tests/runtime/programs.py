"""Programs that tests run in processes of their own: Taichi keeps one runtime per process."""

import os
import subprocess
import sys
import textwrap

from tests.waiting import PATIENCE

INTERPRET = """
import hashlib
import sys

import cv2
import numpy as np
import tisfm

noise = np.random.default_rng(0).uniform(0, 255, (67, 94)).astype(np.float32)
texture = cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 1.5), None, 0, 255, cv2.NORM_MINMAX)
frame0, frame1 = texture[:, 1:].astype(np.uint8), texture[:, :-1].astype(np.uint8)

def interpret():
    return tisfm.interpret(frame0, frame1, camera=tisfm.Camera(50.0))

def digest(result):
    return hashlib.sha256(result.rho.tobytes() + result.flow.tobytes()).hexdigest()
"""
UNDISTORT = """
import numpy as np
import tisfm

frame = np.random.default_rng(0).integers(0, 255, (30, 40)).astype(np.uint8)
camera = tisfm.Camera(40.0, distortion=(-0.2, 0.0, 0.0, 0.0))
print(tisfm.lens.undistort(frame, camera).sum(dtype=int))
"""


def run(code, *arguments, **environment):
    """Run a program; None for a variable of the environment removes it."""
    variables = {**os.environ, "PYTHONWARNINGS": "ignore::DeprecationWarning", **environment}
    return subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code), *map(str, arguments)],
        capture_output=True,
        text=True,
        env={name: value for name, value in variables.items() if value is not None},
        timeout=PATIENCE,
        check=False,
    )


def answer(code, *arguments, **environment):
    """Run a program that succeeds without a message on standard error; return its output."""
    done = run(code, *arguments, **environment)
    assert done.returncode == 0, (done.returncode, done.stderr)
    assert done.stderr == ""
    return done.stdout.strip()


def interpretation():
    """Return the interpretation by INTERPRET in this process, and the digest of its bits."""
    variables: dict = {}
    exec(INTERPRET, variables)
    result = variables["interpret"]()
    return result, variables["digest"](result)
