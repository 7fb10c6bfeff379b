"""Errors of the path of a moving object."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tisfm.errors import InputError
from tisfm.metrics.alignment import Similarity
from tisfm.metrics.trajectory_errors import check_poses, path_length, rotation_angles
from tisfm.rigid import nearest_rotation

MIN_FRAMES = 3
"""Frames that a comparison needs: 9 equations for the 4 unknowns, a scale and an offset."""


@dataclass(frozen=True, kw_only=True)
class ObjectPathErrors:
    """Errors of the estimated poses of a moving object.

    Attributes
    ----------
    frames : int
        Number of frames that were compared.
    position : float
        Root mean square distance between the estimated and the true position of the origin of the
        estimated axes, in the unit of the truth.
    share : float or None
        The same divided by the length of the true path of the object in these frames; None if the
        object stands still.
    rotation : float
        Root mean square angle between the estimated and the true axes, degrees.
    scale : float
        Factor of the estimated distances from the camera, in the aligned world.
    offset : tuple of float
        Origin of the estimated axes in the true axes, (x, y, z), in the unit of the truth.

    Examples
    --------
    >>> from tisfm.metrics import object_path_errors
    >>> from tisfm.scenes import bodies_film, bodies_path
    >>> film = bodies_film(bodies_path(5), 24, 32, bodies=1)
    >>> body = film.body_poses[0]
    >>> errors = object_path_errors(body, body, film.poses, film.poses)
    >>> round(errors.scale, 6)  # relative to the world
    1.0
    """

    frames: int
    position: float
    share: float | None
    rotation: float
    scale: float
    offset: tuple[float, float, float]


def object_path_errors(
    poses: ArrayLike, truth: ArrayLike, cameras: ArrayLike, true_cameras: ArrayLike
) -> ObjectPathErrors | None:
    """Compare the estimated path of a moving object with its true path, in the world.

    Parameters
    ----------
    poses, truth : array_like, shape (N, 4, 4)
        Estimated and true pose of the object in each frame, object to world; NaN if unknown.
    cameras, true_cameras : array_like, shape (N, 4, 4)
        Estimated and true poses of the camera, camera to world; NaN if unknown. The estimated world
        is aligned with the true world by all frames that have both.

    Returns
    -------
    ObjectPathErrors or None
        None if fewer than 3 frames have all four poses.

    Raises
    ------
    ValueError
        If the arrays have other or different shapes, or a value is masked.

    Notes
    -----
    Images do not determine three quantities, which are fitted:

    - The world: a similarity p ↦ s R p + t. R is the rotation nearest to the relative rotations of
      all cameras. (The rotation of the best alignment of centres is not unique on a straight path.)
      s and t then align the centres in least squares.
    - The scale of the object relative to the world: with the camera centre c_k in frame k, and d_k
      from the camera to the estimated position, the object may also be at c_k + σ d_k, with one
      σ ≥ 0 for all frames.
    - The axes of the object: the origin of the estimated axes is at q in the true axes, and the
      estimated axes are the true axes rotated by Q.

    With true poses (B_k, b_k), σ and q minimise Σ ‖c_k + σ d_k - B_k q - b_k‖², which is linear.
    If the frames do not determine the minimum (an object that moves with the camera and does not
    rotate), the solution nearest to σ = 1 and q = 0 is taken. Q is the rotation nearest to all
    B_kᵀ R O_k, with estimated axes O_k. Errors are of the origin of the estimated axes: `offset`
    tells whether it is far outside of the object.

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.metrics import object_path_errors
    >>> from tisfm.scenes import bodies_film, bodies_path
    >>> film = bodies_film(bodies_path(5), 24, 32, bodies=1)
    >>> body = film.body_poses[0]
    >>> errors = object_path_errors(body, body, film.poses, film.poses)  # with itself
    >>> errors.frames, round(errors.share, 6), round(errors.rotation, 3)
    (5, 0.0, 0.0)
    """
    estimated_poses, true_poses, camera, true_camera = (
        check_poses(values, name)
        for values, name in (
            (poses, "poses"),
            (truth, "truth"),
            (cameras, "cameras"),
            (true_cameras, "true_cameras"),
        )
    )
    shapes = [path.shape for path in (estimated_poses, true_poses, camera, true_camera)]
    if len(set(shapes)) > 1:
        numbers = ", ".join(
            str(len(path)) for path in (estimated_poses, true_poses, camera, true_camera)
        )
        raise InputError(
            f"poses, truth, cameras and true_cameras are of {numbers} frames: expected the "
            "same number"
        )
    has_cameras = _has_pose(camera) & _has_pose(true_camera)
    has_all = has_cameras & _has_pose(estimated_poses) & _has_pose(true_poses)
    if has_all.sum() < MIN_FRAMES:
        return None
    world = _align_world(camera[has_cameras], true_camera[has_cameras])
    length = path_length(true_poses[has_all])
    centre = world.apply(camera[has_all, :3, 3])
    from_camera = world.apply(estimated_poses[has_all, :3, 3]) - centre
    rotations, positions = true_poses[has_all, :3, :3], true_poses[has_all, :3, 3]
    scale, offset = _fit_scale_and_offset(centre, from_camera, rotations, positions)
    residual = centre + scale * from_camera - rotations @ offset - positions
    axes = world.rotation @ estimated_poses[has_all, :3, :3]
    axes_rotation = nearest_rotation((rotations.transpose(0, 2, 1) @ axes).sum(axis=0))
    angles = rotation_angles((rotations @ axes_rotation).transpose(0, 2, 1) @ axes)
    position = float(np.sqrt(np.square(residual).sum(axis=1).mean()))
    x, y, z = map(float, offset)
    return ObjectPathErrors(
        frames=int(has_all.sum()),
        position=position,
        share=position / length if length else None,
        rotation=float(np.sqrt(np.square(angles).mean())),
        scale=scale,
        offset=(x, y, z),
    )


def _align_world(cameras: NDArray, true_cameras: NDArray) -> Similarity:
    """Return the similarity from estimated to true cameras: rotation first, then the centres."""
    rotation_sum = (true_cameras[:, :3, :3] @ cameras[:, :3, :3].transpose(0, 2, 1)).sum(axis=0)
    rotation = nearest_rotation(rotation_sum)
    centres, true_centres = cameras[:, :3, 3] @ rotation.T, true_cameras[:, :3, 3]
    mean_centre, true_mean = centres.mean(axis=0), true_centres.mean(axis=0)
    spread = float(np.square(centres - mean_centre).sum())
    scale = (
        float(((centres - mean_centre) * (true_centres - true_mean)).sum() / spread)
        if spread
        else 1.0
    )
    if scale <= 0:  # the paths do not correlate; the scale of the object is fitted in any case
        scale = 1.0
    return Similarity(scale=scale, rotation=rotation, translation=true_mean - scale * mean_centre)


def _fit_scale_and_offset(
    centre: NDArray, from_camera: NDArray, rotations: NDArray, positions: NDArray
) -> tuple[float, NDArray[np.float64]]:
    """Return σ and q in least squares; of several solutions the nearest to σ = 1 and q = 0."""
    # The unknowns are lengths, so that their norm is meaningful: (σ - 1) · distance, and q.
    distance = float(np.sqrt(np.square(from_camera).sum(axis=1).mean())) or 1.0
    system = np.concatenate([from_camera[:, :, None] / distance, -rotations], axis=2).reshape(-1, 4)
    target = (positions - centre - from_camera).ravel()
    solution = np.linalg.lstsq(system, target, rcond=1e-9)[0]
    scale, offset = 1 + float(solution[0]) / distance, solution[1:]
    if scale < 0:
        scale, target = 0.0, (positions - centre).ravel()
        offset = np.linalg.lstsq(system[:, 1:], target, rcond=1e-9)[0]
    return scale, offset


def _has_pose(poses: NDArray) -> NDArray[np.bool_]:
    return np.asarray(np.isfinite(poses).all(axis=(1, 2)))
