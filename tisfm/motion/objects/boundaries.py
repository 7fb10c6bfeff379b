"""Boundaries between labels, to the pixel: which surface the images show on either side."""

from collections.abc import Iterator
from itertools import permutations

import cv2
import numpy as np

from tisfm.motion.objects.min_sum import MinSum
from tisfm.motion.windows import window_variance
from tisfm.solver.sampling import sample
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
LENGTH, IMAGE_EDGES = 5.0, 0.5  # per px of a boundary in uniform frames; and its κ
VARIED = 5  # px, over which frame 0 is alike or varied
ORDER_WINDOW, USUAL_ORDER = 31, 15.0  # px, over which one surface is in front; pixels that order
# in all of the image counts for, beside those in the window
BRIGHTNESS_WINDOW = 31  # px, over which brightness changes alike


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
    flows = np.nan_to_num(flows)
    costs, hidden = _costs(flows, labels, frame0, frame1)
    far = ~(near & reach)[:, free]
    boundaries = MinSum(free, frame0, length=LENGTH, image_edges=IMAGE_EDGES)
    for _ in range(ROUNDS):
        unary = _with_hidden(costs, hidden, flows, labels, free)
        unary[far] = NEVER
        labels = labels.copy()
        labels[free] = boundaries.assign(unary, labels)
    return labels


def _costs(
    flows: np.ndarray, labels: np.ndarray, frame0: np.ndarray, frame1: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return what every label costs at every pixel where it is seen, and where it is hidden.

    What is seen costs −log of a normal distribution of grey levels over one that is the same
    everywhere, from 0 to `MISSED`; things that are not quite rigid have more noise. Where a label
    leaves the image, the others have to decide. What is hidden costs the less, the better its grey
    level is told by those around it.

    Returns
    -------
    seen : (K, H, W) float32
    hidden : (H, W) float32
    """
    residual = np.stack([sample(frame1, flow) - frame0 for flow in flows])
    own = np.take_along_axis(residual, labels[None], axis=0)[0]
    usual = np.median(own)
    own, residual = own - usual, residual - usual
    noise = NOISE * float(np.median(np.abs(own)))
    limit = np.hypot(noise, LEAST_NOISE)
    window = (BRIGHTNESS_WINDOW, BRIGHTNESS_WINDOW)
    residual -= cv2.blur(np.clip(own, -limit, limit), window)
    slope = np.hypot(*(cv2.Sobel(frame0, -1, *way, scale=1 / 8) for way in ((1, 0), (0, 1))))
    least = LEAST_NOISE**2 + (SLIP * slope) ** 2
    common = least + noise**2
    seen = np.empty_like(residual)
    for label, change in enumerate(residual):
        mine = np.abs(change[labels == label])
        variance = least + (NOISE * float(np.median(mine)) if mine.size else noise) ** 2
        met = np.sqrt(common / variance) * np.exp(-(change**2) / (2 * variance))
        seen[label] = -np.log(np.minimum(met, 1) + np.exp(-MISSED))
    gone = np.stack([leaves_image(flow) for flow in flows])
    known = np.where(gone, np.inf, seen).min(axis=0).clip(None, MISSED)
    hidden = LEAST_HIDDEN + 0.5 * np.log1p(_variance(frame0) / common)
    return np.where(gone, known, seen), np.minimum(hidden, HIDDEN)


def _variance(frame: np.ndarray) -> np.ndarray:
    """Return the variance of the least varied of the windows that a pixel lies in."""
    return cv2.erode(window_variance(frame, VARIED), np.ones((VARIED, VARIED), np.uint8))


def _with_hidden(
    costs: np.ndarray,
    hidden: np.ndarray,
    flows: np.ndarray,
    labels: np.ndarray,
    free: np.ndarray,
) -> np.ndarray:
    """Return the costs of the free pixels, (K, N) float32, where some labels hide others.

    `costs` are those where a label is seen, `hidden` where it is hidden.
    """
    count = len(costs)
    own_cost = np.take_along_axis(costs, labels[None], axis=0)[0]
    places = _places(np.take_along_axis(flows, labels[None, None], axis=0)[0])
    taken, missed, seen = (
        _landed(labels, places, values, count)
        for values in (np.ones_like(own_cost), own_cost, np.maximum(hidden - own_cost, 0))
    )
    unary = costs[:, free]
    mine = [_places(flow)[:, free] for flow in flows]
    share = np.zeros_like(unary)
    for front, behind in permutations(range(count), 2):
        before = _before(taken[[front, behind]], missed[[front, behind]])
        if before.any():
            cover = before * (2 * taken[front] - 1).clip(0, 1)
            np.maximum(share[behind], _read(cover, mine[behind]), out=share[behind])
            # Were it here, what is seen behind would be hidden.
            unary[front] += _read(before * seen[behind], mine[front])
    return -np.log((1 - share) * np.exp(-np.minimum(unary, MOST)) + share * np.exp(-hidden[free]))


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
    rows, columns = np.mgrid[: flow.shape[1], : flow.shape[2]].astype(np.float32)
    return flow + np.stack([columns, rows])


def _landed(labels: np.ndarray, places: np.ndarray, values: np.ndarray, count: int) -> np.ndarray:
    """Return the sums of values, bilinearly, where the pixels of each label go.

    They are (K, H + 3, W + 3), with a margin for what leaves the image.
    """
    size = (count, labels.shape[0] + 3, labels.shape[1] + 3)
    sums = np.zeros(size).ravel()
    for corner, weight in _corners(places, *size[1:]):
        index = (labels * size[1] * size[2] + corner).ravel()
        sums += np.bincount(index, (weight * values).ravel(), len(sums))
    sums = sums.reshape(size).astype(np.float32)
    sums[:, (0, -2, -1)] = sums[:, :, (0, -2, -1)] = 0
    return sums


def _read(landed: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Return a sum of `_landed`, bilinearly, at places; 0 beyond the image."""
    return sum(weight * landed.take(corner) for corner, weight in _corners(places, *landed.shape))


def _corners(
    places: np.ndarray, height: int, width: int
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield the four pixels around places, as indices of an image with margins, and weights."""
    x, y = places[0].clip(-1, width - 3) + 1, places[1].clip(-1, height - 3) + 1
    left, top = np.floor(x).astype(np.intp), np.floor(y).astype(np.intp)
    right, down = (x - left).astype(np.float32), (y - top).astype(np.float32)
    for row, share in ((top, 1 - down), (top + 1, down)):
        yield row * width + left, share * (1 - right)
        yield row * width + left + 1, share * right
