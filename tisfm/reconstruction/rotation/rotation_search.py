"""Pieces in which the camera only turns: orientations, and the focal length if it is unknown."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import minimize_scalar

from tisfm.camera import Camera
from tisfm.reconstruction.calibration.settings import CALIBRATION
from tisfm.reconstruction.mapping.settings import MAPPING
from tisfm.reconstruction.mapping.solution import FocalEstimate, Piece
from tisfm.reconstruction.rotation.adjustment import (
    Orientations,
    adjust_orientations,
    measure_residuals,
)
from tisfm.reconstruction.rotation.frame_pairs import FramePair, find_frame_pairs
from tisfm.reconstruction.rotation.pair_homography import fit_homography
from tisfm.reconstruction.rotation.pair_rotation import fit_rotation
from tisfm.reconstruction.rotation.settings import FRAME_SIDE, ROTATION
from tisfm.reconstruction.tracks.tracker import Observations
from tisfm.reconstruction.tracks.views import View


@dataclass(frozen=True, kw_only=True)
class RotationSearch:
    """Searches frames in which the camera only turns."""

    observations: Sequence[Observations]  # tracks in every frame, of a pinhole
    views: Sequence[View]
    matches: Mapping[tuple[int, int], np.ndarray]  # by pair of view indices: (N, 2) indices
    camera: Camera  # pinhole camera
    shape: tuple[int, int]  # height and width of the frames, px
    # largest standard deviation of an estimate that replaces the guess, as a share of the focal
    # length
    max_deviation: float = field(default_factory=lambda: MAPPING.max_useful_deviation)

    def find_piece(
        self,
        frames: Sequence[int],  # in order
        *,
        # Whether the focal length of the camera is used as it is. Otherwise it is estimated.
        is_focal_known: bool,
    ) -> tuple[Piece, FocalEstimate | None] | None:
        """Return a piece with the orientations of frames, and the estimate of the focal length.

        None is returned if the frames show more than a rotation, less than a small turn, or no
        focal length.
        """
        pairs = find_frame_pairs(
            frames, self.observations, self.views, self.matches, self.camera, self.shape
        )
        sample = self._choose_wide_pairs(pairs)
        if not sample:
            return None
        focal = self.camera.focal if is_focal_known else self._find_focal(sample)
        if focal is None:
            return None
        if self._measure_residual_share(sample, focal) > ROTATION.max_first_residual_share:
            return None
        piece_frames, rotations, pairs = self._chain(frames, pairs, focal)
        if len(piece_frames) < ROTATION.min_frames:
            return None
        start = Orientations(rotations=rotations, focal=focal)
        found = adjust_orientations(start, pairs, self._noise, with_focal=not is_focal_known)
        explained = self._find_explained_frames(found, pairs)
        if explained.sum() < ROTATION.min_frames:
            return None
        if explained.mean() < ROTATION.min_explained_share:
            return None
        estimate = None if is_focal_known else self._estimate(found, pairs)
        if not is_focal_known:
            if estimate is None or not self._is_plausible(estimate):
                return None
            if not estimate.is_useful:  # the guess is better known, as one from EXIF data
                with_guess = self.find_piece(frames, is_focal_known=True)
                return None if with_guess is None else (with_guess[0], estimate)
        poses = {}
        for frame, rotation in zip(
            np.array(piece_frames)[explained].tolist(), found.rotations[explained], strict=True
        ):
            poses[frame] = np.eye(4)
            poses[frame][:3, :3] = rotation
        return Piece(poses=poses, views=(), points={}, only_turns=True), estimate

    @property
    def _side(self) -> int:
        return max(self.shape)

    @property
    def _scale(self) -> float:
        """Factor from px of frames with a longer side of 640 px to px of these frames."""
        return self._side / FRAME_SIDE

    @property
    def _noise(self) -> float:
        return ROTATION.outlier_pixels * self._scale

    def _choose_wide_pairs(self, pairs: Sequence[FramePair]) -> list[FramePair]:
        """Return pairs with large motions, spread over the frames."""
        widest: dict[int, FramePair] = {}
        for pair in pairs:
            if pair.motion > widest.get(pair.first, pair).motion or pair.first not in widest:
                widest[pair.first] = pair
        candidates = [
            pair
            for _, pair in sorted(widest.items())
            if pair.motion >= ROTATION.min_motion * self._side
        ]
        count = min(len(candidates), ROTATION.max_sample_pairs)
        return [candidates[k] for k in np.linspace(0, len(candidates) - 1, count).astype(int)]

    def _measure_residual_share(self, pairs: Sequence[FramePair], focal: float) -> float:
        """Return the median residual of a rotation for each pair, divided by the motion."""
        shares = [
            float(np.median(fit_rotation(pair.before, pair.after, focal, self._noise)[1]))
            / pair.motion
            for pair in pairs
        ]
        return float(np.median(shares))

    def _find_focal(self, pairs: Sequence[FramePair]) -> float | None:
        """Return the focal length with which rotations explain pairs best; None outside a range."""

        def measure_cost(log_focal: float) -> float:
            return sum(
                float(
                    np.log1p(
                        (
                            fit_rotation(pair.before, pair.after, np.exp(log_focal), self._noise)[1]
                            / self._noise
                        )
                        ** 2
                    ).mean()
                )
                for pair in pairs
            )

        low, high = np.log(np.array(ROTATION.focal_range) * self._side)
        grid = np.linspace(low, high, ROTATION.focal_candidates)
        best = int(np.argmin([measure_cost(log_focal) for log_focal in grid]))
        if best in (0, len(grid) - 1):
            return None
        bounds = grid[best - 1], grid[best + 1]
        return float(np.exp(minimize_scalar(measure_cost, bounds=bounds, method="bounded").x))

    def _chain(
        self, frames: Sequence[int], pairs: Sequence[FramePair], focal: float
    ) -> tuple[list[int], np.ndarray, list[FramePair]]:
        """Return the frames that rotations connect, their orientations, and their pairs.

        The pairs have indices of the returned frames. Of several connected sets the largest is
        returned.
        """
        tolerance = ROTATION.inlier_pixels * self._scale
        turns: dict[int, list[tuple[int, np.ndarray]]] = {frame: [] for frame in frames}
        agreeing = []
        for pair in pairs:
            rotation, residuals = fit_rotation(pair.before, pair.after, focal, self._noise)
            if np.mean(residuals < tolerance) >= ROTATION.min_inlier_share:
                turns[pair.first].append((pair.second, rotation))
                turns[pair.second].append((pair.first, rotation.T))
                agreeing.append(pair)
        best: dict[int, np.ndarray] = {}
        remaining = set(frames)
        while remaining:
            begin = min(remaining)
            known, waiting = {begin: np.eye(3)}, [begin]
            while waiting:
                frame = waiting.pop(0)
                for other, turn in turns[frame]:
                    if other not in known:
                        known[other] = known[frame] @ turn.T
                        waiting.append(other)
            remaining -= known.keys()
            best = max(best, known, key=len)
        chosen = sorted(best)
        index = {frame: k for k, frame in enumerate(chosen)}
        return (
            chosen,
            np.array([best[frame] for frame in chosen]),
            [
                replace(pair, first=index[pair.first], second=index[pair.second])
                for pair in agreeing
                if pair.first in index
            ],
        )

    def _find_explained_frames(self, found: Orientations, pairs: Sequence[FramePair]) -> np.ndarray:
        """Return which frames a rotation explains, (F,) bool, by their pairs with most motion."""
        of_frame: list[list[tuple[float, float]]] = [[] for _ in found.rotations]
        for pair, residuals in zip(pairs, measure_residuals(pairs, found), strict=True):
            if pair.motion >= ROTATION.min_motion * self._side:
                for frame in (pair.first, pair.second):
                    of_frame[frame].append((pair.motion, float(np.median(residuals)) / pair.motion))
        rotation, homography, motion = self._compare_with_homographies(found, pairs).T
        if (
            not len(motion)
            or np.median(rotation / homography) > ROTATION.max_homography_ratio
            or np.median(rotation / motion) > ROTATION.max_residual_share
        ):
            return np.zeros(len(of_frame), bool)
        return np.array(
            [
                bool(shares)
                and np.median([share for _, share in sorted(shares)[-ROTATION.max_frame_pairs :]])
                <= ROTATION.max_frame_residual_share
                for shares in of_frame
            ]
        )

    def _compare_with_homographies(
        self, found: Orientations, pairs: Sequence[FramePair]
    ) -> np.ndarray:
        """Return (N, 3): residuals of rotation and homography and the motion, px, of wide pairs."""
        widest = self._choose_wide_pairs(pairs)
        smallest = ROTATION.min_homography_residual * self._scale
        fits = [fit_homography(pair, self._side) for pair in widest]
        homographies = [max(smallest, fit) if np.isfinite(fit) else smallest for fit in fits]
        return np.array(
            [
                [np.median(residuals), homography, pair.motion]
                for pair, homography, residuals in zip(
                    widest, homographies, measure_residuals(widest, found), strict=True
                )
            ]
        ).reshape(-1, 3)

    def _estimate(self, found: Orientations, pairs: Sequence[FramePair]) -> FocalEstimate | None:
        """Return the focal length, with the deviation from halves of the time and of the image.

        Halves without points are left out. None is returned if fewer than two halves remain.
        """
        halves = [half for half in _halve(found, pairs) if half]
        if len(halves) < ROTATION.min_halves:
            return None
        errors = []
        for number, half in enumerate(halves):
            factor = ROTATION.half_start_factor ** (1 if number % 2 else -1)
            start = replace(found, focal=factor * found.focal)
            focal = adjust_orientations(start, half, self._noise, with_focal=True).focal
            errors.append(np.log(focal / found.focal))
        spread = CALIBRATION.spread_to_deviation * float(np.sqrt(np.mean(np.square(errors))))
        rotation, homography, motion = self._compare_with_homographies(found, pairs).T
        excess = np.sqrt(np.maximum(rotation**2 - homography**2, 0)) / motion
        arc = ROTATION.arc_deviation * float(np.median(excess))
        deviation = float(np.linalg.norm([spread, ROTATION.focal_deviation, arc]))
        return FocalEstimate(
            focal=found.focal,
            deviation=deviation * found.focal,
            max_deviation=self.max_deviation,
        )

    def _is_plausible(self, estimate: FocalEstimate) -> bool:
        """Return whether a focal length is shown at all, clearly within the searched range."""
        low, high = np.array(ROTATION.focal_range) * self._side
        return (
            estimate.deviation <= MAPPING.max_useful_deviation * estimate.focal
            and estimate.focal - estimate.deviation > low
            and estimate.focal + estimate.deviation < high
        )


def _halve(found: Orientations, pairs: Sequence[FramePair]) -> list[list[FramePair]]:
    """Return the pairs of each half of the time, and the points in each half of the image."""
    middle = len(found.rotations) // 2
    halves = [
        [pair for pair in pairs if max(pair.first, pair.second) <= middle],
        [pair for pair in pairs if min(pair.first, pair.second) >= middle],
    ]
    for axis in (0, 1):
        for sign in (-1, 1):
            chosen = [(pair, sign * pair.before[:, axis] > 0) for pair in pairs]
            halves.append(
                [
                    replace(pair, before=pair.before[half], after=pair.after[half])
                    for pair, half in chosen
                    if half.any()
                ]
            )
    return halves
