"""Inverse depth of what is partly bare: matched where it can be told, and carried across planes."""

import numpy as np

from tisfm.camera import Camera
from tisfm.kernels.layout.images import image_to_lanes, multiply
from tisfm.kernels.layout.launch import in_turn
from tisfm.kernels.rigid.epipolar import along, displacement
from tisfm.motion.matched_planes import MatchedPlanes, matched_planes, noise_deviation
from tisfm.motion.problems import depth_problem
from tisfm.settings import Settings
from tisfm.solver.coarse_to_fine import unknowns_on
from tisfm.solver.data_term import DataTerm
from tisfm.solver.image_pyramid import ImagePyramid
from tisfm.solver.second_order import (
    SecondOrderMinimiser,
    SecondOrderSettings,
    anchors_in_lanes,
    fill,
)

WARPS, ITERATIONS = 3, 2
DATA = 1.0
NOISY = 1.0
WHERE = "all"
KAPPA = 10.0


def carried(pyramid: ImagePyramid, settings: Settings, motion: np.ndarray, planes: MatchedPlanes, second=SecondOrderSettings(beta=98304.0)):
    level = planes.level
    frame = pyramid.frames0[level]
    anchors = planes.believed.astype(np.float32)
    depth, slopes = fill(planes.inverse_depth, anchors, frame, second)
    if DATA == 0:
        return depth
    camera = pyramid.cameras[level]
    problem = depth_problem(settings, camera.focal)
    unknowns = unknowns_on(pyramid, level, problem)
    grid = unknowns.grid
    noise = noise_deviation(frame)
    data_term = DataTerm(
        grid,
        frame,
        pyramid.frames1[level],
        pyramid.taps1(level),
        problem.constancy,
        max(pyramid.contrast, NOISY * noise),
    )
    restricted = grid.allocate(data_term.constraints.shape[0])
    minimiser = SecondOrderMinimiser(
        grid,
        anchors_in_lanes(grid, np.stack([anchors, planes.inverse_depth * anchors])),
        unknowns.edges,
        second,
        constraints=restricted,
        scales=[DATA * scale for scale in data_term.scales],
    )
    for component, image in enumerate((depth, *slopes)):
        image_to_lanes(grid, np.ascontiguousarray(image), minimiser.rho, component=component)
    labels, flow, direction = grid.allocate(1), grid.allocate(2), grid.allocate(2)
    inverse_depth = minimiser.rho[:1]
    weight = grid.allocate(1)
    w = np.full(frame.shape, DATA**0.5, np.float32)
    if WHERE == "believed":
        w *= anchors
    if WHERE == "notbelieved":
        w *= 1 - anchors
    if WHERE == "var":
        import cv2
        m = cv2.blur(frame, (11, 11))
        v = np.maximum(cv2.blur(frame * frame, (11, 11)) - m * m, 0)
        n2 = max(noise, 0.7) ** 2 * KAPPA
        w *= np.sqrt(v / (v + n2))
    if WHERE == "var2":
        import cv2
        m = cv2.blur(frame, (11, 11))
        v = np.maximum(cv2.blur(frame * frame, (11, 11)) - m * m, 0)
        n2 = max(noise, 0.7) ** 2 * KAPPA
        w *= v / (v + n2)
    image_to_lanes(grid, w, weight)
    linearise = in_turn(
        displacement.bind(grid, inverse_depth, labels, unknowns.x_hat, unknowns.y_hat, flow, direction, motions=np.ascontiguousarray(motion[None], np.float32), focal=camera.focal),
        data_term.bind_linearise(flow),
        along.bind(grid, data_term.constraints, flow, direction, inverse_depth, restricted),
        multiply.bind(grid, weight, restricted),
    )
    for _ in range(WARPS):
        linearise()
        minimiser.update()
        minimiser.minimise(ITERATIONS)
    return minimiser.images()[0]
