"""The verdict on a result: what of it is wrong, and whether the program says so.

A piece of a path is wrong if its rotation is off by more than 2°, its path by more than 2 % of its
length, its direction of motion by more than 10°, or the median of its depth by more than 10 %. A
frame is flagged if it is not green (`is_green`).
"""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

import tisfm
from tisfm.metrics import absolute_errors, align, path_length
from tisfm.rigid import nearest_rotation

MAX_ROTATION = 2.0  # degrees
MAX_PATH = 0.02  # share of the length of the path
MAX_DIRECTION = 10.0  # degrees
MAX_DEPTH = 0.10  # share of the depth
MIN_POSES = 3  # poses of a piece that has a path
MIN_PIXELS = 50  # pixels of a frame with a true depth
# A camera whose path is shorter than this share of the median depth only turns.
MIN_PATH = 1e-3
# Share of the frames that have to have depth, or be green, for a sequence to count so.
MOST = 0.5

OUTCOMES = (
    "wrong, green", "wrong, told", "wrong, flagged", "right, flagged", "right, green", "refused",
)  # fmt: skip
MAX_PLANE_RESIDUAL = 1e-3  # of inverse depth, relative: scenes with less are one plane
MIN_SHARE_IN_FRONT = 0.99  # of the pixels that a plane has to be in front of the camera
MIN_ANGLE = 10.0  # degrees between two motions


def is_green(result: tisfm.Reconstruction, frame: int) -> bool:
    """Return whether the program reports a frame as good: its status and its grade."""
    return result.status[frame] == "converged" and result.grade(frame).is_green


def is_green_pair(result: tisfm.Interpretation) -> bool:
    """Return whether the program reports a pair as good: its status and its grade."""
    return result.status == "converged" and result.grade.is_green


@dataclass(frozen=True, kw_only=True)
class Errors:
    """Errors of a piece of a path, or of a pair; None where there is no truth."""

    rotation: float | None = None  # degrees: largest of a frame
    path: float | None = None  # root mean square, share of the length of the path
    direction: float | None = None  # degrees: of the motion in the axes of the camera
    depth: float | None = None  # median of |ΔZ|/Z, each frame in its own scale
    invented: bool = False  # whether there is depth although the camera only turned
    # share of the length of the path: deviation of the true positions, where the truth is inexact
    truth: float = 0.0

    @property
    def faults(self) -> tuple[str, ...]:
        """Names of the errors beyond their limits."""
        limits = {
            "rotation": MAX_ROTATION,
            "path": math.hypot(MAX_PATH, self.truth),
            "direction": MAX_DIRECTION,
            "depth": MAX_DEPTH,
        }
        values = asdict(self)
        found = [n for n, limit in limits.items() if values[n] is not None and values[n] > limit]
        return (*found, *["invented depth"] * self.invented)


@dataclass(frozen=True, kw_only=True)
class Piece:
    """A piece of a result."""

    frames: int
    with_depth: int  # frames that have depth
    green: int  # frames that `is_green` accepts
    converged: int  # frames whose status alone is green
    expected: float | None  # median over frames of the expected relative error of depth
    errors: Errors
    check: dict[str, Any] = field(default_factory=dict)  # numbers of its checks

    @property
    def is_wrong(self) -> bool:
        return bool(self.errors.faults)


