"""Real datasets, where there are any."""

from pathlib import Path

import cv2
import numpy as np

from tests.datasets.made import label
from tisfm.datasets import find_pairs
from tisfm.formats import read_image


def test_real_datasets(shared_data):
    pairs = {label(pair): pair for pair in find_pairs(shared_data)}
    sizes = {
        "middlebury/RubberWhale": (388, 584),
        "sintel_alley/frame_0002": (436, 1024),
        "yosemite_clouds/yos9": (252, 316),
        "yosemite_cloudless/yoscloudless_009": (252, 316),
        "stereo/cones": (375, 450),
        "stereo/motorcycle": (500, 741),
        "kitti/kitti": (376, 1241),
        "new_tsukuba/rgb_00073": (480, 640),
        "sevenscenes/frame-000056": (480, 640),
    }
    for name, size in sizes.items():
        assert pairs[name].load().frame0.shape[:2] == size
    cloudless = pairs["yosemite_cloudless/yoscloudless_009"].load()
    np.testing.assert_array_equal(np.isnan(cloudless.flow[..., 0]), cloudless.sky)


def test_real_motion_takes_one_frame_to_the_other(shared_data):
    """Warped by the truth, frame 1 resembles frame 0: no sign or order is mistaken anywhere."""
    for pair in find_pairs(shared_data):
        if pair.dataset not in ("middlebury", "sintel_alley", "stereo", "yosemite_cloudless"):
            continue
        loaded = pair.load()
        y, x = np.mgrid[: loaded.flow.shape[0], : loaded.flow.shape[1]].astype(np.float32)
        flow = np.nan_to_num(loaded.flow)
        frame0, frame1 = (f.astype(np.float32) for f in (loaded.frame0, loaded.frame1))
        warped = cv2.remap(frame1, x + flow[..., 0], y + flow[..., 1], cv2.INTER_LINEAR)
        known = ~np.isnan(loaded.flow).any(axis=2)
        after = np.median(np.abs(warped - frame0)[known])
        assert after < 0.6 * np.median(np.abs(frame1 - frame0)[known]), label(pair)


def test_real_frames_are_as_they_are_read(shared_data):
    folder = Path(shared_data) / "middlebury" / "Venus"
    (pair,) = find_pairs(folder)
    np.testing.assert_array_equal(pair.load().frame1, read_image(folder / "frame11.png"))
