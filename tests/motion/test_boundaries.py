"""Boundaries between labels, accurate to the pixel."""

import itertools
from dataclasses import replace

import cv2
import numpy as np
import pytest

from tests.draws import nightly_except
from tisfm.motion.objects import boundaries
from tisfm.motion.objects.boundaries import sharpen_labels
from tisfm.motion.objects.label_optimisation import MinSum
from tisfm.motion.objects.settings import OBJECTS

SIZE = (72, 95)
AROUND, WITHIN = (1.5, -0.75), (-2.25, 1.0)  # px/frame


def textured(seed):
    """Return an image that is larger than the frames by 10 px on every side."""
    noise = np.random.default_rng(seed).normal(size=np.add(SIZE, 20)).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 1.2)
    return 120 + 35 * smooth / smooth.std()


def moved(image, flow):
    """Return the image shifted by (u, v), cropped to the frame."""
    shift = np.float32([[1, 0, flow[0] - 10], [0, 1, flow[1] - 10]])
    return cv2.warpAffine(image, shift, SIZE[::-1], flags=cv2.INTER_CUBIC)


def disc():
    y, x = np.mgrid[: SIZE[0] + 20, : SIZE[1] + 20]
    return (np.hypot(x - 55, y - 45) < 22).astype(np.float32)


def scene(*, in_front):
    """Return the true labels and both frames of a disc in front of its surroundings, or behind.

    A disc behind is seen through a hole that moves with the surroundings.
    """
    shape, outer, inner = disc(), textured(1), textured(2)
    frames = []
    for time in (0, 1):
        around, within = (tuple(time * side for side in flow) for flow in (AROUND, WITHIN))
        mask = moved(shape, within if in_front else around)
        frames.append(moved(inner, within) * mask + moved(outer, around) * (1 - mask))
    true = (moved(shape, (0, 0)) > 0.5).astype(np.int32)
    return true, *frames


def flows():
    out = np.empty((2, 2, *SIZE), np.float32)
    out[0], out[1] = np.array(AROUND)[:, None, None], np.array(WITHIN)[:, None, None]
    return out


def overlap(found, true):
    return (found & true).sum() / (found | true).sum()


def anywhere():
    return np.ones((2, *SIZE), bool)


@pytest.mark.parametrize("in_front", [True, False])
@pytest.mark.parametrize("shift", [(2, 0), (-2, 1), (0, -2)])
def test_boundaries_are_right_to_the_pixel(in_front, shift):
    true, *frames = scene(in_front=in_front)
    rough = np.roll(true, shift, axis=(1, 0))
    before = rough.copy()
    found = sharpen_labels(rough, flows(), anywhere(), *frames)
    assert found.dtype == np.int32
    np.testing.assert_array_equal(rough, before)
    # The disc has 1500 px, 140 of them at the boundary; half of these mix both surfaces.
    assert overlap(found == 1, true == 1) > 0.975 > overlap(rough == 1, true == 1) + 0.05


@pytest.mark.parametrize("in_front", [True, False])
def test_hidden_pixels_get_the_label_that_hides_less(in_front, monkeypatch):
    """With a high cost of hidden pixels, the hidden strip gets a label that fits by chance."""
    true, *frames = scene(in_front=in_front)
    found = sharpen_labels(true, flows(), anywhere(), *frames)
    costly = replace(OBJECTS, min_hidden_cost=50.0, max_hidden_cost=50.0)
    monkeypatch.setattr(boundaries, "OBJECTS", costly)
    blind = sharpen_labels(true, flows(), anywhere(), *frames)
    assert (found != true).sum() < (blind != true).sum()


def test_brightness_may_change():
    true, frame0, frame1 = scene(in_front=True)
    rough = np.roll(true, (2, 1), axis=(1, 0))
    found = sharpen_labels(rough, flows(), anywhere(), frame0, 1.1 * frame1 + 8)
    assert overlap(found == 1, true == 1) > 0.97


def test_a_label_stays_within_its_reach():
    true, *frames = scene(in_front=True)
    smaller = cv2.erode(true.astype(np.uint8), np.ones((5, 5), np.uint8)).astype(np.int32)
    reach = anywhere()
    reach[1] = smaller == 1
    found = sharpen_labels(smaller, flows(), reach, *frames)
    assert not found[smaller == 0].any()
    assert overlap(sharpen_labels(smaller, flows(), anywhere(), *frames) == 1, true == 1) > 0.975


def test_one_label_has_no_boundary():
    labels = np.zeros(SIZE, np.int32)
    frame = moved(textured(0), (0, 0))
    assert sharpen_labels(labels, flows()[:1], anywhere()[:1], frame, frame) is labels


# --- Min-sum -----------------------------------------------------------------------------------


def energy_of(found, costs, labels, free, frame, *, length, image_edges):
    """Return the energy of the labels of the free pixels, term by term."""
    labels = labels.copy()
    labels[free] = found
    steps = [np.abs(np.diff(frame, axis=axis)) for axis in (0, 1)]
    usual = sum(step.sum(dtype=float) for step in steps) / sum(step.size for step in steps)
    energy = costs[found, np.arange(len(found))].sum(dtype=float)
    height, width = frame.shape
    for y, x in itertools.product(range(height), range(width)):
        for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
            y1, x1 = y + down, x + right
            if y1 == height or not 0 <= x1 < width or not (free[y, x] or free[y1, x1]):
                continue
            apart = np.hypot(down, right)
            step = abs(float(frame[y1, x1]) - float(frame[y, x])) / apart / usual
            if labels[y, x] != labels[y1, x1]:
                energy += (2 - 2**0.5) * length / apart / (1 + image_edges * step)
    return energy


@pytest.mark.parametrize("seed", nightly_except(0, 1, of=range(4)))
def test_min_sum_finds_the_least_energy(seed):
    """The energy is exact for a chain of pixels, and a local minimum for a block."""
    rng = np.random.default_rng(seed)
    frame = rng.uniform(0, 255, (6, 9)).astype(np.float32)
    labels = rng.integers(0, 3, frame.shape).astype(np.int32)
    model = {"length": 2.0, "image_edges": 1.0}
    chain, block = np.zeros((2, *frame.shape), bool)
    chain[3, 1:8] = True
    block[1:5, 2:8] = True
    for free in (chain, block):
        costs = rng.uniform(0, 2, (3, free.sum())).astype(np.float32)
        found = MinSum(free, frame, **model).assign(costs, labels)
        least = energy_of(found, costs, labels, free, frame, **model)
        if free is chain:
            others = map(np.array, itertools.product(range(3), repeat=int(free.sum())))
        else:
            others = (
                np.where(np.arange(len(found)) == pixel, label, found)
                for pixel, label in itertools.product(range(len(found)), range(3))
            )
        for other in others:
            assert least <= energy_of(other, costs, labels, free, frame, **model) + 1e-4


def test_boundaries_cost_their_length_and_lie_on_edges():
    """With equal costs, the boundary is the shortest one, or follows the image edge."""
    labels = np.zeros((20, 20), np.int32)
    labels[:, 10:] = 1
    free = np.zeros(labels.shape, bool)
    free[:, 5:15] = True
    frame = np.full(labels.shape, 90, np.float32)
    frame[:, 13:] = 120
    costs = np.zeros((2, free.sum()), np.float32)
    found = MinSum(free, frame, length=4.0, image_edges=2.0).assign(costs, labels).reshape(20, 10)
    np.testing.assert_array_equal(found, np.broadcast_to(np.arange(10) >= 8, found.shape))
