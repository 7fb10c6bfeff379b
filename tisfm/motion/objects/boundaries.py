"""Boundaries between labels, to the pixel: which surface the images show on either side."""

from collections.abc import Iterator
from itertools import permutations

import cv2
import numpy as np

from tisfm.motion.objects.label_optimisation import MinSum
from tisfm.motion.window_statistics import window_variance
from tisfm.solver.sampling import sample, spline_taps
from tisfm.visibility.occlusion import leaves_image

REACH = 4  # px: how far a boundary may move
ROUNDS = 2  # of labels, and of what they hide
# Deviation of the grey level of a pixel that is seen, added in squares: grey levels, median
# residuals, and px that its flow may be off by.
LEAST_NOISE, NOISE, SLIP = 3.0, 1.5, 0.4
# In nats, against 0 for a grey level that is met:
MISSED = 3.2  # one that is another's,
LEAST_HIDDEN, HIDDEN = 0.6, 1.7  # of a pixel that is hidden in frame 1, by how varied it is around,
MOST = 50.0  # of anything, so that its logarithm is finite,
NEVER = 1e3  # of a label that may not be here,
LENGTH, IMAGE_EDGES = 4.0, 0.25  # per px of a boundary in uniform frames; and its κ
VARIED = 5  # px, over which frame 0 is alike or varied
ORDER_WINDOW, USUAL_ORDER = 31, 15.0  # px, over which one surface is in front; pixels that order
# in all of the image counts for, beside those in the window
BRIGHTNESS_WINDOW = 31  # px, over which brightness changes alike
MARGINS = 3  # px that images of where pixels go have more than the frames, a side
STRIP = 2**16  # pixels, about, of the frame that are looked at together, for the memory they take

Corner = tuple[np.ndarray, np.ndarray]  # indices of pixels, and their weights


def sharpened(
    labels: np.ndarray,
    flows: np.ndarray,
    reach: np.ndarray,
    frame0: np.ndarray,
    frame1: np.ndarray,
) -> np.ndarray:
    """Return labels with boundaries that are right to the pixel, (H, W) int32.

    Layers are told apart by windows, which reach over boundaries. Here a pixel near a boundary is
    judged by its own grey level in both frames, which are not smoothed, under the flow of every
    label near. Pixels of a surface behind may be hidden in frame 1: under a label whose flow takes
    a pixel to where a surface before it goes, the grey level says little. And a surface before
    others is not where those are still seen. Which of two is before the other shows where they go
    to the same place: its grey levels are met there.

    Parameters
    ----------
    labels : (H, W) int32
    flows : (K, 2, H, W) float32
        Of each label's surface, everywhere.
    reach : (K, H, W) bool
        Where a label may be.
    frame0, frame1 : (H, W) float32
        Grey levels.
    """
    window = np.ones((2 * REACH + 1, 2 * REACH + 1), np.uint8)
    near = np.stack(
        [cv2.dilate((labels == k).astype(np.uint8), window) > 0 for k in range(len(flows))]
    )
    free = near.sum(axis=0) > 1
    if not free.any():
        return labels
    costs, own_cost, hidden = _costs(flows, labels, frame0, frame1, free)
    far = ~(near & reach)[:, free]
    size = np.add(free.shape, MARGINS)
    leads = [list(_corners(_places(np.nan_to_num(flow))[:, free], *size)) for flow in flows]
    boundaries = MinSum(free, frame0, length=LENGTH, image_edges=IMAGE_EDGES)
    for _ in range(ROUNDS):
        unary = _with_hidden(costs, hidden[free], _landed(labels, flows, own_cost, hidden), leads)
        unary[far] = NEVER
        labels = labels.copy()
        labels[free] = boundaries.assign(unary, labels)
        own_cost[free] = np.take_along_axis(costs, labels[free][None], axis=0)[0]
    return labels


