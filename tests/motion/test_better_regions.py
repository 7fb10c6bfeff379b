"""The choice between two depths of a pair, region by region."""

import cv2
import numpy as np
import pytest

from tisfm.camera import Camera
from tisfm.motion.better_regions import better_regions
from tisfm.solver.image_pyramid import ImagePyramid

HEIGHT, WIDTH = 120, 200
NEAR, FAR = 24.0, 8.0  # px: displacements to the left
MOTION = np.column_stack([np.eye(3), [-1.0, 0, 0]])


def textured(seed, size=(HEIGHT, WIDTH + 100)):
    noise = np.random.default_rng(seed).uniform(-300, 555, size)
    return cv2.GaussianBlur(noise, (0, 0), 2).clip(0, 255).astype(np.float32)


def frames_of_a_board(board):
    """Return frames of a board, (rows, columns) of frame 0, before a wall, and their D."""
    wall, surface = textured(1), textured(2)
    frame0, frame1 = wall[:, :WIDTH].copy(), wall[:, int(FAR) :][:, :WIDTH].copy()
    depth = np.full((HEIGHT, WIDTH), FAR, np.float32)
    rows, columns = board
    depth[rows, columns] = NEAR
    frame0[rows, columns] = surface[rows, columns]
    left, right = (max(0, column - int(NEAR)) for column in (columns.start, columns.stop))
    frame1[rows, left:right] = surface[rows, left + int(NEAR) : right + int(NEAR)]
    return frame0, frame1, depth


def choose(frame0, frame1, found, candidate, is_matched=None, valid=None):
    valid_pixels = None if valid is None else (valid, np.ones_like(valid))
    pyramid = ImagePyramid(
        frame0, frame1, Camera(focal=100.0), factor=0.5, levels=1, valid=valid_pixels
    )
    if is_matched is None:
        is_matched = np.ones(found.shape, bool)
    return better_regions(
        pyramid, MOTION, found.astype(np.float32), candidate.astype(np.float32), is_matched
    )


BOARD = slice(30, 90), slice(90, 140)
INSIDE = slice(40, 80), slice(100, 130)


@pytest.mark.parametrize("is_matched", [True, False])
def test_each_region_gets_the_depth_that_the_frames_show(is_matched):
    frame0, frame1, truth = frames_of_a_board(BOARD)
    found = np.full_like(truth, FAR)  # has lost the board
    candidate = truth.copy()
    candidate[:, 160:] = NEAR  # and this one is wrong beside it
    is_better = choose(frame0, frame1, found, candidate, np.full(truth.shape, is_matched))
    assert is_better[INSIDE].all()
    assert not is_better[5:115, 165:195].any()


def test_a_bare_wall_keeps_its_depth():
    """Noise correlates a little better along one of two depths, but counts little."""
    rng = np.random.default_rng(4)
    frame0, frame1, truth = frames_of_a_board(BOARD)
    bare = np.s_[:, 150:]
    for frame, left in ((frame0, 150), (frame1, 150 - int(FAR))):
        frame[:, left:] = 100.0
        frame += rng.normal(0, 2, frame.shape).astype(np.float32)
    candidate = truth.copy()
    candidate[bare] = 2.0
    found = np.full_like(truth, FAR)
    is_better = choose(frame0, frame1, found, candidate)
    assert is_better[INSIDE].all()
    assert not is_better[10:110, 185:].any()


HIDDEN = np.s_[40:80, 80:86]


def frames_with_a_hidden_likeness():
    """Return frames, and two depths that are right but for one part of each.

    The board moves 16 px over the wall to its left. The first depth of the hidden wall lies between
    board and wall, and its pixels in frame 1 look like the wall by chance.
    """
    frame0, frame1, truth = frames_of_a_board(BOARD)
    between, wall = truth.copy(), truth.copy()
    between[HIDDEN] = 12.0
    frame1[40:80, 80 - 12 : 86 - 12] = frame0[HIDDEN]
    between[100:115, 30:70] = wall[5:20, 30:70] = 16.0
    return frame0, frame1, between, wall


def test_a_hidden_pixel_gets_the_farther_depth():
    frame0, frame1, between, wall = frames_with_a_hidden_likeness()
    assert choose(frame0, frame1, between, wall)[HIDDEN].all()
    is_better = choose(frame0, frame1, wall, between)
    assert not is_better[HIDDEN].any() and is_better[8:17, 36:64].all()
    behind_camera = wall.copy()
    behind_camera[HIDDEN] = -3.0
    assert not choose(frame0, frame1, between, behind_camera)[HIDDEN].any()


