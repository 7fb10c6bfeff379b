"""What the tracks of a sequence show: how long they are, and which motions explain them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tisfm.camera import Camera
from tisfm.reconstruction.rotation.frame_pairs import FramePair, find_frame_pairs
from tisfm.reconstruction.rotation.pair_homography import fit_homography
from tisfm.reconstruction.rotation.settings import FRAME_SIDE, ROTATION
from tisfm.reconstruction.tracks.tracker import Observations
from tisfm.reconstruction.tracks.views import View


@dataclass(frozen=True, kw_only=True)
class TrackMeasures:
    """Measures of the tracks of frames; medians over frames, or over pairs of frames.

    Each is measured when it is needed first.
    """

    frames: Sequence[int]  # in order
    observations: Sequence[Observations]
    views: Sequence[View]
    matches: Mapping[tuple[int, int], np.ndarray]  # by pair of view indices: (N, 2) indices
    camera: Camera  # pinhole camera
    shape: tuple[int, int]

    @cached_property
    def survival(self) -> float:
        """The share of the tracks of a frame that the next frame shows."""
        shares = [
            len(self.observations[frame].common_tracks(self.observations[frame + 1])[0])
            / max(1, len(self.observations[frame].tracks))
            for frame in self.frames[:-1]
        ]
        return float(np.median(shares)) if shares else 1.0

    @cached_property
    def motion(self) -> float:
        """The largest median motion between two frames that share tracks, longer sides."""
        return max((pair.motion for pair in self._pairs), default=0.0) / max(self.shape)

    @cached_property
    def homography(self) -> float:
        """The residual of a homography between frames with large motion; infinite without them.

        It has the unit px of frames with a longer side of 640 px.
        """
        side = max(self.shape)
        wide = [pair for pair in self._pairs if pair.motion >= ROTATION.min_motion * side]
        wide = sorted(wide, key=lambda pair: -pair.motion)[: ROTATION.max_sample_pairs]
        residuals = [fit_homography(pair, side) * FRAME_SIDE / side for pair in wide]
        return float(np.median(residuals)) if residuals else np.inf

    @cached_property
    def _pairs(self) -> list[FramePair]:
        return find_frame_pairs(
            self.frames, self.observations, self.views, self.matches, self.camera, self.shape
        )
