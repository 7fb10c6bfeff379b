"""Flow and occlusion: the numbers are those of the metrics."""

from dataclasses import replace

import numpy as np
import pytest

import tisfm
from tests.evaluation.evaluated import FAST, LABELS, H, W
from tisfm.datasets import find_pairs
from tisfm.evaluation import pairs
from tisfm.evaluation.pairs import PairEvaluation, evaluate, mean_errors
from tisfm.formats import write_kitti_flow
from tisfm.metrics import (
    FlowErrors,
    OcclusionScores,
    angular_error,
    endpoint_error,
    endpoint_error_map,
    occlusion_scores,
    outlier_rate,
)
from tisfm.visibility.occlusion import leaves_image


def test_errors_are_those_of_the_metrics(data):
    result = evaluate(find_pairs(data), settings=FAST)
    assert [pair.label for pair in result.pairs] == LABELS
    assert result.settings == FAST and result.faults == []
    for found in result.pairs:
        loaded = found.pair.load()
        expected = tisfm.interpret(loaded.frame0, loaded.frame1, camera=found.camera, settings=FAST)
        assert found.status == expected.status and found.message == expected.status.message
        assert found.size == (H, W) and found.seconds > 0
        masks = {"errors": None, "visible": loaded.occlusion, "without_sky": loaded.sky}
        for name, excluded in masks.items():
            errors = getattr(found, name)
            if name != "errors" and excluded is None:
                assert errors is None
                continue
            mask = None if excluded is None else ~excluded
            arguments = (expected.flow, loaded.flow)
            assert errors.endpoint == pytest.approx(endpoint_error(*arguments, mask=mask))
            assert errors.angular == pytest.approx(angular_error(*arguments, mask=mask))
            assert errors.outliers == outlier_rate(*arguments, mask=mask)
            error = endpoint_error_map(*arguments, mask=mask)
            assert errors.pixels == np.isfinite(error).sum()
            assert errors.over_one == (error[np.isfinite(error)] >= 1).mean()
    assert [bool(pair.visible) for pair in result.pairs] == [False, False, True, False]
    assert [bool(pair.without_sky) for pair in result.pairs] == [False, False, False, True]
    assert 0 < result.pairs[0].errors.endpoint < 0.5


def test_the_camera_is_the_stated_one_unless_another_is_given(data):
    stated = evaluate(find_pairs(data), settings=FAST)
    assert [pair.camera for pair in stated.pairs] == [
        tisfm.Camera(), tisfm.Camera(), tisfm.Camera(56, (27.5, 19.5)), tisfm.Camera()
    ]  # fmt: skip
    camera = tisfm.Camera(70, (20, 20))
    given = evaluate(find_pairs(data), settings=FAST, camera=camera)
    assert {pair.camera for pair in given.pairs} == {camera}
    assert given.pairs[0].errors != stated.pairs[0].errors


def test_settings_reach_the_result(data):
    pairs = find_pairs(data / "mid")[:1]
    errors = [
        evaluate(pairs, settings=settings).pairs[0].errors
        for settings in (None, FAST, tisfm.Settings.preset("paper"))
    ]
    assert len({error.endpoint for error in errors}) == 3
    assert errors[0] == evaluate(pairs, settings=tisfm.Settings()).pairs[0].errors


def test_means_are_over_pairs(data):
    result = evaluate(find_pairs(data), settings=FAST)
    means = result.dataset_means
    assert list(means) == ["mid", "road", "valley"]
    first, second, road, valley = result.pairs
    for name in ("endpoint", "angular", "outliers", "over_one"):
        pair = [getattr(found.errors, name) for found in result.pairs]
        assert getattr(means["mid"].errors, name) == pytest.approx(np.mean(pair[:2]))
        assert getattr(result.mean.errors, name) == pytest.approx(np.mean(pair))
    assert means["mid"].errors.pixels == first.errors.pixels + second.errors.pixels
    assert means["mid"].seconds == pytest.approx((first.seconds + second.seconds) / 2)
    assert (means["mid"].pairs, result.mean.pairs) == (2, 4)
    assert means["road"].visible == road.visible
    assert means["valley"].without_sky == valley.without_sky
    # Over other pairs than the errors: not to be compared with them.
    assert result.mean.visible is None and result.mean.without_sky is None


