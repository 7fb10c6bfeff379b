"""A full disk, or a limit on the size of files: errors name file and reason; no file is partial.

The limit (``ulimit -f``) is set in a process of its own.
"""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.draws import examples, long_draw_too
from tests.exports.made import made

pytest.importorskip("resource", reason="limits of POSIX")

LIMIT = 1500  # bytes
LIMITED = f"""
import contextlib, io, json, resource, sys

from tisfm.cli.command_line import main

resource.setrlimit(resource.RLIMIT_FSIZE, ({LIMIT}, {LIMIT}))
for call in json.loads(sys.argv[1]):
    said = io.StringIO()
    with contextlib.redirect_stderr(said), contextlib.redirect_stdout(said):
        code = main(call)
    print(json.dumps([code, said.getvalue()]))
"""
STEPS = f"""
import json, resource, sys
from pathlib import Path

import numpy as np

import tisfm
from tisfm.reconstruction.frames import disk_cache as shelf
from tisfm.reconstruction.result.folder import write_depth, write_labels
from tisfm.reconstruction.frames.prepared_frames import PreparedFrames
from tisfm.reconstruction.result.renewal import copy_folder
from tisfm.sources.frame_reader import SourceFrame

folder = Path(sys.argv[1])
for name in ("cache", "frames", "depth"):
    (folder / name).mkdir(parents=True)
noise = np.random.default_rng(0).integers(0, 255, (60, 80), np.uint8)
found = tisfm.Reconstruction.load(sys.argv[2])
resource.setrlimit(resource.RLIMIT_FSIZE, ({LIMIT}, {LIMIT}))
frames = PreparedFrames(tisfm.Camera(50.0), folder / "cache", folder / "frames")
shelved = shelf.DiskCache(lambda item: (item,), lambda item: item)
steps = dict(
    grey=lambda: frames.add(SourceFrame(index=0, name="f0", time=None, image=noise)),
    depth=lambda: write_depth(folder, 0, noise / np.float32(255), noise / np.float32(255)),
    labels=lambda: write_labels(folder, 0, noise),
    shelf=lambda: shelved.append(noise),
    copy=lambda: copy_folder(found, folder / "copy"),
)
for name, step in steps.items():
    try:
        step()
    except OSError as error:
        print(json.dumps([name, str(error)]))
"""


def limited(code, *arguments):
    done = subprocess.run(
        [sys.executable, "-c", code, *arguments], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0 and "Traceback" not in done.stderr, done.stderr
    return [json.loads(line) for line in done.stdout.splitlines()]


@long_draw_too
def test_commands_name_file_and_reason(work_folder):
    pytest.importorskip("av")
    made(work_folder / "r", count=6)
    forms = {
        "depth-tiff": "tiff", "nerfstudio": "", "colmap": "", "video-depth": "mp4",
        "gltf-camera": "", "depth-pfm": "pfm",
    }  # fmt: skip
    chosen = list(forms)[:: examples(3, 1)]
    calls = [["export", "r", "--to", form, "-o", f"o/{form}"] for form in chosen]
    calls += [["report", "r"], ["view", "r", "--html", "view.html"]]
    failed = 0
    for call, (code, said) in zip(calls, limited(LIMITED, json.dumps(calls)), strict=True):
        if code == 0:  # small enough
            continue
        failed += 1
        last = said.splitlines()[-1]
        assert code == 1 and last.startswith("tisfm: ") and "Traceback" not in said, (call, said)
        assert "File too large" in last or "was not written to its end" in last, (call, said)
        assert {"report": "report.html", "view": "view.html"}.get(call[0], call[-1]) in last, last
    assert failed >= len(chosen)
    left = [path for path in work_folder.rglob("*") if path.is_file() and "r" not in path.parts]
    assert all(".tisfm" not in str(path.relative_to(work_folder)) for path in left)
    assert all(path.stat().st_size < LIMIT for path in left)


def test_steps_of_a_reconstruction_name_file_and_reason(work_folder):
    made(work_folder / "r", count=2)
    before = {p: p.read_bytes() for p in Path("r").rglob("*") if p.is_file()}
    said = dict(limited(STEPS, "made", "r"))
    names = {
        "grey": "cache/000000.npy", "depth": "depth/000000.npz", "labels": "masks/000000.png",
        "shelf": "a temporary file in ", "copy": "copy",
    }  # fmt: skip
    assert said.keys() == names.keys()
    for name, text in said.items():
        assert names[name] in text and "File too large" in text, text
        assert "TMPDIR" not in text  # the limit holds in every folder
    left = [path.name for path in Path("made").rglob("*") if path.is_file()]
    assert left == ["reconstruction.begun"]  # no result was there before
    assert {p: p.read_bytes() for p in before} == before
