"""Depth of keyframes beside outlines."""

import cv2
import numpy as np
import pytest

from tests.reconstruction.views import views
from tisfm.camera import Camera
from tisfm.metrics import outlines
from tisfm.reconstruction.depth.outline_search import _sharpen, search_outlines


@pytest.fixture(scope="module")
def scene():
    return views("sideways", 480, 640, 4)


def fattened(depth, pixels=9):
    """Return inverse depth whose nearer surfaces reach too far, as windows make them."""
    return cv2.dilate((1 / depth).astype(np.float32), np.ones((pixels, pixels), np.uint8))


def wrong_share(inverse_depth, depth):
    """Return the share of the pixels at outlines that are more than 10 % wrong."""
    error = np.abs(inverse_depth * depth - 1)[outlines(depth)]
    return float((error > 0.1).mean())


def search(scene, inverse_depth, **options):
    return search_outlines(*scene.first(4), inverse_depth, cell_side=2, **options)


def test_fattened_outlines_become_sharp(scene):
    start = fattened(scene.depth)
    found = search(scene, start)
    assert found.dtype == np.float32
    assert wrong_share(found, scene.depth) < 0.6 * wrong_share(start, scene.depth)
    assert np.abs(found * scene.depth - 1).mean() < np.abs(start * scene.depth - 1).mean()


def test_unit_of_length_does_not_matter(scene):
    key, others, motions, camera = scene.first(4)
    motions = motions * [1, 1, 1, 1000]
    found = search_outlines(key, others, motions, camera, fattened(scene.depth) / 1000, cell_side=2)
    same = search(scene, fattened(scene.depth))
    assert (
        np.abs(1000 * found - same) > 1e-3 * same
    ).mean() < 0.01  # rounding decides between equals


def test_depth_without_jumps_stays(scene):
    smooth = np.full(scene.depth.shape, 0.2, np.float32)
    smooth += np.linspace(0, 0.1, smooth.shape[1], dtype=np.float32)
    np.testing.assert_array_equal(search(scene, smooth), smooth)


def test_depth_away_from_jumps_stays(scene):
    start = fattened(scene.depth)
    window = np.ones((23, 23), np.uint8)
    low, high = cv2.erode(start, window), cv2.dilate(start, window)
    is_far = high - low < 0.1 * start
    assert 0.2 < is_far.mean() < 0.98
    np.testing.assert_allclose(search(scene, start)[is_far], start[is_far], rtol=1e-6)


def test_masked_pixels_stay_and_are_not_compared(scene):
    start = fattened(scene.depth)
    used = np.zeros(scene.depth.shape, bool)
    used[:, :320] = True
    found = search(scene, start, key_mask=used)
    np.testing.assert_array_equal(found[~used], start[~used])
    assert (found[used] != start[used]).any()
    # Where no frame is compared, nothing speaks for another depth.
    blind = search(scene, start, masks=[np.zeros(scene.depth.shape, bool)] * 4)
    assert (np.abs(blind - start) > 0.02 * start).mean() < 0.01


@pytest.mark.parametrize(
    ("near", "far", "width"),
    [(200, 5, 90), (40, 10, 6), (40, 10, 40)],
    ids=["large parallax", "thin pole", "board"],
)
def test_right_depth_stays(near, far, width):
    """Rows of texture move by `far` px, and a board before them by `near` px."""
    random = np.random.default_rng(0)
    height, length = 120, 640
    wall, board = (
        cv2.GaussianBlur(random.uniform(-500, 755, (height, length + 600)), (0, 0), 1.5)
        for _ in range(2)
    )
    is_board = np.zeros((height, length), bool)
    is_board[20:100, 300 : 300 + width] = True

    def frame(sign):
        moved = np.roll(is_board, -sign * near, axis=1)
        parts = (
            image[:, 300 + sign * step :][:, :length]
            for image, step in ((board, near), (wall, far))
        )
        return np.where(moved, *parts).clip(0, 255).astype(np.float32)

    motions = np.array([np.column_stack([np.eye(3), (-sign, 0, 0)]) for sign in (1, -1)])
    depth = np.where(is_board, near, far).astype(np.float32) / 100
    found = search_outlines(
        frame(0), [frame(1), frame(-1)], motions, Camera(focal=100.0), depth, cell_side=2
    )
    is_wrong = np.abs(found / depth - 1) > 0.1
    assert is_wrong[is_board].mean() < 0.05
    assert is_wrong[~is_board].mean() < 0.02


