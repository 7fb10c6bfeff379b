"""Boundaries between labels, exact to the pixel, from the grey levels of both frames."""

from collections.abc import Iterator
from itertools import permutations

import cv2
import numpy as np

from tisfm.motion.objects.label_optimisation import MinSum
from tisfm.motion.objects.settings import OBJECTS
from tisfm.motion.window_statistics import window_variance
from tisfm.solver.sampling import sample, spline_taps
from tisfm.visibility.occlusion import leaves_image

MAX_COST = 50.0  # nats: larger costs are clipped, so that exponentials stay above 0
FORBIDDEN_COST = 1e3  # nats: cost of a label that is not allowed at the pixel
TARGET_MARGIN = 3  # px by which images of targets exceed the frames, in each direction
STRIP_PIXELS = 2**16  # pixels of frame 0 that are processed together, which bounds memory

Corner = tuple[np.ndarray, np.ndarray]  # indices of pixels, and their weights


def sharpen_labels(
    labels: np.ndarray,  # (H, W) int32
    flows: np.ndarray,  # (K, 2, H, W) float32: flow of each label's surface, at every pixel
    is_allowed: np.ndarray,  # (K, H, W) bool: whether a label is allowed at a pixel
    # frame0, frame1: (H, W) float32, grey levels
    frame0: np.ndarray,
    frame1: np.ndarray,
) -> np.ndarray:
    """Return labels whose boundaries are exact to the pixel, (H, W) int32.

    Layers are separated by windows, which reach over boundaries. Here, a pixel near a boundary (a
    free pixel) is assigned by its grey level in both frames, without smoothing, under the flow of
    every label nearby. A pixel of a surface in the background may be occluded in frame 1: if its
    flow leads to the target of a surface in front, its grey level has little weight. A surface in
    front cannot be where a surface behind it is visible. Where two surfaces have the same target,
    the surface whose grey levels match there is in front.
    """
    window = np.ones(
        (2 * OBJECTS.max_boundary_shift + 1, 2 * OBJECTS.max_boundary_shift + 1), np.uint8
    )
    is_nearby = np.stack(
        [cv2.dilate((labels == k).astype(np.uint8), window) > 0 for k in range(len(flows))]
    )
    is_free = is_nearby.sum(axis=0) > 1
    if not is_free.any():
        return labels
    costs, own_cost, hidden = _label_costs(flows, labels, frame0, frame1, is_free)
    is_forbidden = ~(is_nearby & is_allowed)[:, is_free]
    size = np.add(is_free.shape, TARGET_MARGIN)
    corners = [list(_corners(_targets(np.nan_to_num(flow))[:, is_free], *size)) for flow in flows]
    boundaries = MinSum(
        is_free, frame0, length=OBJECTS.boundary_cost, image_edges=OBJECTS.image_edges
    )
    for _ in range(OBJECTS.boundary_rounds):
        sums = _sums_at_targets(labels, flows, own_cost, hidden)
        unary_costs = _costs_with_occlusion(costs, hidden[is_free], sums, corners)
        unary_costs[is_forbidden] = FORBIDDEN_COST
        labels = labels.copy()
        labels[is_free] = boundaries.assign(unary_costs, labels)
        own_cost[is_free] = np.take_along_axis(costs, labels[is_free][None], axis=0)[0]
    return labels


