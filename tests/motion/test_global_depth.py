"""Depth of frames far apart: census costs, filling, and boards smaller than their motion."""

import cv2
import numpy as np
import pytest

import tisfm
from bench import reference
from tests.motion.test_plane_sweep_start import SIZES, TWIST, in_vectors
from tests.pairwise import pairwise
from tisfm.rigid import rigid_motion

HEIGHT, WIDTH = 180, 320
FOCAL = 300.0
BACKGROUND, BOARD = 5.0, 80.0  # px: displacements
ROWS, COLUMNS = slice(50, 130), slice(150, 210)  # of the board in frame 0


@pairwise(size=SIZES, lanes=[16, 8, 1], short=True)
def test_census_cost(size, lanes):
    from tisfm.kernels.rigid.census import census_cost

    codes = np.random.default_rng(1).integers(0, 2**24, (2, *size, 2), dtype=np.int32)
    camera = tisfm.Camera(focal=40.0, center=(0.4 * size[1], 0.6 * size[0]))
    rotation, translation = rigid_motion(TWIST)
    out, plain = in_vectors(np.zeros((*size, 16)), lanes, 0)
    motion = np.column_stack([rotation, translation]).astype(np.float32)
    options = {"center": camera.center, "focal": camera.focal, "first": 0.5, "step": 1.5}
    census_cost(*codes, motion, out, **options)
    hypotheses = 0.5 + 1.5 * np.arange(16)
    expected = reference.census_cost(*codes, hypotheses, camera, rotation, translation)
    # Half-way between pixels, rounding decides which one is read.
    assert (np.abs(plain - expected) > 1e-6).mean() <= 0.01


def test_census_cost_refuses_bad_arrays():
    from tisfm.kernels.layout.lanes import aligned_zeros
    from tisfm.kernels.rigid.census import census_cost

    codes, motion = np.zeros((4, 5, 2), np.int32), np.zeros((3, 4), np.float32)
    out, options = (
        aligned_zeros((4, 5, 1, 8)),
        {"center": (2, 2), "focal": 5, "first": 0, "step": 1},
    )
    with pytest.raises(ValueError, match="census1"):
        census_cost(codes, codes[:3], motion, out, **options)
    with pytest.raises(TypeError, match="census0"):
        census_cost(codes.astype(np.float32), codes, motion, out, **options)


def flying_board(motion):
    """Return a textured board before a textured wall, with true displacements, (H, W)."""
    rng = np.random.default_rng(3)
    wall, board = (
        cv2.GaussianBlur(rng.uniform(-500, 755, size), (0, 0), 2).clip(0, 255).astype(np.uint8)
        for size in ((HEIGHT, WIDTH + 200), (80, 60))
    )
    frames = []
    for shift in (0, 1):
        frame = wall[:, 100 + int(shift * BACKGROUND) :][:, :WIDTH].copy()
        left = COLUMNS.start - int(shift * motion)
        frame[ROWS, left : left + 60] = board
        frames.append(frame)
    truth = np.full((HEIGHT, WIDTH), BACKGROUND)
    truth[ROWS, COLUMNS] = motion
    return frames, truth


def interpret_with_pose(frames, preset):
    pose = np.eye(4)
    pose[0, 3] = -1.0
    settings = tisfm.Settings.preset(preset, motion="camera")
    return tisfm.interpret(*frames, camera=tisfm.Camera(focal=FOCAL), settings=settings, pose=pose)


# At half of the resolution, the outline is blurred over 2 px: 12% of the board's pixels.
@pytest.mark.parametrize(("preset", "max_wrong"), [("fast", 0.15), ("balanced", 0.1)])
def test_a_board_smaller_than_its_motion_gets_its_depth(preset, max_wrong):
    frames, truth = flying_board(BOARD)
    result = interpret_with_pose(frames, preset)
    wrong = np.abs(result.inverse_depth * FOCAL - truth) > 3
    assert wrong[ROWS, COLUMNS].mean() < max_wrong
    assert wrong.mean() < 0.05  # the wall beside the board, hidden in frame 1, included
    # What the board hides in frame 1 is beyond the wall's data: its depth is less certain.
    hidden = np.s_[75:105, 80:115]
    deviation = result.inverse_depth_std
    assert np.median(deviation[hidden]) > np.median(deviation[75:105, 230:300])


def test_a_small_board_is_found_beside_depth_that_is_right():
    """One percent of the frame hardly changes a figure of the whole frame."""
    frames, truth = flying_board(BACKGROUND)  # a board at rest on the wall: none to be lost
    small = np.s_[100:130, 240:264]
    patch = cv2.GaussianBlur(np.random.default_rng(7).uniform(-500, 755, (30, 24)), (0, 0), 2).clip(
        0, 255
    )
    frames[0][small] = patch
    frames[1][100:130, 240 - int(BOARD) : 264 - int(BOARD)] = patch
    truth[small] = BOARD
    result = interpret_with_pose(frames, "balanced")
    wrong = np.abs(result.inverse_depth * FOCAL - truth) > 3
    assert wrong[104:126, 244:260].mean() < 0.15
    assert wrong.mean() < 0.03


def test_a_solution_in_another_unit_is_the_same():
    from tisfm.motion.joined_depth import SolutionWithDeviation, rescale
    from tisfm.motion.sparse_start import depth_flow

    rng = np.random.default_rng(8)
    depth = rng.uniform(1, 20, (20, 30)).astype(np.float32)
    motions = np.column_stack([np.eye(3), [-1.0, 0.2, 0.1]])[None]
    solution = SolutionWithDeviation(
        motions=motions,
        inverse_depth=depth,
        precision=rng.uniform(1, 2, (7, 20, 30)).astype(np.float32),
        level=0,
        density=1.0,
        history=[],
        converged=True,
        known_deviation=depth / 10,
    )
    other = rescale(solution, 1.25)
    camera = tisfm.Camera(focal=FOCAL)
    flows = [depth_flow(s.inverse_depth, s.motions[0], camera) for s in (solution, other)]
    np.testing.assert_allclose(flows[1], flows[0], atol=1e-3)
    np.testing.assert_allclose(other.deviation() / other.inverse_depth, 0.1, rtol=1e-5)
    # deviations of a linear problem are as the root of 1 / precision
    np.testing.assert_allclose(
        other.precision[0] * other.inverse_depth**2, solution.precision[0] * depth**2, rtol=1e-5
    )
    np.testing.assert_array_equal(other.precision[3], solution.precision[3])
    assert rescale(solution, 1.0) is solution
