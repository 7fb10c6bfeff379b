"""Methods on sequences: what is measured of them, and how it is told."""

import json
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from bench.sequences.__main__ import main
from bench.sequences.contest import COLMAP_WORKER, Colmap, Outcome, OwnMethod, Score, run_contest
from bench.sequences.entries import SEQUENCES, Entry, data_entries, folder_entries
from bench.sequences.report import COLUMNS, details, summary, write
from bench.sequences.stored import StoredResult, store, store_map
from bench.shared.contest import MethodFailure
from tests.evaluation.reconstructed import PATH, N, Result, make_sequence
from tisfm.datasets import find_sequences


class Made:
    """A method that leaves a result, wrong by a factor per frame where `drift` is not 1."""

    def __init__(self, name, *, drift=1.0, depth=True, failure=""):
        self.name, self.drift, self.depth, self.failure = name, drift, depth, failure
        self.runs = 0

    def run(self, loaded, camera, output):
        self.runs += 1
        if self.failure:
            raise MethodFailure(self.failure)
        assert not list(output.iterdir()) and camera == loaded.camera
        result = Result().drop(1)
        units = [self.drift**k for k in range(N)]
        if self.depth:
            for k in range(N):
                if k != 1:
                    store_map(output, k, result.inverse[k], result.deviation[k])
        piece = [int(number) for number in result.piece]
        poses = result.poses
        store(output, "x", poses=poses, piece=piece, status=result.status, units=units)
        return Outcome(results={self.name: "x"}, seconds=self.runs * N, peak=5_000_000)


@pytest.fixture
def entries(tmp_path):
    make_sequence(tmp_path / "wall")
    return folder_entries([tmp_path / "wall"], [1])


def held(entries, methods, **options):
    settings = {"rounds": 1, "conditions": {"threads": 2}, "missing": {}} | options
    return run_contest(methods, entries, **settings)


def test_stored_results_are_read(tmp_path):
    result = Result().drop(2)
    for k in (0, 1, 3):
        store_map(tmp_path, k, result.inverse[k], result.deviation[k] if k else None)
    piece = [int(number) for number in result.piece]
    units = [1, 2, 3, 4, 5, 6]
    store(tmp_path, "x", poses=result.poses, piece=piece, status=result.status, units=units)
    found = StoredResult(tmp_path, "x")
    np.testing.assert_array_equal(found.poses, result.poses)
    np.testing.assert_array_equal(found.piece, result.piece)
    assert found.status == result.status and found.has_depth
    np.testing.assert_allclose(found.inverse_depth(3), result.inverse[3] / 4)
    np.testing.assert_allclose(found.inverse_depth_std(1), result.deviation[1] / 2)
    assert np.isnan(found.inverse_depth(2)).all() and np.isnan(found.inverse_depth_std(0)).all()
    assert found.inverse_depth(2).shape == result.inverse[2].shape


def test_methods_are_scored_once_and_timed_in_every_round(entries):
    good, drifting = Made("good"), Made("drifting", drift=1.1)
    blind, broken = Made("blind", depth=False), Made("broken", failure="it fell over")
    seen = []
    contest = held(entries, [good, drifting, blind, broken], rounds=3, keep=seen.append)
    assert good.runs == broken.runs == 3
    scores = {score.method: score for score in contest.scores}
    assert scores["good"].seconds == (N, 2 * N, 3 * N) and scores["good"].per_frame == 2
    assert scores["good"].evaluation.pieces[0].share < 1e-9
    assert scores["good"].evaluation.depth.error < 1e-3
    assert scores["good"].evaluation.depth.without == 1
    assert scores["drifting"].evaluation.depth.scale_spread == pytest.approx(
        np.std(np.log(1.1) * np.array([0, 2, 3, 4, 5])), rel=1e-3
    )
    assert scores["blind"].evaluation.depth is None
    assert contest.failures == {"broken on wall": "it fell over"}
    assert len(seen) == 1 and len(seen[0]) == 4


def test_the_report_has_every_figure(entries, tmp_path):
    methods = [Made("good"), Made("blind", depth=False), Made("broken", failure="it fell over")]
    contest = held(entries, methods, missing={"peer": "not installed"})
    assert summary(contest, "ATE, %").rows == [["good", "0.00"], ["blind", "0.00"]]
    table = details(contest, "wall")
    rows = [dict(zip(table.head, row, strict=True)) for row in table.rows]
    assert rows[0]["frames with a pose"] == "5 of 6" and rows[0]["memory, MB"] == "5"
    assert rows[1]["depth error"] == "–" and rows[0]["pixels, %"] == "83.3"
    write(contest, tmp_path / "sequences")
    text = (tmp_path / "sequences.md").read_text()
    assert "broken on wall: it fell over" in text and "peer: not installed" in text
    kept = json.loads((tmp_path / "sequences.json").read_text())
    assert kept["scores"][0]["evaluation"]["posed"] == 5
    assert str(tmp_path) not in (tmp_path / "sequences.json").read_text()


