"""Image motion, inverse depth and ρ̂ for the user, computed from the unknowns as plain images."""

import numpy as np
import taichi as ti

from tisfm.kernels.layout.internals import bind  # stores a value in a kernel's variable
from tisfm.kernels.layout.lanes import CHUNK, check_array, first_row
from tisfm.kernels.layout.launch import Kernel
from tisfm.kernels.model import MIN_DEPTH_RATIO
from tisfm.kernels.model.rigid_motion import flow_of, motion_columns

READOUT_BAND = 16  # smallest number of rows of a band


def motion_fields(
    rho: np.ndarray,  # (n, H, W) float32: ρ̂, px/frame, of 6 or 3 components
    # x_hat, y_hat: (W,), (H,) float32: normalised coordinates
    x_hat: np.ndarray,
    y_hat: np.ndarray,
    flow: np.ndarray,  # (2, H, W) float32: (u, v) = G ρ̂, px/frame
    inverse_depth: np.ndarray,  # (H, W) float32: ‖(τ1, τ2, τ3)‖ = ‖(ρ̂1, ρ̂2, ρ̂3)‖/f
    *,
    focal: float,  # px
    # whether every pixel has its own thread, which is best on a GPU, instead of a band of rows
    by_pixel: bool = False,
) -> None:
    """Compute the image motion (eq. 25) and the unsigned inverse depth (eq. 24) of a field."""
    n, height, width = rho.shape
    if n not in (3, 6):
        raise ValueError(f"rho has {n} components: expected 3 or 6")
    check_array(rho, rho.shape, "rho", aligned=False)
    check_array(x_hat, (width,), "x_hat", aligned=False)
    check_array(y_hat, (height,), "y_hat", aligned=False)
    check_array(flow, (2, height, width), "flow", aligned=False)
    check_array(inverse_depth, (height, width), "inverse_depth", aligned=False)
    if by_pixel:
        _motion_fields_by_pixel(rho, x_hat, y_hat, 1 / focal, n, flow, inverse_depth)
        return
    bands = max(1, height // READOUT_BAND)
    _motion_fields(rho, x_hat, y_hat, 1 / focal, n, bands, flow, inverse_depth)


@Kernel
def _motion_fields(
    rho: ti.types.ndarray(dtype=ti.f32, ndim=3),  # (n, H, W)
    x_hat: ti.types.ndarray(dtype=ti.f32, ndim=1),  # (W,)
    y_hat: ti.types.ndarray(dtype=ti.f32, ndim=1),  # (H,)
    inverse_focal: ti.f32,
    n: ti.template(),
    bands: ti.i32,
    flow: ti.types.ndarray(dtype=ti.f32, ndim=3),  # (2, H, W)
    inverse_depth: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
):
    height, width = rho.shape[1], rho.shape[2]
    for task in range(CHUNK * bands):
        if task % CHUNK == 0:
            band = task // CHUNK
            for y in range(first_row(band, height, bands), first_row(band + 1, height, bands)):
                for x in range(width):
                    _motion_at(rho, x_hat, y_hat, inverse_focal, n, flow, inverse_depth, y, x)


@Kernel
def _motion_fields_by_pixel(
    rho: ti.types.ndarray(dtype=ti.f32, ndim=3),  # (n, H, W)
    x_hat: ti.types.ndarray(dtype=ti.f32, ndim=1),  # (W,)
    y_hat: ti.types.ndarray(dtype=ti.f32, ndim=1),  # (H,)
    inverse_focal: ti.f32,
    n: ti.template(),
    flow: ti.types.ndarray(dtype=ti.f32, ndim=3),  # (2, H, W)
    inverse_depth: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
):
    for y, x in ti.ndrange(rho.shape[1], rho.shape[2]):
        _motion_at(rho, x_hat, y_hat, inverse_focal, n, flow, inverse_depth, y, x)


@ti.func
def _motion_at(
    rho: ti.template(), x_hat: ti.template(), y_hat: ti.template(), inverse_focal, n: ti.template(),
    flow: ti.template(), inverse_depth: ti.template(), y, x,
):  # fmt: skip
    unknowns = ti.static([bind(rho[k, y, x]) for k in range(n)])
    columns = ti.static(motion_columns(n, x_hat[x], y_hat[y]))
    u, v = ti.static(flow_of(columns, unknowns))
    flow[0, y, x] = u
    flow[1, y, x] = v
    square = unknowns[0] * unknowns[0] + unknowns[1] * unknowns[1] + unknowns[2] * unknowns[2]
    inverse_depth[y, x] = ti.sqrt(square) * inverse_focal


def rigid_fields(
    inverse_depth: np.ndarray,  # (H, W) float32: D, px/frame
    labels: np.ndarray,  # (H, W) int32: index of each pixel's motion
    # x_hat, y_hat: (W,), (H,) float32: normalised coordinates
    x_hat: np.ndarray,
    y_hat: np.ndarray,
    # (2, H, W) float32: (u, v), px/frame (`tisfm.kernels.rigid.epipolar`); 0 without motion,
    # exactly
    flow: np.ndarray,
    rho: np.ndarray,  # (6, H, W) float32: ρ̂, px/frame
    *,
    motions: np.ndarray,  # (K, 3, 4) array: R and t
    twists: np.ndarray,  # (K, 6) array: T, which is multiplied by D, and f·ω
    focal: float,  # px
    by_pixel: bool = False,  # whether every pixel has its own thread
) -> None:
    """Compute the exact flow of rigid motions, and from their twists a ρ̂ with Gρ̂ = flow.

    To first order ρ̂ = (D T, f·ω). The exact flow minus the flow Gρ̂ of this first order is added to
    the first two components of ρ̂, which move a pixel right and down.
    """
    height, width = inverse_depth.shape
    count = len(motions)
    check_array(inverse_depth, (height, width), "inverse_depth", aligned=False)
    check_array(labels, (height, width), "labels", dtype=np.int32, aligned=False)
    check_array(x_hat, (width,), "x_hat", aligned=False)
    check_array(y_hat, (height,), "y_hat", aligned=False)
    check_array(flow, (2, height, width), "flow", aligned=False)
    check_array(rho, (6, height, width), "rho", aligned=False)
    if motions.shape != (count, 3, 4) or twists.shape != (count, 6):
        raise ValueError(
            f"motions is {motions.shape} and twists {twists.shape}: expected as many of (3, 4) as "
            "of (6,)"
        )
    if labels.min() < 0 or labels.max() >= count:
        raise ValueError(f"labels go from {labels.min()} to {labels.max()}: {count} motions")
    # R − 1 instead of R, so that zero motion gives exactly zero flow.
    change = (np.array(motions, np.float64) - np.eye(3, 4)).astype(np.float32)
    arguments = inverse_depth, labels, x_hat, y_hat, change, twists.astype(np.float32), focal
    if by_pixel:
        _rigid_fields_by_pixel(*arguments, flow, rho)
        return
    _rigid_fields(*arguments, max(1, height // READOUT_BAND), flow, rho)


@Kernel
def _rigid_fields(
    inverse_depth: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    labels: ti.types.ndarray(dtype=ti.i32, ndim=2),  # (H, W)
    x_hat: ti.types.ndarray(dtype=ti.f32, ndim=1),  # (W,)
    y_hat: ti.types.ndarray(dtype=ti.f32, ndim=1),  # (H,)
    change: ti.types.ndarray(dtype=ti.f32, ndim=3),  # (K, 3, 4): R − 1 and t
    twists: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (K, 6)
    focal: ti.f32,
    bands: ti.i32,
    flow: ti.types.ndarray(dtype=ti.f32, ndim=3),  # (2, H, W)
    rho: ti.types.ndarray(dtype=ti.f32, ndim=3),  # (6, H, W)
):
    height, width = inverse_depth.shape[0], inverse_depth.shape[1]
    for task in range(CHUNK * bands):
        if task % CHUNK == 0:
            band = task // CHUNK
            for y in range(first_row(band, height, bands), first_row(band + 1, height, bands)):
                for x in range(width):
                    _rigid_at(
                        inverse_depth, labels, x_hat, y_hat, change, twists, focal, flow, rho, y, x
                    )  # fmt: skip


@Kernel
def _rigid_fields_by_pixel(
    inverse_depth: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    labels: ti.types.ndarray(dtype=ti.i32, ndim=2),  # (H, W)
    x_hat: ti.types.ndarray(dtype=ti.f32, ndim=1),  # (W,)
    y_hat: ti.types.ndarray(dtype=ti.f32, ndim=1),  # (H,)
    change: ti.types.ndarray(dtype=ti.f32, ndim=3),  # (K, 3, 4): R − 1 and t
    twists: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (K, 6)
    focal: ti.f32,
    flow: ti.types.ndarray(dtype=ti.f32, ndim=3),  # (2, H, W)
    rho: ti.types.ndarray(dtype=ti.f32, ndim=3),  # (6, H, W)
):
    for y, x in ti.ndrange(inverse_depth.shape[0], inverse_depth.shape[1]):
        _rigid_at(inverse_depth, labels, x_hat, y_hat, change, twists, focal, flow, rho, y, x)


@ti.func
def _rigid_at(
    inverse_depth: ti.template(), labels: ti.template(), x_hat: ti.template(), y_hat: ti.template(),
    change: ti.template(), twists: ti.template(), focal, flow: ti.template(), rho: ti.template(), y,
    x,
):  # fmt: skip
    k = labels[y, x]
    x0, y0, depth = x_hat[x], y_hat[y], inverse_depth[y, x]
    d = depth / focal
    x_change, y_change = (
        _coordinate_change(change, k, 0, x0, y0, d),
        _coordinate_change(change, k, 1, x0, y0, d),
    )
    depth_change = ti.max(_coordinate_change(change, k, 2, x0, y0, d), MIN_DEPTH_RATIO - 1.0)
    nearness = focal / (1.0 + depth_change)
    u, v = nearness * (x_change - x0 * depth_change), nearness * (y_change - y0 * depth_change)
    flow[0, y, x], flow[1, y, x] = u, v
    forward = depth * twists[k, 2]
    rotation = ti.static([bind(twists[k, i]) for i in range(3, 6)])
    model_u, model_v = ti.static(
        flow_of(motion_columns(6, x0, y0)[2:], [forward, rotation[0], rotation[1], rotation[2]])
    )
    rho[0, y, x], rho[1, y, x] = u - model_u, v - model_v
    rho[2, y, x] = forward
    for i in ti.static(range(3)):
        rho[3 + i, y, x] = rotation[i]


@ti.func
def _coordinate_change(change: ti.template(), k, row: ti.template(), x, y, d):
    """Return the change of one coordinate of x̂ by a motion, at inverse depth d."""
    rotation_part = change[k, row, 0] * x + change[k, row, 1] * y + change[k, row, 2]
    return rotation_part + d * change[k, row, 3]
