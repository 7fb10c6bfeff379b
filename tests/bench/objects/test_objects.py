"""Errors and tables of the benchmark of moving objects. No timing."""

import json
import os
from dataclasses import replace

import numpy as np
import pytest

from bench.objects import __main__ as objects
from bench.objects import statue
from bench.objects.scores import Score, best, compare_objects, details, table, true_objects
from bench.objects.statue import StatuePair
from tisfm.rigid import pose_matrix
from tisfm.scenes import two_blocks

SIZE = (60, 80)
THREADS = str(os.cpu_count())  # as the tests started Taichi


@pytest.fixture(scope="module")
def scene():
    return two_blocks(*SIZE)


def true_poses(scene):
    return np.stack([pose_matrix(scene.motions[k]) for k in (0, 2, 3)])


def test_the_truth_has_no_error(scene):
    labels = true_objects(scene)
    depth = scene.depth * np.array([1.0, 3.0, 0.2])[labels]
    order = np.array([2, 0, 1])  # of labels, any
    poses = np.empty((3, 4, 4))
    poses[order] = true_poses(scene)
    found = compare_objects(scene, depth, poses, order[labels])
    assert len(found) == 3
    for item in found:
        assert item.iou == 1
        assert item.abs_rel == pytest.approx(0, abs=1e-9)
        assert item.direction == pytest.approx(0, abs=1e-4)


def test_one_motion_for_all_has_no_labels_and_wrong_directions_of_objects(scene):
    found = compare_objects(scene, scene.depth, true_poses(scene)[:1], None)
    assert [item.iou for item in found] == [None] * 3
    assert found[0].direction == pytest.approx(0, abs=1e-4) and found[1].direction > 5
    nothing = compare_objects(scene, np.full(SIZE, np.nan), true_poses(scene)[:1], None)
    assert [item.abs_rel for item in nothing] == [1.0] * 3


def test_a_shared_label_is_seen(scene):
    labels = np.minimum(true_objects(scene), 1)
    found = compare_objects(scene, scene.depth, true_poses(scene)[:2], labels)
    assert found[1].iou < 1 and found[2].iou < 0.9
    score = Score(method="a", group="g", pair="p", seconds=1.0, objects=found, labels=2)
    assert not score.complete and replace(score, labels=3).complete
    assert table([score]).rows[0][1] == "0 of 1"
    assert details([score]).rows[0][2] == "2"


def test_two_stages_are_compared_at_their_best_threshold(scene):
    objects = compare_objects(scene, scene.depth, true_poses(scene)[:1], None)
    rough = tuple(replace(item, abs_rel=0.5) for item in objects)
    given = {"method": "a", "group": "g", "pair": "p", "seconds": 1.0}
    scores = [
        Score(**given, threshold=0.1, objects=rough, one_scale=2.0),
        Score(**given, threshold=0.2, objects=objects, one_scale=1.0),
        Score(**given, threshold=0.3, failure="no motion"),
    ]
    assert best(scores) == [scores[1]]
    row = table(scores).rows[0]
    assert row[0] == "a (0.2 px)" and row[-2:] == ["1.000", "1.00"]


def test_the_man_and_the_cyclist_are_counted_where_they_are():
    assert len(statue.MAN) == len(statue.CYCLIST)
    labels = np.zeros((243, 320), np.int32)
    labels[90:130, 45:65] = 2
    assert statue._label(labels, statue.MAN[0], statue.MAN_SIZE) == 2
    assert statue._label(labels, statue.CYCLIST[0], statue.CYCLIST_SIZE) == 0
    given = {"method": "a", "pair": "p", "focal": 384.0, "labels": 3, "man": True, "seconds": 1.0}
    found = [
        StatuePair(**given, cyclist=True, different=True),
        StatuePair(**given, cyclist=True, different=False),
        StatuePair(**given, cyclist=False, different=True),
    ]
    assert statue.table(found).rows == [["a", "384", "3", "2", "1", "1", "3.0", "1.00"]]


def test_an_unknown_name_is_refused(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(objects, "RESULTS", tmp_path)
    assert objects.main(["--smoke", "--only", "nothing", "--threads", THREADS]) == 2
    assert not list(tmp_path.iterdir())


@pytest.mark.nightly
def test_smoke(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(objects, "RESULTS", tmp_path)
    options = ["--smoke", "--preset", "fast", "--threads", THREADS, "--pairs", "two"]
    assert objects.main(options) == 0
    assert "tisfm fast, objects" in capsys.readouterr().out
    text = (tmp_path / "smoke-objects.md").read_text(encoding="utf-8")
    assert "missing: statue" in text and "## Two blocks" in text and "essential matrix" in text
    record = json.loads((tmp_path / "smoke-objects.json").read_text(encoding="utf-8"))
    assert {score["pair"] for score in record["scores"]} == {"two blocks 0"}
    assert objects.main(["--smoke", "--only", "nothing", "--threads", THREADS]) == 2
