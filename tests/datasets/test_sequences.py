"""Sequences with poses: pairs, cameras and depth."""

import numpy as np
import pytest

from tests.datasets.made import (
    COLOUR,
    MAKERS,
    MOTION,
    H,
    W,
    make_middlebury,
    make_new_tsukuba,
    make_sevenscenes,
    put,
)
from tisfm.datasets import find_pairs
from tisfm.datasets.calibration import (
    COLOUR_CAMERA_OFFSET,
    DEPTH_CAMERA,
    KNOWN_CAMERAS,
    scale_known_camera,
)
from tisfm.formats import FormatError, write_png
from tisfm.metrics import pose_errors
from tisfm.scenes import Box, Plane, Scene, Texture


@pytest.mark.parametrize("kind", ["new_tsukuba", "sevenscenes"])
@pytest.mark.parametrize("step", [None, 1, 2, 3])
def test_pairs_of_a_sequence(data, kind, step):
    MAKERS[kind](data)
    pairs = find_pairs(data, step=step)
    gap = step or {"new_tsukuba": 1, "sevenscenes": 3}[kind]
    count = {"new_tsukuba": 4, "sevenscenes": 5}[kind] - gap
    assert [pair.name[-5:] for pair in pairs] == [f"{k:05d}" for k in range(count)]
    expected = np.linalg.matrix_power(MOTION, gap)
    for k, pair in enumerate(pairs):
        assert f"{k + gap:05d}" in pair.frame1.name
        loaded = pair.load()
        np.testing.assert_array_equal(loaded.frame0, COLOUR[k % 2])
        np.testing.assert_allclose(loaded.pose, expected, atol=1e-6)
        assert pose_errors(loaded.pose, expected).direction < 1e-3
    with pytest.raises(FileNotFoundError):
        find_pairs(data, step=5)


def test_the_step_is_of_sequences_alone(data):
    make_middlebury(data)
    assert find_pairs(data, step=7) == find_pairs(data)
    for step in (0, -1, 1.0, True):
        with pytest.raises(ValueError, match=f"step is {step}: expected a positive whole number"):
            find_pairs(data, step=step)


def test_frames_that_are_missing_leave_out_their_pairs(data):
    make_new_tsukuba(data)
    (data / "rgb_00001.png").unlink()
    assert [pair.name for pair in find_pairs(data)] == ["rgb_00002"]
    make_sevenscenes(data / "other", numbers=(0, 1, 4))
    assert [pair.name for pair in find_pairs(data / "other")] == ["frame-000001"]


def test_cameras_of_sequences(data):
    make_new_tsukuba(data)
    make_sevenscenes(data)
    scale = W / 640
    for pair in find_pairs(data):
        camera, whole = pair.load().camera, KNOWN_CAMERAS[pair.layout]
        assert camera.focal == pytest.approx(whole.focal * scale)
        assert camera.center == pytest.approx(((320.5) * scale - 0.5, 240.5 * scale - 0.5))
        assert scale_known_camera(whole, 640) == whole


def test_sevenscenes_as_they_are_distributed(data):
    make_sevenscenes(data / "chess" / "seq-01")
    make_sevenscenes(data / "chess" / "photos", suffix="jpg")
    pairs = find_pairs(data)
    assert [pair.dataset for pair in pairs] == ["photos"] * 2 + ["chess seq-01"] * 2
    for pair in pairs:
        pair.load()
        pair.frame0.write_bytes(pair.frame0.read_bytes()[:-9])
        with pytest.raises(FormatError, match=pair.frame0.name):
            pair.load()


def test_depth_is_that_of_the_colour_camera(data):
    """Rendered for the depth camera beside it, it is what the colour camera sees."""
    height, width = 120, 160
    views = []
    for camera, shift in (
        (KNOWN_CAMERAS["sevenscenes"], 0.0),
        (DEPTH_CAMERA, COLOUR_CAMERA_OFFSET),
    ):
        wall = Plane(texture=Texture(wavelength=0.1), point=(shift, 0, 2.5), normal=(0.3, 0.2, -1))
        box = Box(
            texture=Texture(wavelength=0.1), center=(0.2 + shift, 0, 1.0), size=(0.3, 0.25, 0.2)
        )
        scene = Scene(
            objects=[wall, box],
            camera=scale_known_camera(camera, width),
            height=height,
            width=width,
        )
        views.append(scene.render(samples=1).depth)
    expected, raw = views
    make_sevenscenes(data, numbers=(0, 3))
    for k in (0, 3):
        put(data / f"frame-{k:06d}.color.png", np.zeros((height, width), np.uint8))
    write_png(data / "frame-000000.depth.png", np.rint(1000 * raw).astype(np.uint16))
    (pair,) = find_pairs(data)
    depth = pair.load().depth
    known = np.isfinite(depth)
    # The colour camera sees more at the edges, and behind the box to its left.
    assert 0.75 < known.mean() < 0.85
    error = np.abs(depth - expected)[known]
    assert np.median(error) < 0.005 and (error < 0.03).mean() > 0.99
    as_it_is = np.abs(raw - expected)
    assert np.median(as_it_is) > 0.015 and (as_it_is < 0.03).mean() < 0.7


def test_depth_that_is_missing(data):
    make_sevenscenes(data)
    loaded = find_pairs(data)[0].load()
    assert np.unique(loaded.depth[np.isfinite(loaded.depth)]).tolist() == [1.25]
    for value in (0, 65535):
        write_png(data / "frame-000000.depth.png", np.full((H, W), value, np.uint16))
        with pytest.raises(FormatError, match=rf"000000\.depth\.png has no known depth .* {H * W}"):
            find_pairs(data)[0].load()
    write_png(data / "frame-000000.depth.png", np.zeros((H, W), np.uint8))
    with pytest.raises(FormatError, match=r"depth\.png holds .* uint8, expected a depth map"):
        find_pairs(data)[0].load()