def judge_sequence(
    result: tisfm.Reconstruction,
    poses: NDArray | None,  # (N, 4, 4) true poses, camera to world; None if unknown
    depth: Sequence[NDArray | None],  # true depth of the frames, on the pixels of the result
    truth_deviation: float = 0.0,  # of the true positions, in their unit
) -> dict[str, Any]:
    """Return the pieces of a result with their errors, and its outcome."""
    green = np.array([is_green(result, k) for k in range(len(result))])
    converged = np.array([status == "converged" for status in result.status])
    relative = [_depth_error(_stated_depth(result, k), true) for k, true in enumerate(depth)]
    pieces = []
    for number in range(int(result.piece.max(initial=-1)) + 1):
        members = [int(k) for k in np.flatnonzero(result.piece == number)]
        if not members:
            continue
        depth_errors = [error for k in members if (error := relative[k]) is not None]
        errors = path_errors(
            result.poses[members],
            None if poses is None else poses[members],
            median_depth=_median_depth([depth[k] for k in members]),
            estimated_depth=_median_depth([result.depth(k) for k in members]),
            depth_error=float(np.median(depth_errors)) if depth_errors else None,
            truth_deviation=truth_deviation,
        )
        check = check_numbers(result.checks[number]) if number < len(result.checks) else {}
        pieces.append(
            Piece(
                frames=len(members),
                with_depth=sum(bool(np.isfinite(result.depth_error[k])) for k in members),
                green=int(green[members].sum()),
                converged=int(converged[members].sum()),
                expected=_expected([result.depth_error[k] for k in members]),
                errors=errors,
                check=check,
            )
        )
    wrong_green = sum(
        1 for error, good in zip(relative, green, strict=True) if good and (error or 0) > MAX_DEPTH
    )
    return {
        "frames": len(result),
        "posed": int((result.piece >= 0).sum()),
        "green": int(green.sum()),
        "green frames with wrong depth": wrong_green,
        "outcome": outcome(len(result), pieces),
        "outcome by status": outcome(
            len(result), [replace(piece, green=piece.converged) for piece in pieces]
        ),
        "pieces": [
            {**vars(p), "errors": asdict(p.errors), "faults": p.errors.faults} for p in pieces
        ],
        "statuses": dict(Counter(map(str, result.status))),
        "grades": dict(Counter(map(str, result.grades))),
        "messages": [
            *sorted({s.message for s in result.status if s.message})[:4],
            *filter(None, [result.calibration.message, result.focal_note]),
        ],
    }


def outcome(frames: int, pieces: Sequence[Piece]) -> str:
    """Return one of `OUTCOMES`.

    A sequence is wrong if any piece is wrong, and green if any frame of a wrong piece is. If none
    is wrong, it is green if most of its frames are, and refused if most have no depth.
    """
    wrong = [piece for piece in pieces if piece.is_wrong]
    if wrong:
        return "wrong, green" if any(piece.green for piece in wrong) else "wrong, flagged"
    if sum(piece.with_depth for piece in pieces) < MOST * frames:
        return "refused"
    is_most_green = sum(piece.green for piece in pieces) >= MOST * frames
    return "right, green" if is_most_green else "right, flagged"


def path_errors(
    poses: NDArray,  # (N, 4, 4) estimated poses
    truth: NDArray | None,  # (N, 4, 4) true poses; None if unknown
    *,
    median_depth: float | None,  # true
    estimated_depth: float | None,
    depth_error: float | None,
    truth_deviation: float = 0.0,  # of the true positions, in their unit
) -> Errors:
    """Return the errors of a piece."""
    if truth is None or len(poses) < MIN_POSES:
        return Errors(depth=depth_error)
    rotation = rotation_errors(poses, truth).max()
    length = path_length(truth)
    if median_depth is not None and length < MIN_PATH * median_depth:
        spread = float(np.linalg.norm(poses[:, :3, 3] - poses[0, :3, 3], axis=1).max())
        has_depth = estimated_depth is not None
        moved = spread / estimated_depth if estimated_depth else None
        return Errors(rotation=float(rotation), path=moved, invented=has_depth)
    error = absolute_errors(poses, truth).similarity / length
    return Errors(
        rotation=float(rotation),
        path=float(error),
        direction=direction_error(poses, truth),
        depth=depth_error,
        truth=truth_deviation / length,
    )


def rotation_errors(poses: NDArray, truth: NDArray) -> NDArray[np.float64]:
    """Return the angles between the rotations after their best alignment, (N,) degrees."""
    between = truth[:, :3, :3] @ np.swapaxes(poses[:, :3, :3], 1, 2)
    alignment = nearest_rotation(between.sum(axis=0))
    residual = np.swapaxes(alignment[None] @ poses[:, :3, :3], 1, 2) @ truth[:, :3, :3]
    cosine = (np.trace(residual, axis1=1, axis2=2) - 1) / 2
    return np.asarray(np.degrees(np.arccos(np.clip(cosine, -1, 1))))


def direction_error(poses: NDArray, truth: NDArray) -> float | None:
    """Return the median angle between the motions in the axes of the cameras, degrees.

    Motions between frames at least a third of the path apart count.
    """
    steps = np.linalg.norm(np.diff(truth[:, :3, 3], axis=0), axis=1)
    along = np.r_[0, np.cumsum(steps)]
    angles = []
    for i in range(len(truth)):
        for j in range(i + 1, len(truth)):
            if along[j] - along[i] < along[-1] / 3:
                continue
            ours, true = (p[i, :3, :3].T @ (p[j, :3, 3] - p[i, :3, 3]) for p in (poses, truth))
            if np.linalg.norm(ours) > 0 and np.linalg.norm(true) > 0:
                angles.append(np.arctan2(np.linalg.norm(np.cross(ours, true)), ours @ true))
    return float(np.degrees(np.median(angles))) if angles else None


