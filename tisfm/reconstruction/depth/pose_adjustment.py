"""Dense bundle adjustment: a fit of the poses of frames and the depth of keyframes to images.

A keyframe and the frames around it form a keyframe window. Every pixel of the keyframe has one
inverse depth. The motion tensors of all frames of the window give normal equations, from which the
depth is eliminated; six unknowns a frame are left. A frame belongs to several windows, so all
windows have one scale.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from tisfm import runtime
from tisfm.camera import Camera
from tisfm.kernels.layout.images import image_to_lanes, lanes_to_images
from tisfm.kernels.layout.lanes import LaneData, LaneGrid
from tisfm.kernels.layout.launch import join_launches
from tisfm.kernels.rigid.epipolar import displacement
from tisfm.kernels.rigid.shared_depth import add_frame, eliminate_depth, squared_residual
from tisfm.motion.matched_planes import noise_deviation
from tisfm.motion.problems import depth_problem
from tisfm.motion.window_statistics import window_variance
from tisfm.reconstruction.depth.settings import DEPTH
from tisfm.reconstruction.geometry.rays import cross_matrices
from tisfm.rigid import rigid_motion, rigid_twist
from tisfm.settings import Settings
from tisfm.solver.data_term import Constancy, DataTerm
from tisfm.solver.image_pyramid import gaussian_pyramid, smooth
from tisfm.solver.sampling import spline_taps
from tisfm.solver.smoothness import mean_step
from tisfm.solver.unknowns import Unknowns

# Shrunk frames in memory.
CACHED_FRAMES = 64

Frames = Callable[[int], np.ndarray]


@dataclass(kw_only=True)
class KeyframeWindow:
    """A keyframe, its depth, and the frames that the keyframe is compared with."""

    key: int
    members: tuple[int, ...]  # frames that are compared with the keyframe
    # (h, w) float32: inverse depth of the keyframe at pyramid level `level`, 1/unit of the poses
    inverse_depth: np.ndarray
    weight: np.ndarray  # (h, w) float32: weight of each pixel, in [0, 1]
    level: int


def make_keyframe_window(
    key: int,
    members: Sequence[int],
    frame: np.ndarray,  # (H, W) float32: grey levels of the keyframe
    # inverse_depth, deviation: (H, W) float32: the inverse depth of the keyframe and its standard
    # deviation. A pixel with a large deviation gets a small weight.
    inverse_depth: np.ndarray,
    deviation: np.ndarray,
    used_pixels: np.ndarray | None = None,  # (H, W) bool; by default all pixels
) -> KeyframeWindow:
    """Return the window of a keyframe."""
    level = 0
    while frame.size >> 2 * level > DEPTH.max_adjustment_pixels:
        level += 1
    small_frame = _shrink(frame, level)
    height, width = small_frame.shape
    stride = 2**level
    offset = stride // 2
    samples = [image[offset::stride, offset::stride] for image in (inverse_depth, deviation)]
    samples = [np.pad(image, [(0, 1)] * 2, mode="edge")[:height, :width] for image in samples]
    depth = samples[0]
    valid = np.isfinite(depth) & (depth > 0)
    with np.errstate(invalid="ignore", divide="ignore"):
        certainty = 1 / (1 + (samples[1] / depth / DEPTH.half_weight_deviation) ** 2)
    variance = window_variance(small_frame, DEPTH.texture_window)
    texture = variance / (variance + DEPTH.adjustment_texture * noise_deviation(small_frame) ** 2)
    weight = np.where(valid, np.nan_to_num(certainty) * texture, 0)
    if used_pixels is not None:
        mask = np.pad(used_pixels[offset::stride, offset::stride], [(0, 1)] * 2, mode="edge")
        weight *= mask[:height, :width]
    median_depth = np.median(depth[valid]) if valid.any() else np.float32(1)
    return KeyframeWindow(
        key=key,
        members=tuple(members),
        inverse_depth=np.where(valid, depth, median_depth).astype(np.float32),
        weight=weight.astype(np.float32),
        level=level,
    )


def adjust_poses(
    poses: Mapping[int, np.ndarray],  # mapping of int to (4, 4) array: camera to world
    windows: Sequence[KeyframeWindow],
    frames: Frames,  # returns a frame by its number, (H, W) float32
    camera: Camera,  # a pinhole, of the frames
    settings: Settings,
    *,
    fixed_frames: Collection[int] = (),  # frames whose poses are fixed; by default the first frame
    rounds: int | None = None,  # Gauss–Newton steps; by default `adjustment_rounds`
) -> dict[int, np.ndarray]:
    """Return poses that fit the images better. The depth of the windows changes in place."""
    new_poses = {frame: np.array(pose, np.float64) for frame, pose in poses.items()}
    windows = [w for w in windows if any(f in new_poses and f != w.key for f in w.members)]
    if not windows:
        return new_poses
    cache = _FrameCache(frames, camera, settings)
    for step_index in range(DEPTH.adjustment_rounds if rounds is None else rounds):
        systems = [_linearise(w, new_poses, cache, move_depth=step_index > 0) for w in windows]
        displacements = {f: _twist_between(new_poses[f], pose) for f, pose in poses.items()}
        steps = _solve(systems, sorted(new_poses), displacements, fixed_frames or (min(new_poses),))
        for frame, step in steps.items():
            rotation, translation = rigid_motion(step)
            inverse_step = np.eye(4)
            inverse_step[:3, :3], inverse_step[:3, 3] = rotation.T, -rotation.T @ translation
            new_poses[frame] = new_poses[frame] @ inverse_step
    return new_poses


class _FrameCache:
    """A cache of shrunk frames and their spline taps, in order of their last use."""

    def __init__(self, frames: Frames, camera: Camera, settings: Settings) -> None:
        self._frames, self._camera, self._settings = frames, camera, settings
        self._entries: dict[tuple[int, int], tuple[np.ndarray, np.ndarray]] = {}

    def shrunk_frame(self, number: int, level: int) -> tuple[np.ndarray, np.ndarray]:
        """Return a frame, (h, w) float32, and its spline's taps."""
        key = number, level
        if key in self._entries:
            self._entries[key] = self._entries.pop(key)  # now the most recently used
            return self._entries[key]
        while len(self._entries) >= CACHED_FRAMES:
            self._entries.pop(next(iter(self._entries)))
        small_frame = _shrink(self._frames(number), level)
        self._entries[key] = small_frame, spline_taps(small_frame)
        return self._entries[key]

    def camera(self, number: int, level: int) -> Camera:
        """Return the camera of a shrunk frame."""
        if not level:
            return self._camera
        return self._camera.scaled(0.5**level, *self._frames(number).shape)

    def constancy(self, focal: float) -> Constancy:
        """Return the constancy assumption for frames of a focal length, px."""
        return depth_problem(self._settings, focal).constancy


