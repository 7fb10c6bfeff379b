"""Scores of all labels of a clip together: region and boundary, and the depth of objects."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import starmap
from statistics import fmean

import cv2
import numpy as np
from numpy.typing import NDArray

# Largest distance of a boundary pixel from the other boundary, as a share of the frame's diagonal:
# as in the evaluation of DAVIS.
BOUNDARY_SHARE = 0.008
OCCLUDER_REACH = 8  # px: pixels at rest within this distance of an object may occlude it
MIN_JUMP = 0.1  # least relative difference of depth that has an order
MIN_PIXELS = 20  # labelled pixels of an object in a frame whose depth counts


def union_iou(labels: Iterable[NDArray], truth: Iterable[NDArray]) -> float:
    """Return the mean over frames of the region similarity of all labels and all objects."""
    return fmean(starmap(_region, zip(labels, truth, strict=True)))


def boundary_f(labels: Iterable[NDArray], truth: Iterable[NDArray]) -> float:
    """Return the mean over frames of the boundary F of all labels and all objects."""
    return fmean(starmap(_boundary, zip(labels, truth, strict=True)))


def _region(labels: NDArray, truth: NDArray) -> float:
    union = ((labels > 0) | (truth > 0)).sum()
    return float(((labels > 0) & (truth > 0)).sum() / union) if union else 1.0


def _boundary(labels: NDArray, truth: NDArray) -> float:
    radius = int(np.ceil(BOUNDARY_SHARE * np.hypot(*truth.shape)))
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1,) * 2)
    outline, true_outline = (_outline(mask > 0) for mask in (labels, truth))
    if not outline.any() or not true_outline.any():
        return float(outline.any() == true_outline.any())
    precision = cv2.dilate(true_outline, disc)[outline > 0].mean()
    recall = cv2.dilate(outline, disc)[true_outline > 0].mean()
    total = precision + recall
    return float(2 * precision * recall / total) if total else 0.0


def _outline(mask: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Return 1 at the pixels of a mask that touch other pixels, but for the frame's border."""
    inner = cv2.erode(mask.astype(np.uint8), np.ones((3, 3), np.uint8))
    return np.asarray(mask.astype(np.uint8) - inner)


@dataclass(frozen=True, kw_only=True)
class ObjectDepthScore:
    """Errors of the depth of moving objects whose true depth is known."""

    # median over the frames of all objects of the median error of the labelled pixels, relative
    error: float
    # share of the labelled pixels whose order of depth with a pixel at rest that occludes them is
    # right
    order: float


def object_depth_score(
    depth: Sequence[NDArray],  # (H, W) for each frame; NaN without depth
    labels: Sequence[NDArray],
    true_depth: NDArray,  # (N, H, W)
    truth: Sequence[NDArray],  # (H, W): true objects
) -> ObjectDepthScore:
    """Compare the depth of objects, in the one scale in which the static scene is right."""
    scale = np.nanmedian(
        [
            np.nanmedian((true / found)[true_mask == 0])
            for found, true, true_mask in zip(depth, true_depth, truth, strict=True)
        ]
    )
    errors, orders = [], []
    for found, label, true, true_mask in zip(depth, labels, true_depth, truth, strict=True):
        for number in np.unique(true_mask[true_mask > 0]):
            pixels = (true_mask == number) & (label > 0) & np.isfinite(found)
            if pixels.sum() >= MIN_PIXELS:
                errors.append(float(np.median(np.abs(scale * found[pixels] / true[pixels] - 1))))
        orders.append(_order_beside(scale * found, label, true, true_mask))
    order = np.concatenate(orders)
    return ObjectDepthScore(
        error=float(np.median(errors)) if errors else float("nan"),
        order=float(order.mean()) if len(order) else float("nan"),
    )


def _order_beside(
    found: NDArray, label: NDArray, true: NDArray, true_mask: NDArray
) -> NDArray[np.bool_]:
    """Return whether labelled pixels are behind the pixels at rest that occlude them."""
    is_right = []
    for shift in ((0, OCCLUDER_REACH), (0, -OCCLUDER_REACH), (OCCLUDER_REACH, 0)):
        other_found, other_true, other_label, other_mask = (
            np.roll(array, shift, (0, 1)) for array in (found, true, label, true_mask)
        )
        pairs = (true_mask > 0) & (label > 0) & (other_mask == 0) & (other_label == 0)
        pairs &= (other_true < (1 - MIN_JUMP) * true) & np.isfinite(found + other_found)
        # what np.roll brings from the other border is no neighbour
        inner = np.zeros_like(pairs)
        inner[OCCLUDER_REACH:, OCCLUDER_REACH:-OCCLUDER_REACH] = True
        is_right.append((other_found < found)[pairs & inner])
    return np.concatenate(is_right)
