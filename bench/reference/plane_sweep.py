"""A plane sweep: costs of hypotheses of inverse depth, and their sums along paths."""

import numpy as np

from bench.reference.epipolar import displacement
from bench.reference.patch_match import bilinear
from tisfm.camera import Camera

Array = np.ndarray  # of float64


def matching_cost(
    features0: Array,  # (3, H, W): I, I_x and I_y
    features1: Array,  # read between pixels by bilinear interpolation
    hypotheses: Array,  # (N,), D = f·d, px/frame
    camera: Camera,
    rotation: Array,
    translation: Array,
) -> Array:
    """Return min(1, |ΔI|) + min(1, |ΔI_x| + |ΔI_y|) of every hypothesis, (H, W, N).

    It is 1 if the hypothesis moves the pixel out of the image.
    """
    height, width = features0.shape[1:]
    rows, columns = np.mgrid[:height, :width]
    costs = []
    for hypothesis in hypotheses:
        u, v = displacement(np.full((height, width), hypothesis), camera, rotation, translation)
        x, y = columns + u, rows + v
        is_inside = (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
        x, y = np.where(is_inside, x, 0), np.where(is_inside, y, 0)
        difference = np.abs([bilinear(image, y, x) for image in features1] - features0)
        cost = np.minimum(1, difference[0]) + np.minimum(1, difference[1] + difference[2])
        costs.append(np.where(is_inside, cost, 1))
    return np.stack(costs, axis=-1)


def census_cost(
    census0: Array,  # (H, W, 2) int32: 24 bits in each word
    census1: Array,
    hypotheses: Array,  # (N,), D = f·d, px/frame
    camera: Camera,
    rotation: Array,
    translation: Array,
) -> Array:
    """Return the share of differing bits at the nearest pixel of every hypothesis, (H, W, N).

    It is 1 if the hypothesis moves the pixel out of the image.
    """
    height, width = census0.shape[:2]
    rows, columns = np.mgrid[:height, :width]
    costs = []
    for hypothesis in hypotheses:
        u, v = displacement(np.full((height, width), hypothesis), camera, rotation, translation)
        x, y = (np.floor(position + 0.5).astype(int) for position in (columns + u, rows + v))
        is_inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
        found = census1[y.clip(0, height - 1), x.clip(0, width - 1)]
        different = (census0 ^ found).astype(np.uint32)[..., None] >> np.arange(24, dtype=np.uint32)
        costs.append(np.where(is_inside, (different & 1).sum(axis=(-1, -2)) / 48, 1))
    return np.stack(costs, axis=-1)


def aggregate(cost: Array, guide: Array, *, step: float, jump: float, edge: float) -> Array:
    """Return the sums along four paths of Hirschmüller (2008), eq. 13, (H, W, N).

    Where the grey levels of `guide`, (H, W), change by `edge`, the penalty of a jump is half.
    """
    total = np.zeros_like(cost)
    # Four turns of the image: in each, the path runs down.
    for turn in range(4):
        path = np.rot90(cost, turn).copy()
        grey = np.rot90(guide, turn)
        for row in range(1, len(path)):
            previous = path[row - 1]
            min_cost = previous.min(axis=-1, keepdims=True)
            penalty = np.maximum(step, jump / (1 + np.abs(grey[row] - grey[row - 1]) / edge))
            best = np.minimum(previous, min_cost + penalty[:, None])
            best[:, 1:] = np.minimum(best[:, 1:], previous[:, :-1] + step)
            best[:, :-1] = np.minimum(best[:, :-1], previous[:, 1:] + step)
            path[row] += best - min_cost
        total += np.rot90(path, -turn)
    return total
