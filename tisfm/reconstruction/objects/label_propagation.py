"""Propagation of labels along the image motion, and refined boundaries of moving objects."""

from collections.abc import Callable, Iterator, Sequence

import cv2
import numpy as np

from tisfm.motion.objects.label_optimisation import Potts
from tisfm.reconstruction.frames.image_motion import ImageMotion, pixel_grid, sample_image
from tisfm.reconstruction.objects.moving_regions import extend_flow
from tisfm.reconstruction.objects.settings import OBJECTS


def refine_boundaries(labels: np.ndarray, motion: ImageMotion, frame: int) -> np.ndarray:
    """Return labels with refined boundaries, (H, W) int32.

    The motion of each label is continued across its boundary. A pixel takes the label whose motion
    leads to similar grey levels in the next or the previous frame. At least one of these two frames
    shows a pixel that a moving object hides in the other frame.
    """
    numbers = np.unique(labels)
    if len(numbers) < 2:
        return labels
    grey, grid = motion.grey(frame), pixel_grid(labels.shape)
    window = np.ones((2 * OBJECTS.max_boundary_shift + 1,) * 2, np.uint8)
    square = np.ones((OBJECTS.rim_width, OBJECTS.rim_width), np.uint8)
    is_near = np.stack([cv2.dilate(np.uint8(labels == k), window) > 0 for k in numbers])
    band = is_near.sum(axis=0) > 1
    differences = np.full((len(numbers), *labels.shape), np.inf, np.float32)
    for neighbour_flow in motion.chained_flows(frame, 1):  # to the next, then to the previous frame
        flow, other = neighbour_flow.positions - grid, motion.grey(neighbour_flow.frame)
        for index, number in enumerate(numbers):
            mask = labels == number
            core = cv2.erode(np.uint8(mask), square) > 0
            source_mask = core if core.sum() >= OBJECTS.min_core_pixels else mask
            extended_flow = extend_flow(flow, source_mask)
            difference = np.abs(sample_image(other, grid + extended_flow) - grey)
            x, y = np.moveaxis(grid + extended_flow, -1, 0)
            is_outside = (x < 0) | (y < 0) | (x > labels.shape[1] - 1) | (y > labels.shape[0] - 1)
            difference = np.where(is_outside, np.inf, cv2.blur(difference, (3, 3)))
            differences[index] = np.minimum(differences[index], difference)
    indices = np.searchsorted(numbers, labels)[None]
    current = np.take_along_axis(differences, indices, axis=0)
    scale = OBJECTS.difference_offset + 1.5 * float(np.median(current[np.isfinite(current)]))
    costs = np.minimum((differences / scale) ** 2, OBJECTS.max_boundary_cost)
    costs += OBJECTS.boundary_change_cost * (labels != numbers[:, None, None])
    costs[~is_near] = 2 * OBJECTS.max_boundary_cost
    weight = np.where(band, OBJECTS.boundary_weight, 1).astype(np.float32)
    best = numbers[Potts(grey).assign(costs.astype(np.float32), weight)]
    return np.where(band, best, labels).astype(np.int32)


def propagate_labels(
    motion: ImageMotion,
    labelled_frames: Sequence[int],  # frames that have labels, in order; at least one
    # returns the labels of a labelled frame, (H, W), in the size of the image motion
    labels_of: Callable[[int], np.ndarray],
) -> Iterator[tuple[int, np.ndarray]]:
    """Yield every frame without labels, and labels from its nearest labelled frame, (H, W) int32.

    Labels pass from frame to frame. A pixel takes the label of its position in the frame before.
    Where forward and backward motion disagree, as at surfaces that were hidden, neighbouring pixels
    and image edges decide. The labels of hidden pixels are lost.
    """
    for index, frame in enumerate(labelled_frames):
        # The first labelled frame has its mirror image at the start of the sequence as previous
        # frame, the last its mirror image at the end: half of the distance reaches start or end.
        previous = labelled_frames[index - 1] if index else -frame - 1
        is_last = index + 1 == len(labelled_frames)
        following = 2 * len(motion) - frame if is_last else labelled_frames[index + 1]
        first, last = frame - (frame - previous - 1) // 2, frame + (following - frame) // 2
        for direction, last_frame in ((1, min(last, len(motion) - 1)), (-1, max(first, 0))):
            labels = labels_of(frame).astype(np.int32)
            for current in range(frame + direction, last_frame + direction, direction):
                labels = _propagate(motion, current, current - direction, labels)
                yield current, labels


def _propagate(motion: ImageMotion, frame: int, other: int, labels: np.ndarray) -> np.ndarray:
    """Return the labels of a frame, (H, W) int32, from the labels of a neighbour frame."""
    numbers = np.unique(labels)
    flow = motion.chained_flow(frame, other)
    coverage = np.stack([sample_image(np.float32(labels == k), flow.positions) for k in numbers])
    costs = np.where(flow.valid, OBJECTS.propagation_cost * (1 - coverage), 0).astype(np.float32)
    weight = np.where(flow.valid, OBJECTS.consistent_weight, OBJECTS.inconsistent_weight)
    best = numbers[Potts(motion.grey(frame)).assign(costs, weight.astype(np.float32))]
    return refine_boundaries(best, motion, frame)
