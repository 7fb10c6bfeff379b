"""A walk indoors: what pycolmap makes of its model."""

import numpy as np
import pycolmap
import pytest

import tisfm
from tests.exports.exported import retriangulated, tracks_per_image
from tisfm.exports import write_colmap


@pytest.mark.nightly
def test_a_walk_indoors(shared_data, tmp_path):
    settings = tisfm.Settings.preset("fast", motion="camera")
    walk = tisfm.reconstruct(
        shared_data / "tartanair" / "images", camera=tisfm.Camera(320.0), settings=settings
    )
    write_colmap(walk, tmp_path)
    model = pycolmap.Reconstruction(tmp_path / "sparse" / "0")
    assert len(model.images) >= 30
    assert model.num_points3D() >= 5000
    assert min(tracks_per_image(model).values()) > 100
    errors, lost = retriangulated(model)
    assert lost < 100
    assert np.median(errors) < 0.3 and np.percentile(errors, 90) < 1
