"""Methods in the comparison of depth: tisfm, and two stages after a flow.

The two stages are the motion of the camera, from an essential matrix by random sampling (OpenCV's
USAC, MAGSAC), and triangulation.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

import tisfm
from bench.depth.pairs import DepthPair
from bench.shared.contest import Method as FlowMethod
from bench.shared.contest import MethodFailure
from tisfm.camera import Camera
from tisfm.evaluation.pair_errors import LITTLE_PARALLAX_STATUSES
from tisfm.rigid import pose_matrix
from tisfm.settings import Motion, Preset, Settings

THRESHOLDS = (0.001, 0.002, 0.005, 0.02, 0.1, 0.5)  # px, of the essential matrix
GRID_CORRESPONDENCES = 4800  # number on a regular grid, about
CONFIDENCE = 0.9999  # of the random sampling
MAX_ITERATIONS = 10_000  # of the random sampling
MIN_CORRESPONDENCES = 5  # for a sample


@dataclass(frozen=True, kw_only=True, eq=False)
class Estimate:
    method: str  # name in the tables
    seconds: float  # wall time of the whole call
    threshold: float | None = None  # of the essential matrix, px
    flow_seconds: float | None = None  # time of the flow, for a method that starts from one
    pose: NDArray | None = None  # (4, 4) float64; P₁ = R P₀ + t
    inverse_depth: NDArray | None = None  # (H, W); signed; None if the method reports no depth
    deviation: NDArray | None = None  # (H, W); standard deviation of the inverse depth
    visible: NDArray | None = None  # (H, W) bool; pixels that the method reports as visible
    status: str = ""
    failure: str = ""  # the reason if there is no result, else ""


class Method(Protocol):
    @property
    def name(self) -> str:
        """Name in the tables."""

    def run(self, pair: DepthPair) -> Sequence[Estimate]:
        """Return an estimate for each threshold; raise MethodFailure if there is none."""


@dataclass(frozen=True)
class OwnMethod:
    """`tisfm.interpret` with a preset and a motion model."""

    preset: Preset
    motion: Motion

    @property
    def name(self) -> str:
        return f"tisfm {self.preset}, {self.motion}"

    def run(self, pair: DepthPair) -> Sequence[Estimate]:
        settings = Settings.preset(self.preset, motion=self.motion)
        pose = pair.pose if pair.pose_given else None
        start_time = time.perf_counter()
        try:
            result = tisfm.interpret(
                pair.frame0, pair.frame1, camera=pair.camera, settings=settings, pose=pose
            )
        except Exception as error:  # a failure must not lose the figures of the other methods
            raise MethodFailure(f"{type(error).__name__}: {error}") from error
        seconds = time.perf_counter() - start_time
        has_depth = result.status not in LITTLE_PARALLAX_STATUSES
        estimated_pose = None if result.motions is None else pose_matrix(result.motions[0])
        return [
            Estimate(
                method=self.name,
                seconds=seconds,
                pose=estimated_pose,
                inverse_depth=result.inverse_depth if has_depth else None,
                deviation=result.inverse_depth_std if has_depth else None,
                visible=~result.occlusion,
                status=str(result.status),
            )
        ]


class FlowThenDepth:
    """A flow, an essential matrix and triangulation.

    `flow` is a method of `bench.shared.contest`: of another library, or of tisfm. Each threshold of
    the essential matrix, px, gives an estimate from the same flow.
    """

    def __init__(self, flow: FlowMethod, thresholds: Sequence[float] = THRESHOLDS) -> None:
        self.flow, self.thresholds = flow, tuple(thresholds)

    @property
    def name(self) -> str:
        return f"{self.flow.name} + essential matrix"

    def run(self, pair: DepthPair) -> Sequence[Estimate]:
        call = self.flow.run(pair.flow_pair())
        pose = pair.pose if pair.pose_given else None
        estimates = []
        for threshold in self.thresholds:
            start_time = time.perf_counter()
            try:
                depth = two_stage(call.flow, pair.camera, threshold=threshold, pose=pose)
                failure = ""
            except NoMotion as none:
                depth, failure = None, str(none)
            seconds = call.seconds + time.perf_counter() - start_time
            estimates.append(
                Estimate(
                    method=self.name,
                    seconds=seconds,
                    threshold=threshold,
                    flow_seconds=call.seconds,
                    pose=None if depth is None else depth.pose,
                    inverse_depth=None if depth is None else depth.inverse_depth,
                    failure=failure,
                )
            )
        return estimates


class NoMotion(ValueError):  # noqa: N818 (an outcome, not an error)
    """No essential matrix was found."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TwoStage:
    pose: NDArray  # (4, 4) float64; P₁ = R P₀ + t, with ‖t‖ = 1 unless it was given
    inverse_depth: NDArray  # (H, W) float64; as triangulated, signed, in units of 1/‖t‖


