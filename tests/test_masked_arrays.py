"""Masked arrays: NumPy's functions drop masks, so what has a masked value is refused."""

import re

import numpy as np
import pytest

import tisfm
from tisfm import formats, metrics, show
from tisfm.checks import refuse_masked
from tisfm.egomotion import camera_motion
from tisfm.point_cloud import PointCloud, point_cloud
from tisfm.rigid import check_pose, rigid_motion

SIZE = (6, 8)
MAP = np.linspace(1, 2, 48).reshape(SIZE)
FLOW = np.dstack([MAP, -MAP])
IMAGE = np.arange(48, dtype=np.uint8).reshape(SIZE)
LABELS = (IMAGE > 20).astype(np.int32)
SEEN = np.ones(SIZE, bool)
CAMERA = tisfm.Camera()
RIGID = {"inverse_depth_std": MAP, "confidence": MAP}

# Functions of arrays, and arguments that they take.
TAKERS = {
    "depth_errors": (metrics.depth_errors, (MAP, MAP, SEEN)),
    "depth_error_map": (metrics.depth_error_map, (MAP, MAP, SEEN)),
    "std_coverage": (metrics.std_coverage, (MAP, MAP, MAP, SEEN)),
    "endpoint_error": (metrics.endpoint_error, (FLOW, FLOW)),
    "endpoint_error_map": (metrics.endpoint_error_map, (FLOW, FLOW)),
    "angular_error": (metrics.angular_error, (FLOW, FLOW)),
    "outlier_rate": (metrics.outlier_rate, (FLOW, FLOW)),
    "flow_errors": (lambda *a: metrics.flow_errors(*a[:2], mask=a[2]), (FLOW, FLOW, SEEN)),
    "occlusion_scores": (
        lambda *a: metrics.occlusion_scores(*a[:2], mask=a[2]),
        (SEEN, SEEN, SEEN),
    ),
    "pose_errors": (metrics.pose_errors, (np.eye(4), np.eye(4))),
    "choose_depth_scale": (formats.choose_depth_scale, (MAP,)),
    "flow_radius": (show.flow_radius, (FLOW,)),
    "usual_length": (show.usual_length, (FLOW,)),
    "flow_to_color": (show.flow_to_color, (FLOW,)),
    "quiver_points": (lambda flow: show.quiver_points(flow, 2), (FLOW,)),
    "depth_grey": (show.depth_grey, (MAP,)),
    "inverse_depth_limit": (show.inverse_depth_limit, (MAP,)),
    "error_to_color": (show.error_to_color, (MAP,)),
    "error_figure": (show.error_figure, (MAP,)),
    "flow_figure": (show.flow_figure, (FLOW, FLOW)),
    "depth_error_figure": (show.depth_error_figure, (MAP, MAP)),
    "uncertainty_to_color": (show.uncertainty_to_color, (MAP, MAP)),
    "second_view": (lambda *a: show.second_view(*a, displacement=1), (IMAGE, MAP)),
    "dubois": (show.dubois, (IMAGE, IMAGE)),
    "anaglyph": (show.anaglyph, (IMAGE, MAP)),
    "label_overlay": (show.label_overlay, (IMAGE, LABELS)),
    "panel_figure": (lambda image: show.panel_figure([("Frame", image)]), (IMAGE,)),
    "comparison_figure": (
        lambda *a: show.comparison_figure(*a[:3], occlusion=a[3]),
        (IMAGE, MAP, FLOW, SEEN),
    ),
    "rigid_figure": (
        lambda *a: show.rigid_figure(*a[:3], labels=a[3], occlusion=a[4], **RIGID),
        (IMAGE, MAP, FLOW, LABELS, SEEN),
    ),
    "rigid_motion": (rigid_motion, (np.arange(6) / 10,)),
    "check_pose": (check_pose, (np.eye(4),)),
    "camera_motion": (lambda *a: camera_motion(*a, CAMERA), (FLOW, MAP)),
    "point_cloud": (
        lambda *a: point_cloud(a[0], CAMERA, frame=a[1], confidence=a[2], occlusion=a[3]),
        (MAP, IMAGE, MAP.astype(np.float32), SEEN),
    ),
    "PointCloud": (
        lambda *a: PointCloud(positions=a[0], colors=a[1], confidence=a[2]),
        (np.ones((5, 3), np.float32), np.ones((5, 3), np.uint8), np.ones(5, np.float32)),
    ),
}
WRITERS = {
    "flo": (formats.write_flo, FLOW),
    "dpt": (formats.write_dpt, MAP),
    "kitti": (formats.write_kitti_flow, FLOW),
    "depth": (lambda path, depth: formats.write_depth_png(path, depth, scale=100), MAP),
    "png": (formats.write_png, IMAGE),
}


