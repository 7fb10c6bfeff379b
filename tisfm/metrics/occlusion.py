"""Precision and recall of an occlusion map."""

from dataclasses import dataclass

from numpy.typing import ArrayLike

from tisfm.checks import check_mask
from tisfm.errors import InputError
from tisfm.metrics.valid_pixels import compared_pixels


@dataclass(frozen=True, kw_only=True)
class OcclusionScores:
    """Precision and recall of an occlusion map.

    Attributes
    ----------
    precision : float
        Share of the marked pixels that are occluded, in [0, 1]; 0 if none is marked.
    recall : float
        Share of the occluded pixels that are marked, in [0, 1]; 0 if none is occluded.
    f1 : float
        Harmonic mean of precision and recall.
    hits, marked, occluded : int
        Pixels that are marked and occluded, that are marked, and that are occluded. The counts of
        several maps can be added.
    pixels : int
        Number of compared pixels.

    Examples
    --------
    >>> from tisfm.metrics import OcclusionScores
    >>> scores = OcclusionScores.from_counts(hits=4, marked=4, occluded=8, pixels=16)
    >>> scores.precision, scores.recall, round(scores.f1, 3)
    (1.0, 0.5, 0.667)
    """

    precision: float
    recall: float
    f1: float
    hits: int
    marked: int
    occluded: int
    pixels: int

    @classmethod
    def from_counts(
        cls, *, hits: int, marked: int, occluded: int, pixels: int
    ) -> "OcclusionScores":
        """Return the scores that follow from the counts."""
        return cls(
            precision=hits / max(marked, 1),
            recall=hits / max(occluded, 1),
            f1=2 * hits / max(marked + occluded, 1),
            hits=hits,
            marked=marked,
            occluded=occluded,
            pixels=pixels,
        )


def occlusion_scores(
    occlusion: ArrayLike, truth: ArrayLike, *, mask: ArrayLike | None = None
) -> OcclusionScores:
    """Compare an occlusion map with the truth.

    Parameters
    ----------
    occlusion, truth : array_like, shape (H, W)
        Estimated and true occlusion, nonzero where a pixel is not visible in the other frame.
    mask : array_like, shape (H, W), optional
        Nonzero where pixels count.

    Returns
    -------
    OcclusionScores

    Raises
    ------
    ValueError
        If shapes differ, a value is masked, or no pixel counts.

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.metrics import occlusion_scores
    >>> truth = np.zeros((4, 4), bool)
    >>> truth[:2] = True
    >>> estimate = np.zeros((4, 4), bool)
    >>> estimate[0] = True
    >>> scores = occlusion_scores(estimate, truth)
    >>> scores.precision, scores.recall
    (1.0, 0.5)
    """
    is_marked, is_occluded = check_mask(occlusion, "occlusion"), check_mask(truth, "truth")
    if is_marked.shape != is_occluded.shape or is_marked.ndim != 2:
        raise InputError(
            f"occlusion is {is_marked.shape} and truth is {is_occluded.shape}: both must be (H, W)"
        )
    is_compared = compared_pixels(mask, is_marked.shape)
    if not is_compared.any():
        raise InputError("no pixel counts: the mask is zero everywhere")
    hits, marked, occluded = (
        int((pixels & is_compared).sum())
        for pixels in (is_marked & is_occluded, is_marked, is_occluded)
    )
    return OcclusionScores.from_counts(
        hits=hits, marked=marked, occluded=occluded, pixels=int(is_compared.sum())
    )
