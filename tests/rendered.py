"""The ready scenes and films, rendered once for several tests: rendering takes long.

Within a run of the tests, films lie in a folder that all its processes share. The arrays of a pair
or a film that is shared cannot be written.
"""

import hashlib
import os
import pickle
from collections import OrderedDict
from dataclasses import fields
from functools import wraps
from inspect import signature
from pathlib import Path

import numpy as np
from filelock import FileLock

from tisfm import scenes

MOST_KEPT = 32  # pairs and films of one kind in memory; a film of 16 frames of 240×320 takes 8 MB
FOLDER = "TISFM_TEST_FILMS"  # the variable of the environment that names the shared folder


def shared(render, *, on_disk=True):
    """Return a function that renders once for the same arguments."""
    kept = OrderedDict()

    @wraps(render)
    def rendered_once(*arguments, **options):
        call = signature(render).bind(*arguments, **options)
        call.apply_defaults()
        values = repr([np.asarray(value).tolist() for value in call.arguments.values()])
        if values not in kept:
            name = hashlib.sha256(f"{render.__qualname__}{values}".encode()).hexdigest()
            kept[values] = _read_only(
                _from_disk(name, lambda: render(*arguments, **options))
                if on_disk and FOLDER in os.environ
                else render(*arguments, **options)
            )
        kept.move_to_end(values)
        while len(kept) > MOST_KEPT:
            kept.popitem(last=False)
        return kept[values]

    return rendered_once


def _from_disk(name, render):
    path = Path(os.environ[FOLDER], name)
    with FileLock(f"{path}.lock"):
        if not path.exists():
            path.write_bytes(pickle.dumps(render(), protocol=5))
    return pickle.loads(path.read_bytes())


def _read_only(item):
    parts = item if isinstance(item, tuple) else [item]
    for part in parts:
        arrays = [part] if isinstance(part, np.ndarray) else _arrays_of(part)
        for array in arrays:
            array.flags.writeable = False
    return item


def _arrays_of(item):
    values = (getattr(item, field.name) for field in fields(item))
    return [value for value in values if isinstance(value, np.ndarray)]


bare_patches = shared(scenes.bare_patches, on_disk=False)
room = shared(scenes.room, on_disk=False)
static_scene = shared(scenes.static_scene, on_disk=False)
three_blocks = shared(scenes.three_blocks, on_disk=False)
two_blocks = shared(scenes.two_blocks, on_disk=False)
bodies_film = shared(scenes.bodies_film)
room_film = shared(scenes.room_film)
