"""Poses adjusted to the images directly, jointly with the depth of keyframes.

A keyframe and the frames around it form a star. Every pixel of the keyframe has one inverse depth,
and says by the motion tensors of all frames of the star how these have to move: six unknowns a
frame, its depth eliminated. Frames are in several stars, which carries one scale through them.
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
from tisfm.motion.matched_planes import noise_deviation
from tisfm.motion.problems import depth_problem
from tisfm.motion.windows import window_variance
from tisfm.rigid import rigid_motion, rigid_twist
from tisfm.settings import Settings
from tisfm.solver.data_term import DataTerm
from tisfm.solver.image_pyramid import gaussian_pyramid, smooth
from tisfm.solver.sampling import spline_taps
from tisfm.solver.smoothness import mean_step
from tisfm.solver.unknowns import Unknowns

PIXELS = 2**17  # at most, of the level that images are compared on
PRESMOOTHING = 0.6  # px
TEXTURE, WINDOW = 50.0, 11  # times the variance of noise: of a window whose pixels weigh half
OUTLYING = 3.0  # times the root of the median squared residual: what has more weighs a quarter
UNSURE = 0.05  # relative deviation of a pixel's depth that weighs half
HELD = 1e-3  # of a pixel's own mean datum: by that its depth is held
PRIOR = 1e-4  # of the diagonal: by that frames are held where they were
TOGETHER = 9  # px across, of which depth moves together
FURTHEST = 0.1  # of a pixel's inverse depth: it moves by no more at a time
ROUNDS = 2  # of Gauss–Newton
LOT = 200  # frames that are adjusted at a time

Frames = Callable[[int], np.ndarray]


@dataclass(kw_only=True)
class Star:
    """A keyframe, its depth, and the frames that are compared with it.

    Attributes
    ----------
    key : int
    members : tuple of int
    inverse_depth : (h, w) float32
        Of the keyframe at `level`, 1/unit of the poses.
    weight : (h, w) float32
        Of its pixels, in [0, 1].
    level : int
    """

    key: int
    members: tuple[int, ...]
    inverse_depth: np.ndarray
    weight: np.ndarray
    level: int


def star_of(
    key: int,
    members: Sequence[int],
    frame: np.ndarray,
    inverse_depth: np.ndarray,
    deviation: np.ndarray,
    counted: np.ndarray | None = None,
) -> Star:
    """Return a star of a keyframe, (H, W) float32, with depth of any deviation.

    Parameters
    ----------
    key : int
    members : sequence of int
    frame, inverse_depth, deviation : (H, W) float32
    counted : (H, W) bool, optional
    """
    level = 0
    while frame.size >> 2 * level > PIXELS:
        level += 1
    small = _shrunk(frame, level)
    height, width = small.shape
    stride = 2**level
    half = stride // 2
    near = [image[half::stride, half::stride] for image in (inverse_depth, deviation)]
    near = [np.pad(image, [(0, 1)] * 2, mode="edge")[:height, :width] for image in near]
    depth = near[0]
    known = np.isfinite(depth) & (depth > 0)
    with np.errstate(invalid="ignore", divide="ignore"):
        sure = 1 / (1 + (near[1] / depth / UNSURE) ** 2)
    variance = window_variance(small, WINDOW)
    texture = variance / (variance + TEXTURE * noise_deviation(small) ** 2)
    weight = np.where(known, np.nan_to_num(sure) * texture, 0)
    if counted is not None:
        shown = np.pad(counted[half::stride, half::stride], [(0, 1)] * 2, mode="edge")
        weight *= shown[:height, :width]
    usual = np.median(depth[known]) if known.any() else np.float32(1)
    return Star(
        key=key,
        members=tuple(members),
        inverse_depth=np.where(known, depth, usual).astype(np.float32),
        weight=weight.astype(np.float32),
        level=level,
    )


def adjusted(
    poses: Mapping[int, np.ndarray],
    stars: Sequence[Star],
    frames: Frames,
    camera: Camera,
    settings: Settings,
    *,
    held: Collection[int] = (),
    rounds: int = ROUNDS,
) -> dict[int, np.ndarray]:
    """Return poses that meet the images better; depth of the stars is moved with them, in place.

    Parameters
    ----------
    poses : mapping of int to (4, 4) array
        Camera to world.
    stars : sequence of Star
    frames : callable
        Returns a frame by its number, (H, W) float32.
    camera : Camera
        A pinhole, of the frames.
    settings : Settings
    held : collection of int
        Frames whose poses stay as they are; by default the first.
    rounds : int
        Of Gauss–Newton.
    """
    found = {frame: np.array(pose, np.float64) for frame, pose in poses.items()}
    if not stars:
        return found
    for _ in range(rounds):
        systems = [_system(star, found, frames, camera, settings) for star in stars]
        moved = {frame: _twist_between(found[frame], pose) for frame, pose in poses.items()}
        steps = _solved(systems, sorted(found), moved, held or (min(found),))
        for frame, step in steps.items():
            turn, shift = rigid_motion(step)
            back = np.eye(4)
            back[:3, :3], back[:3, 3] = turn.T, -turn.T @ shift
            found[frame] = found[frame] @ back
        for system in systems:
            system.move_depth(steps)
    return found


@dataclass(kw_only=True)
class _System:
    """Normal equations of a star: of all its frames, by their own small motions.

    Attributes
    ----------
    star : Star
    frames : list of int
        The keyframe, and the members.
    matrix, vector : (6 M + 6, 6 M + 6) and (6 M + 6,) float64
    to_members : (6 M, 6 M + 6) float64
        The change of the motions from the keyframe to the members.
    slopes : (M, 6, P) float32
        Of the pixels' depth and each motion, jointly.
    gradient, curvature : (P,) float32
        Of the pixels' depth alone.
    scale : float
        D over the inverse depth, px · unit of the poses.
    """

    star: Star
    frames: list[int]
    matrix: np.ndarray
    vector: np.ndarray
    to_members: np.ndarray
    slopes: np.ndarray
    gradient: np.ndarray
    curvature: np.ndarray
    scale: float

    def move_depth(self, steps: Mapping[int, np.ndarray]) -> None:
        """Let the depth of the keyframe follow the motions."""
        own = np.concatenate([steps.get(frame, np.zeros(6)) for frame in self.frames])
        motion = (self.to_members @ own).reshape(-1, 6).astype(np.float32)
        depth = self.star.inverse_depth
        pull = self.gradient + np.einsum("jk,jkp->p", motion, self.slopes)
        # Single pixels are noisy: a neighbourhood moves together.
        pull, curvature = (
            cv2.blur(values.reshape(depth.shape), (TOGETHER, TOGETHER))
            for values in (pull, self.curvature)
        )
        change = -pull / curvature / np.float32(self.scale)
        self.star.inverse_depth = depth + np.clip(change, -FURTHEST * depth, FURTHEST * depth)


def _system(
    star: Star,
    poses: Mapping[int, np.ndarray],
    frames: Frames,
    camera: Camera,
    settings: Settings,
) -> _System:
    """Linearise the images of a star about its poses and depth."""
    key = _shrunk(frames(star.key), star.level)
    height, width = key.shape
    small = camera.scaled(0.5**star.level, *frames(star.key).shape) if star.level else camera
    members = [frame for frame in star.members if frame in poses and frame != star.key]
    unit = 1 / float(np.median(star.inverse_depth))
    scale = small.focal * unit
    grid = runtime.lane_grid(height, width)
    unknowns = Unknowns(grid, small, 1)
    depth = np.ascontiguousarray(star.inverse_depth * np.float32(scale))
    image_to_lanes(grid, depth, unknowns.rho)
    flow, direction = grid.allocate(2, zeros=False), grid.allocate(2, zeros=False)
    tensor = grid.allocate(6)
    constancy = depth_problem(settings, small.focal).constancy
    cx, cy = small.center_for(height, width)
    x_hat = ((np.arange(width, dtype=np.float32) - np.float32(cx)) / np.float32(small.focal))[None]
    y_hat = (np.arange(height, dtype=np.float32) - np.float32(cy)) / np.float32(small.focal)
    rays = np.stack(np.broadcast_arrays(x_hat, y_hat[:, None], np.float32(1))).reshape(3, -1)
    flat, weight = (depth / np.float32(small.focal)).ravel(), star.weight.ravel()
    count = len(members)
    slopes = np.empty((count, 6, flat.size), np.float32)
    gradient, curvature = np.zeros((2, flat.size), np.float32)
    matrix, vector = np.zeros((6 * count, 6 * count)), np.zeros(6 * count)
    to_members = np.zeros((6 * count, 6 * (count + 1)))
    for j, frame in enumerate(members):
        relative = (np.linalg.inv(poses[frame]) @ poses[star.key])[:3]
        relative[:, 3] /= unit
        other = _shrunk(frames(frame), star.level)
        data = DataTerm(grid, key, other, spline_taps(other), constancy, mean_step(key))
        motions = np.ascontiguousarray(relative[None], np.float32)
        in_turn(
            displacement.bind(
                grid,
                unknowns.rho,
                grid.allocate(1),
                unknowns.x_hat,
                unknowns.y_hat,
                flow,
                direction,
                motions=motions,
                focal=small.focal,
            ),
            data.bind_linearise(flow, tensor),
        )()
        mine = _Member(grid, tensor, flow, direction, weight)
        jacobian = _jacobian(relative.astype(np.float32), rays, flat, small.focal)
        block = slice(6 * j, 6 * j + 6)
        slopes[j], own, pull = mine.against(jacobian)
        matrix[block, block], vector[block] = own, pull
        gradient += mine.gradient
        curvature += mine.curvature
        turn, shift = relative[:, :3], relative[:, 3]
        to_members[block, 6 * (j + 1) : 6 * (j + 2)] = np.eye(6)
        to_members[block, :6] = -np.block([[turn, _cross(shift) @ turn], [np.zeros((3, 3)), turn]])
    # Steps are in the unit of the poses.
    for j in range(count + 1):
        to_members[:, 6 * j : 6 * j + 3] /= unit
    curvature += np.float32(HELD) * max(float(curvature.mean()), 1e-12) + np.float32(1e-12)
    rows = slopes.reshape(6 * count, -1)
    matrix -= (rows / curvature).astype(np.float64) @ rows.T.astype(np.float64)
    vector -= (rows @ (gradient / curvature)).astype(np.float64)
    return _System(
        star=star,
        frames=[star.key, *members],
        matrix=to_members.T @ matrix @ to_members,
        vector=to_members.T @ vector,
        to_members=to_members,
        slopes=slopes,
        gradient=gradient,
        curvature=curvature,
        scale=scale,
    )


class _Member:
    """What one frame of a star says, (P,) or (2, P) each: its tensor, and its depth's share."""

    def __init__(
        self,
        grid: LaneGrid,
        tensor: LaneData,
        flow: LaneData,
        direction: LaneData,
        weight: np.ndarray,
    ) -> None:
        size = grid.height, grid.width
        values = [np.empty((n, *size), np.float32) for n in (6, 2, 2)]
        for lanes, images in zip((tensor, flow, direction), values, strict=True):
            lanes_to_images(grid, lanes, images)
        (j11, j12, j22, j1, j2, jtt), (u, v), (a, b) = (x.reshape(len(x), -1) for x in values)
        ex, ey = j11 * u + j12 * v + j1, j12 * u + j22 * v + j2
        residual = np.maximum((ex + j1) * u + (ey + j2) * v + jtt, 0)
        seen = (weight > 0) & (j11 + j22 > 0)
        usual = float(np.median(residual[seen])) if seen.any() else 1.0
        trust = weight / (1 + residual / max(OUTLYING**2 * usual, 1e-12)) ** 2
        self._tensor = trust * j11, trust * j12, trust * j22
        self._pull = trust * ex, trust * ey
        s11, s12, s22 = self._tensor
        self._along = s11 * a + s12 * b, s12 * a + s22 * b
        self.curvature = self._along[0] * a + self._along[1] * b
        self.gradient = self._pull[0] * a + self._pull[1] * b

    def against(self, jacobian: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return GᵀJa, (6, P), ΣGᵀJG, (6, 6), and ΣGᵀe, (6,), for G (2, 6, P)."""
        gu, gv = jacobian
        s11, s12, s22 = self._tensor
        slopes = gu * self._along[0] + gv * self._along[1]
        whole = gu @ (s11 * gu + s12 * gv).T + gv @ (s12 * gu + s22 * gv).T
        pull = gu @ self._pull[0] + gv @ self._pull[1]
        return slopes, whole.astype(np.float64), pull.astype(np.float64)


def _jacobian(motion: np.ndarray, rays: np.ndarray, depth: np.ndarray, focal: float) -> np.ndarray:
    """Return ∂(u, v)/∂(δt, δω) of a small motion after `motion`, (2, 6, P) float32, px."""
    y1, y2, y3 = motion[:, :3] @ rays + depth * motion[:, 3:]
    near = np.float32(focal) / np.maximum(y3, np.float32(1e-6))
    x, y = y1 * near / np.float32(focal), y2 * near / np.float32(focal)
    nothing = np.zeros_like(x)
    # Of R x̂ + d t: d δt + δω × (R x̂ + d t).
    return np.stack(
        [
            np.stack([near * depth, nothing, -near * depth * x, -near * x * y2,
                      near * (y3 + x * y1), -near * y2]),
            np.stack([nothing, near * depth, -near * depth * y, -near * (y3 + y * y2),
                      near * y * y1, near * y1]),
        ]
    )  # fmt: skip


def _twist_between(pose: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return how far a camera has moved from another pose, (6,), as steps count it."""
    relative = np.linalg.inv(pose) @ other
    return rigid_twist(relative[:3, :3], relative[:3, 3])


def _solved(
    systems: Sequence[_System],
    frames: Sequence[int],
    moved: Mapping[int, np.ndarray],
    held: Collection[int],
) -> dict[int, np.ndarray]:
    """Return the step of every frame, that of those which are held being 0.

    Stars say little of how far frames are from others far away: there, what frames had `moved`
    from holds them.
    """
    steps: dict[int, np.ndarray] = {}
    for begin in range(0, len(frames), LOT):
        lot = frames[begin : begin + LOT]
        number = {frame: k for k, frame in enumerate(lot)}
        matrix, vector = np.zeros((6 * len(lot),) * 2), np.zeros(6 * len(lot))
        for system in systems:
            own = [k for k, frame in enumerate(system.frames) if frame in number]
            rows = _six(own)
            there = _six([number[system.frames[k]] for k in own])
            matrix[np.ix_(there, there)] += system.matrix[np.ix_(rows, rows)]
            vector[there] += system.vector[rows]
        diagonal = np.diag(matrix).copy()
        prior = np.where(diagonal > 0, PRIOR * diagonal, 1.0)
        matrix += np.diag(prior)
        vector += prior * np.concatenate([moved[frame] for frame in lot])
        free = _six([number[frame] for frame in lot if frame not in held])
        step = np.zeros(6 * len(lot))
        step[free] = -np.linalg.solve(matrix[np.ix_(free, free)], vector[free])
        steps.update({frame: step[6 * k : 6 * k + 6] for frame, k in number.items()})
    return steps


def _six(numbers: Sequence[int]) -> np.ndarray:
    """Return the six indices of each frame, one frame after the other."""
    return (6 * np.array(numbers, np.intp)[:, None] + np.arange(6)).ravel()


def _shrunk(frame: np.ndarray, level: int) -> np.ndarray:
    return gaussian_pyramid(smooth(frame, PRESMOOTHING), 0.5, level + 1)[level]


def _cross(vector: np.ndarray) -> np.ndarray:
    """Return [v]×."""
    x, y, z = vector
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
