"""Scores of models by all matches: half lines, computed from points, and right and wrong paths."""

import numpy as np
import pytest

from tests.reconstruction.test_coverage import (
    CAMERA,
    MOTION,
    OTHER,
    SHAPE,
    model_of,
    points_seen,
    projected,
    view_of,
)
from tisfm.reconstruction.mapping.first_pairs import first_pair_tolerance
from tisfm.reconstruction.mapping.model_scores import MatchScorer, half_line_distances

REST = np.eye(4)[:3]
SIDEWAYS = np.column_stack([np.eye(3), [-0.5, 0, 0]])  # the camera goes to the right
STRAIGHT_ON = np.array([[0.0, 0.0, 1.0]])


def unit(*direction):
    return np.array([direction]) / np.linalg.norm(direction)


@pytest.mark.parametrize("depth", [0.5, 1.0, 10.0, 1e9])
def test_point_at_any_depth_lies_on_its_half_line(depth):
    after = unit(-0.5, 0, depth)
    found = half_line_distances(REST, SIDEWAYS, STRAIGHT_ON, after)
    assert found[0] == pytest.approx(0, abs=1e-12)


@pytest.mark.parametrize(("x", "away"), [(0.01, 0.01), (-0.01, 0.0)])
def test_point_beyond_infinity_is_as_far_as_infinity(x, away):
    """The camera moves right, so points move left; a point at the right is behind the camera."""
    found = half_line_distances(REST, SIDEWAYS, STRAIGHT_ON, unit(x, 0, 1))
    assert found[0] == pytest.approx(away, abs=1e-12)


@pytest.mark.parametrize(("x", "away"), [(0.05, 0.0), (-0.1, 0.1), (0.12, 0.02)])
def test_half_line_ends_at_the_epipole(x, away):
    """The camera moves back, so a point moves towards the centre, and not past it."""
    back = np.column_stack([np.eye(3), [0, 0, 0.5]])
    found = half_line_distances(REST, back, unit(0.1, 0, 1), unit(x, 0, 1))
    assert found[0] == pytest.approx(away, abs=1e-12)


def test_point_beside_the_line_is_as_far_as_the_line():
    found = half_line_distances(REST, SIDEWAYS, STRAIGHT_ON, unit(-0.2, 0.03, 1))
    assert found[0] == pytest.approx(0.03, rel=1e-9)


def test_without_translation_a_point_stays_at_infinity():
    found = half_line_distances(REST, REST, STRAIGHT_ON, unit(0.02, 0, 1))
    assert found[0] == pytest.approx(0.02, rel=1e-9)


def test_point_behind_the_camera_is_infinitely_far():
    turned = np.diag([1.0, -1.0, -1.0]) @ REST  # by half a turn
    found = half_line_distances(REST, turned, STRAIGHT_ON, unit(0.02, 0, 1))
    assert found[0] == np.inf


def test_right_model_scores_each_match_with_one_and_a_wrong_one_less():
    random = np.random.default_rng(0)
    points = points_seen(random, 10, 150, 80)
    views = [view_of(0, projected(points, REST)), view_of(1, projected(points, MOTION))]
    both = np.repeat(np.arange(80)[:, None], 2, axis=1)
    score = MatchScorer(views, {(0, 1): both}, SHAPE)
    assert score.match_count() == score.match_count({1, 2}) == 80
    assert score.match_count({1}) == 0
    assert score.score(model_of(MOTION)) == pytest.approx(80, rel=1e-3)
    assert score.score(model_of(OTHER)) < 40
    turned_back = np.column_stack([MOTION[:, :3], -MOTION[:, 3]])  # all depths are negative
    assert score.score(model_of(turned_back)) < 40


def test_view_with_a_wrong_position_explains_less():
    """The last of five views has a wrong position."""
    random = np.random.default_rng(0)
    points = points_seen(random, 10, 150, 80)
    places = [MOTION + np.column_stack([np.zeros((3, 3)), [0.1 * k, 0, 0]]) for k in range(4)]
    views = [view_of(k, projected(points, pose)) for k, pose in enumerate([REST, *places])]
    both = np.repeat(np.arange(80)[:, None], 2, axis=1)
    score = MatchScorer(views, {(k, m): both for k in range(5) for m in range(k)}, SHAPE)
    assert score.worst_view_share(model_of(*places)) == pytest.approx(1, abs=1e-3)
    assert score.worst_view_share(model_of(*places[:3], OTHER)) < 0.6


def test_half_the_tolerance_halves_the_score():
    """Frames are 160 px wide, so a match with an error of 0.5 px has the score 0.5."""
    points = np.array([[80.0, 60.0], [100.0, 60.0]])
    moved = points + np.array([-3.0, first_pair_tolerance(160) / 2])
    both = np.repeat(np.arange(2)[:, None], 2, axis=1)
    score = MatchScorer([view_of(0, points), view_of(1, moved)], {(0, 1): both}, SHAPE)
    assert CAMERA.center_for(*SHAPE)[1] == pytest.approx(59.5)
    assert score.score(model_of(SIDEWAYS)) == pytest.approx(1.0, rel=1e-2)


def test_tolerance_of_first_pairs_grows_with_large_frames():
    assert first_pair_tolerance(640) == first_pair_tolerance(1000) == 1.0
    assert first_pair_tolerance(3000) == 3.0
