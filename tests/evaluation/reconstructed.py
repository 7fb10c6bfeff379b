"""A sequence whose truth is known, and results that tests make of it."""

from pathlib import Path

import numpy as np

from tests.trajectory.paths import random_path
from tisfm.formats import write_png

H, W, N = 24, 32, 6
FOCAL, CENTER = 30.0, ((W - 1) / 2, (H - 1) / 2)
PATH = random_path(np.random.default_rng(5), N, length=0.05, turn=0.01)


def plane_depth(pose):
    """The depth, (H, W), of the wall Z = 3 of the world before a camera."""
    rows, columns = np.mgrid[:H, :W]
    rays = np.stack([(columns - CENTER[0]) / FOCAL, (rows - CENTER[1]) / FOCAL, np.ones((H, W))])
    return (3 - pose[2, 3]) / np.tensordot(pose[2, :3], rays, 1)


DEPTHS = np.array([plane_depth(pose) for pose in PATH])


def make_sequence(folder, *, poses=PATH, without_depth=()):
    """Write a folder of frames, poses and depth in 1/10000 m."""
    for k in range(N):
        for name, image in (
            ("images", np.full((H, W), 40 * k, np.uint8)),
            ("depth", np.rint(10000 * DEPTHS[k]).astype(np.uint16)),
        ):
            if name == "depth" and k in without_depth:
                continue
            path = Path(folder) / name / f"{k:03d}.png"
            path.parent.mkdir(parents=True, exist_ok=True)
            write_png(path, image)
    camera = f"fx fy cx cy depth_scale\n{FOCAL} {FOCAL} {CENTER[0]} {CENTER[1]} 10000\n"
    (Path(folder) / "camera.txt").write_text(camera)
    rows = [" ".join(map(repr, pose[:3].ravel().tolist())) for pose in poses]
    (Path(folder) / "poses.txt").write_text("\n".join(rows))


class Result:
    """What `tisfm.reconstruct` could return: the truth in a unit of its own, unless changed."""

    def __init__(self, *, unit=0.5, count=N):
        self.poses = PATH[:count].copy()
        self.poses[:, :3, 3] *= unit
        self.piece = np.zeros(count, np.int32)
        self.status = ["tracked"] * count
        self.inverse = (1 / (unit * DEPTHS[:count])).astype(np.float32)
        self.deviation = (0.1 * self.inverse).astype(np.float32)

    def inverse_depth(self, index):
        return self.inverse[index]

    def inverse_depth_std(self, index):
        return self.deviation[index]

    def drop(self, *indices):
        """Leave frames without a pose and without depth."""
        for index in indices:
            self.poses[index], self.piece[index], self.status[index] = np.nan, -1, "lost"
            self.inverse[index] = self.deviation[index] = np.nan
        return self