def test_a_pixel_without_a_match_may_be_hidden():
    """The found depth continues the board beside it, where frame 1 looks a little alike."""
    frame0, frame1, wall = frames_of_a_board(BOARD)
    rows, columns = BOARD[0], slice(76, 90)
    continued = wall.copy()
    continued[rows, columns] = NEAR
    seen = frame1[rows, 76 - int(NEAR) : 90 - int(NEAR)]
    seen[:] = 0.7 * seen + 0.3 * frame0[rows, columns]
    is_matched = np.ones(wall.shape, bool)
    is_matched[rows, columns] = False
    strip = np.s_[40:80, 80:88]
    assert choose(frame0, frame1, continued, wall, is_matched)[strip].all()
    # If nothing hides the wall, or an ignored board does, frame 1 refutes the depth of the wall.
    is_better = choose(frame0, frame1, continued, np.full_like(wall, FAR), is_matched)
    assert not is_better[strip].any()
    valid = np.ones(wall.shape, bool)
    valid[rows, BOARD[1]] = False
    assert not choose(frame0, frame1, continued, wall, is_matched, valid)[strip].any()


def test_a_wrong_match_hides_nothing():
    """The frames refuse a board, so that it hides no wall beside it."""
    frame0, frame1, board = frames_of_a_board(BOARD)
    wall = textured(1)
    frame0, frame1 = wall[:, :WIDTH].copy(), wall[:, int(FAR) :][:, :WIDTH].copy()
    rows, columns = BOARD[0], slice(74, 90)
    noise = np.random.default_rng(3).normal(0, 20, (60, 16)).astype(np.float32)
    frame1[rows, 74 - int(FAR) : 90 - int(FAR)] += noise
    board[rows, columns] = 4.0
    is_matched = np.ones(board.shape, bool)
    is_matched[rows, columns] = False
    assert not choose(frame0, frame1, np.full_like(board, FAR), board, is_matched).any()


def test_an_ignored_board_hides_nothing():
    frame0, frame1, between, wall = frames_with_a_hidden_likeness()
    valid = np.ones(wall.shape, bool)
    valid[BOARD] = False
    is_better = choose(frame0, frame1, between, wall, valid=valid)
    assert not is_better[44:76, 82:85].any() and is_better[103:112, 36:64].all()


def test_what_leaves_the_image_is_not_replaced_by_weak_matches():
    frame0, frame1, truth = frames_of_a_board((slice(30, 90), slice(0, 22)))
    part = np.s_[40:80, 2:20]
    candidate = truth.copy()
    candidate[:, :22] = 2.0  # inside the image, where frame 1 looks a little alike
    frame1[30:90, :20] = (frame1[30:90, :20] + frame0[30:90, 2:22]) / 2
    assert not choose(frame0, frame1, truth, candidate)[part].any()
    # The other way round, a depth that leaves the image is better than a weak match.
    assert choose(frame0, frame1, candidate, truth)[part].all()


def test_matched_and_other_pixels_are_apart():
    frame0, frame1, truth = frames_of_a_board(BOARD)
    found = np.full_like(truth, FAR)
    candidate = truth.copy()
    candidate[:, 140:200] = NEAR  # wrong, beside the board, and larger
    is_matched = np.zeros(truth.shape, bool)
    is_matched[BOARD] = True
    is_better = choose(frame0, frame1, found, candidate, is_matched)
    assert is_better[INSIDE].all() and not is_better[5:115, 165:195].any()


def test_nearer_and_farther_pixels_are_apart():
    frame0, frame1, truth = frames_of_a_board(BOARD)
    found = np.full_like(truth, FAR)
    candidate = truth.copy()
    candidate[:, 140:200] = 1.0  # wrong, beside the board, and larger
    is_better = choose(frame0, frame1, found, candidate)
    assert is_better[INSIDE].all() and not is_better[5:115, 165:195].any()


def test_ignored_pixels_do_not_count():
    frame0, frame1, truth = frames_of_a_board(BOARD)
    valid = np.ones(truth.shape, bool)
    valid[BOARD] = False
    found = np.full_like(truth, FAR)
    assert not choose(frame0, frame1, found, truth, valid=valid)[INSIDE].any()


@pytest.mark.parametrize("value", [np.nan, np.inf, -40.0, 500.0])
def test_an_impossible_depth_is_replaced(value):
    frame0, frame1, truth = frames_of_a_board(BOARD)
    found = np.full_like(truth, FAR)
    found[BOARD] = value
    is_better = choose(frame0, frame1, found, truth)
    assert is_better[INSIDE].all()


def test_without_a_better_region_nothing_changes():
    frame0, frame1, truth = frames_of_a_board(BOARD)
    assert not choose(frame0, frame1, truth, truth + 0.25).any()


def test_matched_pixels_of_equal_depth_join_a_better_region():
    frame0, frame1, truth = frames_of_a_board(BOARD)
    found = truth.copy()
    found[BOARD] = FAR
    is_matched = np.zeros(truth.shape, bool)
    is_matched[:60] = True
    is_better = choose(frame0, frame1, found, truth, is_matched)
    assert is_better[5:25, 30:].all() and not is_better[95:115, 30:].any()