def _label_costs(
    flows: np.ndarray,  # (K, 2, H, W)
    labels: np.ndarray,  # (H, W)
    frame0: np.ndarray,
    frame1: np.ndarray,
    is_free: np.ndarray,  # (H, W) bool: pixels near a boundary
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the costs of visible labels at free pixels, of own labels, and of occluded pixels.

    A visible pixel costs −log of the ratio of a normal to a uniform distribution of grey levels,
    from 0 to `max_grey_cost`; objects that are not quite rigid have more noise. A label whose flow
    leaves the image takes the least cost of the other labels. An occluded pixel costs less in a
    more uniform neighbourhood.

    Returns three costs, float32: of every label at the free pixels, (K, N); of the own label of
    each pixel, (H, W); and of an occluded pixel, (H, W).
    """
    taps = spline_taps(frame1)
    flow = _flow_of_labels(flows, labels)
    change = sample(frame1, flow, taps) - frame0
    median_change = np.median(change)
    change -= median_change
    noise = OBJECTS.noise_residuals * float(np.median(np.abs(change)))
    limit = np.hypot(noise, OBJECTS.min_noise)
    window = (OBJECTS.brightness_window, OBJECTS.brightness_window)
    brightness = cv2.blur(np.clip(change, -limit, limit), window)
    change -= brightness
    slope = np.hypot(*(cv2.Sobel(frame0, -1, *order, scale=1 / 8) for order in ((1, 0), (0, 1))))
    min_variance = OBJECTS.min_noise**2 + (OBJECTS.flow_error * slope) ** 2
    variance = min_variance + noise**2
    leaves = leaves_image(flow)
    own_cost = np.empty_like(frame0)
    is_used = is_free | leaves
    costs = np.empty((len(flows), np.count_nonzero(is_used)), np.float32)
    min_cost = np.full(costs.shape[1], OBJECTS.max_grey_cost, np.float32)
    leaves_under_label = np.empty(costs.shape, bool)
    for label, flow in enumerate(flows):
        is_label = labels == label
        changes = np.abs(change[is_label])
        deviation = OBJECTS.noise_residuals * float(np.median(changes)) if changes.size else noise
        own_cost[is_label] = _visible_cost(
            change[is_label], min_variance[is_label], variance[is_label], deviation
        )
        flow = np.nan_to_num(flow)
        label_change = (sample(frame1, flow, taps) - frame0 - median_change - brightness)[is_used]
        costs[label] = _visible_cost(
            label_change, min_variance[is_used], variance[is_used], deviation
        )
        leaves_under_label[label] = leaves_image(flow)[is_used]
        np.minimum(min_cost, costs[label], out=min_cost, where=~leaves_under_label[label])
    costs = np.where(leaves_under_label, min_cost, costs)
    own_cost[leaves] = min_cost[leaves[is_used]]
    hidden = OBJECTS.min_hidden_cost + 0.5 * np.log1p(_variance(frame0) / variance)
    return costs[:, is_free[is_used]], own_cost, np.minimum(hidden, OBJECTS.max_hidden_cost)


def _visible_cost(
    change: np.ndarray, min_variance: np.ndarray, frame_variance: np.ndarray, deviation: float
) -> np.ndarray:
    """Return the cost of changes of grey level of visible pixels, (N,) float32."""
    variance = min_variance + deviation**2
    match = np.sqrt(frame_variance / variance) * np.exp(-(change**2) / (2 * variance))
    return -np.log(np.minimum(match, 1) + np.exp(-OBJECTS.max_grey_cost))


def _flow_of_labels(flows: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """Return the flow of each pixel's own label, (2, H, W) float32."""
    own_flow = np.empty_like(flows[0])
    for label, flow in enumerate(flows):
        np.copyto(own_flow, flow, where=labels == label)
    return np.nan_to_num(own_flow, copy=False)


def _variance(frame: np.ndarray) -> np.ndarray:
    """Return the least variance of the windows that contain a pixel, (H, W) float32."""
    window = np.ones((OBJECTS.variation_window, OBJECTS.variation_window), np.uint8)
    return cv2.erode(window_variance(frame, OBJECTS.variation_window), window)


def _costs_with_occlusion(
    costs: np.ndarray, hidden: np.ndarray, sums: np.ndarray, corners: list[list[Corner]]
) -> np.ndarray:
    """Return the costs of the free pixels, (K, N) float32, with occlusion by other labels.

    `costs`, (K, N), are the costs of visible labels, `hidden`, (N,), the costs of occluded pixels,
    `sums` the sums of `_sums_at_targets`, and `corners` the targets of the pixels under each label.
    """
    unary_costs = costs.copy()
    counts, costs_at_targets, hidden_gains = sums
    hidden_share = np.zeros_like(unary_costs)
    for front, back in permutations(range(len(costs)), 2):
        is_in_front = _find_order(counts[[front, back]], costs_at_targets[[front, back]])
        if is_in_front.any():
            cover = is_in_front * (2 * counts[front] - 1).clip(0, 1)
            np.maximum(
                hidden_share[back], _interpolate(cover, corners[back]), out=hidden_share[back]
            )
            # The front label would occlude visible pixels of the back label.
            unary_costs[front] += _interpolate(is_in_front * hidden_gains[back], corners[front])
    return -np.log(
        (1 - hidden_share) * np.exp(-np.minimum(unary_costs, MAX_COST))
        + hidden_share * np.exp(-hidden)
    )


def _find_order(counts: np.ndarray, costs: np.ndarray) -> np.ndarray:
    """Return the pixels of frame 1 where the first of two labels is in front of the second.

    Both labels have targets there, and in the window around the pixel the grey levels of the second
    label match worse.
    """
    is_common = ((counts > 0.5).all(axis=0)).astype(np.float32)
    excess = is_common * (
        costs[1] / np.maximum(counts[1], 0.5) - costs[0] / np.maximum(counts[0], 0.5)
    )
    window = (OBJECTS.order_window, OBJECTS.order_window)
    mean_excess = excess.sum(dtype=np.float64) / max(is_common.sum(dtype=np.float64), 1)
    return (
        cv2.boxFilter(excess, -1, window, normalize=False)
        + OBJECTS.global_order_pixels * mean_excess
        > 1e-3
    )


def _targets(flow: np.ndarray) -> np.ndarray:
    """Return the targets of pixels, x and y, (2, H, W) float32."""
    targets = flow.copy()
    targets[0] += np.arange(flow.shape[2], dtype=np.float32)
    targets[1] += np.arange(flow.shape[1], dtype=np.float32)[:, None]
    return targets


def _sums_at_targets(
    labels: np.ndarray, flows: np.ndarray, own_cost: np.ndarray, hidden: np.ndarray
) -> np.ndarray:
    """Return sums over the pixels of each label at their targets, (3, K, H + 3, W + 3) float32.

    The sums are the number of pixels, their cost, and the additional cost if they were occluded,
    with bilinear weights. The margin contains the targets outside the image.
    """
    height, width = np.add(labels.shape, TARGET_MARGIN)
    targets, count = _targets(_flow_of_labels(flows, labels)), len(flows)
    target_sums = np.empty((3, count, height * width), np.float32)
    rows = max(1, STRIP_PIXELS // labels.shape[1])
    for label in range(count):
        sums = np.zeros((3, height * width))
        for first_row in range(0, len(labels), rows):
            strip = np.s_[first_row : first_row + rows]
            is_label = labels[strip] == label
            if not is_label.any():
                continue
            cost = own_cost[strip][is_label]
            values = np.ones_like(cost), cost, np.maximum(hidden[strip][is_label] - cost, 0)
            for corner, weight in _corners(targets[:, strip][:, is_label], height, width):
                lowest = int(corner.min())
                corner -= lowest
                for total, value in zip(sums, values, strict=True):
                    part = np.bincount(corner, weight * value)
                    total[lowest : lowest + len(part)] += part
        target_sums[:, label] = sums
    target_sums = target_sums.reshape(3, count, height, width)
    target_sums[..., (0, -2, -1), :] = target_sums[..., (0, -2, -1)] = 0
    return target_sums


def _interpolate(sums: np.ndarray, corners: list[Corner]) -> np.ndarray:
    """Return a sum of `_sums_at_targets` between pixels, bilinearly; 0 beyond the image."""
    return sum(weight * sums.take(corner) for corner, weight in corners)


def _corners(targets: np.ndarray, height: int, width: int) -> Iterator[Corner]:
    """Yield the four pixels around targets, as indices of an image with margins, and weights."""
    x, y = targets[0].clip(-1, width - 3) + 1, targets[1].clip(-1, height - 3) + 1
    left, top = np.floor(x).astype(np.intp), np.floor(y).astype(np.intp)
    fraction_x, fraction_y = (x - left).astype(np.float32), (y - top).astype(np.float32)
    for row, row_weight in ((top, 1 - fraction_y), (top + 1, fraction_y)):
        yield row * width + left, row_weight * (1 - fraction_x)
        yield row * width + left + 1, row_weight * fraction_x
