"""Real sequences: what a person sees in them."""

import numpy as np
import pytest

import tisfm
from tisfm.formats import read_flo, read_image
from tisfm.metrics import endpoint_error
from tisfm.sequence import FrameSource


@pytest.mark.slow
@pytest.mark.parametrize(("name", "pairs"), [("flowergarden", 28), ("statue", 30)])
def test_every_pair_is_interpreted(shared_data, name, pairs):
    source = FrameSource(shared_data / name)
    assert len(source) == pairs
    settings = tisfm.Settings.preset("fast")
    count = 0
    for result in tisfm.interpret_sequence(shared_data / name, settings=settings):
        assert result.status in ("converged", "iteration_limit")
        assert np.isfinite(result.flow).all()
        assert 0.1 < np.linalg.norm(result.flow, axis=-1).mean() < 10
        count += 1
    assert count == pairs


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


def test_better_flow_than_dis_on_middlebury(shared_data):
    """The default preset, mean end-point error of four pairs; OpenCV's DIS medium has 0.393."""
    errors = []
    for name in ("RubberWhale", "Grove2", "Urban2", "Venus"):
        folder = shared_data / "middlebury" / name
        frames = [read_image(folder / f"frame{k}.png") for k in (10, 11)]
        truth = read_flo(folder / "flow10.flo")
        errors.append(endpoint_error(tisfm.interpret(*frames).flow, truth))
    assert np.mean(errors) < 0.393