def check_numbers(check: Any) -> dict[str, Any]:
    """Return the medians over pairs of every number of a `PathCheck`, and its objections."""
    record = check.as_json()
    pairs = record.pop("pairs", [])
    names = [name for name in (pairs[0] if pairs else {}) if name not in ("first", "second")]
    numbers = {}
    for name in names:
        values = [pair[name] for pair in pairs if isinstance(pair[name], int | float)]
        numbers[name] = float(np.median(values)) if values else None
    numbers |= {name: value for name, value in record.items() if isinstance(value, int | float)}
    zoom, significance = check.zoom
    return {
        **numbers,
        "zoom_per_frame": zoom,
        "zoom_significance": significance,
        "pairs": len(pairs),
        "objections": list(check.objections),
        "contradicts": check.contradicts,
    }


def judge_pair(
    result: tisfm.Interpretation,
    motion: NDArray | None,  # (4, 4) true motion, P₁ = R P₀ + t; None if unknown
    depth: NDArray | None,  # (H, W) true depth
) -> dict[str, Any]:
    """Return the errors of a pair, and its outcome."""
    from tisfm.rigid import pose_matrix

    depth_error = _depth_error(result.depth, depth)
    has_depth = bool(np.isfinite(result.depth).any())
    errors = Errors(depth=depth_error)
    if motion is not None and result.motions is not None:
        estimate = pose_matrix(result.motions[0])
        angle = float(rotation_angle(estimate[:3, :3].T @ motion[:3, :3]))
        median_depth = _median_depth([depth])
        length = float(np.linalg.norm(motion[:3, 3]))
        if median_depth is not None and length < MIN_PATH * median_depth:
            errors = Errors(rotation=angle, invented=has_depth)
        else:
            ours, true = estimate[:3, 3], motion[:3, 3]
            direction = None
            if has_depth and ours.any() and true.any():
                direction = float(
                    np.degrees(np.arctan2(np.linalg.norm(np.cross(ours, true)), ours @ true))
                )
            errors = Errors(rotation=angle, direction=direction, depth=depth_error)
    converged = result.status == "converged"
    green = is_green_pair(result)
    piece = Piece(
        frames=1,
        with_depth=int(has_depth),
        green=int(green),
        converged=int(converged),
        expected=_expected([result.depth_error]),
        errors=errors,
    )
    return {
        "outcome": outcome(1, [piece]),
        "outcome by status": outcome(1, [replace(piece, green=piece.converged)]),
        "errors": asdict(errors),
        "faults": errors.faults,
        "expected": piece.expected,
        "statuses": {str(result.status): 1},
        "grades": {str(result.grade): 1},
        "messages": [result.status.message] if result.status.message else [],
    }


def has_second_motion(
    depth: NDArray | None,  # (H, W): true depth
    motion: NDArray | None,  # (4, 4): true motion, P₁ = R P₀ + t
    focal: float,  # px
) -> bool:
    """Return whether a pair shows one plane, and a second motion explains it as well.

    No program can tell the two motions apart, because both have the plane in front of the camera.
    """
    if depth is None or motion is None or not motion[:3, 3].any():
        return False
    height, width = depth.shape
    rows, columns = np.mgrid[:height:4, :width:4]
    x, y = (columns - (width - 1) / 2) / focal, (rows - (height - 1) / 2) / focal
    rays = np.stack([x.ravel(), y.ravel(), np.ones(x.size)])
    inverse_depth = 1 / depth[::4, ::4].ravel()
    known = np.isfinite(inverse_depth)
    plane, *_ = np.linalg.lstsq(rays[:, known].T, inverse_depth[known], rcond=None)
    residual = np.abs(plane @ rays[:, known] / inverse_depth[known] - 1)
    if np.median(residual) > MAX_PLANE_RESIDUAL:
        return False
    homography = motion[:3, :3] + np.outer(motion[:3, 3], plane)
    _, _, translations, normals = cv2.decomposeHomographyMat(homography, np.eye(3))
    true = motion[:3, 3] / np.linalg.norm(motion[:3, 3])
    for translation, normal in zip(translations, normals, strict=True):
        direction = translation[:, 0] / np.linalg.norm(translation)
        angle = np.degrees(np.arccos(np.clip(direction @ true, -1, 1)))
        if angle > MIN_ANGLE and (normal[:, 0] @ rays > 0).mean() >= MIN_SHARE_IN_FRONT:
            return True
    return False


