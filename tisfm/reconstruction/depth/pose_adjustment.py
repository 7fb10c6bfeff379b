"""Dense bundle adjustment: poses of frames and depth of keyframes are fitted to the images.

A keyframe and the frames around it form a keyframe window. Every pixel of the keyframe has one
inverse depth. The motion tensors of all frames of the window give normal equations with six
unknowns a frame, in which this depth is eliminated. A frame belongs to several windows; this gives
all windows one scale.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from tisfm import runtime
from tisfm.camera import Camera
from tisfm.kernels.layout.images import image_to_lanes, lanes_to_images
from tisfm.kernels.layout.lanes import LaneData, LaneGrid
from tisfm.kernels.layout.launch import in_turn
from tisfm.kernels.rigid.epipolar import displacement
from tisfm.kernels.rigid.shared_depth import add_frame, answered, squared_residual
from tisfm.motion.matched_planes import noise_deviation
from tisfm.motion.problems import depth_problem
from tisfm.motion.window_statistics import window_variance
from tisfm.reconstruction.geometry.rays import cross_matrices
from tisfm.rigid import rigid_motion, rigid_twist
from tisfm.settings import Settings
from tisfm.solver.data_term import Constancy, DataTerm
from tisfm.solver.image_pyramid import gaussian_pyramid, smooth
from tisfm.solver.sampling import spline_taps
from tisfm.solver.smoothness import mean_step
from tisfm.solver.unknowns import Unknowns

# Values without a stated source were set by hand.

# Pixels of the pyramid level that images are compared on.
MAX_PIXELS = 2**17
# px: standard deviation of the Gaussian that smooths images first.
PRESMOOTHING = 0.6
# Grey-level variance of a window, in variances of the noise, at which a pixel has half the weight.
HALF_WEIGHT_TEXTURE = 50.0
# px: side of this window.
TEXTURE_WINDOW = 11
# Residual with a quarter of the weight, in square roots of the median squared residual.
OUTLIER_SCALE = 3.0
# Relative standard deviation of depth at which a pixel has half the weight.
HALF_WEIGHT_DEVIATION = 0.05
# Damping of a depth step, as a share of a pixel's mean data term.
DEPTH_DAMPING = 1e-3
# Damping of a pose step, as a share of the diagonal of the system.
POSE_DAMPING = 1e-3
# px: side of the window whose depth moves together.
DEPTH_WINDOW = 9
# Largest depth step, as a share of the inverse depth of the pixel.
MAX_DEPTH_STEP = 0.1
# Gauss–Newton steps.
ROUNDS = 2
# Frames that are adjusted at a time, at most.
MAX_FRAMES = 200
# Shrunk frames in memory.
CACHED_FRAMES = 64

Frames = Callable[[int], np.ndarray]


@dataclass(kw_only=True)
class KeyframeWindow:
    """A keyframe, its depth, and the frames that it is compared with."""

    key: int
    members: tuple[int, ...]
    # (h, w) float32: inverse depth of the keyframe at pyramid level `level`, 1/unit of the poses
    inverse_depth: np.ndarray
    weight: np.ndarray  # (h, w) float32: weight of each pixel, in [0, 1]
    level: int


def make_keyframe_window(
    key: int,
    members: Sequence[int],
    frame: np.ndarray,  # (H, W) float32: grey levels of the keyframe
    # inverse_depth, deviation: (H, W) float32, its inverse depth and the standard deviation. A
    # pixel with a large deviation gets a small weight.
    inverse_depth: np.ndarray,
    deviation: np.ndarray,
    counted: np.ndarray | None = None,  # (H, W) bool: pixels that are used; by default all
) -> KeyframeWindow:
    """Return the window of a keyframe."""
    level = 0
    while frame.size >> 2 * level > MAX_PIXELS:
        level += 1
    small = _shrink(frame, level)
    height, width = small.shape
    stride = 2**level
    half = stride // 2
    near = [image[half::stride, half::stride] for image in (inverse_depth, deviation)]
    near = [np.pad(image, [(0, 1)] * 2, mode="edge")[:height, :width] for image in near]
    depth = near[0]
    known = np.isfinite(depth) & (depth > 0)
    with np.errstate(invalid="ignore", divide="ignore"):
        sure = 1 / (1 + (near[1] / depth / HALF_WEIGHT_DEVIATION) ** 2)
    variance = window_variance(small, TEXTURE_WINDOW)
    texture = variance / (variance + HALF_WEIGHT_TEXTURE * noise_deviation(small) ** 2)
    weight = np.where(known, np.nan_to_num(sure) * texture, 0)
    if counted is not None:
        shown = np.pad(counted[half::stride, half::stride], [(0, 1)] * 2, mode="edge")
        weight *= shown[:height, :width]
    usual = np.median(depth[known]) if known.any() else np.float32(1)
    return KeyframeWindow(
        key=key,
        members=tuple(members),
        inverse_depth=np.where(known, depth, usual).astype(np.float32),
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
    held: Collection[int] = (),  # frames whose poses are fixed; by default the first frame
    rounds: int = ROUNDS,  # Gauss–Newton steps
) -> dict[int, np.ndarray]:
    """Return poses that fit the images better. The depth of the windows is changed in place."""
    found = {frame: np.array(pose, np.float64) for frame, pose in poses.items()}
    windows = [
        window for window in windows if any(f in found and f != window.key for f in window.members)
    ]
    if not windows:
        return found
    seen = _FrameCache(frames, camera, settings)
    for number in range(rounds):
        systems = [_linearise(window, found, seen, move_depth=number > 0) for window in windows]
        moved = {frame: _twist_between(found[frame], pose) for frame, pose in poses.items()}
        steps = _solve(systems, sorted(found), moved, held or (min(found),))
        for frame, step in steps.items():
            turn, shift = rigid_motion(step)
            back = np.eye(4)
            back[:3, :3], back[:3, 3] = turn.T, -turn.T @ shift
            found[frame] = found[frame] @ back
    return found


class _FrameCache:
    """Shrunk frames and their spline taps; the frames used last stay in memory."""

    def __init__(self, frames: Frames, camera: Camera, settings: Settings) -> None:
        self._frames, self._camera, self._settings = frames, camera, settings
        self._held: dict[tuple[int, int], tuple[np.ndarray, np.ndarray]] = {}

    def shrunk(self, number: int, level: int) -> tuple[np.ndarray, np.ndarray]:
        """Return a frame, (h, w) float32, and its spline's taps."""
        key = number, level
        if key in self._held:
            self._held[key] = self._held.pop(key)  # now removed last
            return self._held[key]
        while len(self._held) >= CACHED_FRAMES:
            self._held.pop(next(iter(self._held)))
        small = _shrink(self._frames(number), level)
        self._held[key] = small, spline_taps(small)
        return self._held[key]

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
    window: KeyframeWindow, poses: Mapping[int, np.ndarray], views: _FrameCache, *, move_depth: bool
) -> _NormalEquations:
    """Linearise the images of a window about its poses and depth.

    With `move_depth`, the depth is changed in place to fit these poses. This comes last, since the
    equations eliminate the depth before the change.
    """
    key, _ = views.shrunk(window.key, window.level)
    camera = views.camera(window.key, window.level)
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
    off = np.empty((1, *key.shape), np.float32)
    count = len(members)
    slopes, sums = grid.allocate(6 * count), grid.allocate(2)
    matrix, vector = np.zeros((6 * count, 6 * count)), np.zeros(6 * count)
    to_members = np.zeros((6 * count, 6 * (count + 1)))
    for j, frame in enumerate(members):
        relative = (np.linalg.inv(poses[frame]) @ poses[window.key])[:3]
        relative[:, 3] /= unit
        data = DataTerm(
            grid, key, *views.shrunk(frame, window.level), views.constancy(camera.focal),
            mean_step(key),
        )  # fmt: skip
        motions = np.ascontiguousarray(relative[None], np.float32)
        place = unknowns.x_hat, unknowns.y_hat
        in_turn(
            displacement.bind(
                grid, unknowns.rho, labels, *place, flow, direction, motions=motions,
                focal=camera.focal,
            ),
            data.bind_linearise(flow, tensor),
            squared_residual.bind(grid, tensor, flow, residual),
        )()  # fmt: skip
        lanes_to_images(grid, residual, off)
        counting = off[0, window.weight > 0]
        usual = float(np.median(counting[counting > 0])) if (counting > 0).any() else 1.0
        block = slice(6 * j, 6 * j + 6)
        matrix[block, block], vector[block] = add_frame(
            grid, tensor, unknowns.rho, weight, *place, slopes, sums, number=j,
            motion=motions[0], focal=camera.focal, tolerated=max(OUTLIER_SCALE**2 * usual, 1e-12),
        )  # fmt: skip
        turn, shift = relative[:, :3], relative[:, 3]
        to_members[block, 6 * (j + 1) : 6 * (j + 2)] = np.eye(6)
        to_members[block, :6] = -np.block(
            [[turn, cross_matrices(shift[None])[0] @ turn], [np.zeros((3, 3)), turn]]
        )
    # Translations of the steps are in the unit of the poses.
    for j in range(count + 1):
        to_members[:, 6 * j : 6 * j + 3] /= unit
    held = DEPTH_DAMPING * max(float(sums[0].sum()) / key.size, 1e-12) + 1e-12
    answer, pull = answered(grid, slopes, sums, held=held)
    matrix -= answer
    vector -= pull
    if move_depth:
        _move_depth(window, grid, sums, held, camera.focal * unit)
    return _NormalEquations(
        frames=[window.key, *members],
        matrix=to_members.T @ matrix @ to_members,
        vector=to_members.T @ vector,
    )


