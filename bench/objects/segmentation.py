"""Motion masks and labels of the peers: homographies, clusters of flow, and tracking."""

from collections.abc import Sequence
from functools import reduce
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from bench.objects.clips import neighbours

MAX_CORNERS = 1000  # corners that are tracked between frames
CORNER_THRESHOLD = 1.5  # px, RANSAC threshold for tracked corners
MIXTURE_FRAMES = 8  # on each side of the frame, for the mixture of Gaussians
MIN_AREA = 0.002  # of the image: smaller parts are dropped as noise; set by hand
MAX_UNSEEN_FRAMES = 10  # frames without a label, after which it is dropped; set by hand
MAX_LABEL = 255  # largest label in 8 bits


def homographies(grey: Sequence[NDArray]) -> list[NDArray[np.float64]]:
    """Return the homography of the background from each frame to the next, (3, 3).

    Corners are tracked by the method of Lucas and Kanade. RANSAC keeps the largest plane's corners.
    """
    matrices = []
    for frame, next_frame in pairwise(grey):
        corners = cv2.goodFeaturesToTrack(frame, MAX_CORNERS, 0.005, 5)
        matrix = None
        if corners is not None and len(corners) >= 4:
            targets, status, _ = cv2.calcOpticalFlowPyrLK(frame, next_frame, corners, None)  # type: ignore[call-overload]
            valid = status.ravel() == 1
            if valid.sum() >= 4:
                matrix, _ = cv2.findHomography(
                    corners[valid], targets[valid], cv2.RANSAC, CORNER_THRESHOLD
                )
        matrices.append(np.eye(3) if matrix is None else np.asarray(matrix, np.float64))
    return matrices


def homography_between(steps: Sequence[NDArray], first: int, second: int) -> NDArray[np.float64]:
    """Return the homography from one frame to another, in either direction."""
    if second < first:
        return np.asarray(np.linalg.inv(homography_between(steps, second, first)))
    return np.asarray(reduce(lambda product, step: step @ product, steps[first:second], np.eye(3)))


def differences(
    frames: Sequence[NDArray],
    steps: Sequence[NDArray],  # homography of each frame to the next
    gap: int,  # frames to the neighbours before and after
    *,
    both: bool,  # whether the smaller of both differences is used, or the larger
) -> list[NDArray[np.float32]]:
    """Return the difference of each frame from its neighbours, warped to its background.

    Differences are grey levels, (H, W) for each frame; 0 where no neighbour shows the pixel. The
    smaller difference is low at the object's earlier and later position; the larger one is also
    high inside a large object.
    """
    smooth = [cv2.GaussianBlur(frame, (0, 0), 1.5).astype(np.float32) for frame in frames]
    result = []
    for number, frame in enumerate(smooth):
        absolute = [
            np.abs(
                frame - _warp_frame(smooth[other], homography_between(steps, number, other), np.nan)
            )
            for other in (number - gap, number + gap)
            if 0 <= other < len(frames)
        ]
        channels = [value if value.ndim == 2 else value.max(axis=2) for value in absolute]
        if not channels:
            result.append(np.zeros(frame.shape[:2], np.float32))
            continue
        # Where one neighbour does not show the pixel, the difference from the other is used.
        choose = np.fmin if both else np.fmax
        result.append(np.nan_to_num(reduce(choose, channels)).astype(np.float32))
    return result


def mixtures(
    frames: Sequence[NDArray],
    steps: Sequence[NDArray],  # homography of each frame to the next
    gap: int,  # frames to the nearest neighbours; at less distance an object hardly moves
    threshold: float,  # OpenCV's varThreshold: squared distance from the background, in deviations
) -> list[NDArray[np.uint8]]:
    """Return the foreground of OpenCV's MOG2 from neighbours warped to each frame."""
    masks = []
    for number, frame in enumerate(frames):
        model = cv2.createBackgroundSubtractorMOG2(2 * MIXTURE_FRAMES, threshold, False)
        for other in neighbours(len(frames), number, gap, gap + MIXTURE_FRAMES):
            # Where a neighbour shows no pixel, the pixel of the frame is used.
            warped = _warp_frame(
                frames[other], homography_between(steps, number, other), None, frame
            )
            model.apply(warped)
        masks.append((model.apply(frame, learningRate=0) > 0).astype(np.uint8))
    return masks


def clean_mask(mask: NDArray) -> NDArray[np.uint8]:
    """Return a mask, 0 or 1, after opening and closing."""
    size = max(3, round(mask.shape[1] / 100) | 1)
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    wide_disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (3 * size, 3 * size))
    opened = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, disc)
    return np.asarray(cv2.morphologyEx(opened, cv2.MORPH_CLOSE, wide_disc), np.uint8)


def _warp_frame(
    frame: NDArray, matrix: NDArray, border: float | None, under: NDArray | None = None
) -> NDArray:
    """Return a frame warped to another; outside it a border value, or the pixels of `under`."""
    height, width = frame.shape[:2]
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    if under is None:
        value = (border,) * 4
        return np.asarray(
            cv2.warpPerspective(
                frame,
                matrix,
                (width, height),
                flags=flags,
                borderValue=value,  # type: ignore[arg-type]
            )
        )
    return np.asarray(
        cv2.warpPerspective(
            frame,
            matrix,
            (width, height),
            dst=under.copy(),
            flags=flags,
            borderMode=cv2.BORDER_TRANSPARENT,
        )
    )


SAMPLE_STRIDE = 4  # px between the pixels that are fitted
FLOW_THRESHOLD = 1.0  # px, threshold for flow
CLUSTER_SAMPLES = 4000  # pixels for the centres of clusters
POSITION_SCALE = 0.15  # of the image width: distance that counts as much as 1 px of flow


