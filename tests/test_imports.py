"""Directions of imports: no circles, and every package imports what its docstring says."""

import sys

import pytest

from tests.imports import allowed, circles, forbidden, graph, home, imported, sources

MODULES = sources()
IMPORTS = graph()
PACKAGES = [name for name, path in MODULES.items() if path.name == "__init__.py"]
LAYERS = [name for name in PACKAGES if name not in ("tisfm", "tisfm.kernels")]


def test_what_is_imported_is_found(tmp_path):
    path = tmp_path / "own.py"
    path.write_text(
        "import numpy.linalg\n"
        "from typing import TYPE_CHECKING\n"
        "from tisfm import camera, Settings\n"
        "from .reading import FormatError\n"
        "from . import npz\n"
        "if TYPE_CHECKING:\n    from tisfm.pair import interpret\n"
        "else:\n    import zlib\n"
        "def late():\n    from tisfm.rigid import pose_matrix\n"
    )
    assert imported("tisfm.formats.own", path, MODULES) == {
        "numpy.linalg",
        "typing",
        "tisfm",
        "tisfm.camera",
        "tisfm.formats.reading",
        "tisfm.formats.npz",
        "tisfm.rigid",
        "zlib",
    }


def test_circles_are_found():
    assert circles({"a": {"b"}, "b": {"c"}, "c": set()}) == []
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}, "e": {"e"}}) == [
        ["a", "b", "c"],
        ["e"],
    ]


def test_no_module_reaches_itself():
    assert circles(IMPORTS) == []


def test_no_package_reaches_itself():
    """Packages, and the modules of the top level one by one."""
    edges = {}
    for name, others in IMPORTS.items():
        here = home(name, MODULES)
        there = {home(other, MODULES) for other in others if other in MODULES}
        edges.setdefault(here, set()).update(there - {here})
    assert circles(edges) == []


def test_packages_import_what_their_docstrings_say():
    found = {line for package in LAYERS for line in forbidden(package, MODULES, IMPORTS)}
    assert sorted(found) == []


def test_docstrings_are_read_as_they_are_meant(tmp_path):
    docs = {
        "tisfm.low": "May import: nothing of `tisfm`.",
        "tisfm.middle": "On `top`.\n\nMay import: `tisfm.low` (files) and\nof the top level `one`.",
        "tisfm.middle.inner": "May import: what `tisfm.middle` may, and `tisfm.middle`.",
        "tisfm.top": "May import: all of `tisfm` but `tisfm.middle`.",
    }
    modules = {"tisfm.one": tmp_path / "one.py", "tisfm.two": tmp_path / "two.py"}
    for name, doc in docs.items():
        modules[name] = tmp_path / name / "__init__.py"
        modules[f"{name}.own"] = tmp_path / name / "own.py"
        modules[name].parent.mkdir()
        modules[name].write_text(f'"""{doc}"""\n')
    imports = {name: {"numpy", *modules} for name in modules}
    others = {
        "tisfm.low": ["middle", "middle.inner", "middle.inner.own", "middle.own", "one", "top",
                      "top.own", "two"],
        "tisfm.middle": ["middle.inner", "middle.inner.own", "top", "top.own", "two"],
        "tisfm.middle.inner": ["top", "top.own", "two"],
        "tisfm.top": ["middle", "middle.inner", "middle.inner.own", "middle.own"],
    }  # fmt: skip
    for package, names in others.items():
        assert forbidden(package, modules, imports) == [
            f"{name} → tisfm.{other}" for name in (package, f"{package}.own") for other in names
        ]
    modules["tisfm.low"].write_text('"""Files."""')
    with pytest.raises(AssertionError, match=r"tisfm\.low does not say what it may import"):
        allowed("tisfm.low", modules)
    modules["tisfm.low"].write_text('"""May import: `three`."""')
    with pytest.raises(AssertionError, match=r"\['tisfm.three'\]: there is no such module"):
        allowed("tisfm.low", modules)


def test_kernels_need_no_more_than_taichi_and_numpy():
    usual = {"taichi", "numpy", *sys.stdlib_module_names}
    for name, others in IMPORTS.items():
        if name.startswith("tisfm.kernels"):
            foreign = {other for other in others if other.partition(".")[0] not in usual}
            outside = {o for o in foreign if not f"{o}.".startswith("tisfm.kernels.")}
            assert outside == set(), name


def test_the_top_level_stays_small():
    entry = "tisfm.__main__"  # no module imports it
    direct = [name for name in MODULES if name.count(".") == 1 and name not in PACKAGES]
    direct.remove(entry)
    assert 5 < len(direct) <= 25
