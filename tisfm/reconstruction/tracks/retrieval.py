"""Image retrieval: pairs of views that may show the same scene, however far apart in time."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tisfm.motion.sparse_matches import Features
from tisfm.reconstruction.frames.disk_cache import DiskCache
from tisfm.reconstruction.tracks.settings import TRACKS

# Square roots of descriptors lie in [0, 1]: they are multiplied by this number and stored in 8
# bits.
ROOT_SCALE = 255.0
# Number of views whose codes are in memory at a time. Set by hand.
BLOCK_VIEWS = 512


@dataclass(frozen=True, kw_only=True)
class ImageDescriptors:
    """Points of a view with their descriptors, in 8 bits each."""

    points: np.ndarray  # (N, 2) float64: (x, y), px from the upper left pixel's centre
    # (N, 128) uint8: square roots of the descriptors of these points, times `ROOT_SCALE`
    quantised_roots: np.ndarray

    @classmethod
    def from_features(cls, features: Features) -> "ImageDescriptors":
        """Return the points and quantised descriptors of these features."""
        return cls(
            points=features.points,
            quantised_roots=np.rint(features.roots * ROOT_SCALE).astype(np.uint8),
        )

    @classmethod
    def from_arrays(cls, points: np.ndarray, quantised_roots: np.ndarray) -> "ImageDescriptors":
        """Return the descriptors with these arrays."""
        return cls(points=points, quantised_roots=quantised_roots)

    def to_arrays(self) -> tuple[np.ndarray, ...]:
        """Return the points and the quantised roots."""
        return self.points, self.quantised_roots

    def to_features(self) -> Features:
        """Return the points with descriptors in float32."""
        return Features(
            points=self.points, roots=self.quantised_roots.astype(np.float32) / ROOT_SCALE
        )


def find_similar_views(
    descriptors: Sequence[ImageDescriptors],  # descriptors of views, in the order of their frames
    *,
    min_distance: int,  # smallest distance between the two views of a pair, views
) -> list[tuple[int, int]]:
    """Return pairs of views that may show the same scene, the earlier view first, in order.

    References
    ----------
    Jégou et al., "Aggregating local image descriptors into compact codes", TPAMI 2012,
    doi 10.1109/TPAMI.2011.235 (VLAD). Here the codebook is clustered from the views
    themselves, without training images.
    Arandjelović and Zisserman, "All about VLAD", CVPR 2013, doi 10.1109/CVPR.2013.207 (the
    part of the code that belongs to one word has unit length).
    """
    views = [
        k
        for k, view_descriptors in enumerate(descriptors)
        if len(view_descriptors.points) >= TRACKS.min_described_points
    ]
    if len(views) < 2 or views[-1] - views[0] < min_distance:
        return []
    codebook = _cluster_codebook(descriptors, views)
    codes = DiskCache[np.ndarray](lambda block: (block,), np.asarray)
    candidates: list[tuple[float, int, int]] = []
    neighbour_similarities = []
    for begin in range(0, len(views), BLOCK_VIEWS):
        block = np.stack(
            [
                _encode(descriptors[k].quantised_roots, codebook)
                for k in views[begin : begin + BLOCK_VIEWS]
            ]
        )
        similarities = np.hstack(
            [*(block @ earlier_codes.T for earlier_codes in codes), block @ block.T]
        )
        codes.append(block)
        for row, later in enumerate(views[begin : begin + BLOCK_VIEWS], start=begin):
            similarity = similarities[row - begin, :row]
            neighbour_similarities += similarity[-1:].tolist()
            candidates += [
                (float(similarity[column]), views[column], later)
                for column in _select_candidates(similarity, views, later - min_distance)
            ]
    threshold = TRACKS.min_similarity * float(
        np.median(np.array(neighbour_similarities, np.float32))
    )
    return [
        (earlier, later) for similarity, earlier, later in candidates if similarity >= threshold
    ]


def _select_candidates(similarity: np.ndarray, views: Sequence[int], max_view: int) -> list[int]:
    """Return the indices of the most similar earlier views, ascending.

    `similarity` has one value for each entry of `views`. Views after `max_view` are left out.
    """
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
    """Return the codebook: the centres of clusters of descriptors, (words, 128) float32."""
    sample_size = max(1, TRACKS.codebook_sample // len(views))
    # Evenly spaced descriptors of each view: a random choice would need a seed.
    samples = []
    for k in views[:: -(-len(views) // TRACKS.codebook_sample)]:
        roots = descriptors[k].quantised_roots
        samples.append(
            roots[np.linspace(0, len(roots) - 1, min(sample_size, len(roots))).astype(int)]
        )
    sample = np.vstack(samples).astype(np.float32)
    centres = sample[np.linspace(0, len(sample) - 1, TRACKS.codebook_size).astype(int)]
    for _ in range(TRACKS.codebook_rounds):
        words = _nearest_words(sample, centres)
        for k in range(TRACKS.codebook_size):
            if (words == k).any():
                centres[k] = sample[words == k].mean(axis=0)
    return centres


def _nearest_words(descriptors: np.ndarray, centres: np.ndarray) -> np.ndarray:
    """Return the index of the nearest centre of each descriptor, (N,)."""
    # Half the squared distance, with the opposite sign and without the term |descriptor|².
    nearness = descriptors @ centres.T - (centres**2).sum(axis=1) / 2
    return np.asarray(nearness.argmax(axis=1))


def _encode(descriptors: np.ndarray, codebook: np.ndarray) -> np.ndarray:
    """Return the code of a view, (words · 128,) float32, of unit length."""
    values = descriptors.astype(np.float32)
    words = _nearest_words(values, codebook)
    sums = np.zeros_like(codebook)
    for k in np.unique(words):
        residual = (values[words == k] - codebook[k]).sum(axis=0)
        sums[k] = residual / max(float(np.linalg.norm(residual)), 1e-6)
    return np.asarray(sums.ravel() / max(float(np.linalg.norm(sums)), 1e-6))
