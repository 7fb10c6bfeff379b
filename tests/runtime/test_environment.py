"""Importing, environments without a home folder or a cache, and checkouts."""

import os
from pathlib import Path

import pytest

import tisfm
from tests.draws import examples, long_draw_too
from tests.runtime.programs import UNDISTORT, answer

HORN_SCHUNCK = """
import numpy as np
from tisfm.horn_schunck import horn_schunck
print(horn_schunck(np.zeros((20, 20)), np.zeros((20, 20))).shape)
"""
on_posix = pytest.mark.skipif(os.name == "nt", reason="Taichi keeps its cache elsewhere on Windows")


def test_importing_is_quick_and_silent():
    code = """
    import sys
    import tisfm
    for name in ("taichi", "matplotlib", "rich", "tyro"):
        assert name not in sys.modules, name
    """
    assert answer(code) == ""


@pytest.mark.nightly
@on_posix
def test_horn_schunck_needs_no_home():
    """It starts the runtime before Taichi is loaded, as `interpret` does."""
    assert answer(HORN_SCHUNCK, HOME=None, XDG_CACHE_HOME=None) == "(20, 20, 2)"


@on_posix
@long_draw_too
def test_a_cache_in_a_folder_of_its_own(tmp_path):
    """Kernels are compiled, then found there; or compiled again where no folder can be made.

    Without a folder, Taichi alone ends the process by a signal, when it starts or when it ends.
    """
    environments = [
        {"XDG_CACHE_HOME": str(tmp_path)},
        {"XDG_CACHE_HOME": None, "HOME": "/proc/nonexistent"},
        {"XDG_CACHE_HOME": str(tmp_path)},
        {"XDG_CACHE_HOME": "/dev/null"},
    ][: examples(2, 4)]
    sums = {answer(UNDISTORT, **environment) for environment in environments}
    assert len(sums) == 1 and int(sums.pop()) > 0
    assert list((tmp_path / "taichi" / "ticache").iterdir())


def test_a_checkout_has_its_kernels(monkeypatch):
    """Started there, Python takes its package, though another may be the installed one."""
    root = Path(__file__).parents[2]
    monkeypatch.chdir(root)
    code = """
    import importlib.util
    import sys
    sys.meta_path = [finder for finder in sys.meta_path if "editable" not in repr(finder)]
    import tisfm.kernels
    assert importlib.util.find_spec("tisfm.tisfm") is None
    print(tisfm.kernels.__path__[0])
    """
    assert Path(answer(code)) == root / "kernels"


def test_the_version_is_that_of_the_package():
    from importlib.metadata import version

    assert tisfm.__version__ == version("tisfm")
