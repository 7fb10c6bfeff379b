"""A film and its reconstruction, made once."""

import os
import shutil

import pytest
from filelock import FileLock

import tisfm
from tests.reconstruction.films import walk
from tisfm.exports import write_colmap

FAST = tisfm.Settings.preset("fast", motion="camera")


@pytest.fixture(scope="session")
def film():
    return walk()


@pytest.fixture(scope="session")
def found(film, tmp_path_factory):
    """The reconstruction of the film; one for all processes of a run."""
    folder = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        folder = folder.parent
    folder = folder / "exported_walk"
    with FileLock(f"{folder}.lock"):
        if not (folder / "reconstruction.json").exists():
            tisfm.reconstruct(film.frames, camera=film.camera, settings=FAST, folder=folder)
    return tisfm.Reconstruction.load(folder)


@pytest.fixture(scope="session")
def exported(found, tmp_path_factory):
    """The folder of a model as text and binary, and what was said of it."""
    folder = tmp_path_factory.mktemp("colmap")
    return folder, write_colmap(found, folder, form="both")


@pytest.fixture
def copied(found, tmp_path):
    """A copy of the reconstruction, whose files may be changed."""
    shutil.copytree(found.folder, tmp_path / "copied")
    return tisfm.Reconstruction.load(tmp_path / "copied")
