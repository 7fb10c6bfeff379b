"""What is promised is written whole, whatever goes wrong on the way."""

from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

import tisfm
from tests.draws import nightly_except
from tests.evaluation.evaluated import (
    FAST,
    FILES,
    HOLE,
    H,
    W,
    evaluate_to,
    promised,
    record,
    written,
)
from tisfm.datasets import find_pairs
from tisfm.evaluation import files, pairs
from tisfm.evaluation.files import EvaluationWriter
from tisfm.evaluation.pairs import evaluate
from tisfm.formats import read_flo, read_image
from tisfm.metrics import FlowErrors, endpoint_error
from tisfm.show import UNKNOWN_COLOR


@pytest.mark.parametrize("name", ["frame10.png", "frame11.png", "flow10.flo"])
def test_a_fault_of_one_pair_does_not_lose_the_others(data, tmp_path, name):
    path = data / "mid" / "A" / name
    path.write_bytes(path.read_bytes()[:50])
    result = evaluate_to(tmp_path / "out", data / "mid")
    assert [pair.label for pair in result.faults] == ["mid/A"]
    assert str(path) in result.faults[0].fault and "cut off" in result.faults[0].fault
    assert result.faults[0].errors is None
    assert result.mean.pairs == 1
    assert result.dataset_means["mid"].errors == result.pairs[1].errors
    assert set(written(tmp_path / "out")) == promised("mid/B")
    about = record(tmp_path / "out")["pairs"][0]
    assert about["fault"] == result.faults[0].fault
    assert about["errors"] is None and about["outputs"] is None


def test_pairs_that_all_fail_have_no_mean(data):
    for path in data.rglob("*10.png"):
        path.write_bytes(b"nothing")
    result = evaluate(find_pairs(data / "mid"), settings=FAST)
    assert len(result.faults) == 2
    assert result.mean is None and result.dataset_means == {"mid": None}


def test_flow_that_is_not_finite_is_a_fault(data, monkeypatch):
    original = pairs.interpret

    def broken(*arguments, **options):
        result = original(*arguments, **options)
        result.flow[3, 4] = np.nan
        return result

    monkeypatch.setattr(pairs, "interpret", broken)
    result = evaluate(find_pairs(data / "mid"), settings=FAST)
    assert all("flow is not finite at 1 of" in pair.fault for pair in result.pairs)


def test_the_promised_files(data, tmp_path):
    result = evaluate_to(tmp_path / "out", data)
    assert set(written(tmp_path / "out")) == promised(*FILES)
    for found in result.pairs:
        loaded = found.pair.load()
        stem = tmp_path / "out" / found.label
        flow = read_flo(f"{stem}_flow.flo")
        assert endpoint_error(flow, loaded.flow) == pytest.approx(found.errors.endpoint)
        for ending in ("flow", "error"):
            picture = read_image(f"{stem}_{ending}.png")
            assert picture.ndim == 3 and picture.shape[1] > 200
    grey = read_image(tmp_path / "out" / "mid" / "A_error.png") == UNKNOWN_COLOR
    assert grey.all(axis=2).mean() > 0.3 * HOLE.mean()


def test_the_record_holds_every_number(data, tmp_path):
    result = evaluate_to(tmp_path / "out", data)
    about = record(tmp_path / "out")
    assert about["complete"] is True
    assert about["version"] == tisfm.__version__
    assert set(about["versions"]) == {"python", "numpy", "taichi", "opencv-python-headless"}
    assert about["threads"] >= 1 and about["camera"] is None
    assert tisfm.Settings(**about["settings"]) == FAST
    for entry, found in zip(about["pairs"], result.pairs, strict=True):
        assert f"{entry['dataset']}/{entry['name']}" == found.label == entry["outputs"]
        for name in ("errors", "visible", "without_sky", "occlusion"):
            expected = getattr(found, name)
            assert entry[name] == (None if expected is None else asdict(expected))
        assert entry["seconds"] == found.seconds
        assert entry["size"] == [H, W]
        assert entry["status"] == found.status
        assert Path(entry["inputs"]["truth"]) == found.pair.truth
        assert Path(entry["inputs"]["frame1"]) == found.pair.frame1
    assert FlowErrors(**about["mean"]["errors"]) == result.mean.errors
    assert {name: mean["pairs"] for name, mean in about["dataset_means"].items()} == {
        "mid": 2, "road": 1, "valley": 1
    }  # fmt: skip