@dataclass(frozen=True, kw_only=True)
class _NormalEquations:
    """Normal equations of a window, for small motions of its frames."""

    frames: list[int]  # the keyframe, then the members
    # matrix, vector: (6 M + 6, 6 M + 6) and (6 M + 6,) float64
    matrix: np.ndarray
    vector: np.ndarray


def _linearise(
    window: KeyframeWindow, poses: Mapping[int, np.ndarray], cache: _FrameCache, *, move_depth: bool
) -> _NormalEquations:
    """Linearise the images of a window about its poses and depth.

    With `move_depth`, the depth changes in place to fit these poses. This is the last step, since
    the equations are for the depth before the change.
    """
    key, _ = cache.shrunk_frame(window.key, window.level)
    camera = cache.camera(window.key, window.level)
    members = [frame for frame in window.members if frame in poses and frame != window.key]
    unit = 1 / float(np.median(window.inverse_depth))
    grid = runtime.lane_grid(*key.shape)
    unknowns = Unknowns(grid, camera, 1)
    weight, labels = grid.allocate(1), grid.allocate(1)
    depth = np.ascontiguousarray(window.inverse_depth * np.float32(camera.focal * unit))
    image_to_lanes(grid, depth, unknowns.rho)
    image_to_lanes(grid, window.weight, weight)
    flow, direction = grid.allocate(2, zeros=False), grid.allocate(2, zeros=False)
    tensor, residual = grid.allocate(6), grid.allocate(1, zeros=False)
    residual_image = np.empty((1, *key.shape), np.float32)
    count = len(members)
    slopes, sums = grid.allocate(6 * count), grid.allocate(2)
    matrix, vector = np.zeros((6 * count, 6 * count)), np.zeros(6 * count)
    # of the motions from the keyframe to the members, by the pose steps of all frames
    jacobian = np.zeros((6 * count, 6 * (count + 1)))
    for j, frame in enumerate(members):
        relative = (np.linalg.inv(poses[frame]) @ poses[window.key])[:3]
        relative[:, 3] /= unit
        data = DataTerm(
            grid, key, *cache.shrunk_frame(frame, window.level), cache.constancy(camera.focal),
            mean_step(key),
        )  # fmt: skip
        motions = np.ascontiguousarray(relative[None], np.float32)
        image_points = unknowns.x_hat, unknowns.y_hat
        join_launches(
            displacement.bind(
                grid, unknowns.rho, labels, *image_points, flow, direction, motions=motions,
                focal=camera.focal,
            ),
            data.bind_linearise(flow, tensor),
            squared_residual.bind(grid, tensor, flow, residual),
        )()  # fmt: skip
        lanes_to_images(grid, residual, residual_image)
        residuals = residual_image[0, window.weight > 0]
        median_square = float(np.median(residuals[residuals > 0])) if (residuals > 0).any() else 1.0
        block = slice(6 * j, 6 * j + 6)
        matrix[block, block], vector[block] = add_frame(
            grid, tensor, unknowns.rho, weight, *image_points, slopes, sums, number=j,
            motion=motions[0], focal=camera.focal,
            quarter_weight_residual=max(DEPTH.outlier_scale**2 * median_square, 1e-12),
        )  # fmt: skip
        rotation, translation = relative[:, :3], relative[:, 3]
        jacobian[block, 6 * (j + 1) : 6 * (j + 2)] = np.eye(6)
        coupling = cross_matrices(translation[None])[0] @ rotation
        jacobian[block, :6] = -np.block([[rotation, coupling], [np.zeros((3, 3)), rotation]])
    # Translations of the steps are in the unit of the poses.
    for j in range(count + 1):
        jacobian[:, 6 * j : 6 * j + 3] /= unit
    depth_damping = DEPTH.depth_damping * max(float(sums[0].sum()) / key.size, 1e-12) + 1e-12
    depth_matrix, depth_vector = eliminate_depth(grid, slopes, sums, depth_stiffness=depth_damping)
    matrix -= depth_matrix
    vector -= depth_vector
    if move_depth:
        _move_depth(window, grid, sums, depth_damping, camera.focal * unit)
    return _NormalEquations(
        frames=[window.key, *members],
        matrix=jacobian.T @ matrix @ jacobian,
        vector=jacobian.T @ vector,
    )


