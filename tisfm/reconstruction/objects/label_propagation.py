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
    known: Sequence[int],  # frames that have labels, in order; at least one
    # returns the labels of such a frame, (H, W), in the size of the frames of the image motion
    labelled: Callable[[int], np.ndarray],
) -> Iterator[tuple[int, np.ndarray]]:
    """Yield the frames without labels and labels for them, (H, W) int32, from the nearest frame.

    A pixel takes the label of its position in the frame before. Where forward and backward motion
    disagree, as at surfaces that were hidden, the neighbours and the image edges decide.
    `refine_boundaries` refines the boundaries in every frame. The labels of hidden pixels are lost.
    """
    for place, frame in enumerate(known):
        before = known[place - 1] if place else -frame - 1
        after = known[place + 1] if place + 1 < len(known) else 2 * len(motion) - frame
        first, last = frame - (frame - before - 1) // 2, frame + (after - frame) // 2
        for way, end in ((1, min(last, len(motion) - 1)), (-1, max(first, 0))):
            labels = labelled(frame).astype(np.int32)
            for at in range(frame + way, end + way, way):
                labels = _carried(motion, at, at - way, labels)
                yield at, labels


def _carried(motion: ImageMotion, frame: int, other: int, labels: np.ndarray) -> np.ndarray:
    """Return the labels of a frame, (H, W) int32, from the labels of a neighbour frame."""
    numbers = np.unique(labels)
    led = next(led for led in motion.chained_flows(frame, 1) if led.frame == other)
    shares = np.stack([sample_image(np.float32(labels == k), led.places) for k in numbers])
    costs = np.where(led.found, CHANGE_COST * (1 - shares), 0).astype(np.float32)
    weight = np.where(led.found, FOLLOWED_WEIGHT, LOST_WEIGHT).astype(np.float32)
    found = numbers[Potts(motion.grey(frame)).assign(costs, weight)]
    return refine_boundaries(found, motion, frame)
