"""Films as other programs read them."""

import io

import numpy as np
import pytest

from tisfm.view.saving import encoded_film

av = pytest.importorskip("av", reason="PyAV is not installed: pip install 'tisfm[video]'")


@pytest.mark.parametrize("size", [(48, 64), (49, 65)])
def test_a_film_has_its_pictures(size):
    pictures = [np.full((*size, 3), 20 * k, np.uint8) for k in range(6)]
    data = encoded_film(pictures, frames_per_second=12)
    with av.open(io.BytesIO(data)) as container:
        stream = container.streams.video[0]
        assert stream.codec_context.name == "h264" and stream.average_rate == 12
        shown = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    assert len(shown) == 6 and shown[0].shape == (48, 64, 3)
    assert [round(float(picture.mean())) for picture in shown] == pytest.approx(
        [20 * k for k in range(6)], abs=4
    )
