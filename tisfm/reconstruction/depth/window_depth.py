"""Inverse depth of a keyframe from several frames whose poses are known.

Planes are matched in all frames at once (`tisfm.reconstruction.depth.window_planes`). Second-order
smoothness propagates reliable matches to the other pixels (`tisfm.solver.second_order`). Then the
data terms of all frames refine D, the scaled inverse depth of a pixel. Each data term acts along an
epipolar line of its frame. The sum Σ w_j (A_j D² + 2 B_j D) of the data terms is one scalar term.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

import cv2
import numpy as np

from tisfm import runtime
from tisfm.camera import Camera
from tisfm.errors import InputError
from tisfm.kernels.layout.images import image_to_lanes, lanes_to_images
from tisfm.kernels.layout.launch import join_launches
from tisfm.kernels.model import MIN_DIVISOR
from tisfm.kernels.rigid.epipolar import displacement
from tisfm.kernels.rigid.shared_depth import add_depth_terms, depth_constraint
from tisfm.motion.problems import depth_problem
from tisfm.motion.textureless_depth import SECOND_ORDER, texture_weight
from tisfm.reconstruction.depth.fattened_matches import remove_fattened
from tisfm.reconstruction.depth.outline_search import search_outlines
from tisfm.reconstruction.depth.settings import DEPTH, OUTLINES
from tisfm.reconstruction.depth.window_matching import ChooseFurther, OtherFrames, match_keyframe
from tisfm.reconstruction.depth.window_planes import Window, WindowPlanes, plane_costs
from tisfm.settings import Settings
from tisfm.solver.data_term import DataTerm
from tisfm.solver.sampling import enlarge, spline_taps
from tisfm.solver.second_order import (
    SecondOrderMinimiser,
    SecondOrderSettings,
    anchors_in_lanes,
    extend_depth,
)
from tisfm.solver.smoothness import image_driven_factor, mean_step
from tisfm.solver.unknowns import Unknowns

Effort = Literal["fast", "balanced", "accurate"]


def by_effort(numbers: tuple[int, int, int], effort: Effort) -> int:
    """Return the number for an effort, from the numbers of all efforts."""
    return numbers[get_args(Effort).index(effort)]


@dataclass(frozen=True, kw_only=True)
class WindowDepth:
    """Inverse depth of a keyframe."""

    inverse_depth: np.ndarray  # (H, W) float32: 1/unit of the poses; positive
    deviation: np.ndarray  # (H, W) float32: standard deviation of the inverse depth
    is_reliable: np.ndarray  # (h, w) bool: cells, 2^`level` px a side, with a reliable match
    level: int


def window_depth(
    key: np.ndarray,  # (H, W) float32: grey levels on the 8-bit scale
    others: Sequence[np.ndarray],  # sequence of (H, W) float32: M frames that show the same scene
    motions: np.ndarray,  # (M, 3, 4) array: R, t from the keyframe to each frame: P₁ = R P₀ + t
    camera: Camera,  # a pinhole
    settings: Settings,  # settings of the data terms
    *,
    effort: Effort = "balanced",  # how densely planes are matched
    # (H, W) bool: used pixels of the keyframe; the other pixels get propagated depth
    key_mask: np.ndarray | None = None,
    # sequence of (H, W) bool or None: used pixels of each other frame
    masks: Sequence[np.ndarray | None] | None = None,
    # H and W of the uncropped frames, as for `Window`
    uncropped_shape: tuple[int, int] | None = None,
    searches_outlines: bool = True,  # whether depth beside jumps is searched again
    # chooses frames for cells without a match; without it, cells are matched once
    choose_further: ChooseFurther | None = None,
) -> WindowDepth | None:  # None if there are too few reliable matches
    """Estimate the inverse depth of every pixel of a keyframe.

    Raises ValueError if there is no other frame, a size differs, a motion is not finite or has no
    translation, or the effort is unknown.
    """
    if effort not in get_args(Effort):
        efforts = ", ".join(map(repr, get_args(Effort)))
        raise InputError(f"effort is {effort!r}: expected one of {efforts}")
    frames = OtherFrames(
        grey=list(others),
        motions=np.asarray(motions, np.float64),
        masks=[None] * len(others) if masks is None else masks,
    )
    frames.check(key.shape)
    if key_mask is not None and np.shape(key_mask) != key.shape:
        raise InputError(f"key_mask is {np.shape(key_mask)} but key is {key.shape}")
    runtime.start()

    def make_window(frames: OtherFrames) -> Window:
        return Window(
            key,
            frames.grey,
            frames.motions,
            camera,
            cells=by_effort(DEPTH.max_cells, effort),
            key_mask=key_mask,
            masks=frames.masks,
            uncropped_shape=uncropped_shape,
        )

    matches = match_keyframe(frames, make_window, choose_further)
    frames, window = matches.frames, matches.window
    anchors = remove_fattened(window, matches.anchors, second_order(window.level))
    planes = replace(matches.planes, is_reliable=anchors[0] > 0)
    if planes.is_reliable.sum() < max(1, DEPTH.min_matched_share * window.used_cells.sum()):
        return None
    iterations = by_effort(DEPTH.propagation_iterations, effort)
    refinement = _DepthRefinement(window, settings, anchors, iterations)
    for _ in range(DEPTH.warps):
        refinement.step()
    depth = refinement.depth()
    depth = np.maximum(depth, min_inverse_depth(planes.inverse_depth[planes.is_reliable]))
    deviation = _deviation(planes, depth, refinement.residual(), window.used_cells)
    side, scale = 2**window.level, window.unit * window.camera_of(window.level).focal
    images = enlarge(np.stack([depth, deviation]) / np.float32(scale), side, *key.shape)
    inverse_depth = images[0]
    if searches_outlines:
        inverse_depth = search_outlines(
            key,
            frames.grey,
            frames.motions,
            camera,
            images[0],
            cell_side=side,
            key_mask=key_mask,
            masks=frames.masks,
        )
    return WindowDepth(
        inverse_depth=inverse_depth,
        deviation=np.hypot(
            images[1] * (inverse_depth / images[0]),
            np.float32(OUTLINES.deviation_per_change) * (inverse_depth - images[0]),
        ),
        is_reliable=planes.is_reliable,
        level=window.level,
    )


def min_inverse_depth(matches: np.ndarray) -> np.float32:
    """Return the smallest inverse depth that may be propagated from matches, (N,)."""
    return np.float32(np.quantile(matches, DEPTH.ignored_far_share) / DEPTH.max_depth_factor)


def second_order(level: int) -> SecondOrderSettings:
    """Return the smoothness of cells of 2^`level` px a side.

    This is the scaled smoothness of full resolution: slopes continue over the same number of px,
    although there are fewer matched cells.
    """
    side = 2.0**level
    return replace(
        SECOND_ORDER,
        alpha=SECOND_ORDER.alpha / side,
        beta=SECOND_ORDER.beta / side**3,
        crease_contrast=DEPTH.slope_scale,
        image_edges=DEPTH.image_edges,
    )


class _DepthRefinement:
    """Depth of the cells, its slopes, and the data terms of all frames."""

    def __init__(
        self,
        window: Window,
        settings: Settings,
        anchors: np.ndarray,  # (2, h, w) float32: weight of each cell, and its matched D, cells
        iterations: int,  # iterations that propagate matches
    ) -> None:
        level = window.level
        frame, camera = window.at_cell_level(0), window.camera_of(level)
        smoothness = second_order(level)
        depth, slopes = extend_depth(
            anchors[1], anchors[0], frame, smoothness, iterations=iterations
        )
        self._grid = grid = runtime.lane_grid(*frame.shape)
        unknowns = Unknowns(grid, camera, 1)
        texture = texture_weight(frame, half_variance=DEPTH.data_texture) * window.used_cells
        weight = anchors[0] * (1 - (1 - DEPTH.min_match_share) * texture)
        constraint = grid.allocate(3)
        self._sums = sums = grid.allocate(3)  # A, B and C of the sum of the data terms
        self._minimiser = minimiser = SecondOrderMinimiser(
            grid,
            anchors_in_lanes(grid, np.stack([weight, anchors[1]])),
            image_driven_factor(grid, frame, smoothness.image_edges),
            smoothness,
            constraints=constraint,
            scales=[np.inf],
        )
        for component, values in enumerate((depth, *slopes)):
            image_to_lanes(grid, np.ascontiguousarray(values), minimiser.rho, component=component)
        inverse_depth = minimiser.rho[:1]
        flow, direction = grid.allocate(2, zeros=False), grid.allocate(2, zeros=False)
        tensor = grid.allocate(6)
        constancy = depth_problem(settings, camera.focal).constancy
        costs = plane_costs(window, depth, slopes) / np.float32(DEPTH.max_cost)
        visibility = np.maximum(1 - costs, 0) * texture
        self._linearisers: list[Callable[[], None]] = []
        for j, motion in enumerate(window.motions):
            other = window.at_cell_level(1 + j)
            data = DataTerm(grid, frame, other, spline_taps(other), constancy, mean_step(frame))
            data_weight, labels = grid.allocate(1), grid.allocate(1)
            image_to_lanes(grid, np.float32(DEPTH.data_weight) * visibility[j], data_weight)
            motions = np.ascontiguousarray(motion[None], np.float32)
            self._linearisers.append(
                join_launches(
                    displacement.bind(
                        grid, inverse_depth, labels, unknowns.x_hat, unknowns.y_hat, flow,
                        direction, motions=motions, focal=camera.focal,
                    ),
                    data.bind_linearise(flow, tensor),
                    add_depth_terms.bind(
                        grid, tensor, flow, direction, inverse_depth, data_weight, sums
                    ),
                )
            )  # fmt: skip
        self._update_constraint = depth_constraint.bind(grid, sums, constraint)

    def step(self) -> None:
        """Linearise the data terms of every frame once, and minimise the energy."""
        self._sums.fill(0)
        for linearise in self._linearisers:
            linearise()
        self._update_constraint()
        self._minimiser.update()
        self._minimiser.minimise(DEPTH.iterations)

    def depth(self) -> np.ndarray:
        """Return D, (h, w) float32, cells."""
        return self._minimiser.images()[0]

    def residual(self) -> tuple[np.ndarray, np.ndarray]:
        """Return A and A D² + 2 B D + C of the last linearisation, (h, w) float32 each."""
        sums = np.empty((3, self._grid.height, self._grid.width), np.float32)
        lanes_to_images(self._grid, self._sums, sums)
        depth = self.depth()
        return sums[0], np.maximum((sums[0] * depth + 2 * sums[1]) * depth + sums[2], 0)


def _deviation(
    planes: WindowPlanes,
    depth: np.ndarray,
    residual: tuple[np.ndarray, np.ndarray],
    used_cells: np.ndarray,  # (h, w) bool
) -> np.ndarray:
    """Return the standard deviation of D, (h, w) float32, cells."""
    distance = cv2.distanceTransform((~planes.is_reliable).astype(np.uint8), cv2.DIST_L2, 5)
    precision, square = (cv2.blur(image, DEPTH.averaging_window) for image in residual)
    square = np.minimum(square / np.maximum(precision, MIN_DIVISOR), DEPTH.max_residual**2)
    weight = planes.is_reliable.astype(np.float32)
    difference = cv2.blur(weight * np.abs(depth - planes.inverse_depth), DEPTH.averaging_window)
    min_share = np.float32(1 / math.prod(DEPTH.averaging_window))
    difference = difference / np.maximum(cv2.blur(weight, DEPTH.averaging_window), min_share)
    difference = (
        np.float32(DEPTH.difference_share) * difference**2 / (difference + DEPTH.match_scatter)
    )
    deviation: np.ndarray = np.sqrt(
        DEPTH.min_deviation**2
        + DEPTH.residual_share**2 * square
        + difference**2
        + (find_bend_share(depth, distance, used_cells) * depth) ** 2,
        dtype=np.float32,
    )
    return deviation


def find_bend_share(
    depth: np.ndarray,  # (h, w) float32: D, cells
    distance: np.ndarray,  # (h, w) float32: distance from the nearest match, cells
    used_cells: np.ndarray,  # (h, w) bool
) -> np.ndarray:
    """Return the deviation because propagated depth bends, (h, w) float32, as a share of D.

    A bare wall goes on as a plane between matches on itself. Matches on objects in front of it lie
    in no plane with each other, so the depth between them bends, and may be far from the wall. The
    bend is the length of the second derivatives of D, over the distance of propagation; the least
    in a window counts, since a jump between two surfaces is narrow.

    If propagated depth bends in most of the keyframe, its few matches, and the path from them, are
    uncertain, too: the cube of the share of such cells adds to the deviation of every cell.
    """
    smooth = cv2.GaussianBlur(depth, (0, 0), DEPTH.bend_smoothing)
    along_x, along_y, mixed = (
        cv2.Sobel(smooth, cv2.CV_32F, *order, scale=1 / 4) for order in ((2, 0), (0, 2), (1, 1))
    )
    curvature = np.sqrt(along_x**2 + 2 * mixed**2 + along_y**2)
    curvature = cv2.erode(curvature, np.ones((DEPTH.bend_window,) * 2, np.uint8))
    bend = curvature * distance**2 / np.maximum(depth, MIN_DIVISOR)
    share = DEPTH.deviation_per_bend * bend**2 / (bend + DEPTH.usual_bend)
    bent_share = float((bend[used_cells] > DEPTH.usual_bend).mean()) if used_cells.any() else 0.0
    whole = DEPTH.deviation_of_bent_frame * bent_share**3
    return np.asarray(np.hypot(np.minimum(share, DEPTH.max_bend_share), whole), np.float32)
