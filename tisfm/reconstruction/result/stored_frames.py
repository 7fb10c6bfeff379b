"""Depth, labels and pictures of frames, read on demand, and the points and the mesh of several."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from tisfm.point_cloud import PointCloud
from tisfm.reconstruction.result.folder import read_depth, read_labels, read_mask, read_picture
from tisfm.reconstruction.result.reconstruction_record import ReconstructionRecord

if TYPE_CHECKING:
    from tisfm.fusion import DepthView, Mesh
    from tisfm.fusion.agreement import Coverage


# Relative standard deviation of depth that a mesh of normal coverage uses at most; set by hand.
_MAX_MESH_STD = 0.03


@dataclass(frozen=True, kw_only=True, eq=False)
class StoredFrames(ReconstructionRecord):
    """The frames of a reconstruction, with the depth that is in its folder."""

    def inverse_depth(self, frame: int) -> np.ndarray:
        """Return the inverse depth of a frame, (H, W) float32, 1/unit of the poses.

        NaN where there is no depth. Numbers have 11 significant bits.

        Raises
        ------
        IndexError
            If there is no such frame.
        """
        return self._depth_of(frame)[0]

    def inverse_depth_std(self, frame: int) -> np.ndarray:
        """Return the standard deviation of the inverse depth of a frame, (H, W) float32.

        Infinite where there is no depth, and at masked pixels, whose depth is filled from their
        surroundings.
        """
        return self._depth_of(frame)[1]

    def depth(self, frame: int) -> np.ndarray:
        """Return the depth of a frame, (H, W) float32, in the unit of the poses; NaN for none."""
        inverse_depth = self.inverse_depth(frame)
        depth = np.full_like(inverse_depth, np.nan)
        np.divide(1, inverse_depth, out=depth, where=inverse_depth > 0)
        return depth

    def labels(self, frame: int) -> np.ndarray:
        """Return the object id of each pixel of a frame, (H, W) uint8.

        0 is static; other numbers are the ids of `objects`. Under ``motion="camera"`` there are no
        objects: pixels above 0 move on their own and are masked, as the status of the frame says.
        The labels fit the frame without distortion, as `picture`.

        Examples
        --------
        >>> import tisfm
        >>> result = tisfm.Reconstruction.load("bodies")  # of ``motion="objects"``
        >>> result.labels(0).shape, result.labels(0).dtype
        ((180, 240), dtype('uint8'))
        """
        return read_labels(self.folder, self._number(frame), self.shape)

    @property
    def mask(self) -> np.ndarray | None:
        """Pixels that are fixed on the sensor and were masked, (H, W) bool; None if there are none.

        A bonnet, a logo, a caption or a border, found by ``fixed_pixels="mask"`` of
        `tisfm.reconstruct`. Their depth is filled from the surroundings. If a zoom or a readout
        effect was removed, such pixels lie elsewhere in every frame of the result: these are the
        pixels that are masked in all frames.
        """
        return read_mask(self.folder, self.shape)

    def picture(self, frame: int) -> np.ndarray:
        """Return the frame without distortion, (H, W) or (H, W, 3) RGB uint8."""
        return read_picture(self.folder, self._number(frame))

    def points(
        self,
        frames: Iterable[int] | None = None,
        *,
        coverage: "Coverage" = "normal",
        agreeing: int | None = None,
        max_relative_std: float | None = None,
        voxel: float | None = None,
    ) -> PointCloud:
        """Return coloured points on which several frames agree, in the axes of the world.

        Labelled pixels, which move on their own, are left out.

        Parameters
        ----------
        frames : iterable of int, optional
            Frames of one piece; by default the keyframes of the largest piece.
        coverage : {"normal", "strict", "complete"}
            How much of the surface is kept. "normal" keeps what two frames agree on. "strict" keeps
            what three frames agree on precisely. "complete" also keeps uncertain depth, such as
            depth that was continued far over walls without texture, and what a single frame shows.
        agreeing : int, optional
            Number of frames, the point's own frame included, that have to agree on a point; by
            default 2, 3 or 1, by the coverage. A point that several frames see through is left
            out.
        max_relative_std : float, optional
            Largest relative deviation of inverse depth; less certain pixels are left out. If the
            frames differ by less than their deviations, the deviations are first reduced to fit. By
            default 0.02, 0.01 or 0.1, by the coverage, or a multiple of the median deviation if
            this is larger.
        voxel : float, optional
            Side of the cubes that keep one point each, in the unit of the poses.

        Returns
        -------
        PointCloud
            The positions are (M, 3) float32, in the unit of the poses.

        Raises
        ------
        IndexError, ValueError
            If a frame does not exist, frames are of several pieces, or an option is out of its
            range.

        Examples
        --------
        >>> import tisfm
        >>> cloud = tisfm.Reconstruction.load("walk").points()
        >>> cloud.positions.shape[1], cloud.colors.shape[1], len(cloud) > 1000
        (3, 3, True)
        >>> cloud.save("scene.ply")
        """
        from tisfm.fusion import fused_points

        views = self._views(frames)
        points = fused_points(
            views,
            coverage=coverage,
            agreeing=agreeing,
            max_relative_std=max_relative_std,
            voxel=voxel,
        )
        return replace(points, note=self.warning(views.frames))

    def mesh(
        self,
        frames: Iterable[int] | None = None,
        *,
        coverage: "Coverage" = "normal",
        agreeing: int | None = None,
        max_relative_std: float | None = None,
        voxel: float | None = None,
        truncation: float | None = None,
    ) -> "Mesh":
        """Return the surface on which several frames agree, as coloured triangles.

        It needs scikit-image: ``pip install 'tisfm[mesh]'``.

        Parameters
        ----------
        frames : iterable of int, optional
            As for `points`.
        coverage : {"normal", "strict", "complete"}
            How much of the surface is kept. "strict" and "complete" use the depth that `points`
            keeps. "normal" uses all depth that is certain enough; it covers less than "complete",
            and is more exact.
        agreeing : int, optional
            Number of frames that have to show the surface; by default 3, and 1 for "complete".
        max_relative_std : float, optional
            Largest relative deviation of depth; less certain depth is left out, such as depth that
            was propagated far over walls without texture. By default 0.03 for "normal"; otherwise
            as for `points`.
        voxel : float, optional
            Side of the voxels, in the unit of the poses; by default 2 px at the median depth, or
            half the median deviation of depth if this is larger.
        truncation : float, optional
            Largest distance from a surface at which distances are stored.

        Returns
        -------
        Mesh
            With ``vertices``, ``faces``, ``colors``, and ``save(path)`` for ``.ply`` or ``.glb``.

        Raises
        ------
        ImportError
            If scikit-image is not installed.
        IndexError, ValueError
            As for `points`; or if voxels are too small for the memory (the message names a size).

        Examples
        --------
        >>> import tisfm
        >>> surface = tisfm.Reconstruction.load("walk").mesh()
        >>> surface.save("scene.glb")
        """
        from tisfm.fusion import fused_mesh

        views = self._views(frames)
        if coverage == "normal" and max_relative_std is None:
            max_relative_std = _MAX_MESH_STD
        surface = fused_mesh(
            views,
            coverage=coverage,
            agreeing=agreeing,
            max_relative_std=max_relative_std,
            voxel=voxel,
            truncation=truncation,
        )
        return replace(surface, note=self.warning(views.frames))

    def _depth_of(self, frame: int) -> tuple[np.ndarray, np.ndarray]:
        number = self._number(frame)
        inverse_depth, deviation = read_depth(self.folder, number, self.shape)
        unit = np.float32(self.unit[self.piece[number]] if self.piece[number] >= 0 else 1)
        return inverse_depth / unit, deviation / unit

    def _views(self, frames: Iterable[int] | None) -> "_Views":
        if frames is None:
            largest = self.largest_piece
            return _Views(self, [k for k in self.keyframes if self.piece[k] == largest])
        numbers = [self._number(frame) for frame in frames]
        self._require_one_piece(numbers)
        return _Views(self, [frame for frame in numbers if self.piece[frame] >= 0])


class _Views(Sequence["DepthView"]):
    """Frames for fusion, without moving objects, read on demand."""

    def __init__(self, result: StoredFrames, frames: list[int]) -> None:
        self._result, self.frames = result, frames

    def __len__(self) -> int:
        return len(self.frames)

    def __getitem__(self, index: Any) -> Any:
        from tisfm.fusion import DepthView

        frame, result = self.frames[index], self._result
        inverse_depth, deviation = result._depth_of(frame)
        deviation[result.labels(frame) > 0] = np.inf  # what moves is at no place of the scene
        return DepthView(
            inverse_depth=inverse_depth,
            inverse_depth_std=deviation,
            pose=result.poses[frame],
            frame=result.picture(frame),
            camera=result.camera,
        )
