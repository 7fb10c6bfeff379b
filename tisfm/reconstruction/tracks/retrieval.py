"""Image retrieval: pairs of views that may show the same scene, however far apart in time."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tisfm.motion.sparse_matches import Features
from tisfm.reconstruction.frames.disk_cache import DiskCache

# Values without a stated source were set by hand.

# Words of the codebook.
CODEBOOK_SIZE = 32
# Descriptors that the codebook is clustered from.
CODEBOOK_SAMPLE = 8192
# Number of rounds of this clustering.
CODEBOOK_ROUNDS = 8
# Largest number of earlier views that a view is matched with.
CANDIDATES = 3
# Smallest distance, in views, between two of these candidates.
MIN_CANDIDATE_DISTANCE = 3
# The fewest described points of a view.
MIN_POINTS = 30
# Smallest similarity of matched views, as a share of the median similarity of neighbouring views.
MIN_LIKENESS = 0.4
# Largest value of a descriptor, which is stored in 8 bits.
MAX_LEVEL = 255.0
# Views whose codes are in memory at a time.
BLOCK_VIEWS = 512


@dataclass(frozen=True, kw_only=True)
class ImageDescriptors:
    """Descriptors of a view, in 8 bits each."""

    points: np.ndarray  # (N, 2) float64: (x, y), px from the upper left pixel's centre
    levels: np.ndarray  # (N, 128) uint8: square roots of the descriptors of these points, times 255

    @classmethod
    def of(cls, found: Features) -> "ImageDescriptors":
        """Return the descriptors of a view with these points."""
        return cls(points=found.points, levels=np.rint(found.roots * MAX_LEVEL).astype(np.uint8))

    @classmethod
    def of_arrays(cls, points: np.ndarray, levels: np.ndarray) -> "ImageDescriptors":
        """Return the descriptors with these arrays."""
        return cls(points=points, levels=levels)

    def arrays(self) -> tuple[np.ndarray, ...]:
        """Return its arrays."""
        return self.points, self.levels

    def described(self) -> Features:
        """Return the points with their descriptors."""
        return Features(points=self.points, roots=self.levels.astype(np.float32) / MAX_LEVEL)


def find_similar_views(
    looks: Sequence[ImageDescriptors],  # descriptors of views, in the order of their frames
    *,
    apart: int,  # smallest distance, in views, from the earlier to the later view
) -> list[tuple[int, int]]:
    """Return pairs of views that may show the same scene, the earlier view first, in order.

    References
    ----------
    Jégou et al., "Aggregating local image descriptors into compact codes", TPAMI 2012,
    doi 10.1109/TPAMI.2011.235 (VLAD); the codebook is clustered from these views themselves.
    Arandjelović and Zisserman, "All about VLAD", CVPR 2013, doi 10.1109/CVPR.2013.207 (each
    word's part is of unit length).
    """
    seen = [k for k, look in enumerate(looks) if len(look.points) >= MIN_POINTS]
    if len(seen) < 2 or seen[-1] - seen[0] < apart:
        return []
    codebook = _codebook(looks, seen)
    codes = DiskCache[np.ndarray](lambda block: (block,), np.asarray)
    found: list[tuple[float, int, int]] = []
    following = []
    for begin in range(0, len(seen), BLOCK_VIEWS):
        block = np.stack(
            [_code(looks[k].levels, codebook) for k in seen[begin : begin + BLOCK_VIEWS]]
        )
        likeness = np.hstack([*(block @ before.T for before in codes), block @ block.T])
        codes.append(block)
        for row, later in enumerate(seen[begin : begin + BLOCK_VIEWS], start=begin):
            alike = likeness[row - begin, :row]
            following += alike[-1:].tolist()
            found += [
                (float(alike[column]), seen[column], later)
                for column in _most_alike(alike, seen, later - apart)
            ]
    least = MIN_LIKENESS * float(np.median(np.array(following, np.float32)))
    return [(earlier, later) for like, earlier, later in found if like >= least]


def _most_alike(alike: np.ndarray, seen: Sequence[int], last: int) -> list[int]:
    """Return the earlier views, up to `last`, that are most similar to a view, in order."""
    chosen: list[int] = []
    for column in np.argsort(-alike, kind="stable").tolist():
        if len(chosen) == CANDIDATES:
            break
        far = all(abs(seen[column] - seen[other]) >= MIN_CANDIDATE_DISTANCE for other in chosen)
        if seen[column] <= last and far:
            chosen.append(column)
    return sorted(chosen)


def _codebook(looks: Sequence[ImageDescriptors], seen: Sequence[int]) -> np.ndarray:
    """Return the centres of clusters of descriptors, (CODEBOOK_SIZE, 128) float32."""
    each = max(1, CODEBOOK_SAMPLE // len(seen))
    # Evenly spaced descriptors of each view: no random choice, and so no seed.
    some = []
    for k in seen[:: -(-len(seen) // CODEBOOK_SAMPLE)]:
        levels = looks[k].levels
        some.append(levels[np.linspace(0, len(levels) - 1, min(each, len(levels))).astype(int)])
    sample = np.vstack(some).astype(np.float32)
    centres = sample[np.linspace(0, len(sample) - 1, CODEBOOK_SIZE).astype(int)]
    for _ in range(CODEBOOK_ROUNDS):
        word = _words(sample, centres)
        for k in range(CODEBOOK_SIZE):
            if (word == k).any():
                centres[k] = sample[word == k].mean(axis=0)
    return centres


def _words(levels: np.ndarray, centres: np.ndarray) -> np.ndarray:
    """Return the nearest centre of each descriptor, (N,)."""
    nearness = levels @ centres.T - (centres**2).sum(axis=1) / 2
    return np.asarray(nearness.argmax(axis=1))


def _code(levels: np.ndarray, centres: np.ndarray) -> np.ndarray:
    """Return the code of a view, (CODEBOOK_SIZE · 128,) float32, of unit length."""
    values = levels.astype(np.float32)
    word = _words(values, centres)
    sums = np.zeros_like(centres)
    for k in np.unique(word):
        part = (values[word == k] - centres[k]).sum(axis=0)
        sums[k] = part / max(float(np.linalg.norm(part)), 1e-6)
    return np.asarray(sums.ravel() / max(float(np.linalg.norm(sums)), 1e-6))
