"""Several views of the ready-made scenes, with true depth and motions."""

from dataclasses import dataclass
from unittest import mock

import numpy as np

from tests.rendered import room_film, shared
from tisfm.camera import Camera
from tisfm.rigid import pose_matrix, rigid_motion
from tisfm.scenes import block_scenes, static_scene

FACTORS = (1, -1, 2, -2, 3, -3, 4, -4)  # of the motion of the camera
ROOM_MOTION = np.array((0.12, 0.0, 0.08, 0.003, 0.01, 0.006))


@dataclass(frozen=True, kw_only=True)
class Views:
    """A keyframe, other frames in the order of `FACTORS`, and the truth."""

    key: np.ndarray
    others: list[np.ndarray]
    motions: np.ndarray
    camera: Camera
    depth: np.ndarray

    def first(self, count):
        """Return the arguments of `window_depth` for the first `count` frames."""
        return self.key, self.others[:count], self.motions[:count], self.camera

    def errors(self, found):
        """Return |d − d*| / d* of every pixel."""
        return np.abs(1 / found.inverse_depth - self.depth) / self.depth


@shared
def views(kind, height=120, width=160, count=4):
    """Return views of a room, or of the static scene of a kind."""
    if kind == "room":
        poses = [pose_matrix(factor * ROOM_MOTION) for factor in (0, *FACTORS[:count])]
        film = room_film(poses, height, width, samples=2)
        key, *others = film.frames.astype(np.float32)
        motions, depth = np.linalg.inv(poses[1:])[:, :3], film.depth[0]
        return Views(key=key, others=others, motions=motions, camera=film.camera, depth=depth)
    pairs = []
    for factor in FACTORS[:count]:
        motion = factor * np.array(block_scenes._STATIC_MOTIONS[kind])
        with mock.patch.dict(block_scenes._STATIC_MOTIONS, {kind: motion}):
            pairs.append(static_scene(kind, height, width, samples=2))
    return Views(
        key=pairs[0].frame0.astype(np.float32),
        others=[pair.frame1.astype(np.float32) for pair in pairs],
        motions=np.array([np.column_stack(rigid_motion(pair.motions[0])) for pair in pairs]),
        camera=pairs[0].camera,
        depth=pairs[0].depth,
    )
