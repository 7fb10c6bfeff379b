"""Errors of the trajectory of a camera: ATE, RPE and KITTI's drift."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tisfm.checks import check_unmasked, check_whole_numbers
from tisfm.errors import InputError
from tisfm.metrics.alignment import align

KITTI_LENGTHS = tuple(100.0 * k for k in range(1, 9))
"""Lengths of the segments of KITTI's odometry benchmark, m."""

KITTI_START_INTERVAL = 10
"""Frames between the starts of segments, as in that benchmark."""

LENGTH_SHARES = tuple(0.1 * k for k in range(1, 9))
"""Lengths of segments as shares of the path, for paths up to 100 m."""


@dataclass(frozen=True, kw_only=True)
class AbsoluteErrors:
    """Absolute trajectory errors (ATE): distances of camera centres from the true centres.

    Attributes
    ----------
    poses : int
        Number of frames that were compared.
    similarity, rigid : float
        Root mean square distance after alignment by a similarity, and by a rigid motion, in the
        unit of the truth.
    scale : float
        Scale of the similarity: true length per estimated length.

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.metrics import absolute_errors
    >>> truth = np.tile(np.eye(4), (4, 1, 1))
    >>> truth[:, 0, 3] = range(4)
    >>> estimated = truth.copy()
    >>> estimated[3] = np.nan  # no pose
    >>> absolute_errors(estimated, truth).poses
    3
    """

    poses: int
    similarity: float
    rigid: float
    scale: float


@dataclass(frozen=True, kw_only=True)
class RelativeErrors:
    """Relative pose errors (RPE): errors of the motions between frames.

    The residual motion of a pair of frames is the estimated motion times the inverse true motion.

    Attributes
    ----------
    pairs : int
        Number of pairs of frames that were compared.
    step : int
        Frames from the first to the second frame of a pair.
    translation : float
        Root mean square length of the residual translations, in the unit of the truth.
    rotation : float
        Root mean square angle of the residual rotations, degrees.

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.metrics import relative_errors
    >>> from tisfm.rigid import pose_matrix
    >>> truth = np.array([pose_matrix([k, 0, 0, 0, 0, 0]) for k in range(5)])
    >>> errors = relative_errors(truth, truth, step=2)
    >>> errors.pairs, errors.step
    (3, 2)
    """

    pairs: int
    step: int
    translation: float
    rotation: float


@dataclass(frozen=True, kw_only=True)
class Drift:
    """Errors of the motions along segments of a path, per length.

    Attributes
    ----------
    segments : int
        Number of segments that were compared.
    lengths : tuple of float
        Lengths of the segments, in the unit of the truth.
    translation : float
        Mean length of the residual translation per length of the segment; 0.01 is 1 %.
    rotation : float
        Mean angle of the residual rotation, degrees per unit of length.

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.metrics import drift
    >>> from tisfm.rigid import pose_matrix
    >>> truth = np.array([pose_matrix([k, 0, 0, 0, 0, 0]) for k in range(9)])
    >>> errors = drift(truth, truth, lengths=[2.0])
    >>> errors.lengths, errors.segments > 0
    ((2.0,), True)
    """

    segments: int
    lengths: tuple[float, ...]
    translation: float
    rotation: float


def path_length(truth: ArrayLike) -> float:
    """Return the length of a path: the sum of the distances between consecutive known poses.

    Parameters
    ----------
    truth : array_like, shape (N, 4, 4)
        Camera to world; NaN where there is no pose.

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.metrics import path_length
    >>> from tisfm.rigid import pose_matrix
    >>> path_length(np.array([pose_matrix([k, 0, 0, 0, 0, 0]) for k in range(4)]))
    3.0
    """
    poses = check_poses(truth, "truth")
    return float(_distances_along(poses[_has_pose(poses)])[-1]) if _has_pose(poses).any() else 0.0