def _move_depth(
    window: KeyframeWindow, grid: LaneGrid, sums: LaneData, damping: float, scale: float
) -> None:
    """Change the depth of a window, D / `scale`, by (aᵀJa + damping) δD = −aᵀe.

    `sums` has aᵀJa and aᵀe.
    """
    images = np.empty((2, grid.height, grid.width), np.float32)
    lanes_to_images(grid, sums, images)
    # Steps of single pixels are noisy, so steps are averaged over a neighbourhood.
    side = DEPTH.depth_window
    curvature, gradient = (cv2.blur(values, (side, side)) for values in images)
    step = -gradient / (curvature + np.float32(damping)) / np.float32(scale)
    limit = DEPTH.max_depth_step * window.inverse_depth
    window.inverse_depth = window.inverse_depth + np.clip(step, -limit, limit)


def _twist_between(pose: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return the twist, (6,), from a pose to another, in the parameters of the pose steps."""
    relative = np.linalg.inv(pose) @ other
    return rigid_twist(relative[:3, :3], relative[:3, 3])


def _solve(
    systems: Sequence[_NormalEquations],
    frames: Sequence[int],
    displacements: Mapping[int, np.ndarray],
    fixed_frames: Collection[int],
) -> dict[int, np.ndarray]:
    """Return the step of every frame, (6,); it is 0 for fixed frames.

    Windows hardly constrain the motion between distant frames. For this reason a weak prior pulls
    each frame to its pose before the adjustment. `displacements` has the twist from there, (6,).
    """
    steps: dict[int, np.ndarray] = {}
    for start in range(0, len(frames), DEPTH.max_adjustment_frames):
        batch = frames[start : start + DEPTH.max_adjustment_frames]
        batch_index = {frame: k for k, frame in enumerate(batch)}
        matrix, vector = np.zeros((6 * len(batch),) * 2), np.zeros(6 * len(batch))
        for system in systems:
            members = [k for k, frame in enumerate(system.frames) if frame in batch_index]
            rows = _pose_rows(members)
            batch_rows = _pose_rows([batch_index[system.frames[k]] for k in members])
            matrix[np.ix_(batch_rows, batch_rows)] += system.matrix[np.ix_(rows, rows)]
            vector[batch_rows] += system.vector[rows]
        diagonal = np.diag(matrix).copy()
        prior = np.where(diagonal > 0, DEPTH.pose_damping * diagonal, 1.0)
        matrix += np.diag(prior)
        vector += prior * np.concatenate([displacements[frame] for frame in batch])
        free_rows = _pose_rows([batch_index[frame] for frame in batch if frame not in fixed_frames])
        step = np.zeros(6 * len(batch))
        step[free_rows] = -np.linalg.solve(matrix[np.ix_(free_rows, free_rows)], vector[free_rows])
        steps.update({frame: step[6 * k : 6 * k + 6] for frame, k in batch_index.items()})
    return steps


def _pose_rows(numbers: Sequence[int]) -> np.ndarray:
    """Return the six indices of each frame, one frame after the other."""
    return (6 * np.array(numbers, np.intp)[:, None] + np.arange(6)).ravel()


def _shrink(frame: np.ndarray, level: int) -> np.ndarray:
    return gaussian_pyramid(smooth(frame, DEPTH.adjustment_smoothing), 0.5, level + 1)[level]
