"""Labels of moving things against their true masks."""

from itertools import permutations, product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tisfm.metrics import label_scores

SHAPE = 6, 10


def bars(*parts):
    """A row of pixels for each frame: lists of (value, first, end)."""
    frames = np.zeros((len(parts), 1, 10), np.uint8)
    for frame, bar in zip(frames, parts, strict=True):
        for value, first, end in bar:
            frame[0, first:end] = value
    return frames


def iou(one, other):
    return (one & other).sum() / (one | other).sum()


def test_true_labels_are_right_with_any_values():
    truth = bars([(255, 0, 3), (7, 5, 9)], [(255, 1, 4), (7, 5, 9)])
    labels = np.select([truth == 255, truth == 7], [2, 9])
    scores = label_scores(labels, truth)
    assert [(s.object_id, s.label, s.iou, s.frames) for s in scores.objects] == [
        (7, 9, 1.0, 2),
        (255, 2, 1.0, 2),
    ]
    assert scores.iou == 1 and scores.switches == 0 and scores.frames == 2


def test_one_label_stands_for_an_object_throughout():
    truth = bars(*[[(1, 0, 4)]] * 4)
    labels = bars([(3, 0, 4)], [(3, 0, 4)], [(5, 0, 4)], [(3, 0, 2), (5, 2, 4)])
    (thing,) = label_scores(labels, truth).objects
    assert thing.label == 3
    assert thing.iou == pytest.approx((1 + 1 + 0 + 0.5) / 4)
    assert thing.followed == 4 and thing.switches == 2  # 3, 3, 5, and 3: the first of equals


def test_frames_with_the_object_or_its_label_count():
    truth = bars([(1, 0, 4)], [], [], [(1, 0, 4)])
    labels = bars([(2, 0, 4)], [], [(2, 5, 6)], [])
    (thing,) = label_scores(labels, truth).objects
    assert (thing.frames, thing.present, thing.followed) == (3, 2, 1)
    assert thing.iou == pytest.approx(1 / 3)


def test_objects_share_no_label_and_the_sum_is_the_greatest():
    # Label 1 covers both; the second thing has no other, the first has 2 in part.
    truth = bars([(1, 0, 4), (2, 4, 8)])
    labels = bars([(1, 1, 8), (2, 0, 1)])
    first, second = label_scores(labels, truth).objects
    assert (first.label, second.label) == (2, 1)
    assert first.iou == pytest.approx(1 / 4) and second.iou == pytest.approx(4 / 7)


def test_an_object_without_a_label():
    truth = bars([(1, 0, 4), (2, 6, 8)], [(1, 0, 4)])
    labels = bars([(1, 0, 4)], [(1, 0, 4)])
    first, second = label_scores(labels, truth).objects
    assert first.iou == 1
    assert (second.label, second.iou, second.frames, second.followed) == (None, 0.0, 1, 0)
    nothing = label_scores(np.zeros_like(labels), truth)
    assert nothing.iou == 0 and [s.label for s in nothing.objects] == [None, None]


def test_hidden_and_lost_frames_are_passed_over_by_switches():
    truth = bars([(1, 0, 4)], [(1, 0, 4)], [], [(1, 0, 4)], [(1, 0, 4)])
    same = bars([(2, 0, 4)], [], [(3, 0, 4)], [(2, 0, 4)], [(2, 0, 4)])
    other = bars([(2, 0, 4)], [], [], [(3, 0, 4)], [(3, 0, 4)])
    assert label_scores(same, truth).switches == 0
    assert label_scores(other, truth).switches == 1


def test_the_least_overlap_decides_about_a_match():
    truth = bars([(1, 0, 4)], [(1, 0, 4)])
    labels = bars([(2, 0, 4)], [(2, 3, 4), (3, 1, 3)])  # of 1/4 and 1/2 of it
    counts = [
        (s.followed, s.switches)
        for least in (0.2, 0.5, 0.6)
        for s in label_scores(labels, truth, least=least).objects
    ]
    assert counts == [(2, 1), (2, 1), (1, 0)]