def test_occlusion_is_compared_where_the_truth_is_known(data):
    (found,) = evaluate(find_pairs(data / "road"), settings=FAST).pairs
    loaded = found.pair.load()
    ours = tisfm.interpret(loaded.frame0, loaded.frame1, camera=found.camera, settings=FAST)
    known = np.isfinite(loaded.flow).all(axis=-1)
    leaves = leaves_image(np.moveaxis(loaded.flow, -1, 0))
    truth = loaded.occlusion | leaves
    assert found.occlusion == occlusion_scores(ours.occlusion, truth, mask=known)
    assert 0 < found.occlusion.f1 <= 1
    noc = data / "road" / "training" / "flow_noc" / "000003_10.png"
    write_kitti_flow(noc, loaded.flow)  # as if the dataset did not count what leaves the image
    (found,) = evaluate(find_pairs(data / "road"), settings=FAST).pairs
    assert found.occlusion == occlusion_scores(ours.occlusion, leaves, mask=known)
    write_kitti_flow(noc.parents[1] / "flow_occ" / noc.name, 0 * loaded.flow)
    write_kitti_flow(noc, 0 * loaded.flow)
    (found,) = evaluate(find_pairs(data / "road"), settings=FAST).pairs
    assert found.occlusion == occlusion_scores(ours.occlusion, 0 * leaves, mask=known)
    assert found.occlusion.occluded == found.occlusion.hits == 0 < found.occlusion.marked


def test_occlusion_of_a_dataset_counts_false_alarms_where_nothing_is_occluded():
    def scored(hits, marked, occluded):
        scores = OcclusionScores.from_counts(
            hits=hits, marked=marked, occluded=occluded, pixels=1000
        )
        errors = FlowErrors(endpoint=1.0, angular=1.0, outliers=0.0, over_one=0.0, pixels=1000)
        return PairEvaluation(pair=None, seconds=1.0, errors=errors, occlusion=scores)

    found, nothing_there = scored(hits=60, marked=80, occluded=100), scored(0, 40, 0)
    mean = mean_errors([found, nothing_there]).occlusion
    assert (mean.hits, mean.marked, mean.occluded, mean.pixels) == (60, 120, 100, 2000)
    assert mean.precision == 0.5 and mean.recall == 0.6
    assert mean.f1 == pytest.approx(120 / 220)
    assert mean.f1 < found.occlusion.f1
    assert mean_errors([found, replace(nothing_there, occlusion=None)]).occlusion is None


def test_a_pair_that_is_all_occluded_has_no_visible_errors(data):
    visible = np.full((H, W, 2), np.nan)
    write_kitti_flow(data / "road" / "training" / "flow_noc" / "000003_10.png", visible)
    (found,) = evaluate(find_pairs(data / "road"), settings=FAST).pairs
    assert found.visible is None and found.errors is not None


def test_a_pair_given_twice_counts_once(data):
    pairs = find_pairs(data / "mid")
    result = evaluate([*pairs, *find_pairs(data)[:2]], settings=FAST)
    assert [pair.label for pair in result.pairs] == LABELS[:2]


def test_no_time_includes_compiling(data, monkeypatch):
    """A small pair of the same type and channels is interpreted first."""
    seen = []
    original = pairs.interpret

    def spy(frame0, frame1, **options):
        seen.append((frame0.shape, frame0.dtype, options["settings"]))
        return original(frame0, frame1, **options)

    monkeypatch.setattr(pairs, "interpret", spy)
    evaluate(find_pairs(data), settings=FAST)
    grey, colour = (H, W), (H, W, 3)
    assert [shape for shape, _, _ in seen] == [(64, 64), grey, grey, (64, 64, 3), colour, grey]
    assert {(dtype, settings) for _, dtype, settings in seen} == {(np.dtype(np.uint8), FAST)}


@pytest.mark.parametrize(
    ("options", "message"),
    [({"camera": 600.0}, "camera is 600.0: expected a tisfm.Camera"),
     ({"settings": "fast"}, "settings is 'fast': expected a tisfm.Settings")],
)  # fmt: skip
def test_options_are_checked(options, message):
    with pytest.raises(TypeError, match=message):
        evaluate([], **options)
