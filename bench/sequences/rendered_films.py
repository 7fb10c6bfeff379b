"""Films of a rendered room with exact truth; each film tests one ability."""

import hashlib
import tempfile
from dataclasses import asdict, dataclass
from pathlib import Path

import cv2
import numpy as np

from tisfm.camera import Camera
from tisfm.rigid import pose_matrix
from tisfm.scenes import Film, room_film

SIZE = 240, 320  # px, height and width
CACHE = Path(tempfile.gettempdir()) / "tisfm-rendered-films"


@dataclass(frozen=True, kw_only=True)
class Take:
    """Parameters of a film.

    Attributes
    ----------
    name : str
    poses : (N, 4, 4) float64
        Camera to world, m.
    textured : bool
        Whether the room's walls have a pattern.
    seed : int
    height, width : int
        Of the frames, px.
    readout : float
        Readout time of the rolling shutter, as for `tisfm.Camera`.
    """

    name: str
    poses: np.ndarray
    textured: bool
    seed: int = 0
    height: int = SIZE[0]
    width: int = SIZE[1]
    readout: float = 0.0

    def film(self) -> Film:
        """Return the film; rendered films are kept in a temporary folder."""
        words = repr(sorted((asdict(self) | {"poses": self.poses.tobytes()}).items()))
        path = CACHE / f"{hashlib.sha256(words.encode()).hexdigest()[:16]}.npz"
        if path.exists():
            with np.load(path) as kept:
                camera = Camera(focal=float(kept["focal"]))
                return Film(
                    frames=kept["frames"], depth=kept["depth"], poses=self.poses, camera=camera
                )
        film = room_film(
            self.poses,
            self.height,
            self.width,
            seed=self.seed,
            textured=self.textured,
            samples=2,
            readout=self.readout,
        )
        CACHE.mkdir(exist_ok=True)
        part = path.with_suffix(".part.npz")
        np.savez(part, frames=film.frames, depth=film.depth, focal=film.camera.focal)
        part.replace(path)
        return film


def walked(count: int) -> np.ndarray:
    """Return the poses of a camera that moves sideways and forward, and turns slightly."""
    return np.array([pose_matrix((0.04 * k, 0, 0.02 * k, 0, 0.01 * k, 0)) for k in range(count)])


def round_trip(count: int) -> np.ndarray:
    """Return the poses of a camera that circles in the room and ends at its first position.

    It looks at one corner of the room, and to the left and right of the corner.
    """
    at = np.linspace(0, 2 * np.pi, count)
    positions = np.stack([0.6 * np.sin(at), 0.08 * np.sin(2 * at), 0.5 * (1 - np.cos(at))], axis=1)
    return _looking(positions, 0.35 * np.sin(at))


def rounds(count: int, of_round: int = 225) -> np.ndarray:
    """Return the poses of a camera that circles repeatedly and looks outward.

    Rounds have different radii and heights.
    """
    at = 2 * np.pi * np.arange(count) / of_round
    radius = 0.7 + 0.15 * np.sin(at / 3.1)
    height = 0.2 * np.sin(at / 4.3)
    return _looking(np.stack([radius * np.sin(at), height, radius * np.cos(at)], axis=1), at)


def turned(before: int, turning: int, after: int, step: float = 0.02) -> np.ndarray:
    """Return the poses of a camera that moves, turns on the spot, and moves on; step in rad."""
    going = np.array([0.035, 0, 0.02])
    shift = np.r_[np.arange(before), np.full(turning, before - 1), before + np.arange(after)]
    angle = np.r_[np.zeros(before), 1 + np.arange(turning), np.full(after, turning)] * step
    return _looking((shift - shift[0])[:, None] * going, angle - step * turning / 2)


def shaken(count: int) -> np.ndarray:
    """Return the poses of a moving camera that shakes by up to 3° between frames."""
    at = np.arange(count)
    turns = 0.03 * np.sin(0.9 * at), 0.04 * (np.cos(0.7 * at) - 1), 0.02 * np.sin(1.3 * at)
    twists = np.stack([0.04 * at, 0.01 * np.sin(at), 0.02 * at, *turns], axis=1)
    return np.array([pose_matrix(twist) for twist in twists])


def around_one(count: int) -> np.ndarray:
    """Return the poses of a keyframe, and of frames on both sides at growing distances."""
    factors = [0, *(sign * k for k in range(1, count) for sign in (1, -1))][:count]
    motion = np.array([0.12, 0.0, 0.08, 0.003, 0.01, 0.006])
    return np.array([pose_matrix(factor * motion) for factor in factors])


def _looking(positions: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Return the poses of a camera at positions, (N, 3), turned right by angles, (N,) rad."""
    poses = np.tile(np.eye(4), (len(positions), 1, 1))
    for pose, position, angle in zip(poses, positions, angles, strict=True):
        pose[:3, :3] = cv2.Rodrigues(np.array([0.0, angle, 0.0]))[0]
        pose[:3, 3] = position
    return poses