def absolute_errors(poses: ArrayLike, truth: ArrayLike) -> AbsoluteErrors:
    """Compare the centres of a camera with the true centres, after an alignment.

    Parameters
    ----------
    poses, truth : array_like, shape (N, 4, 4)
        Estimated and true poses, camera to world; NaN for a missing pose. Frames with both poses
        count.

    Returns
    -------
    AbsoluteErrors

    Raises
    ------
    ValueError
        If shapes differ, a value is masked, or no frame has both poses.

    References
    ----------
    Sturm et al., A benchmark for the evaluation of RGB-D SLAM systems, IROS 2012,
    doi 10.1109/IROS.2012.6385773: the absolute trajectory error. `tisfm.metrics.align` has the
    source of the alignment.

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.metrics import absolute_errors
    >>> from tisfm.rigid import pose_matrix
    >>> truth = np.array([pose_matrix([k, 0, 0.1 * k * k, 0, 0, 0]) for k in range(5)])
    >>> estimated = truth.copy()
    >>> estimated[:, :3, 3] /= 2  # in another unit
    >>> errors = absolute_errors(estimated, truth)
    >>> round(errors.similarity, 6), round(errors.scale, 6)
    (0.0, 2.0)
    """
    estimated_poses, true_poses = _check_both(poses, truth)
    has_both = _has_pose(estimated_poses) & _has_pose(true_poses)
    centres, true_centres = estimated_poses[has_both, :3, 3], true_poses[has_both, :3, 3]
    similarity, rigid = align(centres, true_centres), align(centres, true_centres, with_scale=False)
    return AbsoluteErrors(
        poses=int(has_both.sum()),
        similarity=_root_mean_square(similarity.apply(centres) - true_centres),
        rigid=_root_mean_square(rigid.apply(centres) - true_centres),
        scale=similarity.scale,
    )


def relative_errors(
    poses: ArrayLike, truth: ArrayLike, *, step: int = 1, scale: float = 1.0
) -> RelativeErrors | None:
    """Compare the motions from frame i to frame i + `step` with the true motions.

    Parameters
    ----------
    poses, truth : array_like, shape (N, 4, 4)
        Estimated and true poses, camera to world; NaN for a missing pose.
    step : int, default 1
    scale : float, default 1
        Factor of the estimated translations before comparing, such as `AbsoluteErrors.scale`.

    Returns
    -------
    RelativeErrors or None
        None if no pair has all four poses.

    Raises
    ------
    ValueError
        If shapes differ, a value is masked, no frame has both poses, or `step` is not a positive
        whole number.

    References
    ----------
    Sturm et al., as for `absolute_errors`: the relative pose error.

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.metrics import relative_errors
    >>> from tisfm.rigid import pose_matrix
    >>> truth = np.array([pose_matrix([k, 0, 0, 0, 0, 0]) for k in range(5)])
    >>> estimated = np.array([pose_matrix([1.1 * k, 0, 0, 0, 0, 0]) for k in range(5)])
    >>> round(relative_errors(estimated, truth).translation, 6)  # per frame
    0.1
    """
    check_whole_numbers(1, step=step)
    estimated_poses, true_poses = _check_both(poses, truth)
    begin = np.arange(max(0, len(estimated_poses) - step))
    residuals = _residual_motions(estimated_poses, true_poses, begin, begin + step, scale)
    if not len(residuals):
        return None
    return RelativeErrors(
        pairs=len(residuals),
        step=step,
        translation=_root_mean_square(residuals[:, :3, 3]),
        rotation=float(np.sqrt(np.square(rotation_angles(residuals)).mean())),
    )


