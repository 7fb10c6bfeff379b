"""Flow beside other libraries, changes of settings, parts without texture. No timing."""

import itertools
import json
import os

import cv2
import numpy as np
import pytest

from bench import ablation, peers, untextured, window
from bench.shared.figures import contest_figure
from bench.untextured import Method
from tests.bench.shared.fakes import Fake, contest, flow_pair
from tisfm.scenes import bare_patches
from tisfm.settings import Settings


@pytest.mark.nightly
def test_smoke_of_the_peers(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(peers, "RESULTS", tmp_path)
    threads = str(os.cpu_count())  # as the tests started Taichi
    assert peers.main(["--smoke", "--only", "tisfm fast", "DIS", "--threads", threads]) == 0
    assert {path.name for path in tmp_path.iterdir()} == {
        f"smoke-peers.{suffix}" for suffix in ("md", "json", "png")
    }
    assert "OpenCV DIS medium" in capsys.readouterr().out
    assert peers.main(["--smoke", "--only", "nothing", "--threads", threads]) == 2
    assert "no method has nothing in its name" in capsys.readouterr().err


def test_names_in_the_picture_overlap_neither_each_other_nor_the_marks():
    methods = [
        Fake(f"method number {k}", [], error=1 + 0.02 * k, seconds=1e-3 * (1 + 0.01 * k))
        for k in range(6)
    ]
    figure = contest_figure(contest(methods, [flow_pair()]))
    (axes,) = figure.axes
    boxes = [text.get_window_extent() for text in axes.texts]
    assert len(boxes) == 6
    assert not any(a.overlaps(b) for a, b in itertools.combinations(boxes, 2))
    marks = [line for line in axes.lines if line.get_marker() == "o"]
    centres = [axes.transData.transform(np.ravel(mark.get_xydata())) for mark in marks]
    assert not any(box.contains(*centre) for box in boxes for centre in centres)


@pytest.mark.nightly
def test_smoke_of_the_changes(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(ablation, "RESULTS", tmp_path)
    monkeypatch.setattr(ablation, "CHANGES", {"one warp": {"warps": 1}, "none": {"warps": 2}})
    threads = str(os.cpu_count())
    assert ablation.main(["--smoke", "--preset", "fast", "--threads", threads]) == 0
    printed = capsys.readouterr().out
    assert "missing: none: the same as the preset" in printed
    assert "one warp: warps = 1" in (tmp_path / "smoke-ablation.md").read_text(encoding="utf-8")


def test_the_changes_are_possible_and_an_impossible_one_is_named():
    for preset in ("fast", "balanced", "accurate"):
        assert set(ablation.variants(preset, ablation.CHANGES)) == set(ablation.CHANGES)
    with pytest.raises(ValueError, match="'few' is impossible: warps is 0"):
        ablation.variants("fast", {"few": {"warps": 0}})


def test_parts_without_texture(tmp_path, monkeypatch, capsys):
    fast = Settings.preset("fast", outer_iterations=2)
    methods = {"a": Method(fast), "b": Method(fast, noise=5), "c": Method(None)}
    monkeypatch.setattr(untextured, "methods", lambda: methods)
    monkeypatch.setattr(untextured, "SEEDS", (0, 1))
    threads = str(os.cpu_count())
    size = ["--height", "90", "--width", "120"]
    monkeypatch.setattr(untextured, "RESULTS", tmp_path)
    assert untextured.main([*size, "--threads", threads]) == 0
    text = (tmp_path / "untextured.md").read_text(encoding="utf-8")
    assert capsys.readouterr().out.strip() in text
    assert f"- threads: {threads}" in text and "- NumPy: " in text
    record = json.loads((tmp_path / "untextured.json").read_text(encoding="utf-8"))
    assert {name: len(rows) for name, rows in record["found"].items()} == {"a": 2, "b": 2, "c": 2}
    assert set(record["found"]["a"][0]) == set(untextured.COLUMNS)
    assert all(np.isfinite(v) for rows in record["found"].values() for v in rows[0].values())
    assert record["found"]["a"] != record["found"]["b"]
    assert "depth_bare" not in record["found"]["c"][0]


def test_the_noise_has_the_stated_deviation():
    pair = bare_patches(90, 120)
    noise = untextured.add_noise(pair, 5, seed=0).frame1 - pair.frame1.astype(float)
    assert noise.std() == pytest.approx(5, rel=0.05)
    assert {method.noise for method in untextured.methods().values()} == {0, 2, 5}


@pytest.mark.nightly
def test_three_frames_are_compared_with_two(tmp_path, monkeypatch, capsys):
    from tisfm.scenes import two_blocks

    rendered = [
        [window.blocks(two_blocks, 48, 64, 2.0, 3)],
        [window.papered_room(48, 64, 3, "forward")],
    ]
    monkeypatch.setattr(window, "triples", lambda data: iter(rendered))
    threads = str(os.cpu_count())
    arguments = ["--presets", "fast", "--repetitions", "1", "--threads", threads]
    monkeypatch.setattr(window, "RESULTS", tmp_path)
    assert window.main([*arguments]) == 0
    text = (tmp_path / "window.md").read_text(encoding="utf-8")
    assert "## `fast`" in text and "two_blocks, 64×48, 2 times its speed" in text
    assert "fast | two_blocks" in capsys.readouterr().out


def test_flow_of_a_film_leads_to_the_same_grey():
    triple = window.papered_room(60, 80, 3, "forward")
    height, width = triple.flow.shape[:2]
    place = (triple.flow + np.moveaxis(np.mgrid[:height, :width][::-1], 0, -1)).astype(np.float32)
    there = cv2.remap(triple.frames[2], place[..., 0], place[..., 1], cv2.INTER_LINEAR)
    off = np.abs(there.astype(float) - triple.frames[1])
    assert np.median(off[~triple.occluded_pixels]) < 4  # noise of 1.5 grey levels in both
    assert 0.02 < triple.occluded_pixels.mean() < 0.4
