"""What the tracks of a sequence show: how long they are, and which motions explain them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from tisfm.camera import Camera
from tisfm.reconstruction.rotation.frame_pairs import FRAME_SIDE, FramePair, frame_pairs
from tisfm.reconstruction.rotation.settings import ROTATION
from tisfm.reconstruction.tracks.tracker import Observations
from tisfm.reconstruction.tracks.views import View


@dataclass(frozen=True, kw_only=True)
class TrackMeasures:
    """Measures of the tracks of frames; medians over frames, or over pairs of frames."""

    survival: float  # share of the tracks of a frame that the next frame shows
    motion: float  # largest median motion between two frames that share tracks, longer sides
    # residual of a homography between frames with large motion, px of frames with a longer side of
    # 640 px; infinite without such frames
    homography: float


def measure_tracks(
    frames: Sequence[int],  # consecutive
    observations: Sequence[Observations],
    views: Sequence[View],
    matches: Mapping[tuple[int, int], np.ndarray],
    camera: Camera,
    shape: tuple[int, int],
) -> TrackMeasures:
    """Return the measures of the tracks of frames."""
    survival = [
        len(observations[frame].common_tracks(observations[frame + 1])[0])
        / max(1, len(observations[frame].tracks))
        for frame in frames[:-1]
    ]
    pairs = frame_pairs(frames, observations, views, matches, camera, shape)
    side = max(shape)
    wide = [pair for pair in pairs if pair.motion >= ROTATION.min_motion * side]
    wide = sorted(wide, key=lambda pair: -pair.motion)[: ROTATION.max_sample_pairs]
    residuals = [_homography_residual(pair) * FRAME_SIDE / side for pair in wide]
    return TrackMeasures(
        survival=float(np.median(survival)) if survival else 1.0,
        motion=max((pair.motion for pair in pairs), default=0.0) / side,
        homography=float(np.median(residuals)) if residuals else np.inf,
    )


def _homography_residual(pair: FramePair) -> float:
    """Return the median residual of the best homography of a pair, px."""
    matrix, _ = cv2.findHomography(pair.before, pair.after, cv2.RANSAC, ROTATION.inlier_pixels)
    if matrix is None:
        return np.inf
    mapped = cv2.perspectiveTransform(pair.before[None], matrix)[0]
    return float(np.median(np.hypot(*(mapped - pair.after).T)))