def two_stage(
    flow: NDArray,  # (H, W, 2), px/frame
    camera: Camera,  # without distortion
    *,
    threshold: float,  # px, largest distance of an inlier from its epipolar line
    pose: ArrayLike | None = None,  # (4, 4); if the motion is known, only depth is triangulated
) -> TwoStage:
    """Return pose and depth from a flow.

    Raise `NoMotion` if there are too few correspondences, or no essential matrix fits them.
    """
    if pose is not None:
        motion = np.array(pose, np.float64)
        return TwoStage(pose=motion, inverse_depth=triangulate(flow, camera, motion))
    motion = np.eye(4)
    motion[:3, :3], motion[:3, 3] = _relative_pose(flow, camera, threshold)
    inverse_depth = triangulate(flow, camera, motion)
    if np.mean(inverse_depth > 0) < 0.5:  # an essential matrix does not determine the sign of t
        motion[:3, 3] *= -1
        inverse_depth = -inverse_depth
    return TwoStage(pose=motion, inverse_depth=inverse_depth)


def triangulate(
    flow: NDArray,  # (H, W, 2), px/frame
    camera: Camera,  # without distortion
    pose: NDArray,  # (4, 4), P₁ = R P₀ + t
) -> NDArray[np.float64]:
    """Return the inverse depth at which every point moves nearest to the end of its flow, (H, W).

    It is signed, in units of 1/‖t‖, and 0 at the epipole.
    """
    height, width = flow.shape[:2]
    cx, cy = camera.center_for(height, width)
    x = (np.arange(width) - cx) / camera.focal
    y = (np.arange(height)[:, None] - cy) / camera.focal
    x1, y1 = x + flow[..., 0] / camera.focal, y + flow[..., 1] / camera.focal
    # R x̂₀ + d t has the direction (x̂₁, ŷ₁, 1): two equations, linear in d.
    rotated_x, rotated_y, rotated_z = (row[0] * x + row[1] * y + row[2] for row in pose[:3, :3])
    tx, ty, tz = pose[:3, 3]
    slope_x, slope_y = tx - x1 * tz, ty - y1 * tz
    remainder_x, remainder_y = x1 * rotated_z - rotated_x, y1 * rotated_z - rotated_y
    square = slope_x**2 + slope_y**2
    inverse_depth = np.zeros((height, width))
    np.divide(
        slope_x * remainder_x + slope_y * remainder_y, square, out=inverse_depth, where=square > 0
    )
    return inverse_depth


def _relative_pose(flow: NDArray, camera: Camera, threshold: float) -> tuple[NDArray, NDArray]:
    """Return R and t, ‖t‖ = 1 and of either sign, of the essential matrix of a flow."""
    height, width = flow.shape[:2]
    stride = max(1, round((height * width / GRID_CORRESPONDENCES) ** 0.5))
    rows, columns = np.mgrid[stride // 2 : height : stride, stride // 2 : width : stride]
    start = np.stack([columns.ravel(), rows.ravel()], axis=1).astype(np.float64)
    end = start + flow[rows.ravel(), columns.ravel()]
    is_inside = ((end >= 0) & (end <= (width - 1, height - 1))).all(axis=1)
    if np.count_nonzero(is_inside) < MIN_CORRESPONDENCES:
        raise NoMotion(
            f"only {np.count_nonzero(is_inside)} of {len(is_inside)} points stay in the image"
        )
    cx, cy = camera.center_for(height, width)
    intrinsic = np.array([[camera.focal, 0, cx], [0, camera.focal, cy], [0, 0, 1.0]])
    essential, _ = cv2.findEssentialMat(
        start[is_inside],
        end[is_inside],
        intrinsic,
        method=cv2.USAC_MAGSAC,
        prob=CONFIDENCE,
        threshold=threshold,
        maxIters=MAX_ITERATIONS,
    )
    if essential is None or essential.shape[0] < 3 or not np.isfinite(essential).all():
        raise NoMotion(f"no essential matrix was found at a threshold of {threshold:g} px")
    rotation0, rotation1, direction = cv2.decomposeEssentialMat(essential[:3])
    # The two rotations differ by half a turn about t; frames are close in time.
    rotation = rotation0 if np.trace(rotation0) > np.trace(rotation1) else rotation1
    return np.asarray(rotation, np.float64), np.asarray(direction, np.float64).ravel()