def test_pairs_of_one_name_do_not_overwrite_each_other(data, tmp_path):
    (data / "again").mkdir()
    (data / "mid").rename(data / "again" / "mid")
    (data / "road").rename(data / "mid")
    (data / "mid" / "training").rename(data / "mid" / "A")
    pairs = [pair for pair in find_pairs(data) if pair.layout == "middlebury"]
    twin = tmp_path / "other" / "mid" / "a"  # the same, where file names ignore case
    twin.parent.mkdir(parents=True)
    (data / "again" / "mid" / "B").rename(twin)
    writer = EvaluationWriter(tmp_path / "out", camera=None, settings=FAST)
    evaluate([*pairs[:1], *find_pairs(twin)], settings=FAST, on_pair=writer.write)
    assert set(written(tmp_path / "out")) == promised("mid/A", "mid/a_2")


def test_names_stay_within_the_folder(data, tmp_path):
    (pair,) = find_pairs(data / "mid" / "A")
    wild = type(pair)(**{**vars(pair), "dataset": "../x y", "name": "../../é/?z"})
    writer = EvaluationWriter(tmp_path / "out", camera=None, settings=FAST)
    evaluate([wild], settings=FAST, on_pair=writer.write)
    (entry,) = record(tmp_path / "out")["pairs"]
    assert entry["name"] == "../../é/?z"
    assert set(written(tmp_path / "out")) == promised(entry["outputs"])
    assert not {path.name for path in tmp_path.iterdir()} - {"data", "out"}


@pytest.mark.parametrize(
    "step",
    nightly_except("write_flo", "rename", of=["interpret", "write_flo", "save_figure", "rename"]),
)
def test_files_of_an_interrupted_evaluation_are_whole(data, tmp_path, monkeypatch, step):
    """Ctrl-C at the second pair: the record holds the first, and every file there is whole."""
    evaluate_to(tmp_path / "whole", data / "mid")
    module = pairs if step == "interpret" else files
    name = "atomic_write" if step == "rename" else step
    original, calls = getattr(module, name), []
    # One warm-up and one pair; one flow; two figures; the empty record and that of one pair.
    before = {"interpret": 2, "write_flo": 1, "save_figure": 3, "rename": 2}[step]

    def interrupted(*arguments, **options):
        calls.append(1)
        if len(calls) > before:
            raise KeyboardInterrupt
        return original(*arguments, **options)

    monkeypatch.setattr(module, name, interrupted)
    with pytest.raises(KeyboardInterrupt):
        evaluate_to(tmp_path / "out", data / "mid")
    left, whole = written(tmp_path / "out"), written(tmp_path / "whole")
    assert set(left) <= set(whole)
    for name in set(left) - {"eval.json"}:
        assert left[name] == whole[name], name
    about = record(tmp_path / "out")
    assert about["complete"] is False and about["mean"] is None
    assert [entry["name"] for entry in about["pairs"]] == ["A"]


def test_the_record_of_an_earlier_evaluation_is_removed(data, tmp_path):
    evaluate_to(tmp_path / "out", data / "valley")
    EvaluationWriter(tmp_path / "out", camera=tisfm.Camera(5.0), settings=tisfm.Settings())
    about = record(tmp_path / "out")
    assert about["pairs"] == [] and about["complete"] is False
    assert about["camera"] == asdict(tisfm.Camera(5.0))


def test_a_picture_that_cannot_be_written_is_a_fault(data, tmp_path, monkeypatch):
    original = files.write_flo

    def full(path, flow):
        if "B_flow" in str(path):
            raise OSError(28, "No space left on device")
        original(path, flow)

    monkeypatch.setattr(files, "write_flo", full)
    result = evaluate_to(tmp_path / "out", data / "mid")
    (fault,) = result.faults
    assert fault.label == "mid/B" and "No space left on device" in fault.fault
    assert [entry["fault"] is None for entry in record(tmp_path / "out")["pairs"]] == [
        True, False
    ]  # fmt: skip
