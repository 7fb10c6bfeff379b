"""Real sequences: what a person sees in them."""

import numpy as np
import pytest

import tisfm
from bench.objects import statue
from bench.shared.sequences import MIDDLEBURY, find_pairs
from tests.draws import nightly_except
from tisfm.formats import read_image
from tisfm.metrics import angular_error, endpoint_error, outlier_rate
from tisfm.sources import FrameSource


@pytest.mark.parametrize("taken", nightly_except(5, of=[5, None]))
@pytest.mark.parametrize(("name", "pairs"), [("flowergarden", 28), ("statue", 30)])
def test_every_pair_is_interpreted(shared_data, name, pairs, taken):
    assert len(FrameSource(shared_data / name)) == pairs
    settings = tisfm.Settings.preset("fast")
    count = 0
    for result in tisfm.interpret_sequence(shared_data / name, settings=settings, stop=taken):
        assert result.status in ("converged", "iteration_limit")
        assert np.isfinite(result.flow).all()
        assert 0.1 < np.linalg.norm(result.flow, axis=-1).mean() < 10
        count += 1
    assert count == (pairs if taken is None else taken - 1)


def test_the_tree_stands_out_from_the_houses(shared_data):
    frames = [read_image(shared_data / "flowergarden" / f"img0{k}.pgm") for k in (40, 41)]
    result = tisfm.interpret(*frames)
    tree = result.inverse_depth[40:105, 81:94]
    houses = result.inverse_depth[35:65, 115:165]
    assert np.median(tree) > 3 * np.median(houses)
    assert np.quantile(tree, 0.1) > np.quantile(houses, 0.9)


def test_the_walking_man_moves_on_his_own(shared_data):
    frames = [read_image(path) for path in sorted((shared_data / "statue").iterdir())[12:14]]
    flow = tisfm.interpret(*frames).flow
    man = np.median(flow[90:140, 88:102].reshape(-1, 2), axis=0)
    wall = np.median(flow[30:110, 130:170].reshape(-1, 2), axis=0)
    assert np.linalg.norm(man - wall) > 1.5


@pytest.mark.nightly  # of one pair: the test above, and tests/motion/test_runaways.py
def test_the_man_and_the_cyclist_have_labels_of_their_own(shared_data):
    pairs = list(statue.statue_pairs(shared_data))
    assert len(pairs) == 14
    found = [statue.interpret_pair("balanced", *pair, 600.0) for pair in pairs]
    # 9 to 12 with focal lengths from 580 to 620 px: rounding alone changes it, so machines differ.
    assert sum(seen.man and seen.cyclist and seen.different for seen in found) >= 8


# Accuracy. The bars lie somewhat above what is measured (README, bench/results/peers.md).


def flows(shared_data, preset, *names):
    """Yield flow and truth of pairs of `bench.sequences`; every one of them must be there."""
    pairs, _ = find_pairs(shared_data)
    chosen = [pair for pair in pairs if pair.name in names]
    assert len(chosen) == len(names)
    settings = tisfm.Settings.preset(preset)
    for pair in chosen:
        yield tisfm.interpret(pair.frame0, pair.frame1, settings=settings).flow, pair.truth


@pytest.mark.parametrize(
    ("preset", "bar"),
    [
        ("fast", 0.393),  # OpenCV's DIS medium
        ("balanced", 0.24),
        pytest.param("accurate", 0.18, marks=pytest.mark.nightly),
    ],
)
def test_end_point_error_on_middlebury(shared_data, preset, bar):
    assert (
        np.mean([endpoint_error(*pair) for pair in flows(shared_data, preset, *MIDDLEBURY)]) < bar
    )


@pytest.mark.parametrize(
    ("name", "bar"),
    [("yosemite_clouds", 2.4), pytest.param("yosemite_cloudless", 1.5, marks=pytest.mark.nightly)],
)
def test_angular_error_on_yosemite(shared_data, name, bar):
    (pair,) = flows(shared_data, "accurate", name)
    assert angular_error(*pair) < bar


def test_end_point_error_on_alley(shared_data):
    (pair,) = flows(shared_data, "balanced", "sintel_alley")
    assert endpoint_error(*pair) < 0.19


@pytest.mark.nightly  # of smaller displacements: the tests above
def test_outliers_of_stereo_pairs(shared_data):
    """Displacements of up to 60 px."""
    rates = [outlier_rate(*pair) for pair in flows(shared_data, "balanced", "cones", "motorcycle")]
    assert np.mean(rates) < 0.25
