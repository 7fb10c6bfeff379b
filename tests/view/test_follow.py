"""The view from where the camera was: all of the frame is in sight, whatever the window."""

import math
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.view.results import HEIGHT, WIDTH
from tisfm.view.viewpoint import following_fov

pytest.importorskip("viser", reason="viser is not installed: pip install 'tisfm[view]'")


@given(aspect=st.floats(0.2, 5), focal=st.floats(10, 1000))
def test_the_whole_frame_fills_the_window(aspect, focal):
    frame = SimpleNamespace(shape=(HEIGHT, WIDTH), camera=SimpleNamespace(focal=focal))
    up = math.tan(following_fov(frame, aspect) / 2)
    own_up, own_side = HEIGHT / (2 * focal), WIDTH / (2 * focal)
    assert up >= own_up * (1 - 1e-9) and up * aspect >= own_side * (1 - 1e-9)
    assert min(up / own_up, up * aspect / own_side) == pytest.approx(1)