@settings(max_examples=30)
@given(seed=st.integers(0, 10**6), things=st.integers(1, 3), found=st.integers(0, 4))
def test_the_mean_is_that_of_frames_one_by_one(seed, things, found):
    rng = np.random.default_rng(seed)
    truth = rng.integers(0, things + 1, (5, *SHAPE)) * rng.integers(0, 2, (5, 1, 1))
    truth[0, 0, :things] = np.arange(things) + 1
    labels = rng.integers(0, found + 1, (5, *SHAPE))
    scores = label_scores(labels, truth)
    of = {s.object_id: s.label for s in scores.objects}
    given_away = [label for label in of.values() if label is not None]
    assert len(given_away) == len(set(given_away))
    means = {}
    for thing, label in product(range(1, things + 1), range(1, found + 1)):
        mine, true = labels == label, truth == thing
        counted = [k for k in range(5) if mine[k].any() or true[k].any()]
        means[thing, label] = np.mean([iou(mine[k], true[k]) for k in counted] or [0])
        if of[thing] == label:
            assert scores.objects[thing - 1].frames == len(counted)
    # The best of all choices of labels, some of which stand for none.
    choices = permutations([*range(1, found + 1), *[None] * things], things)
    best = max(sum(means.get(pair, 0) for pair in enumerate(choice, 1)) for choice in set(choices))
    assert scores.iou * things == pytest.approx(best)
    assert scores.iou * things == pytest.approx(sum(means.get(pair, 0) for pair in of.items()))


def test_booleans_generators_and_inputs_stay():
    truth = np.zeros((2, *SHAPE), bool)
    truth[:, 1:4] = True
    labels = 3 * truth.astype(np.int32)
    before = labels.copy(), truth.copy()
    (thing,) = label_scores((label for label in labels), iter(truth)).objects
    assert (thing.object_id, thing.label, thing.iou) == (1, 3, 1.0)
    np.testing.assert_array_equal(labels, before[0])
    np.testing.assert_array_equal(truth, before[1])


@pytest.mark.parametrize(
    ("labels", "truth", "error", "words"),
    [
        (np.ones((1, 4, 5), int), np.ones((1, 4, 6), int), ValueError, r"\(4, 5\) and truth\[0\]"),
        (np.ones((1, 4, 5), int), np.ones((2, 4, 5), int), ValueError, "labels has 1 frames"),
        (np.ones((2, 4, 5), int), np.ones((1, 4, 5), int), ValueError, "truth has 1 frames"),
        (np.ones((1, 4, 5)), np.ones((1, 4, 5), int), TypeError, r"labels\[0\] is of type float64"),
        (np.ones((1, 4, 5), int), -np.ones((1, 4, 5), int), ValueError, "from -1 to -1"),
        (300 * np.ones((1, 4, 5), int), np.ones((1, 4, 5), int), ValueError, "expected 0 to 255"),
        (np.ones((1, 4), int), np.ones((1, 4), int), ValueError, r"labels\[0\] is \(4,\)"),
        (np.ones((1, 4, 5), int), np.zeros((1, 4, 5), int), ValueError, "truth has no object"),
        ([], [], ValueError, "truth has no object in any of 0 frames"),
        (
            [np.ma.masked_equal([[1, 2]], 2)],
            [np.ones((1, 2), int)],
            ValueError,
            "1 of 2 values masked",
        ),
    ],
)
def test_errors_name_the_argument(labels, truth, error, words):
    with pytest.raises(error, match=words):
        label_scores(labels, truth)


@pytest.mark.parametrize("least", [0, -1, 1.1, float("nan")])
def test_least_is_a_share(least):
    with pytest.raises(ValueError, match="least is"):
        label_scores(np.ones((1, 2, 2), int), np.ones((1, 2, 2), int), least=least)
