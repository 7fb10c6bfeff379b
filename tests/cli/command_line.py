"""What the tests of the command line share: its frames, and what it leaves."""

import json
import sys
import tempfile
from pathlib import Path

import cv2
import numpy as np

import tisfm

H, W = 24, 40
ENDINGS = {".npz", "_depth.png", "_depth16.png", "_anaglyph.png", "_figure.png"}
RECORDS = {"run.json", "run.csv"}
# -c so that a test does not depend on where scripts were installed.
TISFM = (sys.executable, "-c", "import sys; from tisfm.cli import main; sys.exit(main())")


def make_frames(count, seed=3):
    """Frames of a texture that moves by one pixel more each time."""
    width = W + count**2
    noise = np.random.default_rng(seed).uniform(0, 255, (H, width)).astype(np.float32)
    texture = cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 1.5), None, 0, 255, cv2.NORM_MINMAX)
    starts = [count**2 - k * (k + 1) // 2 for k in range(count)]
    return [texture[:, start : start + W].astype(np.uint8) for start in starts]


FRAMES = make_frames(4)


def kept(result):
    """Return a result as a run keeps it, rounded."""
    with tempfile.TemporaryDirectory() as folder:
        result.save(Path(folder, "kept.npz"), compact=True)
        return tisfm.Interpretation.load(Path(folder, "kept.npz"))


def files(folder):
    """Return what lies in a folder, but for how long things took."""
    found = {path.name: path.read_bytes() for path in Path(folder).iterdir() if path.is_file()}
    found.pop("timings.csv", None)
    return found


def promised(*names, figures=True):
    endings = ENDINGS if figures else ENDINGS - {"_figure.png"}
    return {name + ending for name in names for ending in endings} | RECORDS


def record(folder):
    return json.loads((Path(folder) / "run.json").read_text(encoding="utf-8"))


def load(folder, name):
    return tisfm.Interpretation.load(Path(folder) / f"{name}.npz")


def assert_one_line(code, err, *words):
    assert code not in (0, None)
    assert err.startswith("tisfm: ") and err.endswith("\n")
    assert err.count("\n") == 1, err
    assert "Traceback" not in err
    for word in words:
        assert str(word) in err, err


def forbid(*arguments, **options):
    raise AssertionError("nothing was left to interpret")
