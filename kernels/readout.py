"""What a user reads off the unknowns, on plain images."""

import numpy as np
import taichi as ti

from tisfm.kernels.lanes import CHUNK, check_array
from tisfm.kernels.launch import Kernel
from tisfm.kernels.rigid_motion import flow_of, motion_columns
from tisfm.kernels.small_spd import bind

BAND = 16  # rows, at least


def motion_fields(
    rho: np.ndarray,
    x_hat: np.ndarray,
    y_hat: np.ndarray,
    flow: np.ndarray,
    inverse_depth: np.ndarray,
    *,
    focal: float,
    by_pixel: bool = False,
) -> None:
    """Compute image motion (eq. 25) and inverse depth (eq. 24 without its sign) of a field.

    Parameters
    ----------
    rho : (n, H, W) float32
        ρ̂, px/frame, of 6 or 3 components.
    x_hat, y_hat : (W,), (H,) float32
        Normalised coordinates.
    flow : (2, H, W) float32
        (u, v) = G ρ̂, px/frame.
    inverse_depth : (H, W) float32
        ‖(τ1, τ2, τ3)‖ = ‖(ρ̂1, ρ̂2, ρ̂3)‖/f.
    focal : float
        px.
    by_pixel : bool
        Whether every pixel is a thread's own, as a GPU wants it, and not a band of rows.
    """
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
    bands = max(1, height // BAND)
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
            for y in range(band * height // bands, (band + 1) * height // bands):
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
    rho: ti.template(),
    x_hat: ti.template(),
    y_hat: ti.template(),
    inverse_focal,
    n: ti.template(),
    flow: ti.template(),
    inverse_depth: ti.template(),
    y,
    x,
):
    here = ti.static([bind(rho[k, y, x]) for k in range(n)])
    columns = ti.static(motion_columns(n, x_hat[x], y_hat[y]))
    u, v = ti.static(flow_of(columns, here))
    flow[0, y, x] = u
    flow[1, y, x] = v
    square = here[0] * here[0] + here[1] * here[1] + here[2] * here[2]
    inverse_depth[y, x] = ti.sqrt(square) * inverse_focal
