"""What the source is made of, and the way of a frame: of a made-up project and of this one."""

import sys
import textwrap
from pathlib import Path

import pytest

from bench.shared.results import ROOT
from bench.structure import __main__ as structure
from bench.structure.drawing import draw
from bench.structure.source import code_lines, cycles, lines_by_folder, read, storeys
from bench.structure.way import Call, Way, from_stops, trace

FILES = {
    "tisfm/__init__.py": "from tisfm.top import run\n",
    "tisfm/top.py": """
        from typing import TYPE_CHECKING
        import tisfm.solver.sweep
        from .values import X
        if TYPE_CHECKING:
            from tisfm.other import Y

        def run():
            from tisfm.kernels import a
        """,
    "tisfm/values.py": "X = 1\n",
    "tisfm/other.py": "from tisfm.top import run\n",
    "tisfm/solver/__init__.py": "",
    "tisfm/solver/sweep.py": "from ..values import X\nfrom tisfm import other\n",
    "kernels/__init__.py": "",
    "kernels/a.py": "from tisfm.kernels.b import c\n",
    "kernels/b.py": "from tisfm.kernels.a import d\n",
}


@pytest.fixture
def project(tmp_path):
    for name, content in FILES.items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(textwrap.dedent(content), encoding="utf-8")
    return tmp_path


def test_imports_of_every_kind_are_found(project):
    source = read(project)
    assert source.graph["tisfm.top"] == {"tisfm.solver.sweep", "tisfm.values", "tisfm.kernels.a"}
    assert source.modules["tisfm.top"].types == {"tisfm.other"}
    assert source.graph["tisfm.solver.sweep"] == {"tisfm.values", "tisfm.other"}
    assert source.graph["tisfm"] == {"tisfm.top"}
    assert source.packages["tisfm"] == {"tisfm.solver", "tisfm.kernels"}


def test_cycles_and_storeys(project):
    source = read(project)
    circle = {"tisfm.top", "tisfm.solver.sweep", "tisfm.other"}
    kernels = {"tisfm.kernels.a", "tisfm.kernels.b"}
    assert cycles(source.graph) == [kernels, circle]
    found = storeys(source.graph)
    assert {found[name] for name in circle} == {1}
    assert {found[name] for name in kernels} == {0} and found["tisfm"] == 2
    assert cycles(source.packages) == [{"tisfm", "tisfm.solver"}]


def test_what_a_cycle_of_packages_stands_on_is_a_room_of_its_own(project):
    (project / "tisfm/other.py").write_text("from tisfm.values import X\n", encoding="utf-8")
    source = read(project)
    assert cycles(source.packages) == [{"tisfm", "tisfm.solver"}]
    assert source.rooms["tisfm.values"] == source.rooms["tisfm.other"] == "tisfm (base)"
    assert source.rooms["tisfm.top"] == "tisfm"
    assert not cycles(source.grouped(source.rooms))


def test_only_lines_with_code_count():
    counted = ["x = [", "    1,", "]", "def f():", '    return """a', 'b"""']
    others = ['"""Docstring', 'of two lines."""', "", "# why"]
    assert code_lines("\n".join(others + counted[:4] + ['    "doc"', *counted[4:], ""])) == 6


def test_lines_of_this_checkout_by_folder():
    lines = lines_by_folder(ROOT)
    assert {"tisfm", "kernels", "bench/structure", "tests/bench/structure"} <= lines.keys()
    here = code_lines(Path(__file__).read_text(encoding="utf-8"))
    assert lines["tests/bench/structure"] == here


def test_this_checkout_has_no_cycle_of_modules():
    assert not cycles(read(ROOT).graph)


@pytest.mark.nightly
def test_this_checkout_is_drawn(tmp_path):
    draw(read(ROOT), tmp_path / "rooms.png", "title")
    assert (tmp_path / "rooms.png").stat().st_size > 10_000


STOPS = [
    ("a", True), ("b", True), ("a", False), ("b", True), ("k", True), ("c", True), ("k", False),
    ("b", False), ("a", False), ("b", True), ("a", False),
]  # fmt: skip


def test_stops_are_counted_and_modules_can_be_left_out():
    way = from_stops(STOPS)
    assert way.calls == [Call("a", (Call("b"), Call("b", (Call("k", (Call("c"),)),)), Call("b")))]
    assert (way.stops, way.back, way.entered) == (len(STOPS), 5, {"a": 1, "b": 3, "c": 1, "k": 1})
    without = way.without(lambda module: module == "k")
    assert without.calls == (Call("a", (Call("b"), Call("b", (Call("c"),)), Call("b"))),)
    assert way.without(lambda module: module == "b").entered == {"a": 1, "k": 1, "c": 1}


def test_what_calls_back_into_its_caller_is_left_out_with_that_call():
    way = Way([Call("a", (Call("k", (Call("a", (Call("b"),)),)),))])
    assert way.without(lambda module: module == "k").calls == (Call("a", (Call("b"),)),)


def test_loops_are_folded_whatever_their_number():
    b, c, d = (Call(name) for name in "bcd")
    way = Way([Call("a", (b, b, b, c, b, b, b, b, b, c, d))]).folded()
    assert list(way.lines(str.upper)) == ["A", "  ×2:", "    B ×3", "    C", "  D"]
    assert way.entered == {"a": 1, "b": 1, "c": 1, "d": 1}
    assert (way.stops, way.back) == (7, 3)


@pytest.mark.nightly
def test_the_way_of_a_pair():
    way = trace(ROOT, Path(sys.executable), "field")
    (call,) = way.calls
    assert call.module == "tisfm.pair"
    assert way.entered["tisfm.pair"] == 1
    assert any(module.startswith("tisfm.kernels.") for module in way.entered)
    assert way.folded().stops < way.stops
    with pytest.raises(RuntimeError, match="interprets nothing with motion='none'"):
        trace(ROOT, Path(sys.executable), "none")


@pytest.mark.nightly
def test_report(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(structure, "RESULTS", tmp_path)
    assert structure.main([str(ROOT), "--names", "x", "--motion"]) == 0
    assert {path.name for path in tmp_path.iterdir()} == {"structure-x.md", "structure-x.png"}
    assert "- of modules: none" in (tmp_path / "structure-x.md").read_text(encoding="utf-8")
    assert "bench/structure" in capsys.readouterr().out
    assert structure.main([str(ROOT), str(ROOT), "--names", "x", "y", "--motion"]) == 0
    table = (tmp_path / "structure.md").read_text(encoding="utf-8")
    assert "|  | x | y |" in table and "| cycles of packages | " in table
    with pytest.raises(SystemExit):
        structure.main([str(tmp_path)])
    assert "is no checkout of this project" in capsys.readouterr().err
