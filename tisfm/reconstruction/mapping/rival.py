"""A rival: another motion that explains the matches of a model nearly as well."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation


@dataclass(frozen=True, kw_only=True)
class Rival:
    """The motion that lost against the motion of a model, though it came near."""

    # count of matches minus the score of this motion, divided by the same difference of the model:
    # 1 if both motions explain the matches equally well
    loss: float
    # median angles between the motions of consecutive views, degrees
    direction: float  # between their directions of translation
    rotation: float  # between their rotations

    @property
    def message(self) -> str:
        """What makes the model doubtful, and what to do."""
        return (
            "two camera motions explain the tracks equally well, as if the frames show a single "
            f"plane: their directions differ by {self.direction:.0f}°, their rotations by "
            f"{self.rotation:.1f}° from view to view. Depth may belong to the wrong motion: take "
            "more frames, or frames that show more than a plane"
        )


def compare_motions(
    # poses, other_poses: (V, 3, 4) float64, world to camera, of the same views
    poses: np.ndarray,
    other_poses: np.ndarray,
    loss: float,  # as for `Rival`
) -> Rival:
    """Return the other motion of at least two views as a rival."""
    directions, rotations = [], []
    for motion, other in zip(_find_motions(poses), _find_motions(other_poses), strict=True):
        angle = np.arctan2(np.linalg.norm(np.cross(motion[1], other[1])), motion[1] @ other[1])
        directions.append(np.degrees(angle))
        turn = Rotation.from_matrix(motion[0] @ other[0].T)
        rotations.append(np.degrees(turn.magnitude()))
    return Rival(
        loss=loss,
        direction=float(np.median(directions)),
        rotation=float(np.median(rotations)),
    )


def _find_motions(poses: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return the rotation and the translation from each view to the next one."""
    rotations = poses[1:, :, :3] @ np.swapaxes(poses[:-1, :, :3], 1, 2)
    translations = poses[1:, :, 3] - np.einsum("vij,vj->vi", rotations, poses[:-1, :, 3])
    return list(zip(rotations, translations, strict=True))
