"""Errors of the path of a camera."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tisfm.checks import unmasked, whole
from tisfm.errors import InputError
from tisfm.metrics.alignment import align

KITTI_LENGTHS = tuple(100.0 * k for k in range(1, 9))  # m
SHARES = tuple(0.1 * k for k in range(1, 9))  # of a path that is shorter than the first of these
KITTI_EVERY = 10  # frames from one beginning to the next


@dataclass(frozen=True, kw_only=True)
class AbsoluteErrors:
    """How far the centres of a camera are from the true ones.

    Attributes
    ----------
    poses : int
        Frames that were compared.
    similarity, rigid : float
        Root mean square distance after the best similarity, and after the best rigid motion (ATE),
        in the unit of the truth.
    scale : float
        That of the similarity: true lengths per estimated one.

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.metrics import absolute_errors
    >>> truth = np.tile(np.eye(4), (4, 1, 1))
    >>> truth[:, 0, 3] = range(4)
    >>> found = truth.copy()
    >>> found[3] = np.nan  # no pose
    >>> absolute_errors(found, truth).poses
    3
    """

    poses: int
    similarity: float
    rigid: float
    scale: float


@dataclass(frozen=True, kw_only=True)
class RelativeErrors:
    """Errors of the motions between frames (RPE).

    Attributes
    ----------
    pairs : int
        Pairs of frames that were compared.
    step : int
        Frames from the first to the second of a pair.
    translation : float
        Root mean square of the length of what is left of the motion, in the unit of the truth.
    rotation : float
        Root mean square of its angle, degrees.

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
    """Errors of the motions along parts of a path, per length.

    Attributes
    ----------
    segments : int
        Parts that were compared.
    lengths : tuple of float
        Lengths of the parts that were asked for.
    translation : float
        Mean length of what is left of the motion, per length of the part; 0.01 is 1 %.
    rotation : float
        Mean of its angle, degrees per unit of length.

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.metrics import drift
    >>> from tisfm.rigid import pose_matrix
    >>> truth = np.array([pose_matrix([k, 0, 0, 0, 0, 0]) for k in range(9)])
    >>> found = drift(truth, truth, lengths=[2.0])
    >>> found.lengths, found.segments > 0
    ((2.0,), True)
    """

    segments: int
    lengths: tuple[float, ...]
    translation: float
    rotation: float


