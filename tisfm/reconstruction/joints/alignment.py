"""Direct alignment of two pieces of a path: the similarity under which both show the same image."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from tisfm.camera import Camera
from tisfm.reconstruction.geometry.sim3 import sim3_from_vector
from tisfm.reconstruction.joints.patches import Level, Patches, build_pyramid, compare
from tisfm.reconstruction.joints.settings import JOINTS


@dataclass(frozen=True, kw_only=True, eq=False)
class PieceEnd:
    """Frames of a piece beside a joint, and the points that they show."""

    images: Sequence[np.ndarray]  # (H, W) uint8; the frame next to the joint first
    poses: np.ndarray  # (M, 4, 4): camera to world of these frames
    # for each frame: positions of points, (N, 2) px, and their depths, (N,); each point is in one
    # frame only
    points: Sequence[tuple[np.ndarray, np.ndarray]]
    camera: Camera  # pinhole camera

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width of the frames, px."""
        height, width = self.images[0].shape
        return height, width

    @cached_property
    def levels(self) -> list[list[Level]]:
        """The pyramid of each frame."""
        return [build_pyramid(image) for image in self.images]

    @cached_property
    def patches(self) -> list[Patches]:
        """The patches around the points, at each level."""
        return [
            Patches.join(
                [
                    Patches.cut(levels[number], self.camera, self.shape, pose, *points, frame)
                    for frame, (levels, pose, points) in enumerate(
                        zip(self.levels, self.poses, self.points, strict=True)
                    )
                ]
            )
            for number in range(len(self.levels[0]))
        ]

    @property
    def patch_count(self) -> int:
        """Number of patches at the level that has fewest."""
        return min(len(patches) for patches in self.patches)

    @cached_property
    def median_depth(self) -> float:
        """The median depth of the points."""
        return float(np.median(np.concatenate([depths for _, depths in self.points])))

    @cached_property
    def to_cameras(self) -> np.ndarray:
        """(M, 3, 4): world to camera."""
        return np.linalg.inv(self.poses)[:, :3]

    def own_score(self) -> float:
        """Return how well the frames show the patches of the other frames: see `score`."""
        finest = self.patches[0]
        parts = [finest.select(finest.sources != frame) for frame in range(len(self.images))]
        scores = [
            self.score(part, to_camera, frame)
            for frame, (part, to_camera) in enumerate(zip(parts, self.to_cameras, strict=True))
            if len(part)
        ]
        return float(np.mean(scores)) if scores else 0.0

    def score(
        self,
        patches: Patches,  # at this level, in any world
        to_camera: np.ndarray,  # (3, 4): from that world to the camera of a frame, up to a scale
        frame: int = 0,  # number of the frame
        level: int = 0,
    ) -> float:
        """Return the mean correlation of patches with a frame, from 0 to 1; 0 if out of view."""
        if not len(patches):
            return 0.0
        seen = compare(patches, self.levels[frame][level], self.camera, self.shape, to_camera)
        return float(np.maximum(seen.correlation, 0.0).sum() / len(patches))


@dataclass(frozen=True, kw_only=True, eq=False)
class Alignment:
    """A similarity from the world of the later piece to that of the earlier one."""

    similarity: np.ndarray  # (4, 4)
    score: float  # mean correlation of all patches, from 0 to 1; 0 for patches out of view
    scale_deviation: float = np.inf  # standard deviation of the logarithm of the scale


