"""Image retrieval: pairs of views that may show the same scene, however far apart in time."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tisfm.motion.sparse_matches import Features
from tisfm.reconstruction.frames.disk_cache import DiskCache
from tisfm.reconstruction.tracks.settings import TRACKS

# Largest value of a descriptor, which is stored in 8 bits.
MAX_LEVEL = 255.0
# Views whose codes are in memory at a time. Set by hand.
BLOCK_VIEWS = 512


@dataclass(frozen=True, kw_only=True)
class ImageDescriptors:
    """Descriptors of a view, in 8 bits each."""

    points: np.ndarray  # (N, 2) float64: (x, y), px from the upper left pixel's centre
    levels: np.ndarray  # (N, 128) uint8: square roots of the descriptors of these points, times 255

    @classmethod
    def from_features(cls, features: Features) -> "ImageDescriptors":
        """Return the descriptors of a view with these points."""
        return cls(
            points=features.points, levels=np.rint(features.roots * MAX_LEVEL).astype(np.uint8)
        )

    @classmethod
    def from_arrays(cls, points: np.ndarray, levels: np.ndarray) -> "ImageDescriptors":
        """Return the descriptors with these arrays."""
        return cls(points=points, levels=levels)

    def to_arrays(self) -> tuple[np.ndarray, ...]:
        """Return its arrays."""
        return self.points, self.levels

    def to_features(self) -> Features:
        """Return the points with their descriptors."""
        return Features(points=self.points, roots=self.levels.astype(np.float32) / MAX_LEVEL)


def find_similar_views(
    descriptors: Sequence[ImageDescriptors],  # descriptors of views, in the order of their frames
    *,
    min_distance: int,  # smallest distance, in views, from the earlier to the later view
) -> list[tuple[int, int]]:
    """Return pairs of views that may show the same scene, the earlier view first, in order.

    References
    ----------
    Jégou et al., "Aggregating local image descriptors into compact codes", TPAMI 2012,
    doi 10.1109/TPAMI.2011.235 (VLAD); the codebook is clustered from these views themselves.
    Arandjelović and Zisserman, "All about VLAD", CVPR 2013, doi 10.1109/CVPR.2013.207 (each
    word's part is of unit length).
    """
    views = [
        k for k, each in enumerate(descriptors) if len(each.points) >= TRACKS.min_described_points
    ]
    if len(views) < 2 or views[-1] - views[0] < min_distance:
        return []
    codebook = _cluster_codebook(descriptors, views)
    codes = DiskCache[np.ndarray](lambda block: (block,), np.asarray)
    candidates: list[tuple[float, int, int]] = []
    next_similarities = []
    for begin in range(0, len(views), BLOCK_VIEWS):
        block = np.stack(
            [_encode(descriptors[k].levels, codebook) for k in views[begin : begin + BLOCK_VIEWS]]
        )
        similarities = np.hstack(
            [*(block @ earlier_codes.T for earlier_codes in codes), block @ block.T]
        )
        codes.append(block)
        for row, later in enumerate(views[begin : begin + BLOCK_VIEWS], start=begin):
            similarity = similarities[row - begin, :row]
            next_similarities += similarity[-1:].tolist()
            candidates += [
                (float(similarity[column]), views[column], later)
                for column in _select_candidates(similarity, views, later - min_distance)
            ]
    threshold = TRACKS.min_similarity * float(np.median(np.array(next_similarities, np.float32)))
    return [(earlier, later) for value, earlier, later in candidates if value >= threshold]


def _select_candidates(similarity: np.ndarray, views: Sequence[int], max_view: int) -> list[int]:
    """Return the earlier views, up to `max_view`, that are most similar to a view, in order."""
    selected: list[int] = []
    for column in np.argsort(-similarity, kind="stable").tolist():
        if len(selected) == TRACKS.max_candidates:
            break
        is_distant = all(
            abs(views[column] - views[other]) >= TRACKS.min_candidate_distance for other in selected
        )
        if views[column] <= max_view and is_distant:
            selected.append(column)
    return sorted(selected)


def _cluster_codebook(descriptors: Sequence[ImageDescriptors], views: Sequence[int]) -> np.ndarray:
    """Return the centres of clusters of descriptors, (words, 128) float32."""
    count = max(1, TRACKS.codebook_sample // len(views))
    # Evenly spaced descriptors of each view: no random choice, and so no seed.
    samples = []
    for k in views[:: -(-len(views) // TRACKS.codebook_sample)]:
        levels = descriptors[k].levels
        samples.append(levels[np.linspace(0, len(levels) - 1, min(count, len(levels))).astype(int)])
    sample = np.vstack(samples).astype(np.float32)
    centres = sample[np.linspace(0, len(sample) - 1, TRACKS.codebook_size).astype(int)]
    for _ in range(TRACKS.codebook_rounds):
        words = _nearest_words(sample, centres)
        for k in range(TRACKS.codebook_size):
            if (words == k).any():
                centres[k] = sample[words == k].mean(axis=0)
    return centres


def _nearest_words(levels: np.ndarray, centres: np.ndarray) -> np.ndarray:
    """Return the nearest centre of each descriptor, (N,)."""
    nearness = levels @ centres.T - (centres**2).sum(axis=1) / 2
    return np.asarray(nearness.argmax(axis=1))


def _encode(levels: np.ndarray, centres: np.ndarray) -> np.ndarray:
    """Return the code of a view, (words · 128,) float32, of unit length."""
    values = levels.astype(np.float32)
    words = _nearest_words(values, centres)
    sums = np.zeros_like(centres)
    for k in np.unique(words):
        residual = (values[words == k] - centres[k]).sum(axis=0)
        sums[k] = residual / max(float(np.linalg.norm(residual)), 1e-6)
    return np.asarray(sums.ravel() / max(float(np.linalg.norm(sums)), 1e-6))