def path_length(truth: ArrayLike) -> float:
    """Return the length of a path, straight from each frame with a pose to the next.

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
    poses = whole_poses(truth, "truth")
    return float(_travelled(poses[_posed(poses)])[-1]) if _posed(poses).any() else 0.0


def absolute_errors(poses: ArrayLike, truth: ArrayLike) -> AbsoluteErrors:
    """Compare the centres of a camera with the true ones, after an alignment.

    Parameters
    ----------
    poses, truth : array_like, shape (N, 4, 4)
        Estimated and true poses, camera to world; NaN where there is none. Frames count that have
        both.

    Returns
    -------
    AbsoluteErrors

    Raises
    ------
    ValueError
        If shapes differ, a value is masked, or no frame has both.

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
    >>> found = truth.copy()
    >>> found[:, :3, 3] /= 2  # in another unit
    >>> errors = absolute_errors(found, truth)
    >>> round(errors.similarity, 6), round(errors.scale, 6)
    (0.0, 2.0)
    """
    found, true = _both(poses, truth)
    known = _posed(found) & _posed(true)
    centres, goal = found[known, :3, 3], true[known, :3, 3]
    best, rigid = align(centres, goal), align(centres, goal, with_scale=False)
    return AbsoluteErrors(
        poses=int(known.sum()),
        similarity=_root_mean_square(best.apply(centres) - goal),
        rigid=_root_mean_square(rigid.apply(centres) - goal),
        scale=best.scale,
    )


def relative_errors(
    poses: ArrayLike, truth: ArrayLike, *, step: int = 1, scale: float = 1.0
) -> RelativeErrors | None:
    """Compare the motions from frame i to frame i + `step` with the true ones.

    Parameters
    ----------
    poses, truth : array_like, shape (N, 4, 4)
        Estimated and true poses, camera to world; NaN where there is none.
    step : int, default 1
    scale : float, default 1
        What the estimate is multiplied by first, such as `AbsoluteErrors.scale`.

    Returns
    -------
    RelativeErrors or None
        None where there is no such pair of which all four poses are known.

    Raises
    ------
    ValueError
        If shapes differ, a value is masked, no frame has both, or `step` is not a positive whole
        number.

    References
    ----------
    Sturm et al., as for `absolute_errors`: the relative pose error.

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.metrics import relative_errors
    >>> from tisfm.rigid import pose_matrix
    >>> truth = np.array([pose_matrix([k, 0, 0, 0, 0, 0]) for k in range(5)])
    >>> found = np.array([pose_matrix([1.1 * k, 0, 0, 0, 0, 0]) for k in range(5)])
    >>> round(relative_errors(found, truth).translation, 6)  # a frame
    0.1
    """
    whole(1, step=step)
    found, true = _both(poses, truth)
    first = np.arange(max(0, len(found) - step))
    left = _left_over(found, true, first, first + step, scale)
    if not len(left):
        return None
    return RelativeErrors(
        pairs=len(left),
        step=step,
        translation=_root_mean_square(left[:, :3, 3]),
        rotation=float(np.sqrt(np.square(rotation_angles(left)).mean())),
    )


def drift(
    poses: ArrayLike,
    truth: ArrayLike,
    *,
    lengths: Sequence[float] | None = None,
    every: int | None = None,
    scale: float = 1.0,
) -> Drift | None:
    """Compare the motions along parts of the true path of given lengths.

    Parameters
    ----------
    poses, truth : array_like, shape (N, 4, 4)
        Estimated and true poses, camera to world; NaN where there is none.
    lengths : sequence of float, optional
        Of the parts, in the unit of the truth. By default KITTI's, 100, 200, …, 800 m, if the path
        is longer than 100 m; else 10, 20, …, 80 % of it, which may be few frames, so that errors
        are divided by the true length from the first frame of a part to the last. Errors of
        lengths that are given, and of KITTI's, are divided by these, as the benchmark has it.
    every : int, optional
        Frames from the beginning of a part to that of the next; by default KITTI's 10, or 1 where
        the path is no longer than 100 m.
    scale : float, default 1
        What the estimate is multiplied by first.

    Returns
    -------
    Drift or None
        None where no part has both its poses.

    Raises
    ------
    ValueError
        If shapes differ, a value is masked, no frame has both, a length is not positive, or `every`
        is not a positive whole number.

    References
    ----------
    Geiger, Lenz and Urtasun, Are we ready for autonomous driving?, CVPR 2012,
    doi 10.1109/CVPR.2012.6248074. A part ends at the first frame that is farther along the path,
    as in the benchmark's program.

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.metrics import drift
    >>> from tisfm.rigid import pose_matrix
    >>> truth = np.array([pose_matrix([k, 0, 0, 0, 0, 0]) for k in range(9)])
    >>> found = np.array([pose_matrix([1.1 * k, 0, 0, 0, 0, 0]) for k in range(9)])
    >>> round(drift(found, truth).translation, 6)  # a tenth of the way
    0.1
    """
    found, true = _both(poses, truth)
    known = np.flatnonzero(_posed(true))
    along = _travelled(true[known])
    short = along[-1] <= KITTI_LENGTHS[0]
    measured = lengths is None and short
    if lengths is None:
        lengths = [share * along[-1] for share in SHARES] if short else KITTI_LENGTHS
    elif not all(np.isfinite(length) and length > 0 for length in lengths):
        raise InputError(f"lengths are {list(lengths)}: expected positive numbers")
    if every is None:
        every = 1 if short else KITTI_EVERY
    whole(1, every=every)
    begins = np.arange(0, len(known), every)
    translations, rotations = [], []
    for length in lengths:
        ends = np.searchsorted(along, along[begins] + length, side="right")
        first, last = begins[ends < len(known)], ends[ends < len(known)]
        posed = _posed(found)[known[first]] & _posed(found)[known[last]]
        first, last = first[posed], last[posed]
        left = _left_over(found, true, known[first], known[last], scale)
        divisor = along[last] - along[first] if measured else np.full(len(last), length)
        translations.append(np.linalg.norm(left[:, :3, 3], axis=1) / divisor)
        rotations.append(rotation_angles(left) / divisor)
    if not sum(map(len, rotations)):
        return None
    return Drift(
        segments=sum(map(len, rotations)),
        lengths=tuple(lengths),
        translation=float(np.concatenate(translations).mean()),
        rotation=float(np.concatenate(rotations).mean()),
    )


def _left_over(
    found: NDArray, true: NDArray, first: NDArray, second: NDArray, scale: float
) -> NDArray[np.float64]:
    """Return (true motion)⁻¹ · motion, (K, 4, 4), of the pairs whose poses are known."""
    known = _posed(found) & _posed(true)
    counted = known[first] & known[second]
    first, second = first[counted], second[counted]
    scaled = found.copy()
    scaled[:, :3, 3] *= scale
    motion, true_motion = (np.linalg.solve(path[first], path[second]) for path in (scaled, true))
    return np.linalg.solve(true_motion, motion)


def rotation_angles(motions: NDArray) -> NDArray[np.float64]:
    """Return the angles of the rotations in rigid motions, (K, 4, 4), degrees."""
    from scipy.spatial.transform import Rotation  # slow to import

    return np.degrees(Rotation.from_matrix(motions[:, :3, :3]).magnitude())


def _travelled(poses: NDArray) -> NDArray[np.float64]:
    """Return how far along the path each pose is, (N,)."""
    steps = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])


def _both(poses: ArrayLike, truth: ArrayLike) -> tuple[NDArray, NDArray]:
    found, true = whole_poses(poses, "poses"), whole_poses(truth, "truth")
    if found.shape != true.shape:
        raise InputError(f"poses are {found.shape} and truth is {true.shape}: expected as many")
    if not (_posed(found) & _posed(true)).any():
        raise InputError(
            f"no frame has both poses: of {len(found)}, {_posed(found).sum()} have an estimated "
            f"and {_posed(true).sum()} a true one"
        )
    return found, true


def whole_poses(values: ArrayLike, name: str) -> NDArray[np.float64]:
    """Return poses, (N, 4, 4) float64; raise ValueError unless they are such."""
    array = unmasked(values, name, np.float64)
    if array.ndim != 3 or array.shape[1:] != (4, 4):
        raise InputError(f"{name} are {array.shape}: expected (N, 4, 4)")
    return array


def _posed(poses: NDArray) -> NDArray[np.bool_]:
    return np.asarray(np.isfinite(poses).all(axis=(1, 2)))


def _root_mean_square(vectors: NDArray) -> float:
    return float(np.sqrt(np.square(vectors).sum(axis=1).mean()))
