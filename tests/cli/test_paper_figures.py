"""The paper's comparisons of settings, drawn."""

from types import SimpleNamespace

import numpy as np

import tisfm
from tisfm.cli import figures


def test_both_panels_of_a_figure_have_one_grey_scale(tmp_path, monkeypatch):
    """Inverse depth is ten times as great in each further interpretation."""
    sizes = iter(10.0 ** np.arange(5))
    limits = []

    def interpret(*frames, **options):
        return SimpleNamespace(inverse_depth=np.full((8, 9), next(sizes)))

    def grey(depth, limit):
        limits.append(limit)
        return np.zeros(depth.shape, np.uint8)

    monkeypatch.setattr(figures, "interpret", interpret)
    monkeypatch.setattr(figures, "depth_grey", grey)
    monkeypatch.setattr(figures, "panel_figure", lambda pictures, title: None)
    monkeypatch.setattr(figures, "save_figure", lambda path, figure: None)
    frame = np.zeros((8, 9), np.uint8)
    figures.write_paper_figures(tmp_path, frame, frame, camera=tisfm.Camera(focal=9.0))
    assert limits == [10.0, 10.0, 100.0, 100.0, 1e4, 1e4]
