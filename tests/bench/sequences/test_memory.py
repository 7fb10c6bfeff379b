"""Peak memory of a sequence: what is measured, and how it is told."""

import json

import numpy as np
import pytest

from bench.sequences import memory


@pytest.mark.nightly
def test_a_short_film_in_a_process_of_its_own(tmp_path, monkeypatch):
    monkeypatch.setattr(memory, "RESULTS", tmp_path)
    monkeypatch.setattr(memory, "BATCH", 12)
    assert memory.main(["--counts", "12", "--depth-of", "none", "--output", "own"]) == 0
    (row,) = json.loads((tmp_path / "own.json").read_text())["rows"]
    assert row["frames"] == 12 and row["frames with a pose"] == 12 and row["pieces"] == 1
    assert 50 < row["peak memory, MB"] < 4000 and row["ATE, %"] < 5


def test_the_table_has_a_row_for_each_film():
    rows = [dict(zip(memory.FIGURES, (n, 300.4, 1, n, 0.01234), strict=True)) for n in (250, 500)]
    text = memory.report({"preset": "fast"}, rows)
    assert "- preset: fast" in text
    assert "| 500 | 300 | 1 | 500 | 0.012 |" in text


def test_rendered_sequences_are_not_rendered_again(tmp_path, monkeypatch):
    monkeypatch.setattr(memory, "CACHE", tmp_path)
    monkeypatch.setattr(memory, "BATCH", 2)
    folder, camera = memory.render_frames(3)
    assert sorted(file.name for file in folder.iterdir()) == [f"0000{k}.png" for k in range(4)]
    assert camera.focal == 96
    monkeypatch.setattr(memory.cv2, "imwrite", None)
    np.testing.assert_array_equal(memory.render_frames(4)[0], folder)
