"""The data term as motion tensors: all that the solver needs to know of the images."""

import taichi as ti

from tisfm.kernels.derivatives import DERIVATIVE_HALO
from tisfm.kernels.lanes import LaneArray, LaneGrid, lane_kernel

TINY = 1e-12  # squared grey levels: no division by zero in uniform regions


def constancy_tensors(
    grid: LaneGrid, derivatives, flow, mask, out, *, brightness, gradient, normalization
) -> None:
    """Write the tensors of brightness and of gradient constancy, linearised about a flow.

    With frame 1 warped by (u₀, v₀), the constraint I_t + ∇I·(u − u₀, v − v₀) = 0 squared is
    (u,v) J (u,v)ᵀ + 2 jᵀ(u,v) + J_tt in the whole flow (u, v), with c = I_t − ∇I·(u₀, v₀),
    J = ∇I ∇Iᵀ, j = c ∇I and J_tt = c². With (u₀, v₀) = 0 it is the paper's eq. 4. Gradient
    constancy is the sum of the same for I_x and I_y in place of I.

    Normalised, each constraint is divided by |∇I|² + ζ²: it is then the squared distance, in px,
    of (u, v) from the line on which the constraint holds, whatever the contrast of the image.

    Parameters
    ----------
    grid : LaneGrid
    derivatives : lane array, 3 components, halo `DERIVATIVE_HALO`
        I_x, I_y, I_t.
    flow : lane array, 2 components
        (u₀, v₀), px/frame.
    mask : lane array, 1 component
        Weight of the constraints at each pixel; 0 outside the image.
    out : lane array, 6 or 12 components
        J11, J12, J22, j1, j2, J_tt: of brightness, if its weight is above 0, then of the
        gradient, if its weight is.
    brightness, gradient : float
        Weights of the two constraints; at least one above 0.
    normalization : float or None
        ζ, grey levels per px; None for constraints as they are.

    References
    ----------
    Brox, Bruhn, Papenberg, Weickert, "High accuracy optical flow estimation based on a theory for
    warping", ECCV 2004, doi 10.1007/978-3-540-24673-2_3 (gradient constancy); Zimmer, Bruhn,
    Weickert, "Optic flow in harmony", IJCV 2011, doi 10.1007/s11263-011-0422-6 (normalisation).
    """
    if brightness < 0 or gradient < 0 or not brightness + gradient > 0:
        raise ValueError(
            f"brightness is {brightness} and gradient is {gradient}: expected weights of at "
            "least 0, not both 0"
        )
    grid.check(derivatives, 3, "derivatives", halo=DERIVATIVE_HALO)
    grid.check(flow, 2, "flow")
    grid.check(mask, 1, "mask")
    grid.check(out, 6 * ((brightness > 0) + (gradient > 0)), "out")
    _constancy_tensors[grid.lanes](
        derivatives,
        flow,
        mask,
        brightness,
        gradient,
        1.0 if normalization is None else normalization**2 + TINY,
        0.0 if normalization is None else 1.0,
        brightness > 0,
        gradient > 0,
        grid.serial,
        out,
    )


@lane_kernel
def _constancy_tensors(
    derivatives: LaneArray(3),  # (3, H+4, S+4)
    flow: LaneArray(3),  # (2, H+2, S+2)
    mask: LaneArray(3),  # (1, H+2, S+2)
    brightness: ti.f32,
    gradient: ti.f32,
    noise: ti.f32,  # ζ²; 1 for constraints as they are
    normalized: ti.f32,  # 1 or 0
    use_brightness: ti.template(),
    use_gradient: ti.template(),
    serial: ti.template(),
    out: LaneArray(3),  # (6 or 12, H+2, S+2)
):
    ti.loop_config(serialize=serial)
    for row, position in ti.ndrange(out.shape[1] - 2, out.shape[2] - 2):
        y, s = row + 1, position + 1
        u, v = flow[0, y, s], flow[1, y, s]
        if ti.static(use_brightness):
            ix, iy = derivatives[0, y + 1, s + 1], derivatives[1, y + 1, s + 1]
            c = derivatives[2, y + 1, s + 1] - ix * u - iy * v
            weight = brightness * mask[0, y, s] / (noise + normalized * (ix * ix + iy * iy))
            out[0, y, s] = weight * ix * ix
            out[1, y, s] = weight * ix * iy
            out[2, y, s] = weight * iy * iy
            out[3, y, s] = weight * c * ix
            out[4, y, s] = weight * c * iy
            out[5, y, s] = weight * c * c
        if ti.static(use_gradient):
            first = ti.static(6 if use_brightness else 0)
            ixx = _along_row(derivatives, 0, y + 1, s + 1)
            ixy = _along_row(derivatives, 1, y + 1, s + 1)
            iyy = _along_column(derivatives, 1, y + 1, s + 1)
            # Differentiation is linear: the change of a derivative is the derivative of I_t.
            cx = _along_row(derivatives, 2, y + 1, s + 1) - ixx * u - ixy * v
            cy = _along_column(derivatives, 2, y + 1, s + 1) - ixy * u - iyy * v
            weight = gradient * mask[0, y, s]
            wx = weight / (noise + normalized * (ixx * ixx + ixy * ixy))
            wy = weight / (noise + normalized * (ixy * ixy + iyy * iyy))
            out[first, y, s] = wx * ixx * ixx + wy * ixy * ixy
            out[first + 1, y, s] = wx * ixx * ixy + wy * ixy * iyy
            out[first + 2, y, s] = wx * ixy * ixy + wy * iyy * iyy
            out[first + 3, y, s] = wx * cx * ixx + wy * cy * ixy
            out[first + 4, y, s] = wx * cx * ixy + wy * cy * iyy
            out[first + 5, y, s] = wx * cx * cx + wy * cy * cy


@ti.func
def _along_row(array: ti.template(), k: ti.template(), y, s):
    near, far = ti.static(8.0 / 12.0, 1.0 / 12.0)
    inner = array[k, y, s + 1] - array[k, y, s - 1]
    return near * inner - far * (array[k, y, s + 2] - array[k, y, s - 2])


@ti.func
def _along_column(array: ti.template(), k: ti.template(), y, s):
    near, far = ti.static(8.0 / 12.0, 1.0 / 12.0)
    inner = array[k, y + 1, s] - array[k, y - 1, s]
    return near * inner - far * (array[k, y + 2, s] - array[k, y - 2, s])
