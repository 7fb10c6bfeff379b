"""The benchmark of stereo pairs with large displacements."""

import cv2
import numpy as np
import pytest

from bench import far_apart
from bench.far_apart import StereoPair, boards, find_pairs, measure


def test_boards_are_seen_from_both_sides():
    pair = boards(96, 160, seed=1)
    rows, columns = np.nonzero(pair.is_seen())
    shifted = cv2.remap(
        pair.right,
        (np.arange(160) - pair.disparity).astype(np.float32),
        np.repeat(np.arange(96, dtype=np.float32)[:, None], 160, axis=1),
        cv2.INTER_LINEAR,
    )
    difference = np.abs(shifted[rows, columns].astype(float) - pair.left[rows, columns])
    assert np.median(difference) < 4  # noise of both frames
    assert pair.disparity.min() > 0 and pair.disparity.max() < 80
    hidden = np.abs(shifted.astype(float) - pair.left)[~pair.is_seen()]
    assert np.median(hidden) > 15


def test_a_thing_hides_what_it_moves_over():
    disparity = np.full((10, 40), 2.0)
    disparity[:, 20:25] = 8.0
    frame = np.zeros((10, 40), np.uint8)
    seen = StereoPair(name="", left=frame, right=frame, disparity=disparity).is_seen()
    expected = np.ones(40, bool)
    expected[:2] = False  # outside the right frame
    expected[14:19] = False  # at 12 to 16 there, as the thing
    assert (seen[0] != expected).sum() <= 2  # beside an outline
    assert not seen[:, 15:18].any()


def test_errors_count_pixels_that_are_off_or_missing():
    disparity = np.full((4, 10), 1.0)
    frame = np.zeros((4, 10), np.uint8)
    pair = StereoPair(name="", left=frame, right=frame, disparity=disparity)
    found = disparity.copy()
    found[0] += 3.5
    found[1] = np.nan
    found[2] += 2.5
    errors = measure(lambda _: found, pair)
    assert errors.overall == pytest.approx(50)
    assert errors.seen == pytest.approx(50)
    assert errors.hidden == pytest.approx(50)


def test_the_matcher_of_opencv_finds_boards():
    assert measure(far_apart.block_matcher, boards(120, 200, seed=2)).seen < 30


@pytest.mark.parametrize(
    ("size", "seed", "most"),
    [
        ((270, 480), 20, 30),  # 57 % if frame 1 could refute a depth that it does not show
        ((360, 640), 30, 30),  # 35 % without a search, as few matches contradict the first depth
    ],
)
def test_hidden_pixels_of_boards_get_the_wall_behind(size, seed, most):
    method = far_apart.own_method("fast", pose_given=True)
    assert measure(method, boards(*size, seed=seed)).hidden < most


def test_pairs_of_a_folder(tmp_path):
    folder = tmp_path / "things" / "chair"
    folder.mkdir(parents=True)
    for side in ("left", "right"):
        cv2.imwrite(str(folder / f"{side}.png"), np.full((20, 30, 3), 99, np.uint8))
    cv2.imwrite(str(folder / "disparity.png"), np.full((20, 30), 160, np.uint16))
    pairs = list(find_pairs(tmp_path, (40, 60)))
    assert [pair.name for pair in pairs] == ["chair", *(f"boards {n}" for n in range(4))]
    assert (pairs[0].disparity == 2.5).all() and pairs[1].left.shape == (40, 60)


@pytest.mark.nightly
def test_report(tmp_path, monkeypatch):
    monkeypatch.setattr(far_apart, "RESULTS", tmp_path)
    assert far_apart.main(["--smoke", "--preset", "fast"]) == 0
    text = (tmp_path / "smoke-far_apart.md").read_text(encoding="utf-8")
    assert "## boards: means of 4 pairs" in text and "| `fast`, pose given |" in text
