"""Scenes, films and interpretations, computed once for several tests.

Within a run of the tests, they lie in a folder that all its processes share. Their arrays cannot be
written.
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

import tisfm
from tisfm import scenes

MOST_KEPT = 32  # items of one kind in memory; a film of 16 frames of 240×320 takes 8 MB
FOLDER = "TISFM_TEST_FILMS"  # the variable of the environment that names the shared folder
_interpretations = OrderedDict()


def shared(render):
    """Return a function that renders once for the same arguments."""
    kept = OrderedDict()

    @wraps(render)
    def rendered_once(*arguments, **options):
        call = signature(render).bind(*arguments, **options)
        call.apply_defaults()
        values = repr([np.asarray(value).tolist() for value in call.arguments.values()])
        name = hashlib.sha256(f"{render.__qualname__}{values}".encode()).hexdigest()
        return once(name, kept, lambda: render(*arguments, **options))

    return rendered_once


def once(name, kept, compute):
    """Return an item from memory, from the folder of this run, or computed; arrays read-only."""
    if name not in kept:
        kept[name] = _read_only(_from_disk(name, compute) if FOLDER in os.environ else compute())
    kept.move_to_end(name)
    while len(kept) > MOST_KEPT:
        kept.popitem(last=False)
    return kept[name]


def _from_disk(name, compute):
    path = Path(os.environ[FOLDER], name)
    with FileLock(f"{path}.lock"):
        if not path.exists():
            path.write_bytes(pickle.dumps(compute(), protocol=5))
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


bare_patches = shared(scenes.bare_patches)
room = shared(scenes.room)
static_scene = shared(scenes.static_scene)
three_blocks = shared(scenes.three_blocks)
two_blocks = shared(scenes.two_blocks)
bodies_film = shared(scenes.bodies_film)
room_film = shared(scenes.room_film)
walkers_film = shared(scenes.walkers_film)


def shared_interpretation(frame0, frame1, **options):
    """Return what `tisfm.interpret` returns for these arguments.

    Tests that replace a part of the method, or compare two runs, call `tisfm.interpret`.
    """
    arguments = pickle.dumps((frame0, frame1, sorted(options.items())), protocol=5)
    name = hashlib.sha256(arguments).hexdigest()
    return once(name, _interpretations, lambda: tisfm.interpret(frame0, frame1, **options))