def homography_residual(flow: NDArray) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the flow minus the flow of its dominant homography, (H, W, 2), and its length, px."""
    start, end, x, y = _samples(flow)
    matrix, _ = cv2.findHomography(start, end, cv2.RANSAC, FLOW_THRESHOLD)
    if matrix is None:
        return flow, np.zeros(flow.shape[:2], np.float32)
    background_targets = cv2.perspectiveTransform(
        np.stack([x, y], axis=-1).reshape(1, -1, 2), matrix
    )
    background = background_targets.reshape(flow.shape) - np.stack([x, y], axis=-1)
    residual = (flow - background).astype(np.float32)
    return residual, np.linalg.norm(residual, axis=2)


def epipolar_distance(flow: NDArray) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the flow, and its distance from the dominant epipolar lines (Sampson), px."""
    start, end, x, y = _samples(flow)
    matrix, _ = cv2.findFundamentalMat(start, end, cv2.FM_RANSAC, FLOW_THRESHOLD, 0.99)
    if matrix is None or matrix.shape != (3, 3):
        return flow, np.zeros(flow.shape[:2], np.float32)
    ones = np.ones_like(x)
    first = np.stack([x, y, ones])
    second = np.stack([x + flow[..., 0], y + flow[..., 1], ones])
    line, back = np.tensordot(matrix, first, 1), np.tensordot(matrix.T, second, 1)
    distance = np.abs((second * line).sum(axis=0))
    length = np.sqrt(line[0] ** 2 + line[1] ** 2 + back[0] ** 2 + back[1] ** 2)
    return flow, (distance / np.maximum(length, 1e-12)).astype(np.float32)


def clusters(
    residual: NDArray,  # (H, W, 2), motion relative to the background, px
    moving: NDArray,  # (H, W) bool
    count: int,
) -> NDArray[np.uint8]:
    """Return `count` clusters of moving pixels by motion and position (k-means), 0 if static."""
    labels = moving.astype(np.uint8)
    rows, columns = np.nonzero(moving)
    if count == 1 or len(rows) < 10 * count:
        return labels
    distance_unit = POSITION_SCALE * moving.shape[1]
    features = np.column_stack(
        [residual[rows, columns], columns / distance_unit, rows / distance_unit]
    ).astype(np.float32)
    samples = np.linspace(0, len(rows) - 1, min(CLUSTER_SAMPLES, len(rows))).astype(np.intp)
    cv2.setRNGSeed(0)
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 20, 0.1)
    _, _, centres = cv2.kmeans(features[samples], count, None, stop, 3, cv2.KMEANS_PP_CENTERS)  # type: ignore[call-overload]
    distance = np.square(features[:, None] - centres[None]).sum(axis=2)
    labels[rows, columns] = 1 + distance.argmin(axis=1)
    return labels


def _samples(flow: NDArray) -> tuple[NDArray, NDArray, NDArray, NDArray]:
    """Return some pixels and the ends of their flow, (n, 2) each, and x and y of all pixels."""
    y, x = (grid.astype(np.float32) for grid in np.mgrid[: flow.shape[0], : flow.shape[1]])
    sample = np.s_[SAMPLE_STRIDE // 2 :: SAMPLE_STRIDE, SAMPLE_STRIDE // 2 :: SAMPLE_STRIDE]
    start = np.column_stack([x[sample].ravel(), y[sample].ravel()])
    return start, start + flow[sample].reshape(-1, 2), x, y


def one_label(masks: Sequence[NDArray]) -> list[NDArray[np.uint8]]:
    """Return label 1 for all moving pixels."""
    return [(mask > 0).astype(np.uint8) for mask in masks]


def track_parts(masks: Sequence[NDArray]) -> list[NDArray[np.uint8]]:
    """Return labels of connected parts, which overlapping parts of later frames inherit.

    `masks`, (H, W) for each frame, are 0 for static pixels; parts with different values are
    separate. A part gets the label that it overlaps most in the last 10 frames, unless a larger
    part has that label. Otherwise it gets a new label, up to 255.
    """
    masks_by_label: dict[int, NDArray[np.bool_]] = {}
    last_frames: dict[int, int] = {}
    next_label = 1
    labels = []
    for number, mask in enumerate(masks):
        label = np.zeros(mask.shape, np.uint8)
        pairs, used_labels = [], set()
        components = connected_parts(mask)
        for index, part in enumerate(components):
            for known_label, last in masks_by_label.items():
                if number - last_frames[known_label] <= MAX_UNSEEN_FRAMES and (
                    overlap := int((part & last).sum())
                ):
                    pairs.append((overlap, index, known_label))
        names: dict[int, int] = {}
        for _, index, known_label in sorted(pairs, reverse=True):
            if index not in names and known_label not in used_labels:
                names[index] = known_label
                used_labels.add(known_label)
        for index, part in enumerate(components):
            if index not in names:
                if next_label > MAX_LABEL:
                    continue
                names[index], next_label = next_label, next_label + 1
            name = names[index]
            label[part] = name
            masks_by_label[name], last_frames[name] = part, number
        labels.append(label)
    return labels


def connected_parts(mask: NDArray) -> list[NDArray[np.bool_]]:
    """Return the connected parts of each value that are large enough, the largest first."""
    areas_and_parts = []
    for value in np.unique(mask[mask > 0]):
        _, components = cv2.connectedComponents((mask == value).astype(np.uint8))
        areas = np.bincount(components.ravel())
        areas[0] = 0
        areas_and_parts += [
            (int(areas[k]), components == k) for k in np.flatnonzero(areas >= MIN_AREA * mask.size)
        ]
    return [part for _, part in sorted(areas_and_parts, key=lambda item: -item[0])]