def _costs(
    flows: np.ndarray,
    labels: np.ndarray,
    frame0: np.ndarray,
    frame1: np.ndarray,
    free: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return what labels cost at free pixels where they are seen, and what a pixel's own costs.

    What is seen costs −log of a normal distribution of grey levels over one that is the same
    everywhere, from 0 to `MISSED`; things that are not quite rigid have more noise. Where a label
    leaves the image, the others have to decide. What is hidden costs the less, the better its grey
    level is told by those around it.

    Returns
    -------
    seen : (K, N) float32
        Of every label at the free pixels.
    own : (H, W) float32
        Of the label that a pixel has.
    hidden : (H, W) float32
    """
    taps = spline_taps(frame1)
    flow = _own(flows, labels)
    change = sample(frame1, flow, taps) - frame0
    usual = np.median(change)
    change -= usual
    noise = NOISE * float(np.median(np.abs(change)))
    limit = np.hypot(noise, LEAST_NOISE)
    window = (BRIGHTNESS_WINDOW, BRIGHTNESS_WINDOW)
    brightness = cv2.blur(np.clip(change, -limit, limit), window)
    change -= brightness
    slope = np.hypot(*(cv2.Sobel(frame0, -1, *way, scale=1 / 8) for way in ((1, 0), (0, 1))))
    least = LEAST_NOISE**2 + (SLIP * slope) ** 2
    common = least + noise**2
    gone = leaves_image(flow)
    own = np.empty_like(frame0)
    looked_at = free | gone
    seen = np.empty((len(flows), np.count_nonzero(looked_at)), np.float32)
    known = np.full(seen.shape[1], MISSED, np.float32)
    away = np.empty(seen.shape, bool)
    for label, flow in enumerate(flows):
        mine = labels == label
        found = np.abs(change[mine])
        deviation = NOISE * float(np.median(found)) if found.size else noise
        own[mine] = _seen(change[mine], least[mine], common[mine], deviation)
        flow = np.nan_to_num(flow)
        there = (sample(frame1, flow, taps) - frame0 - usual - brightness)[looked_at]
        seen[label] = _seen(there, least[looked_at], common[looked_at], deviation)
        away[label] = leaves_image(flow)[looked_at]
        np.minimum(known, seen[label], out=known, where=~away[label])
    seen = np.where(away, known, seen)
    own[gone] = known[gone[looked_at]]
    hidden = LEAST_HIDDEN + 0.5 * np.log1p(_variance(frame0) / common)
    return seen[:, free[looked_at]], own, np.minimum(hidden, HIDDEN)


def _seen(
    change: np.ndarray, least: np.ndarray, common: np.ndarray, deviation: float
) -> np.ndarray:
    """Return what grey levels that change by so much cost where a label is seen, (N,) float32."""
    variance = least + deviation**2
    met = np.sqrt(common / variance) * np.exp(-(change**2) / (2 * variance))
    return -np.log(np.minimum(met, 1) + np.exp(-MISSED))


def _own(flows: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """Return the flow of the label that a pixel has, (2, H, W) float32."""
    own = np.empty_like(flows[0])
    for label, flow in enumerate(flows):
        np.copyto(own, flow, where=labels == label)
    return np.nan_to_num(own, copy=False)


def _variance(frame: np.ndarray) -> np.ndarray:
    """Return the variance of the least varied of the windows that a pixel lies in."""
    return cv2.erode(window_variance(frame, VARIED), np.ones((VARIED, VARIED), np.uint8))


def _with_hidden(
    costs: np.ndarray,
    hidden: np.ndarray,
    landed: np.ndarray,
    leads: list[list[Corner]],
) -> np.ndarray:
    """Return the costs of the free pixels, (K, N) float32, where some labels hide others.

    `costs`, (K, N), are those where a label is seen, `hidden`, (N,), where it is hidden; `leads`
    says where the pixels go under every label.
    """
    unary = costs.copy()
    taken, missed, seen = landed
    share = np.zeros_like(unary)
    for front, behind in permutations(range(len(costs)), 2):
        before = _before(taken[[front, behind]], missed[[front, behind]])
        if before.any():
            cover = before * (2 * taken[front] - 1).clip(0, 1)
            np.maximum(share[behind], _read(cover, leads[behind]), out=share[behind])
            # Were it here, what is seen behind would be hidden.
            unary[front] += _read(before * seen[behind], leads[front])
    return -np.log((1 - share) * np.exp(-np.minimum(unary, MOST)) + share * np.exp(-hidden))


def _before(taken: np.ndarray, missed: np.ndarray) -> np.ndarray:
    """Return the places of frame 1 where the first of two labels is before the other.

    They both go there, and around there, grey levels of the second are missed by more.
    """
    both = ((taken > 0.5).all(axis=0)).astype(np.float32)
    excess = both * (missed[1] / np.maximum(taken[1], 0.5) - missed[0] / np.maximum(taken[0], 0.5))
    window = (ORDER_WINDOW, ORDER_WINDOW)
    usual = excess.sum(dtype=np.float64) / max(both.sum(dtype=np.float64), 1)
    return cv2.boxFilter(excess, -1, window, normalize=False) + USUAL_ORDER * usual > 1e-3


def _places(flow: np.ndarray) -> np.ndarray:
    """Return where pixels go, x and y, (2, H, W) float32."""
    places = flow.copy()
    places[0] += np.arange(flow.shape[2], dtype=np.float32)
    places[1] += np.arange(flow.shape[1], dtype=np.float32)[:, None]
    return places


def _landed(
    labels: np.ndarray, flows: np.ndarray, own_cost: np.ndarray, hidden: np.ndarray
) -> np.ndarray:
    """Return what comes of the pixels of each label where they go, (3, K, H + 3, W + 3) float32.

    How many there are, what they cost, and by how much more they would if they were hidden: sums,
    bilinearly, with a margin for what leaves the image.
    """
    height, width = np.add(labels.shape, MARGINS)
    places, count = _places(_own(flows, labels)), len(flows)
    landed = np.empty((3, count, height * width), np.float32)
    rows = max(1, STRIP // labels.shape[1])
    for label in range(count):
        sums = np.zeros((3, height * width))
        for first in range(0, len(labels), rows):
            strip = np.s_[first : first + rows]
            mine = labels[strip] == label
            if not mine.any():
                continue
            cost = own_cost[strip][mine]
            values = np.ones_like(cost), cost, np.maximum(hidden[strip][mine] - cost, 0)
            for corner, weight in _corners(places[:, strip][:, mine], height, width):
                least = int(corner.min())
                corner -= least
                for total, value in zip(sums, values, strict=True):
                    part = np.bincount(corner, weight * value)
                    total[least : least + len(part)] += part
        landed[:, label] = sums
    landed = landed.reshape(3, count, height, width)
    landed[..., (0, -2, -1), :] = landed[..., (0, -2, -1)] = 0
    return landed


def _read(landed: np.ndarray, corners: list[Corner]) -> np.ndarray:
    """Return a sum of `_landed`, bilinearly, at places; 0 beyond the image."""
    return sum(weight * landed.take(corner) for corner, weight in corners)


def _corners(places: np.ndarray, height: int, width: int) -> Iterator[Corner]:
    """Yield the four pixels around places, as indices of an image with margins, and weights."""
    x, y = places[0].clip(-1, width - 3) + 1, places[1].clip(-1, height - 3) + 1
    left, top = np.floor(x).astype(np.intp), np.floor(y).astype(np.intp)
    right, down = (x - left).astype(np.float32), (y - top).astype(np.float32)
    for row, share in ((top, 1 - down), (top + 1, down)):
        yield row * width + left, share * (1 - right)
        yield row * width + left + 1, share * right
