"""What the tests of the file that keeps a result share."""

import dataclasses
import json

import numpy as np

import tisfm
from tests.test_interpretation import frames


def field_result():
    return tisfm.interpret(
        *frames(),
        camera=tisfm.Camera(50.0, center=(18.5, 12.25)),
        settings=tisfm.Settings.preset("paper", outer_iterations=4),
    )


def rigid_result():
    """A result with two motions."""
    found = tisfm.interpret(
        *frames(), camera=tisfm.Camera(50.0), settings=tisfm.Settings(motion="camera")
    )
    labels = found.labels.copy()
    labels[5:9, 7:20] = 1
    motions = np.vstack([found.motions, [[0.6, 0, 0.8, 0, 0.1, 0]]])
    return dataclasses.replace(found, labels=labels, motions=motions)


def entries_of(path):
    with np.load(path, allow_pickle=False) as file:
        return {name: file[name] for name in file.files}


def rewritten(path, write=np.savez, **changes):
    """Replace or drop (None) entries of an .npz."""
    entries = {**entries_of(path), **changes}
    write(path, **{name: value for name, value in entries.items() if value is not None})


def about_of(path):
    return json.loads(str(entries_of(path)["about"]))


def about(path, **changes):
    """Change what an .npz says about itself."""
    rewritten(path, about=np.array(json.dumps({**about_of(path), **changes})))


def half_precision(array):
    """What is kept of an array."""
    return array.astype(np.float16).astype(np.float32)
