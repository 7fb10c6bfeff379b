"""Flow along epipolar lines, and motion tensors restricted to them."""

import numpy as np
import pytest

from bench import reference
from tests.lanes import LANES
from tests.pairwise import pairwise
from tests.rendered import static_scene
from tisfm.rigid import rigid_motion
from tisfm.scenes.block_scenes import STATIC_KINDS

SIZES = [(5, 1), (7, 9), (13, 37), (6, 64)]
TWIST = (0.4, -0.3, 0.8, 0.02, -0.05, 0.03)

each_size = pytest.mark.parametrize("size", SIZES, ids=lambda s: f"{s[0]}x{s[1]}")
each_lanes = pytest.mark.parametrize("lanes", LANES)


@pytest.mark.parametrize("kind", STATIC_KINDS)
def test_reference_displacement_is_the_flow_of_a_scene(kind):
    scene = static_scene(kind, 40, 60)
    rotation, translation = rigid_motion(scene.motions[0])
    inverse_depth = scene.camera.focal / scene.depth
    flow = reference.displacement(inverse_depth, scene.camera, rotation, translation)
    np.testing.assert_allclose(flow, np.moveaxis(scene.flow, -1, 0), atol=1e-9)


OTHER_TWIST = (-0.2, 0.5, 0.3, -0.01, 0.03, 0.05)


def two_motions():
    """Return (rotation, translation) of two motions, and both as kernels take them."""
    poses = [rigid_motion(twist) for twist in (TWIST, OTHER_TWIST)]
    return poses, np.array([np.column_stack(pose) for pose in poses], np.float32)


