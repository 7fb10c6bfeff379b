"""The demonstration's animation."""

from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image, ImageSequence

from tisfm.cli.demo_animation import FRAMES, animation_frames, write_animation

H, W = 45, 60


def step(near=1.0, far=0.2):
    """Return a frame that is brighter, and nearer, in its middle."""
    result = SimpleNamespace(
        frame=np.full((H, W), 60, np.uint8), inverse_depth=np.full((H, W), far, np.float32)
    )
    result.frame[15:30, 20:40] = 200
    result.inverse_depth[15:30, 20:40] = near
    return result


def middle_of_bright(picture):
    return np.mean(np.nonzero(picture[..., 1] > 130), axis=1)


def test_the_animation_is_an_endless_loop_of_some_seconds(tmp_path):
    write_animation(tmp_path / "a.webp", step(), width=120)
    with Image.open(tmp_path / "a.webp") as image:
        assert image.format == "WEBP" and image.size == (120, 90)
        assert image.n_frames == FRAMES > 20 and image.info["loop"] == 0
        pictures = [np.array(each.convert("RGB")) for each in ImageSequence.Iterator(image)]
        image.seek(1)
        image.load()
        assert 2000 < FRAMES * image.info["duration"] < 5000  # ms
    changes = [
        np.abs(one.astype(int) - other).mean()
        for one, other in zip(pictures, pictures[1:] + pictures[:1], strict=True)
    ]
    assert min(changes) > 0.05 and max(changes) < 20  # grey levels: all move, none jumps


def test_the_same_result_gives_the_same_bytes(tmp_path):
    for name in ("a.webp", "b.webp"):
        write_animation(tmp_path / name, step(), width=60)
    assert (tmp_path / "a.webp").read_bytes() == (tmp_path / "b.webp").read_bytes()


def test_near_points_circle_and_no_pixel_is_empty():
    pictures = animation_frames(step(), width=120)
    assert np.ptp(pictures[0], axis=2).max() == 0  # no colours there
    _, right = middle_of_bright(pictures[0])
    assert right > 62  # at one end of the ellipse, px
    down, above = middle_of_bright(pictures[2])[0], middle_of_bright(pictures[-2])[0]
    assert down > above + 1
    assert min(picture.min() for picture in pictures) > 5


def test_halfway_near_is_bright_in_colours():
    picture = animation_frames(step(), width=120)[FRAMES // 2]
    near, far = picture[45, 55], picture[10, 10]
    assert near.sum() > 2 * far.sum() and np.ptp(far) > 20


@pytest.mark.parametrize("inverse_depth", [0.0, np.nan, -1.0, 0.5])
def test_flat_depth_is_animated(inverse_depth):
    flat = step(near=inverse_depth, far=inverse_depth)
    pictures = animation_frames(flat, width=31)
    assert pictures[0].shape == (23, 31, 3)
    flat.frame = np.dstack([flat.frame] * 3)
    assert np.array_equal(animation_frames(flat, width=31), pictures)