def test_large_frames_are_halved(scene, monkeypatch):
    from dataclasses import replace

    from tisfm.reconstruction.depth import outline_search

    small = replace(outline_search.OUTLINES, max_pixels=240 * 320)
    monkeypatch.setattr(outline_search, "OUTLINES", small)
    key, others, motions, camera = scene.first(4)
    cut = slice(0, 479), slice(0, 637)  # odd sizes
    start = fattened(scene.depth)[cut]
    center = camera.center_for(480, 640)
    camera = replace(camera, center=center)
    found = search_outlines(
        key[cut], [other[cut] for other in others], motions, camera, start, cell_side=2
    )
    assert found.shape == start.shape
    depth = scene.depth[cut]
    assert wrong_share(found, depth) < 0.8 * wrong_share(start, depth)
    used = np.zeros(start.shape, bool)
    used[:, :317] = True  # the border of the mask lies within halved pixels
    masked = search_outlines(
        key[cut],
        [other[cut] for other in others],
        motions,
        camera,
        start,
        cell_side=2,
        key_mask=used,
    )
    np.testing.assert_array_equal(masked[~used], start[~used])


def image_with_an_edge(offset):
    """Return grey levels with an edge at column 40, and inverse depth with a jump beside it."""
    columns = np.arange(80)
    key = np.where(columns < 40, 50, 150) * np.ones((60, 1), np.float32)
    depth = np.where(columns < 40 + offset, 3, 1) * np.ones((60, 1), np.float32)
    return key.astype(np.float32), depth.astype(np.float32)


def sharpen(depth, key, is_used=None):
    everywhere = np.ones(depth.shape, bool)
    return _sharpen(depth, key, everywhere, everywhere if is_used is None else is_used)


def test_median_moves_outlines_to_edges_of_the_image():
    key, depth = image_with_an_edge(1)
    sharp, is_changed = sharpen(depth, key)
    np.testing.assert_array_equal(sharp, image_with_an_edge(0)[1])
    np.testing.assert_array_equal(is_changed, sharp != depth)


def test_median_keeps_slopes_and_thin_things():
    key, _ = image_with_an_edge(0)
    slope = np.linspace(1, 4, 80, dtype=np.float32) * np.ones((60, 1), np.float32)
    assert not sharpen(slope, key)[1].any()
    random = np.random.default_rng(0)
    noise = random.uniform(0, 255, key.shape).astype(np.float32)
    pole = np.where(np.abs(np.arange(80) - 40) < 3, 3, 1) * np.ones((60, 1), np.float32)
    assert sharpen(pole.astype(np.float32), noise)[1].mean() < 0.01


def test_median_ignores_masked_pixels():
    key, depth = image_with_an_edge(1)
    is_used = np.ones(key.shape, bool)
    is_used[30:] = False
    results = []
    for masked_depth in (1, 7):
        filled = np.where(is_used, depth, masked_depth).astype(np.float32)
        results.append(sharpen(filled, key, is_used)[0][is_used])
    np.testing.assert_array_equal(*results)
    assert (results[0] != depth[is_used]).any()


def test_band_grows_with_the_cells_up_to_a_limit(scene):
    start = fattened(scene.depth, 21)  # 10 px too far
    changed = {
        side: search_outlines(*scene.first(4), start, cell_side=side) != start
        for side in (1, 3, 4, 8)
    }
    assert 1.2 * changed[1].sum() < changed[3].sum()
    np.testing.assert_array_equal(changed[4], changed[8])  # 16 px, the limit, in place of 40 px