def chequered(height, width):
    rows, columns = np.mgrid[:height, :width]
    return ((rows // 2 + columns // 3) % 2).astype(np.float64)


@each_size
@each_lanes
def test_displacement_and_direction(size, lanes, make_problem):
    from tisfm.kernels.rigid.epipolar import displacement

    problem = make_problem(*size, 1, lanes)
    field = problem.unknowns
    inverse_depth = np.abs(problem.rho) + 1
    field.rho[...] = problem.to_lanes(inverse_depth)
    poses, motions = two_motions()
    labels = chequered(*size)
    flow, direction = problem.grid.allocate(2), problem.grid.allocate(2)
    displacement(
        problem.grid, field.rho, problem.to_lanes(labels[None]), field.x_hat, field.y_hat,
        flow, direction, motions=motions, focal=problem.camera.focal,
    )  # fmt: skip

    def exact(values):
        each = [reference.displacement(values[0], problem.camera, *pose) for pose in poses]
        return np.where(labels == 0, *each)

    expected = exact(inverse_depth)
    # f·(π(…) − x̂) is a difference of numbers of up to f·x̂.
    np.testing.assert_allclose(problem.from_lanes(flow), expected, atol=1e-4, rtol=1e-5)
    step = 1e-4
    slope = (exact(inverse_depth + step) - exact(inverse_depth - step)) / (2 * step)
    np.testing.assert_allclose(problem.from_lanes(direction), slope, atol=2e-6, rtol=1e-5)


def split(constraints):
    """Return the constraints of each term."""
    return [constraints] if len(constraints) < 3 else [constraints[:1], constraints[1:]]


@pairwise(
    ways=3,
    size=SIZES,
    lanes=LANES,
    count=[1, 2, 3],
    held=[(3.0, np.inf), (np.inf, np.inf), (3.0, 40.0)],
    label=[0, 1],
    short=True,
)
def test_motion_system(size, lanes, count, held, label, make_problem):
    alpha, tolerated = held
    from tisfm.kernels.rigid.motion_system import motion_system

    problem = make_problem(*size, 1, lanes)
    unknowns = problem.unknowns
    constraints = make_problem(*size, 1, lanes, seed=1, channels=count).constraints
    terms = reference.tensors_of(split(constraints))
    scales = (2.0, 0.5)[: len(terms)]
    inverse_depth = np.abs(problem.rho) + 1
    unknowns.rho[...] = problem.to_lanes(inverse_depth)
    poses, motions = two_motions()
    labels = problem.to_lanes(chequered(*size)[None])
    rng = np.random.default_rng(7)
    weights = problem.from_lanes(unknowns.edges) * rng.uniform(0.1, 1, (2, *size))
    matrix, vector = motion_system(
        problem.system(weights),
        problem.to_lanes(constraints.reshape(-1, *size)),
        unknowns.rho,
        labels,
        motions=motions,
        label=label,
        focal=problem.camera.focal,
        scales=scales,
        depth_stiffness=alpha,
        quarter_weight_residual=tolerated,
    )
    identity = reference.motion_matrix(problem.camera, *size, 2)
    moved = reference.displacement(inverse_depth[0], problem.camera, *poses[label])
    tensor = reference.robust_tensor(terms, identity, moved, scales)
    east, south = np.pad(weights, ((0, 0), (1, 0), (1, 0)))
    neighbours = east[1:, 1:] + east[1:, :-1] + south[1:, 1:] + south[:-1, 1:]
    hold = min(alpha, 1e12) * np.maximum(neighbours, 1e-12)
    mine = chequered(*size) == label
    squares = sum(reference.residual(term, identity, moved) for term in terms)
    expected = reference.motion_system(
        tensor * mine / (1 + squares / tolerated) ** 2,
        inverse_depth[0],
        hold,
        problem.camera,
        *poses[label],
    )
    if not mine.any():
        assert not matrix.any() and not vector.any()
        return
    np.testing.assert_allclose(matrix, expected[0], rtol=1e-4, atol=1e-4 * np.abs(matrix).max())
    np.testing.assert_allclose(vector, expected[1], rtol=1e-3, atol=1e-4 * np.abs(vector).max())


@pairwise(size=SIZES, lanes=LANES, count=[1, 2, 3])
def test_along(size, lanes, count, make_problem):
    from tisfm.kernels.rigid.epipolar import restrict_to_line

    problem = make_problem(*size, 1, lanes, channels=count)
    constraints = problem.constraints
    rng = np.random.default_rng(3)
    flow, direction = rng.normal(size=(2, 2, *size)).astype(np.float32).astype(np.float64)
    out = problem.grid.allocate(3 * count)
    restrict_to_line(
        problem.grid, problem.to_lanes(constraints.reshape(-1, *size)), problem.to_lanes(flow),
        problem.to_lanes(direction), problem.unknowns.rho, out,
    )  # fmt: skip
    terms = reference.tensors_of(split(constraints))
    expected = reference.restrict_to_line(terms, flow, direction, problem.rho[0])
    restricted = problem.from_lanes(out).reshape(count, 3, *size).astype(float)
    actual = reference.tensors_of(split(restricted))
    identity = reference.motion_matrix(problem.camera, *size, 2)
    moved = np.stack([problem.rho[0] + 0.7, np.zeros(size)])
    for term, found, wanted in zip(terms, actual, expected, strict=True):
        for component, values in zip(found, wanted, strict=True):
            scale = max(float(np.abs(values).max()), 1.0)
            np.testing.assert_allclose(component, values, atol=1e-5 * scale)
        # What it is for: the same quadratic form, in D alone.
        np.testing.assert_allclose(
            reference.data_energy(wanted, identity, moved),
            reference.data_energy(term, identity, flow + 0.7 * direction),
            rtol=1e-9,
        )


@pytest.mark.parametrize(
    "motions", [np.eye(3), np.zeros((0, 3, 4), np.float32), np.zeros((1, 4, 4), np.float32), None]
)
def test_motions_are_checked(motions, make_problem):
    from tisfm.kernels.rigid.epipolar import displacement

    problem = make_problem(5, 7, 1, 1)
    field, grid = problem.unknowns, problem.grid
    with pytest.raises((TypeError, ValueError), match="motions is"):
        displacement(
            grid, field.rho, grid.allocate(1), field.x_hat, field.y_hat,
            grid.allocate(2), grid.allocate(2), motions=motions, focal=1.0,
        )  # fmt: skip


@each_size
@pytest.mark.parametrize("by_pixel", [False, True])
def test_rigid_fields(size, by_pixel, make_problem):
    from tisfm.kernels.model.readout import rigid_fields

    problem = make_problem(*size, 1, 1)
    camera = problem.camera
    cx, cy = camera.center_for(*size)
    x_hat = ((np.arange(size[1]) - cx) / camera.focal).astype(np.float32)
    y_hat = ((np.arange(size[0]) - cy) / camera.focal).astype(np.float32)
    depth = np.abs(problem.rho[0]).astype(np.float32) + 1
    poses, motions = two_motions()
    labels = chequered(*size).astype(np.int32)
    twists = np.array([TWIST, OTHER_TWIST])
    flow, rho = np.empty((2, *size), np.float32), np.empty((6, *size), np.float32)
    options = {"focal": camera.focal, "by_pixel": by_pixel}
    place = depth, labels, x_hat, y_hat, flow, rho
    rigid_fields(*place, motions=motions, twists=twists, **options)
    each = [reference.displacement(depth, camera, *pose) for pose in poses]
    np.testing.assert_allclose(flow, np.where(labels == 0, *each), atol=1e-5, rtol=1e-5)
    expected = np.moveaxis(twists[labels], -1, 0)
    expected[:3] *= depth
    np.testing.assert_allclose(rho[2:], expected[2:], rtol=1e-6)
    matrix = reference.motion_matrix(camera, *size, 6)
    np.testing.assert_allclose(reference.flow(matrix, rho), flow, atol=1e-5)
    still = np.tile(np.eye(3, 4), (2, 1, 1))
    rigid_fields(*place, motions=still, twists=0 * twists, **options)
    assert not flow.any() and not rho.any()
    with pytest.raises(ValueError, match="labels go from 0 to 1: 1 motions"):
        rigid_fields(*place, motions=still[:1], twists=twists[:1], **options)
