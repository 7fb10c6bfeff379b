"""Propagation of labels, along the image motion, to the frames without labels."""

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from tisfm.motion.objects.label_optimisation import Potts
from tisfm.reconstruction.frames.image_motion import ImageMotion, sample_image
from tisfm.reconstruction.objects.boundaries import refine_boundaries

# Values without a stated source were set by hand.

# Cost of a label that differs from the propagated one.
CHANGE_COST = 6.0
# Data weight of pixels where forward and backward motion agree.
FOLLOWED_WEIGHT = 0.5
# Data weight of all other pixels.
LOST_WEIGHT = 0.02


def propagate_labels(
    motion: ImageMotion,
    labelled_frames: Sequence[int],  # frames that have labels, in order; at least one
    # returns the labels of such a frame, (H, W), in the size of the frames of the image motion
    labels_of: Callable[[int], np.ndarray],
) -> Iterator[tuple[int, np.ndarray]]:
    """Yield the frames without labels and labels for them, (H, W) int32, from the nearest frame.

    A pixel takes the label of its position in the frame before. Where forward and backward motion
    disagree, as at surfaces that were hidden, the neighbours and the image edges decide.
    `refine_boundaries` refines the boundaries in every frame. The labels of hidden pixels are lost.
    """
    for index, frame in enumerate(labelled_frames):
        previous = labelled_frames[index - 1] if index else -frame - 1
        following = (
            labelled_frames[index + 1]
            if index + 1 < len(labelled_frames)
            else 2 * len(motion) - frame
        )
        first, last = frame - (frame - previous - 1) // 2, frame + (following - frame) // 2
        for direction, last_frame in ((1, min(last, len(motion) - 1)), (-1, max(first, 0))):
            labels = labels_of(frame).astype(np.int32)
            for current in range(frame + direction, last_frame + direction, direction):
                labels = _propagate(motion, current, current - direction, labels)
                yield current, labels


def _propagate(motion: ImageMotion, frame: int, other: int, labels: np.ndarray) -> np.ndarray:
    """Return the labels of a frame, (H, W) int32, from the labels of a neighbour frame."""
    numbers = np.unique(labels)
    chain = next(chain for chain in motion.chained_flows(frame, 1) if chain.frame == other)
    shares = np.stack([sample_image(np.float32(labels == k), chain.positions) for k in numbers])
    costs = np.where(chain.valid, CHANGE_COST * (1 - shares), 0).astype(np.float32)
    weight = np.where(chain.valid, FOLLOWED_WEIGHT, LOST_WEIGHT).astype(np.float32)
    best = numbers[Potts(motion.grey(frame)).assign(costs, weight)]
    return refine_boundaries(best, motion, frame)
