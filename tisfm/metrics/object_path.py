"""Errors of the path of a moving thing."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tisfm.errors import InputError
from tisfm.metrics.alignment import Similarity
from tisfm.metrics.trajectory_errors import path_length, rotation_angles, whole_poses

FEWEST = 3  # frames: 9 equations for a scale and an offset


@dataclass(frozen=True, kw_only=True)
class ObjectPathErrors:
    """How far a moving thing is from where it truly is.

    Attributes
    ----------
    frames : int
        Frames that were compared.
    position : float
        Root mean square distance of the origin of the found axes from where it is truly, in the
        unit of the truth.
    share : float or None
        The same per length of the true path of the body's origin through these frames; None where
        it stands still.
    rotation : float
        Root mean square angle between the found and the true axes, degrees.
    scale : float
        What the found distances from the camera are multiplied by, in the aligned world.
    offset : tuple of float
        The origin of the found axes in those of the body, (x, y, z), in the unit of the truth.

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
    """Compare the path of a moving thing with that of the true body, through the world.

    Parameters
    ----------
    poses, truth : array_like, shape (N, 4, 4)
        For each frame found pose, thing to world, and true pose, body to world; NaN where unknown.
    cameras, true_cameras : array_like, shape (N, 4, 4)
        Found and true poses of the camera, camera to world; NaN where there is none. Found worlds
        are brought to the true one by all frames that have both.

    Returns
    -------
    ObjectPathErrors or None
        None where fewer than 3 frames have all four poses.

    Raises
    ------
    ValueError
        If shapes differ or are others, or a value is masked.

    Notes
    -----
    Three things cannot be found from pictures, and are fitted:

    - The world: the similarity p ↦ s R p + t. R is the rotation nearest to all of the cameras'
      turns, rather than that of the best alignment of centres, which on a straight path may turn
      about the path. s and t then bring the centres nearest.
    - The scale of a moving thing relative to the world: in frame k, with the camera's centre c_k,
      the thing may as well be at c_k + σ d_k, for one σ of all frames; d_k leads from the camera
      to it. σ is not negative.
    - The axes that a thing was given: its origin is at q in those of the true body, and its axes
      are those of the body turned by Q.

    With true poses (B_k, b_k), σ and q minimise Σ ‖c_k + σ d_k - B_k q - b_k‖², which is linear.
    Where frames cannot tell, as those of a body that flies along with the camera without a turn,
    the answer nearest to σ = 1 and q = 0 is taken. Q is the rotation nearest to all B_kᵀ R O_k, of
    found axes O_k. The positions compared are of the origin of the found axes, so an origin far
    outside of the body, which `offset` tells, makes for other errors than one within.

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
    found, true, camera, true_camera = (
        whole_poses(values, name)
        for values, name in (
            (poses, "poses"),
            (truth, "truth"),
            (cameras, "cameras"),
            (true_cameras, "true_cameras"),
        )
    )
    shapes = [path.shape for path in (found, true, camera, true_camera)]
    if len(set(shapes)) > 1:
        numbers = ", ".join(str(len(path)) for path in (found, true, camera, true_camera))
        raise InputError(
            f"poses, truth, cameras and true_cameras are of {numbers} frames: expected as many"
        )
    seen = _known(camera) & _known(true_camera)
    both = seen & _known(found) & _known(true)
    if both.sum() < FEWEST:
        return None
    world = _world(camera[seen], true_camera[seen])
    length = path_length(true[both])
    centre = world.apply(camera[both, :3, 3])
    away = world.apply(found[both, :3, 3]) - centre
    turns, places = true[both, :3, :3], true[both, :3, 3]
    scale, offset = _fitted(centre, away, turns, places)
    left = centre + scale * away - turns @ offset - places
    axes = world.rotation @ found[both, :3, :3]
    fixed = nearest_rotation((turns.transpose(0, 2, 1) @ axes).sum(axis=0))
    angles = rotation_angles((turns @ fixed).transpose(0, 2, 1) @ axes)
    position = float(np.sqrt(np.square(left).sum(axis=1).mean()))
    x, y, z = map(float, offset)
    return ObjectPathErrors(
        frames=int(both.sum()),
        position=position,
        share=position / length if length else None,
        rotation=float(np.sqrt(np.square(angles).mean())),
        scale=scale,
        offset=(x, y, z),
    )


def nearest_rotation(matrix: NDArray) -> NDArray[np.float64]:
    """Return the rotation R with the greatest trace of Rᵀ M, (3, 3)."""
    left, _, right = np.linalg.svd(matrix)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(left) * np.linalg.det(right))])
    return np.asarray(left * signs @ right)


def _world(cameras: NDArray, true_cameras: NDArray) -> Similarity:
    """Return what brings found cameras to the true ones: their turns first, then their centres."""
    turn = (true_cameras[:, :3, :3] @ cameras[:, :3, :3].transpose(0, 2, 1)).sum(axis=0)
    rotation = nearest_rotation(turn)
    centres, goal = cameras[:, :3, 3] @ rotation.T, true_cameras[:, :3, 3]
    middle, target = centres.mean(axis=0), goal.mean(axis=0)
    spread = float(np.square(centres - middle).sum())
    scale = float(((centres - middle) * (goal - target)).sum() / spread) if spread else 1.0
    if scale <= 0:  # it went elsewhere: no scale is right, and the thing's own makes up for it
        scale = 1.0
    return Similarity(scale=scale, rotation=rotation, translation=target - scale * middle)


def _fitted(
    centre: NDArray, away: NDArray, turns: NDArray, places: NDArray
) -> tuple[float, NDArray[np.float64]]:
    """Return σ and q: what is nearest to σ = 1 and q = 0, of all that fit best."""
    # In lengths: σ - 1 times the mean distance, beside q.
    distance = float(np.sqrt(np.square(away).sum(axis=1).mean())) or 1.0
    system = np.concatenate([away[:, :, None] / distance, -turns], axis=2).reshape(-1, 4)
    left = (places - centre - away).ravel()
    step = np.linalg.lstsq(system, left, rcond=1e-9)[0]
    scale, offset = 1 + float(step[0]) / distance, step[1:]
    if scale < 0:
        scale, left = 0.0, (places - centre).ravel()
        offset = np.linalg.lstsq(system[:, 1:], left, rcond=1e-9)[0]
    return scale, offset


def _known(poses: NDArray) -> NDArray[np.bool_]:
    return np.asarray(np.isfinite(poses).all(axis=(1, 2)))
