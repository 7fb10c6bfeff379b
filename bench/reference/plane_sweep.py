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


def census_transform(frame: Array) -> Array:
    """Return for every pixel which of its 24 neighbours are darker, one bit each, (H, W) int32."""
    height, width = frame.shape
    padded = np.pad(frame, 2, mode="edge")
    shifts = [(dy, dx) for dy in range(5) for dx in range(5) if (dy, dx) != (2, 2)]
    darker = [padded[dy : dy + height, dx : dx + width] < frame for dy, dx in shifts]
    return (np.array(darker) << np.arange(24)[:, None, None]).sum(axis=0).astype(np.int32)


def outline_cost(
    census0: Array,  # (H, W) int32: 24 bits
    census1: Array,  # (M, H, W) int32; −1 is not compared
    hypotheses: Array,  # (N,), D = f·d, px/frame
    camera: Camera,
    motions: Array,  # (M, 3, 4)
    guess: Array,  # (H, W)
    is_free: Array,  # (H, W) bool
    *,
    best_count: int,
    guess_costs: tuple[float, float],
    guess_distances: tuple[float, float],
) -> Array:
    """Return the mean of the least shares of differing bits, and the cost of the guess, (H, W, N).

    Only frames that show a hypothesis count; without any, the share is 1/2. Pixels that are not
    free have the cost of the guess alone.
    """
    height, width = census0.shape
    rows, columns = np.mgrid[:height, :width]
    costs = []
    for hypothesis in hypotheses:
        shares = []
        for codes, motion in zip(census1, motions, strict=True):
            depth = np.full((height, width), hypothesis)
            u, v = displacement(depth, camera, motion[:, :3], motion[:, 3])
            x, y = (np.floor(position + 0.5).astype(int) for position in (columns + u, rows + v))
            found = codes[y.clip(0, height - 1), x.clip(0, width - 1)]
            is_seen = (x >= 0) & (x < width) & (y >= 0) & (y < height) & (found >= 0)
            bits = ((census0 ^ found)[..., None] >> np.arange(24)) & 1
            shares.append(np.where(is_seen, bits.sum(axis=-1) / 24, np.inf))
        least = np.sort(shares, axis=0)[:best_count]
        seen = np.isfinite(least)
        mean = np.where(seen, least, 0).sum(axis=0) / np.maximum(seen.sum(axis=0), 1)
        share = np.where(seen.any(axis=0), mean, 0.5)
        free, fixed = (
            cost * np.minimum(1, np.abs(hypothesis - guess) / distance)
            for cost, distance in zip(guess_costs, guess_distances, strict=True)
        )
        costs.append(np.where(is_free, share + free, fixed))
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
