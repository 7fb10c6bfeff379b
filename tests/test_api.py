"""Public names: docs/api.md, ``__all__`` and what can be imported are one list."""

import ast
import re
from importlib import import_module
from pathlib import Path

import pytest

import tisfm

ROOT = Path(__file__).parents[1]
PAGES = [
    ROOT / "README.md",
    *sorted((ROOT / "docs").glob("*.md")),
    *sorted((ROOT / "docs" / "guides").glob("*.md")),
]


def documented(text):
    """Return the names of each module of the page, in its order."""
    modules, names = {}, []
    for line in text.splitlines():
        if heading := re.fullmatch(r"## `([\w.]+)`", line):
            names = modules.setdefault(heading[1], [])
        elif row := re.fullmatch(r"\| `(\w+)` \| \S.* \|", line):
            names.append(row[1])
        else:
            assert not line.startswith("| `"), f"a row of another form: {line}"
    return modules


PUBLIC = documented((ROOT / "docs" / "api.md").read_text(encoding="utf-8"))


@pytest.mark.parametrize("module", PUBLIC)
def test_the_page_names_the_exports_of_the_module(module):
    loaded = import_module(module)
    assert sorted(PUBLIC[module]) == sorted(loaded.__all__)
    for name in PUBLIC[module]:
        assert hasattr(loaded, name)


def test_public_modules_are_reached_by_importing_the_package():
    """`tests/test_wheel.py` does so in a new process."""
    modules = {module.removeprefix("tisfm.") for module in PUBLIC if module != "tisfm"}
    assert modules == set(tisfm._SUBMODULES)
    assert dir(tisfm) == sorted(modules | set(tisfm.__all__))
    for module in modules:
        assert getattr(tisfm, module) is import_module(f"tisfm.{module}")
    with pytest.raises(AttributeError, match="module 'tisfm' has no attribute 'nothing'"):
        _ = tisfm.nothing


def names_shown(text):
    """Return the dotted names below ``tisfm`` that a page imports or calls."""
    shown = {f"tisfm{name}" for name in re.findall(r"\btisfm((?:\.[A-Za-z_]+)+)\(", text)}
    for code in re.findall(r"^```python\n(.*?)^```", text, flags=re.DOTALL | re.MULTILINE):
        for node in ast.walk(ast.parse(code)):
            if isinstance(node, ast.ImportFrom) and node.module.partition(".")[0] == "tisfm":
                shown |= {f"{node.module}.{alias.name}" for alias in node.names}
            elif isinstance(node, ast.Import):
                shown |= {a.name for a in node.names if a.name.partition(".")[0] == "tisfm"}
    return shown


def is_public(name):
    """Whether a dotted name is a module or a name of the list, or an attribute of one."""
    names = {f"{module}.{name}" for module in PUBLIC for name in PUBLIC[module]}
    parts = name.split(".")
    return name in PUBLIC or any(".".join(parts[:n]) in names for n in (2, 3))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_pages_show_public_names_only(page):
    internal = sorted(n for n in names_shown(page.read_text(encoding="utf-8")) if not is_public(n))
    assert internal == []


def test_names_are_found_on_a_page():
    text = (
        'Call `tisfm.solver.solve(x)` or `tisfm.Settings.preset("fast")`.\n\n'
        "```python\nfrom tisfm.formats import read_flo, _header\nimport tisfm.pair\n```\n"
    )
    shown = names_shown(text)
    assert {name for name in shown if is_public(name)} == {
        "tisfm.Settings.preset",
        "tisfm.formats.read_flo",
    }
    assert shown - {name for name in shown if is_public(name)} == {
        "tisfm.formats._header",
        "tisfm.pair",
        "tisfm.solver.solve",
    }