def test_sequences_can_be_stepped_and_thinned(entries, tmp_path):
    (entry,) = entries
    assert entry.name == "wall"
    stepped = Entry(sequence=entry.sequence, step=2)
    assert stepped.name == "wall, every 2" and len(stepped.load().frames) == 3
    thinned = Entry(sequence=entry.sequence, thinned=2)
    loaded = thinned.load()
    assert [path.stem for path in loaded.frames] == ["000", "001", "002", "004"]
    np.testing.assert_allclose(loaded.poses, PATH[[0, 1, 2, 4]])
    assert thinned.name == "wall, every 2 from 2 on"
    found, missing = data_entries(tmp_path)
    assert found == [] and set(missing) == {name for name, _ in SEQUENCES}


def test_nothing_to_run_is_reported(tmp_path, monkeypatch, capsys):
    monkeypatch.delenv("TISFM_DATA", raising=False)
    assert main([]) == 2 and "give --data" in capsys.readouterr().err
    make_sequence(tmp_path / "wall")
    assert main(["--folder", str(tmp_path / "wall"), "--methods", "nobody"]) == 2
    assert "no method has nobody in its name" in capsys.readouterr().err
    with pytest.raises(ValueError, match="no sequence or no method"):
        held([], [Made("good")])


def test_a_process_that_fails_is_a_failure_of_the_method(entries, tmp_path):
    loaded = entries[0].load()
    here = tmp_path / "out"
    here.mkdir()
    nobody = Colmap(python=tmp_path / "no" / "python", threads=1)
    with pytest.raises(MethodFailure, match="No such file"):
        nobody.run(loaded, loaded.camera, here)
    assert len(list((here / "images").iterdir())) == N
    poses = loaded.poses.copy()
    poses[0] = np.nan
    given = OwnMethod(preset="fast", method="reconstruct", threads=1, poses_given=True)
    with pytest.raises(MethodFailure, match="not all poses are known"):
        given.run(replace(loaded, poses=poses), loaded.camera, here)


def test_an_unknown_camera_is_reported(entries, tmp_path):
    loaded = entries[0].load()
    unknown = OwnMethod(preset="fast", method="reconstruct", threads=1, camera_given=False)
    assert unknown.name == "tisfm fast, camera unknown"
    lens = replace(loaded.camera, distortion=(-0.3, 0, 0, 0))
    with pytest.raises(MethodFailure, match="distortion"):
        unknown.run(loaded, lens, tmp_path)


@pytest.mark.parametrize(
    ("focal", "text"),
    [
        (None, "–"),
        ((0.0146, 0.007, True), "+1.5 ± 0.7"),
        ((-0.1, 0.06, False), "-10.0 ± 6.0, doubted"),
    ],
)
def test_the_focal_length_has_a_column(focal, text):
    score = Score(method="tisfm fast", sequence="wall", focal=focal)
    assert dict(COLUMNS)["focal length, % off"](score) == text
    assert score.as_json()["focal"] == focal


def test_the_worker_reports_whether_it_can_run():
    command = [sys.executable, COLMAP_WORKER, "survey"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert set(json.loads(done.stdout)) in ({"version"}, {"reason"})


class Few(Entry):
    """The first four frames."""

    def load(self):
        return super().load().take(range(4))


@pytest.mark.nightly
def test_chained_pairs_of_real_frames(shared_data):
    (sequence,) = find_sequences(shared_data / "tartanair")
    entry = Few(sequence=sequence)
    method = OwnMethod(preset="fast", method="chain", threads=1)
    contest = held([entry], [method])
    scores = {score.method: score for score in contest.scores}
    assert set(scores) == {"chained pairs, fast", "pairs, fast"} and not contest.failures
    chained, alone = (score.evaluation for score in scores.values())
    assert chained.posed == 4 and alone.posed == 0
    assert chained.depth.share > 0.9 and alone.depth.share > 0.9
    assert all(score.peak > 1e8 and score.per_frame > 0 for score in scores.values())
    assert isinstance(contest.scores[0], Score)