def masked(array):
    """Return a masked array, and the same whose first value is masked."""
    free, hidden = np.ma.masked_array(array), np.ma.masked_array(array)
    hidden = hidden.copy()
    hidden[(0,) * array.ndim] = np.ma.masked
    return free, hidden


@pytest.mark.parametrize(
    ("name", "index"), [(name, k) for name, (_, given) in TAKERS.items() for k in range(len(given))]
)
def test_masked_values_are_refused(name, index):
    function, given = TAKERS[name]
    free, hidden = masked(given[index])
    function(*given[:index], free, *given[index + 1 :])
    size = given[index].size
    with pytest.raises(ValueError, match=rf"^\S.* has 1 of {size} values masked: \w"):
        function(*given[:index], hidden, *given[index + 1 :])


@pytest.mark.parametrize("kind", WRITERS)
def test_masked_values_are_not_written(tmp_path, kind):
    write, array = WRITERS[kind]
    free, hidden = masked(array)
    write(tmp_path / "free", free)
    with pytest.raises(ValueError, match=rf"has 1 of {array.size} values masked: fill them first"):
        write(tmp_path / "hidden", hidden)
    assert [path.name for path in tmp_path.iterdir()] == ["free"]


def test_a_result_with_masked_values_is_not_saved(tmp_path):
    frame = np.random.default_rng(0).integers(0, 256, (16, 20), np.uint8)
    settings = tisfm.Settings.preset("fast", outer_iterations=1)
    result = tisfm.interpret(frame, frame, settings=settings)
    _, hidden = masked(result.confidence)
    object.__setattr__(result, "confidence", hidden)
    with pytest.raises(ValueError, match="confidence has 1 of 320 values masked"):
        result.save(tmp_path / "result.npz")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("rows", [list, tuple, lambda frame: [list(row) for row in frame]])
def test_rows_may_be_masked(rows):
    free, hidden = masked(MAP)
    metrics.depth_errors(rows(free), MAP)
    with pytest.raises(ValueError, match="depth has 1 of 48 values masked"):
        metrics.depth_errors(rows(hidden), MAP)
    plain = list(MAP)
    with pytest.raises(
        ValueError, match="frame1 has 1 of 48 values masked: every pixel of a frame"
    ):
        tisfm.interpret(plain, rows(hidden))
    with pytest.raises(ValueError, match="frame_000001 has 1 of 48 values masked"):
        next(iter(tisfm.interpret_sequence([plain, rows(hidden)])))


@pytest.mark.parametrize(
    "values", [None, 3.0, "text", b"bytes", [], [[]], np.ma.masked_array(MAP), {"a": 1}, range(3)]
)
def test_arrays_without_a_mask_pass(values):
    refuse_masked(values, "values")


def test_the_advice_can_be_followed():
    _, hidden = masked(MAP)
    with pytest.raises(ValueError, match=re.escape("for instance by truth.filled(np.nan)")):
        metrics.depth_errors(MAP, hidden)
    assert metrics.depth_errors(MAP, hidden.filled(np.nan)).density == 1
    _, mask = masked(SEEN)
    with pytest.raises(ValueError, match=re.escape("for instance by mask.filled(0)")):
        metrics.depth_errors(MAP, MAP, mask)
    assert np.isnan(metrics.depth_error_map(MAP, MAP, mask.filled(0))[0, 0])
