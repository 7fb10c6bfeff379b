"""What came of one pair: its errors, or why there are none."""

from dataclasses import dataclass

from tisfm.camera import Camera
from tisfm.datasets import DatasetPair
from tisfm.metrics import DepthErrors, FlowErrors, OcclusionScores, PoseErrors

LITTLE_PARALLAX = ("little_parallax", "pure_rotation", "no_motion")
"""Codes of a status that say that depth and direction of translation cannot be seen."""


@dataclass(frozen=True, kw_only=True)
class PairEvaluation:
    """What came of one pair.

    Attributes
    ----------
    pair : DatasetPair
        Where its files lie.
    fault : str or None
        Why there are no errors to report, in one line; None if all went well.
    size : (int, int) or None
        Height and width, px.
    camera : Camera or None
        The camera it was interpreted with.
    status, message : str
        How the interpretation ended, and what to try; empty where it was not begun.
    seconds : float or None
        Time of the interpretation. Reading files, compiling kernels, comparing and writing are
        not part of it.
    errors : FlowErrors or None
        Of the flow, where the truth is known; None if the dataset has no true flow.
    visible : FlowErrors or None
        The same without the pixels that are occluded in frame 1, if the dataset says which.
    without_sky : FlowErrors or None
        The same without the sky, if the dataset says where it is.
    occlusion : OcclusionScores or None
        How well our map of occlusion agrees with that of the dataset and what leaves the image,
        where the true flow is known; None if the dataset has none. Where nothing is occluded, its
        count of marked pixels is that of false alarms.
    depth : DepthErrors or None
        Of the depth, scaled by the median, where the truth is known; None if the dataset has no
        true depth, or the interpretation none.
    without_depth : bool
        Whether the dataset has true depth but the interpretation none: its status says that there
        is too little parallax, or no pixel of known depth has one.
    pose : PoseErrors or None
        Of the one motion of the scene before the camera; None if the dataset has no true pose, it
        was given to the interpretation, or the interpretation has no such motion. Where there is
        too little parallax, its direction is None.

    Examples
    --------
    >>> from tisfm.datasets import find_pairs
    >>> from tisfm.evaluation import PairEvaluation
    >>> (pair,) = find_pairs("calibrated", step=8)
    >>> record = PairEvaluation(pair=pair, fault="the file is damaged")  # `evaluate` makes it
    >>> record.depth is None
    True
    """

    pair: DatasetPair
    fault: str | None = None
    size: tuple[int, int] | None = None
    camera: Camera | None = None
    status: str = ""
    message: str = ""
    seconds: float | None = None
    errors: FlowErrors | None = None
    visible: FlowErrors | None = None
    without_sky: FlowErrors | None = None
    occlusion: OcclusionScores | None = None
    depth: DepthErrors | None = None
    without_depth: bool = False
    pose: PoseErrors | None = None

    @property
    def label(self) -> str:
        """Dataset and name."""
        return f"{self.pair.dataset}/{self.pair.name}"

    @property
    def little_parallax(self) -> bool:
        """Whether the interpretation says that the parallax does not suffice for depth."""
        return self.status in LITTLE_PARALLAX
