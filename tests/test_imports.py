"""No cycles of imports; every package imports only packages that its docstring names."""

import sys

import pytest

from tests.imports import (
    allowed_imports,
    cycles,
    forbidden_imports,
    import_graph,
    imports_of,
    package_of,
    sources,
)

MODULES = sources()
PACKAGES = [name for name, path in MODULES.items() if path.name == "__init__.py"]
LAYERS = [name for name in PACKAGES if name not in ("tisfm", "tisfm.kernels")]


def test_imports_of_a_module(tmp_path):
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
    assert imports_of("tisfm.formats.own", path, MODULES) == {
        "numpy.linalg",
        "typing",
        "tisfm",
        "tisfm.camera",
        "tisfm.formats.reading",
        "tisfm.formats.npz",
        "tisfm.rigid",
        "zlib",
    }


def test_cycles_of_a_graph():
    assert cycles({"a": {"b"}, "b": {"c"}, "c": set()}) == []
    assert cycles({"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}, "e": {"e"}}) == [
        ["a", "b", "c"],
        ["e"],
    ]


def test_modules_have_no_cycle():
    assert cycles(import_graph()) == []


def test_packages_have_no_cycle():
    """A module of the top level counts as a package."""
    edges = {}
    for name, others in import_graph().items():
        here = package_of(name, MODULES)
        there = {package_of(other, MODULES) for other in others if other in MODULES}
        edges.setdefault(here, set()).update(there - {here})
    assert cycles(edges) == []


def test_packages_import_only_the_packages_of_their_docstrings():
    found = {
        line for package in LAYERS for line in forbidden_imports(package, MODULES, import_graph())
    }
    assert sorted(found) == []


def test_docstrings_that_name_allowed_imports(tmp_path):
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
        assert forbidden_imports(package, modules, imports) == [
            f"{name} → tisfm.{other}" for name in (package, f"{package}.own") for other in names
        ]
    modules["tisfm.low"].write_text('"""Files."""')
    with pytest.raises(AssertionError, match=r"tisfm\.low does not say what it may import"):
        allowed_imports("tisfm.low", modules)
    modules["tisfm.low"].write_text('"""May import: `three`."""')
    with pytest.raises(AssertionError, match=r"\['tisfm.three'\]: there is no such module"):
        allowed_imports("tisfm.low", modules)


def test_kernels_import_only_taichi_and_numpy():
    usual = {"taichi", "numpy", *sys.stdlib_module_names}
    for name, others in import_graph().items():
        if name.startswith("tisfm.kernels"):
            foreign = {other for other in others if other.partition(".")[0] not in usual}
            outside = {o for o in foreign if not f"{o}.".startswith("tisfm.kernels.")}
            assert outside == set(), name


def test_the_top_level_stays_small():
    entry = "tisfm.__main__"  # no module imports it
    direct = [name for name in MODULES if name.count(".") == 1 and name not in PACKAGES]
    direct.remove(entry)
    assert 5 < len(direct) <= 25