def drift(
    poses: ArrayLike,
    truth: ArrayLike,
    *,
    lengths: Sequence[float] | None = None,
    every: int | None = None,
    scale: float = 1.0,
) -> Drift | None:
    """Compare the motions along segments of the true path that have given lengths.

    Parameters
    ----------
    poses, truth : array_like, shape (N, 4, 4)
        Estimated and true poses, camera to world; NaN for a missing pose.
    lengths : sequence of float, optional
        Lengths of the segments, in the unit of the truth. By default KITTI's 100, 200, …, 800 m for
        a path longer than 100 m, else 10, 20, …, 80 % of the path. Errors are divided by these
        lengths, as in the benchmark. By default on a path up to 100 m, whose segments may have few
        frames, they are divided by the true length from the first frame of a segment to the last.
    every : int, optional
        Frames between the starts of segments; by default KITTI's 10, or 1 for a path up to 100 m.
    scale : float, default 1
        Factor of the estimated translations before comparing.

    Returns
    -------
    Drift or None
        None if no segment has estimated poses at both ends.

    Raises
    ------
    ValueError
        If shapes differ, a value is masked, no frame has both poses, a length is not positive, or
        `every` is not a positive whole number.

    References
    ----------
    Geiger, Lenz and Urtasun, Are we ready for autonomous driving?, CVPR 2012,
    doi 10.1109/CVPR.2012.6248074. A segment ends at the first frame beyond its length, as in the
    program of the benchmark.

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.metrics import drift
    >>> from tisfm.rigid import pose_matrix
    >>> truth = np.array([pose_matrix([k, 0, 0, 0, 0, 0]) for k in range(9)])
    >>> estimated = np.array([pose_matrix([1.1 * k, 0, 0, 0, 0, 0]) for k in range(9)])
    >>> round(drift(estimated, truth).translation, 6)  # a tenth of the length
    0.1
    """
    estimated_poses, true_poses = _check_both(poses, truth)
    frames = np.flatnonzero(_has_pose(true_poses))
    distances = _distances_along(true_poses[frames])
    is_short = distances[-1] <= KITTI_LENGTHS[0]
    uses_shares = lengths is None and is_short
    if lengths is None:
        lengths = [share * distances[-1] for share in LENGTH_SHARES] if is_short else KITTI_LENGTHS
    elif not all(np.isfinite(length) and length > 0 for length in lengths):
        raise InputError(f"lengths are {list(lengths)}: expected positive numbers")
    if every is None:
        every = 1 if is_short else KITTI_START_INTERVAL
    check_whole_numbers(1, every=every)
    starts = np.arange(0, len(frames), every)
    translations, rotations = [], []
    for length in lengths:
        ends = np.searchsorted(distances, distances[starts] + length, side="right")
        begin, end = starts[ends < len(frames)], ends[ends < len(frames)]
        has_both_ends = (
            _has_pose(estimated_poses)[frames[begin]] & _has_pose(estimated_poses)[frames[end]]
        )
        begin, end = begin[has_both_ends], end[has_both_ends]
        residuals = _residual_motions(
            estimated_poses, true_poses, frames[begin], frames[end], scale
        )
        divisor = distances[end] - distances[begin] if uses_shares else np.full(len(end), length)
        translations.append(np.linalg.norm(residuals[:, :3, 3], axis=1) / divisor)
        rotations.append(rotation_angles(residuals) / divisor)
    if not sum(map(len, rotations)):
        return None
    return Drift(
        segments=sum(map(len, rotations)),
        lengths=tuple(lengths),
        translation=float(np.concatenate(translations).mean()),
        rotation=float(np.concatenate(rotations).mean()),
    )


def _residual_motions(
    estimated_poses: NDArray, true_poses: NDArray, begin: NDArray, end: NDArray, scale: float
) -> NDArray[np.float64]:
    """Return (true motion)⁻¹ · motion, (K, 4, 4), of the pairs with all poses."""
    has_both = _has_pose(estimated_poses) & _has_pose(true_poses)
    is_complete = has_both[begin] & has_both[end]
    begin, end = begin[is_complete], end[is_complete]
    scaled_poses = estimated_poses.copy()
    scaled_poses[:, :3, 3] *= scale
    motion, true_motion = (
        np.linalg.solve(path[begin], path[end]) for path in (scaled_poses, true_poses)
    )
    return np.linalg.solve(true_motion, motion)


def rotation_angles(motions: NDArray) -> NDArray[np.float64]:
    """Return the angles of the rotations in rigid motions, (K, 4, 4), degrees."""
    from scipy.spatial.transform import Rotation  # slow to import

    return np.degrees(Rotation.from_matrix(motions[:, :3, :3]).magnitude())


def _distances_along(poses: NDArray) -> NDArray[np.float64]:
    """Return the distance of each pose from the start along the path, (N,)."""
    steps = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])


def _check_both(poses: ArrayLike, truth: ArrayLike) -> tuple[NDArray, NDArray]:
    estimate, reference = check_poses(poses, "poses"), check_poses(truth, "truth")
    if estimate.shape != reference.shape:
        raise InputError(
            f"poses are {estimate.shape} and truth is {reference.shape}: expected the same number"
        )
    if not (_has_pose(estimate) & _has_pose(reference)).any():
        raise InputError(
            f"no frame has both an estimated and a true pose: of {len(estimate)} frames, "
            f"{_has_pose(estimate).sum()} have an estimated and "
            f"{_has_pose(reference).sum()} a true one; check that both lists have the same frames"
        )
    return estimate, reference


def check_poses(values: ArrayLike, name: str) -> NDArray[np.float64]:
    """Return poses as float64; raise ValueError unless they are (N, 4, 4)."""
    array = check_unmasked(values, name, np.float64)
    if array.ndim != 3 or array.shape[1:] != (4, 4):
        raise InputError(f"{name} are {array.shape}: expected (N, 4, 4)")
    return array


def _has_pose(poses: NDArray) -> NDArray[np.bool_]:
    return np.asarray(np.isfinite(poses).all(axis=(1, 2)))


def _root_mean_square(vectors: NDArray) -> float:
    return float(np.sqrt(np.square(vectors).sum(axis=1).mean()))
