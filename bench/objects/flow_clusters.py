"""Peers that take flow apart: the background's motion, and clusters of what is left."""

import cv2
import numpy as np
from numpy.typing import NDArray

_EVERY = 4  # px: every so many rows and columns are fitted
_RANSAC = 1.0  # px
_SAMPLES = 4000  # pixels that clusters are found from
_NEAR = 0.15  # of the image's width: a distance that counts as much as a px of flow


def off_homography(flow: NDArray) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the flow less that of the homography of most of it, (H, W, 2), and its length, px."""
    here, there, x, y = _places(flow)
    matrix, _ = cv2.findHomography(here, there, cv2.RANSAC, _RANSAC)
    if matrix is None:
        return flow, np.zeros(flow.shape[:2], np.float32)
    moved = cv2.perspectiveTransform(np.stack([x, y], axis=-1).reshape(1, -1, 2), matrix)
    background = moved.reshape(flow.shape) - np.stack([x, y], axis=-1)
    left = (flow - background).astype(np.float32)
    return left, np.linalg.norm(left, axis=2)


def off_epipolar_lines(flow: NDArray) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the flow, and how far its ends are from epipolar lines of most of it (Sampson), px."""
    here, there, x, y = _places(flow)
    matrix, _ = cv2.findFundamentalMat(here, there, cv2.FM_RANSAC, _RANSAC, 0.99)
    if matrix is None or matrix.shape != (3, 3):
        return flow, np.zeros(flow.shape[:2], np.float32)
    ones = np.ones_like(x)
    first = np.stack([x, y, ones])
    second = np.stack([x + flow[..., 0], y + flow[..., 1], ones])
    line, back = np.tensordot(matrix, first, 1), np.tensordot(matrix.T, second, 1)
    off = np.abs((second * line).sum(axis=0))
    length = np.sqrt(line[0] ** 2 + line[1] ** 2 + back[0] ** 2 + back[1] ** 2)
    return flow, (off / np.maximum(length, 1e-12)).astype(np.float32)


def clusters(left: NDArray, moving: NDArray, count: int) -> NDArray[np.uint8]:
    """Divide what moves by its motion and place, by k-means.

    Parameters
    ----------
    left : (H, W, 2) array
        Motion, px.
    moving : (H, W) bool array
    count : int
        How many clusters.

    Returns
    -------
    (H, W) uint8
        0 where nothing moves, and 1 to `count`.
    """
    labels = moving.astype(np.uint8)
    rows, columns = np.nonzero(moving)
    if count == 1 or len(rows) < 10 * count:
        return labels
    near = _NEAR * moving.shape[1]
    features = np.column_stack([left[rows, columns], columns / near, rows / near]).astype(
        np.float32
    )
    chosen = np.linspace(0, len(rows) - 1, min(_SAMPLES, len(rows))).astype(np.intp)
    cv2.setRNGSeed(0)
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 20, 0.1)
    _, _, centres = cv2.kmeans(features[chosen], count, None, stop, 3, cv2.KMEANS_PP_CENTERS)  # type: ignore[call-overload]
    distance = np.square(features[:, None] - centres[None]).sum(axis=2)
    labels[rows, columns] = 1 + distance.argmin(axis=1)
    return labels


def _places(flow: NDArray) -> tuple[NDArray, NDArray, NDArray, NDArray]:
    """Return some places and where they go, (n, 2) each, and x and y of all pixels."""
    y, x = (grid.astype(np.float32) for grid in np.mgrid[: flow.shape[0], : flow.shape[1]])
    some = np.s_[_EVERY // 2 :: _EVERY, _EVERY // 2 :: _EVERY]
    here = np.column_stack([x[some].ravel(), y[some].ravel()])
    return here, here + flow[some].reshape(-1, 2), x, y
