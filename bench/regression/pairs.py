"""Pairs that both checkouts interpret: rendered scenes, and frames of real sequences."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tisfm.camera import Camera
from tisfm.formats import read_image
from tisfm.rigid import pose_matrix
from tisfm.scenes import SyntheticPair, bare_patches, static_scene, two_blocks

# Height and width of rendered pairs, px.
QUICK_SIZE = (96, 128)  # in a quick run
SIZE = (240, 320)  # for results
TIMED_SIZE = (480, 640)  # for times

# name → folder, the two frames, focal length px and centre (cx, cy), None where unknown
SEQUENCES: dict[str, tuple[str, str, str, float | None, tuple[float, float] | None]] = {
    "Grove2": ("middlebury/Grove2", "frame10.png", "frame11.png", None, None),
    "RubberWhale": ("middlebury/RubberWhale", "frame10.png", "frame11.png", None, None),
    "sintel_alley": ("sintel_alley", "frame_0002.png", "frame_0003.png", None, None),
    "new_tsukuba": ("new_tsukuba", "rgb_00010.png", "rgb_00011.png", 615.0, (320.0, 240.0)),
    "sevenscenes": (
        "sevenscenes", "frame-000044.color.jpg", "frame-000047.color.jpg", 525.0, (320.0, 240.0)
    ),
    "kitti": ("kitti", "000001.png", "000002.png", 718.856, (607.1928, 185.2157)),
    "flowergarden": ("flowergarden", "img040.pgm", "img041.pgm", None, None),
    "statue": ("statue", "img0600.bmp", "img0603.bmp", None, None),
}  # fmt: skip


@dataclass(frozen=True, kw_only=True, eq=False)
class Pair:
    """Two frames, their camera, and the true motion of the static scene, if known."""

    name: str
    frame0: NDArray
    frame1: NDArray
    camera: Camera
    pose: NDArray | None = None

    def store(self, folder: Path) -> Path:
        """Write the pair to a file for the workers; return its path."""
        center = self.camera.center_for(*self.frame0.shape[:2])
        arrays: dict[str, Any] = {"frame0": self.frame0, "frame1": self.frame1}
        if self.pose is not None:
            arrays["pose"] = self.pose
        path = folder / f"{self.name}.npz"
        np.savez(path, camera=np.array([self.camera.focal, *center]), **arrays)
        return path


def scene_pairs(height: int, width: int) -> list[Pair]:
    """Return a static scene, one with moving objects, and one with bare walls."""
    return [
        _scene_pair("static_scene", static_scene("forward+rotation", height, width)),
        _scene_pair("two_blocks", two_blocks(height, width)),
        _scene_pair("bare_patches", bare_patches(height, width)),
    ]


def _scene_pair(name: str, scene: SyntheticPair) -> Pair:
    return Pair(
        name=name,
        frame0=scene.frame0,
        frame1=scene.frame1,
        camera=scene.camera,
        pose=pose_matrix(scene.motions[0]),
    )


def real_pairs(data: Path) -> tuple[list[Pair], dict[str, str]]:
    """Return the real pairs in a folder, and name → reason of the missing ones."""
    pairs, missing = [], {}
    for name, (folder, first, second, focal, center) in SEQUENCES.items():
        try:
            frames = [read_image(data / folder / file) for file in (first, second)]
        except FileNotFoundError as error:
            missing[name] = f"no file {error.filename}"
            continue
        camera = Camera(focal=focal or 1.2 * max(frames[0].shape[:2]), center=center)
        pairs.append(Pair(name=name, frame0=frames[0], frame1=frames[1], camera=camera))
    return pairs, missing