@dataclass(frozen=True, kw_only=True, eq=False)
class Aligner:
    """Aligns the ends of two pieces: the grey levels of patches, seen in frames of the other."""

    earlier: PieceEnd
    later: PieceEnd
    # whether patches of the earlier piece are used, and whether patches of the later one are
    uses: tuple[bool, bool] = (True, True)

    @property
    def _level_count(self) -> int:
        return min(len(self.earlier.levels[0]), len(self.later.levels[0]))

    def align_coarsely(self, start: np.ndarray) -> Alignment:
        """Return the alignment at the coarsest level, from a start, (4, 4)."""
        return self._align(start, [self._level_count - 1], frame_count=1)

    def refine(self, start: np.ndarray) -> Alignment:
        """Return the alignment from a start, through all levels."""
        coarse_to_fine = list(reversed(range(self._level_count)))
        return self._align(start, coarse_to_fine, frame_count=None)

    def refine_one_way(self, start: np.ndarray, *, shows_earlier: bool) -> Alignment:
        """Return the alignment, from a start, with the patches of one piece only.

        These are patches of the earlier piece, shown by the later frames, or the reverse.
        """
        one_way = replace(self, uses=(shows_earlier, not shows_earlier))
        return one_way._align(start, [1, 0][-self._level_count :], frame_count=None)

    def _align(
        self, similarity: np.ndarray, levels: Sequence[int], frame_count: int | None
    ) -> Alignment:
        matrix, variance = np.eye(7), np.inf
        for level in levels:
            for _ in range(JOINTS.steps):
                matrix, vector, variance = self._equations(similarity, level, frame_count)
                damping = JOINTS.damping * np.diag(np.diag(matrix)) + 1e-9 * np.eye(7)
                step = np.linalg.solve(matrix + damping, vector)
                similarity = self._move(similarity, step)
                if np.abs(step).max() < JOINTS.min_step:
                    break
        scores = [
            end.score(patches, to_camera, frame, levels[-1])
            for patches, end, frame, to_camera, _ in self._views(
                similarity, levels[-1], frame_count
            )
        ]
        covariance = np.linalg.inv(matrix + 1e-9 * np.eye(7)) * variance
        return Alignment(
            similarity=similarity,
            score=float(np.mean(scores)),
            scale_deviation=float(np.sqrt(covariance[0, 0])),
        )

    def _views(
        self, similarity: np.ndarray, level: int, frame_count: int | None
    ) -> Iterator[tuple[Patches, PieceEnd, int, np.ndarray, float]]:
        """Yield patches in the earlier world, a frame that sees them, and the sign of its motion.

        A frame has its piece, its number and its camera, (3, 4). If the later piece moves, its
        points move with it (+1), and its cameras move away from the points of the earlier piece
        (−1).
        """
        earlier, later = self.earlier, self.later
        moved = later.patches[level].transformed(similarity)
        if self.uses[1]:
            for frame, to_camera in enumerate(earlier.to_cameras[:frame_count]):
                yield moved, earlier, frame, to_camera, 1.0
        if not self.uses[0]:
            return
        inverse = np.linalg.inv(similarity)
        for frame, pose in enumerate(later.to_cameras[:frame_count]):
            to_camera = pose[:, :3] @ inverse[:3]
            to_camera[:, 3] += pose[:, 3]
            yield earlier.patches[level], later, frame, to_camera, -1.0

    def _equations(
        self, similarity: np.ndarray, level: int, frame_count: int | None
    ) -> tuple[np.ndarray, np.ndarray, float]:
        """Return the normal equations of a step, (7, 7) and (7,), and the variance of grey levels.

        Unknowns: logarithm of the scale, rotation, and translation over the depth, all about the
        pivot.
        """
        matrix, vector = np.zeros((7, 7)), np.zeros(7)
        square_sum, count = 0.0, 0.0
        pivot, unit = self._pivot
        for patches, end, frame, to_camera, sign in self._views(similarity, level, frame_count):
            seen = compare(
                patches,
                end.levels[frame][level],
                end.camera,
                end.shape,
                to_camera,
                with_derivative=True,
            )
            if not len(seen.visible):
                continue
            assert seen.derivative is not None
            derivative = sign * seen.derivative
            offsets = patches.points[seen.visible] - pivot
            jacobian = np.concatenate(
                [
                    (derivative * offsets).sum(axis=-1, keepdims=True),
                    np.cross(offsets, derivative),
                    derivative * unit,
                ],
                axis=-1,
            )
            jacobian -= jacobian.mean(axis=1, keepdims=True)  # grey levels are without their mean
            residual = seen.reference - seen.shown
            weight = _robust_weights(residual)
            weighted = jacobian * weight[:, None, None]
            matrix += np.einsum("nki,nkj->ij", weighted, jacobian)
            vector += np.einsum("nki,nk->i", weighted, residual)
            square_sum += float((weight[:, None] * residual**2).sum())
            count += float(weight.sum())
        # Pixels of a patch share their errors: a patch counts as one measurement.
        return matrix, vector, square_sum / max(count, 1e-9)

    @cached_property
    def _pivot(self) -> tuple[np.ndarray, float]:
        """The centre of the points of the earlier piece, and their median depth."""
        points = self.earlier.patches[0].points
        return np.median(points.reshape(-1, 3), axis=0), self.earlier.median_depth

    def _move(self, similarity: np.ndarray, step: np.ndarray) -> np.ndarray:
        pivot, unit = self._pivot
        change = sim3_from_vector(step[0], step[1:4], np.zeros(3))
        change[:3, 3] = pivot - change[:3, :3] @ pivot + unit * step[4:]
        return np.asarray(change @ similarity)


def _robust_weights(residual: np.ndarray) -> np.ndarray:
    """Return the weights of patches, (N,), from the residuals of their pixels, (N, K)."""
    error = np.sqrt((residual**2).mean(axis=1))
    deviation = max(float(np.median(error)), JOINTS.noise)
    return np.asarray(1 / (1 + (error / deviation) ** 2) ** 2)


def start_similarity(relative: np.ndarray, earlier: PieceEnd, later: PieceEnd) -> np.ndarray:
    """Return the similarity for a motion between the frames beside the joint.

    `relative`, (4, 4), is the pose of the first frame of the later piece in the axes of the last
    frame of the earlier piece, in the unit of the earlier piece. The scale is the ratio of the
    median depths.
    """
    scale = earlier.median_depth / later.median_depth
    scaling = np.diag([scale, scale, scale, 1.0])
    return np.asarray(earlier.poses[0] @ relative @ scaling @ np.linalg.inv(later.poses[0]))
