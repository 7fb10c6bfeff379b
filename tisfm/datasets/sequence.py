"""A sequence with ground truth."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tisfm.camera import Camera
from tisfm.datasets.depth_files import MM_PER_METRE, read_depth


@dataclass(frozen=True, kw_only=True, eq=False)
class LoadedSequence:
    """The ground truth of a sequence, and the paths of its frames and depth maps.

    Attributes
    ----------
    frames : tuple of Path
        Image files of the frames, in order.
    poses : (N, 4, 4) float64 ndarray
        True poses, camera to world, m; NaN for a frame without a pose.
    camera : Camera or None
        None if unknown.
    times : (N,) float64 ndarray or None
        Times of the frames, s; None if unknown.
    depths : tuple of Path or None
        File of the true depth map of each frame; None for a frame without one.
    depth_scale : float
        Values of a depth map per metre.

    Examples
    --------
    >>> from tisfm.datasets import find_sequences
    >>> loaded = find_sequences("calibrated")[0].load()
    >>> loaded.poses.shape, loaded.depth(0).shape, loaded.camera.focal
    ((9, 4, 4), (180, 240), 144.0)
    >>> len(loaded.take([0, 4, 8]).frames)
    3
    """

    frames: tuple[Path, ...]
    poses: NDArray[np.float64]
    camera: Camera | None = None
    times: NDArray[np.float64] | None = None
    depths: tuple[Path | None, ...]
    depth_scale: float = MM_PER_METRE

    @property
    def posed(self) -> NDArray[np.bool_]:
        """Which frames have a true pose, (N,)."""
        return np.asarray(np.isfinite(self.poses[:, 0, 0]))

    def depth(self, index: int) -> NDArray[np.float32] | None:
        """Read the true depth Z of a frame, (H, W), m, NaN where unknown; None if it has none.

        Raises
        ------
        FormatError
            If the file is damaged, or not a depth map.
        OSError
            If the file does not exist or cannot be read.
        """
        path = self.depths[index]
        return None if path is None else read_depth(path, self.depth_scale)

    def take(self, indices: Iterable[int]) -> "LoadedSequence":
        """Return the sequence of some of the frames, in the order of `indices`."""
        selected_indices = list(indices)
        return replace(
            self,
            frames=tuple(self.frames[index] for index in selected_indices),
            poses=self.poses[selected_indices],
            times=None if self.times is None else self.times[selected_indices],
            depths=tuple(self.depths[index] for index in selected_indices),
        )
