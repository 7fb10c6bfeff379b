"""One level of the pyramid under known rigid motions: depth, data, and a step for the motions.

A lane array holds an image as vertical strips (`tisfm.kernels.layout.lanes`).
"""

import cv2
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.spatial.transform import Rotation

from tisfm.kernels.layout.images import image_to_lanes, multiply
from tisfm.kernels.layout.lanes import LaneData, on_host
from tisfm.kernels.layout.launch import join_launches
from tisfm.kernels.model import MIN_DIVISOR
from tisfm.kernels.rigid.epipolar import displacement, restrict_to_line
from tisfm.kernels.rigid.motion_system import motion_system
from tisfm.motion.epipolar_fit import fix_scale, rotation_prior
from tisfm.motion.problems import depth_problem
from tisfm.motion.settings import DEPTH
from tisfm.settings import Settings
from tisfm.solver.coarse_to_fine import data_term_on, unknowns_on
from tisfm.solver.half_quadratic import HalfQuadratic
from tisfm.solver.image_pyramid import ImagePyramid
from tisfm.solver.unknowns import Unknowns
from tisfm.visibility.confidence import median

SAMPLED_PIXELS = 20_000  # approximate number for medians and means over the image


class RigidLevel:
    """Depth, labels and data on one level of the pyramid."""

    def __init__(
        self,
        pyramid: ImagePyramid,
        level: int,
        settings: Settings,
        labels: np.ndarray,  # (H, W) int: index of each pixel's motion
        coarse: Unknowns | None = None,  # of the next coarser level, which is interpolated
        *,
        support: np.ndarray | None = None,  # (H, W) bool: pixels whose data are used
        count: int,  # number of motions
    ) -> None:
        self._focal = pyramid.cameras[level].focal
        problem = depth_problem(settings, self._focal)
        self.unknowns = unknowns = unknowns_on(pyramid, level, problem, coarse)
        grid = unknowns.grid
        size = (grid.width, grid.height)
        label_image = cv2.resize(labels.astype(np.float32), size, interpolation=cv2.INTER_NEAREST)
        self._labels = grid.allocate(1)
        if count > 1:
            image_to_lanes(grid, label_image, self._labels)
        self._label_image = label_image
        self._rows = slice(1, -1, max(1, grid.height * grid.width // SAMPLED_PIXELS))
        used_pixels = _valid_pixels(unknowns, pyramid.valid0(level))[0, self._rows, 1:-1]
        sampled_labels = np.where(used_pixels > 0, on_host(self._labels)[0, self._rows, 1:-1], -1)
        self._samples = [np.flatnonzero(sampled_labels == label) for label in range(count)]
        if labels.any():
            multiply(grid, _same_label_edges(unknowns, label_image), unknowns.edges)
        valid: np.ndarray | None = None
        if support is not None:
            valid = cv2.resize(support.astype(np.float32), size, interpolation=cv2.INTER_AREA)
        elif labels.any() and pyramid.scales[level] >= DEPTH.min_refined_scale:
            # Stencils across a boundary mix two motions, so their pixels have no data.
            valid = (~_has_mixed_window(label_image)).astype(np.float32)
        data_term = data_term_on(pyramid, level, problem, unknowns)
        self._constraints, self._scales = data_term.constraints, data_term.scales
        line_constraints = grid.allocate(self._constraints.shape[0])
        self.minimiser = HalfQuadratic(
            unknowns,
            line_constraints,
            scales=self._scales,
            smoothness=problem.smoothness,
            effort=problem.effort,
        )
        self.flow, direction = (grid.allocate(2, zeros=False) for _ in range(2))
        self._motions = np.zeros((count, 3, 4), np.float32)
        launches = [
            displacement.bind(
                grid,
                unknowns.rho,
                self._labels,
                unknowns.x_hat,
                unknowns.y_hat,
                self.flow,
                direction,
                motions=self._motions,
                focal=self._focal,
            ),
            data_term.bind_linearise(self.flow),
            restrict_to_line.bind(
                grid, self._constraints, self.flow, direction, unknowns.rho, line_constraints
            ),
        ]
        if valid is not None:
            weight = grid.allocate(1)
            image_to_lanes(grid, np.sqrt(valid), weight)  # constraints are squared later
            launches.append(multiply.bind(grid, weight, line_constraints))
        self._linearise = join_launches(*launches)

    def linearise(self, motions: np.ndarray) -> None:
        """Linearise the data at the current depth, and restrict them to epipolar lines."""
        self._motions[...] = motions
        self._linearise()

    def despeckle(self) -> None:
        """Replace depth by its median in a small window, which removes single wrong pixels."""
        depth = self.unknowns.images()[0]
        has_one_motion = len(self._motions) == 1
        medians = (
            cv2.medianBlur(depth, DEPTH.median_window)
            if has_one_motion
            else median_of_labels(depth, self._label_image)
        )
        image_to_lanes(self.unknowns.grid, medians, self.unknowns.rho)

    def median_residuals(self, motions: np.ndarray) -> np.ndarray:
        """Return the median residual of each motion's pixels, (K,).

        The residual is 0 without pixels or without translation. It is computed on a sample of rows,
        with the weights of the last iteration.
        """
        depth = on_host(self.unknowns.rho)[0, self._rows, 1:-1]
        tensor = on_host(self.minimiser.system.tensor)[:, self._rows, 1:-1]
        residual = (tensor[0] * depth + 2 * tensor[3]) * depth + tensor[5]
        median_residuals = np.zeros(len(motions))
        for label, motion in enumerate(motions):
            label_residuals = residual.ravel()[self._samples[label]]
            if label_residuals.size and motion[:, 3].any():
                median_residuals[label] = np.sqrt(max(median(label_residuals), 0))
        return median_residuals

    def refine_motions(
        self, motions: np.ndarray, unknowns: int, median_residuals: np.ndarray
    ) -> np.ndarray:
        """Return the motions after a Gauss–Newton step on the last linearisation."""
        system = self.minimiser.system
        motions = motions.copy()
        motions32 = motions.astype(np.float32)
        for label, motion in enumerate(motions):
            matrix, vector = motion_system(
                system,
                self._constraints,
                self.unknowns.rho,
                self._labels,
                motions=motions32,
                label=label,
                focal=self._focal,
                scales=self._scales,
                depth_stiffness=DEPTH.weak_smoothness * system.alpha,
                quarter_weight_residual=(DEPTH.outlier_residual * float(median_residuals[label]))
                ** 2
                + MIN_DIVISOR,
            )
            if label > 0:  # objects hardly rotate relative to the background
                stiffness, offset = rotation_prior(
                    motion[:, :3], motions[0, :, :3], median_residuals[label]
                )
                matrix[3:, 3:] += stiffness * np.eye(3)
                vector[3:] -= stiffness * offset
            motions[label] = _apply_step(motion, matrix, vector, unknowns)
        return motions


def median_of_labels(
    values: np.ndarray,  # (H, W) float32
    labels: np.ndarray,  # (H, W) float32
) -> np.ndarray:  # (H, W) float32
    """Return the median in a window around every pixel, over pixels of the same label only."""
    medians = cv2.medianBlur(values, DEPTH.median_window)
    is_mixed = _has_mixed_window(labels)
    if is_mixed.any():
        neighbour_labels, neighbours = (
            sliding_window_view(
                np.pad(image, DEPTH.median_window // 2, mode="edge"),
                (DEPTH.median_window, DEPTH.median_window),
            )[is_mixed]
            for image in (labels, values)
        )
        is_same = neighbour_labels == labels[is_mixed][:, None, None]
        neighbours = np.where(is_same, neighbours, np.nan).reshape(len(neighbours), -1)
        medians[is_mixed] = np.nanmedian(neighbours, axis=1)
    return medians


def _has_mixed_window(labels: np.ndarray) -> np.ndarray:
    """Return the pixels whose window contains several labels, (H, W) bool."""
    window = np.ones((DEPTH.median_window, DEPTH.median_window), np.uint8)
    return cv2.erode(labels, window) != cv2.dilate(labels, window)


def _apply_step(
    motion: np.ndarray, matrix: np.ndarray, vector: np.ndarray, unknowns: int
) -> np.ndarray:
    """Return a motion after the step that solves its normal equations; ‖t‖ stays."""
    translation = motion[:, 3]
    length = np.linalg.norm(translation)
    if not (length > 0 and np.isfinite(matrix).all() and np.isfinite(vector).all()):
        return motion
    matrix = fix_scale(matrix, translation / length)
    step = np.zeros(6)
    step[:unknowns] = -np.linalg.solve(matrix[:unknowns, :unknowns], vector[:unknowns])
    rotation_step = Rotation.from_rotvec(step[3:]).as_matrix()
    translation1 = rotation_step @ translation + step[:3]
    return np.column_stack(
        [rotation_step @ motion[:, :3], translation1 * (length / np.linalg.norm(translation1))]
    )


def _valid_pixels(unknowns: Unknowns, valid: np.ndarray | None) -> np.ndarray:
    """Return 1 on the used pixels of the image, else 0, as a lane array on the host."""
    used_pixels = unknowns.grid.image_mask()
    if valid is None:
        return used_pixels
    weight = unknowns.grid.allocate(1)
    image_to_lanes(unknowns.grid, valid.astype(np.float32), weight)
    return used_pixels * on_host(weight)


def _same_label_edges(unknowns: Unknowns, labels: np.ndarray) -> LaneData:
    """Return a lane array that is 1 for edges between pixels of the same label, else 0."""
    grid = unknowns.grid
    is_same = np.zeros((2, *labels.shape), np.float32)
    is_same[0, :, :-1] = labels[:, 1:] == labels[:, :-1]
    is_same[1, :-1] = labels[1:] == labels[:-1]
    out = grid.allocate(2)
    for component, edges in enumerate(is_same):
        image_to_lanes(grid, edges, out, component=component)
    return out
