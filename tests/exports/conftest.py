"""A film and its reconstruction, made once."""

import shutil

import pytest

import tisfm
from tests.reconstruction.films import walk
from tisfm.exports import write_colmap

FAST = tisfm.Settings.preset("fast", motion="camera")


@pytest.fixture(scope="session")
def film():
    return walk()


@pytest.fixture(scope="session")
def found(film, make_once):
    """The reconstruction of the film; one for all processes of a run."""

    def reconstruct(folder):
        tisfm.reconstruct(film.frames, camera=film.camera, settings=FAST, folder=folder / "walk")

    return tisfm.Reconstruction.load(make_once("exported_walk", reconstruct) / "walk")


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