def _stated_depth(result: tisfm.Reconstruction, frame: int) -> NDArray:
    """Return the depth of a frame, NaN where it is filled: its deviation is infinite there."""
    is_stated = np.isfinite(result.inverse_depth_std(frame))
    return np.where(is_stated, result.depth(frame), np.float32(np.nan))


def _expected(errors: Sequence[float]) -> float | None:
    known = [float(error) for error in errors if np.isfinite(error)]
    return float(np.median(known)) if known else None


def rotation_angle(rotation: NDArray) -> float:
    """Return the angle of a rotation, (3, 3), degrees."""
    return float(np.degrees(np.arccos(np.clip((np.trace(rotation) - 1) / 2, -1, 1))))


def _depth_error(depth: NDArray, truth: NDArray | None) -> float | None:
    """Return the median of |ΔZ|/Z after scaling by the median ratio; None for too few pixels."""
    if truth is None:
        return None
    both = np.isfinite(depth) & np.isfinite(truth) & (truth > 0)
    if both.sum() < MIN_PIXELS:
        return None
    ratio = depth[both] / truth[both]
    return float(np.median(np.abs(ratio / np.median(ratio) - 1)))


def coverage(
    inverse_depth: NDArray,  # (H, W)
    deviation: NDArray,  # (H, W): its standard deviation
    truth: NDArray | None,  # (H, W): true depth
) -> tuple[float, float] | None:
    """Return the shares of pixels that are off by at most one and at most two deviations.

    Inverse depth is scaled by the median ratio first. None for too few pixels.
    """
    if truth is None:
        return None
    known = np.isfinite(truth) & (truth > 0) & (inverse_depth > 0) & np.isfinite(deviation)
    if known.sum() < MIN_PIXELS:
        return None
    ours, true = inverse_depth[known], 1 / truth[known]
    scale = np.median(true / ours)
    deviations = np.abs(ours * scale - true) / (deviation[known] * scale)
    return float((deviations <= 1).mean()), float((deviations <= 2).mean())


def pose_errors(poses: NDArray, truth: NDArray) -> tuple[NDArray, NDArray]:
    """Return the errors of positions and of rotations in the axes of the cameras, (N, 3) each.

    Positions count after the best similarity, in the unit of the estimate; rotations after the best
    rotation, in degrees.
    """
    centers, true_centers = poses[:, :3, 3], truth[:, :3, 3]
    shift = centers - align(true_centers, centers).apply(true_centers)
    between = truth[:, :3, :3] @ np.swapaxes(poses[:, :3, :3], 1, 2)
    turned = nearest_rotation(between.sum(axis=0)) @ poses[:, :3, :3]
    turns = np.swapaxes(turned, 1, 2) @ truth[:, :3, :3]
    vectors = np.array([cv2.Rodrigues(turn)[0].ravel() for turn in turns])
    return np.einsum("nji,nj->ni", poses[:, :3, :3], shift), np.degrees(vectors)


def pose_coverage(
    result: tisfm.Reconstruction,
    truth: NDArray | None,  # (N, 4, 4) true poses; None if unknown
) -> dict[str, list[float]]:
    """Return the shares of pose errors within one and two deviations, of the largest piece.

    Each axis of each frame counts. Nothing for a short piece, or one whose camera only turns.
    """
    members = np.flatnonzero((result.piece == result.largest_piece) & result.has_position)
    if truth is None or len(members) < MIN_POSES:
        return {}
    poses, true = result.poses[members], truth[members]
    deviations = (result.position_deviation[members], result.rotation_deviation[members])
    shares = {}
    for name, error, deviation in zip(
        ("position", "rotation"), pose_errors(poses, true), deviations, strict=True
    ):
        known = deviation > 0
        if known.any():
            ratio = np.abs(error[known]) / deviation[known]
            shares[f"{name} within"] = [float((ratio <= k).mean()) for k in (1, 2)]
    return shares


def _median_depth(maps: Sequence[NDArray | None]) -> float | None:
    values = [np.nanmedian(m) for m in maps if m is not None and np.isfinite(m).any()]
    return float(np.median(values)) if values else None
