"""Results of a method on a sequence, as files that its process leaves for the comparison."""

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray


class StoredResult:
    """A stored result with the interface that `tisfm.evaluation.compare_sequence` needs.

    NAME.json in its folder has the pose of each frame, (4, 4) or None, its segment, its status, the
    unit that divides its inverse depth, and the numbers of the keyframes, or None. NNNNNN.npy and
    NNNNNN_std.npy are the inverse depth and its deviation of each frame with depth.
    """

    def __init__(self, folder: Path, name: str) -> None:
        self._folder = folder
        content = json.loads((folder / f"{name}.json").read_text(encoding="utf-8"))
        poses = [np.full((4, 4), np.nan) if pose is None else pose for pose in content["poses"]]
        self.poses: NDArray[np.float64] = np.array(poses, dtype=float)
        self.piece: NDArray[np.int32] = np.array(content["piece"], np.int32)
        self.status: list[str] = content["status"]
        self.keyframes: list[int] | None = content["keyframes"]
        self._units: list[float] = content["units"]

    @property
    def has_depth(self) -> bool:
        return any(self._folder.glob("*.npy"))

    def inverse_depth(self, index: int) -> NDArray[np.float32]:
        """Return the inverse depth of a frame, (H, W), NaN where unknown."""
        return self._map(index, "")

    def inverse_depth_std(self, index: int) -> NDArray[np.float32]:  # (H, W)
        return self._map(index, "_std")

    def _map(self, index: int, ending: str) -> NDArray[np.float32]:
        path = self._folder / f"{index:06d}{ending}.npy"
        if not path.exists():
            depth_file = next(iter(sorted(self._folder.glob("*.npy"))))
            return np.full(np.load(depth_file, mmap_mode="r").shape, np.nan, np.float32)
        return np.asarray(np.load(path) / np.float32(self._units[index]))


def store(
    folder: Path,
    name: str,
    *,
    poses: NDArray[np.float64],
    piece: list[int],
    status: list[str],
    units: list[float] | None = None,
    keyframes: list[int] | None = None,  # None if the method has none
) -> None:
    content: dict[str, Any] = {
        "poses": [pose.tolist() if np.isfinite(pose).all() else None for pose in poses],
        "piece": piece,
        "status": status,
        "keyframes": keyframes,
        "units": units or [1.0] * len(piece),
    }
    (folder / f"{name}.json").write_text(json.dumps(content), encoding="utf-8")


def store_map(
    folder: Path, index: int, inverse_depth: NDArray, deviation: NDArray | None = None
) -> None:
    np.save(folder / f"{index:06d}.npy", np.asarray(inverse_depth, np.float32))
    if deviation is not None:
        np.save(folder / f"{index:06d}_std.npy", np.asarray(deviation, np.float32))