def _move_depth(
    window: KeyframeWindow, grid: LaneGrid, sums: LaneData, held: float, scale: float
) -> None:
    """Change the depth of a window, D / `scale`, by (aᵀJa + held) δD = −aᵀe.

    `sums` has aᵀJa and aᵀe.
    """
    images = np.empty((2, grid.height, grid.width), np.float32)
    lanes_to_images(grid, sums, images)
    # Single pixels are noisy, so the depth of a neighbourhood moves together.
    curvature, pull = (cv2.blur(values, (DEPTH_WINDOW, DEPTH_WINDOW)) for values in images)
    depth = window.inverse_depth
    change = -pull / (curvature + np.float32(held)) / np.float32(scale)
    window.inverse_depth = depth + np.clip(change, -MAX_DEPTH_STEP * depth, MAX_DEPTH_STEP * depth)


def _twist_between(pose: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return the twist, (6,), from a pose to another, in the parameters of the steps."""
    relative = np.linalg.inv(pose) @ other
    return rigid_twist(relative[:3, :3], relative[:3, 3])


def _solve(
    systems: Sequence[_NormalEquations],
    frames: Sequence[int],
    moved: Mapping[int, np.ndarray],
    held: Collection[int],
) -> dict[int, np.ndarray]:
    """Return the step of every frame; it is 0 for fixed frames.

    Windows hardly constrain the motion between distant frames. There, a weak prior pulls each frame
    back by `moved`, its motion from the pose before the adjustment.
    """
    steps: dict[int, np.ndarray] = {}
    for begin in range(0, len(frames), MAX_FRAMES):
        batch = frames[begin : begin + MAX_FRAMES]
        number = {frame: k for k, frame in enumerate(batch)}
        matrix, vector = np.zeros((6 * len(batch),) * 2), np.zeros(6 * len(batch))
        for system in systems:
            own = [k for k, frame in enumerate(system.frames) if frame in number]
            rows = _pose_rows(own)
            there = _pose_rows([number[system.frames[k]] for k in own])
            matrix[np.ix_(there, there)] += system.matrix[np.ix_(rows, rows)]
            vector[there] += system.vector[rows]
        diagonal = np.diag(matrix).copy()
        prior = np.where(diagonal > 0, POSE_DAMPING * diagonal, 1.0)
        matrix += np.diag(prior)
        vector += prior * np.concatenate([moved[frame] for frame in batch])
        free = _pose_rows([number[frame] for frame in batch if frame not in held])
        step = np.zeros(6 * len(batch))
        step[free] = -np.linalg.solve(matrix[np.ix_(free, free)], vector[free])
        steps.update({frame: step[6 * k : 6 * k + 6] for frame, k in number.items()})
    return steps


def _pose_rows(numbers: Sequence[int]) -> np.ndarray:
    """Return the six indices of each frame, one frame after the other."""
    return (6 * np.array(numbers, np.intp)[:, None] + np.arange(6)).ravel()


def _shrink(frame: np.ndarray, level: int) -> np.ndarray:
    return gaussian_pyramid(smooth(frame, PRESMOOTHING), 0.5, level + 1)[level]
