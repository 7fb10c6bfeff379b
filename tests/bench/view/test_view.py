"""The viewer on long results: they are what they are said to be, and a slow page fails."""

import pytest

from bench.view import __main__ as view
from bench.view.__main__ import lengthen_reconstruction, lengthen_run
from bench.view.opening import Opening, browser_path
from tests.view.results import write_reconstruction, write_run
from tisfm.results.opening import open_result


def opening(first, **changes):
    given = {
        "served": 1.0, "processor": 1.5, "refined": 4.0, "steps": ((0.1, 0.9), (0.3, 1.1)),
        "memory": 150.0, "peak": 400.0,
    }  # fmt: skip
    return Opening(first=first, **{**given, **changes})


def test_long_results_have_all_frames(tmp_path):
    write_run(tmp_path / "short", 3)
    lengthen_run(tmp_path / "short", tmp_path / "long", 20)
    result = open_result(tmp_path / "long")
    assert len(result.names) == 20
    assert (result.read(19).picture == open_result(tmp_path / "short").read(1).picture).all()
    shot = write_reconstruction(tmp_path / "made")
    lengthen_reconstruction(tmp_path / "made", tmp_path / "longer", 20)
    result = open_result(tmp_path / "longer")
    assert len(result.names) == 20 and (result.piece == 0).all()
    assert result.read(7).inverse_depth == pytest.approx(1 / shot.depth[1], rel=2e-3)  # back


def test_report():
    found = {"run": [opening(2.0), opening(2.6), opening(2.2)], "reconstruction": [opening(3.1)]}
    text = view.report(found, 1000, {"processor": "x"})
    row = "| `tisfm run` | 1000 | 1.00 | 2.20 | 2.60 | 1.50 | 4.00 | 0.20 | 1.00 | 150 | 400 |"
    assert row in text and "- processor: x" in text
    assert [bar.is_met for bar in view.bars(found)] == [True, False]
    unknown = view.report({"run": [opening(2.0, memory=None)]}, 10, {})
    assert "| – | 400 |" in unknown


@pytest.mark.nightly
def test_smoke(capsys):
    pytest.importorskip("viser", reason="viser is not installed: pip install 'tisfm[view]'")
    pytest.importorskip("playwright", reason="playwright is not installed")
    if browser_path() is None:
        pytest.skip("no Chromium: Debian has it as the package chromium")
    assert view.main(["--smoke"]) == 0
    text = capsys.readouterr().out
    assert "| `tisfm run` | 30 |" in text and "| `tisfm reconstruct` | 30 |" in text
