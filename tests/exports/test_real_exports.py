"""A real sequence, in the files of others."""

import cv2
import numpy as np
import pytest

import tisfm
from tests.exports.test_depths import read
from tisfm.exports import SequenceFrames, write_depths, write_points, write_tum_paths, write_video
from tisfm.trajectory import read_tum


@pytest.mark.nightly
def test_a_garden(shared_data, tmp_path):
    pytest.importorskip("av")
    source = shared_data / "flowergarden"
    if not source.is_dir():
        pytest.skip(f"{source} is not there")
    settings = tisfm.Settings.preset("fast", motion="camera")
    camera = tisfm.Camera(160.0)
    result = tisfm.reconstruct(source, camera=camera, settings=settings, folder=tmp_path / "walk")
    frames = SequenceFrames(result)
    placed = np.flatnonzero(result.piece == result.largest_piece)
    assert len(placed) > 25
    found = read_tum(write_tum_paths(result, tmp_path)[0])
    np.testing.assert_array_equal(found.times, placed)
    for kind in ("tum", "kitti", "tiff"):  # the sky is beyond what 16 bits hold
        (tmp_path / kind).mkdir()
        files = write_depths(frames, tmp_path / kind, kind)
        depth, rounding = read(files[10], kind)
        true = result.depth(int(files[10].stem[-3:]) - 30)
        known = np.isfinite(depth)
        assert known.mean() > 0.6
        np.testing.assert_allclose(depth[known], true[known], rtol=1e-6, atol=rounding)
    assert write_points(result, tmp_path, suffix="glb")[0].stat().st_size > 10_000
    for kind in ("depth", "anaglyph", "wiggle"):
        write_video(frames, tmp_path / f"{kind}.mp4", kind)
        capture = cv2.VideoCapture(str(tmp_path / f"{kind}.mp4"))
        assert int(capture.get(cv2.CAP_PROP_FRAME_COUNT)) == len(files)
        assert capture.get(cv2.CAP_PROP_FRAME_WIDTH) == 176  # of 175
