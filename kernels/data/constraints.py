"""The data term as linear constraints on the flow; the solver needs nothing else from the images.

A constraint p u + q v + c = 0 is stored as (p, q, c), times the root of its weight. The brightness
term has one constraint, the gradient term two. A term is the sum of its squared constraints; its
motion tensor (J11, J12, J22, j1, j2, J_tt) is the sum of their (p², p q, q², p c, q c, c²). The
number of constraints determines the terms: 1 is brightness, 2 gradient, 3 brightness and gradient.

A lane array holds an image as vertical strips (`tisfm.kernels.layout.lanes`).
"""

from collections.abc import Sequence
from typing import Any

import taichi as ti

from tisfm.kernels.data.derivatives import DERIVATIVE_HALO
from tisfm.kernels.layout.internals import bind  # stores a value in a kernel's variable
from tisfm.kernels.layout.lanes import LaneArray, LaneData, LaneGrid, lane_kernel
from tisfm.kernels.layout.launch import Launch, operation
from tisfm.kernels.model import MIN_DIVISOR
from tisfm.kernels.model.robust import robust_data, scale_pairs, terms_of


@operation
def constancy_constraints(
    grid: LaneGrid,
    derivatives: LaneData,  # lane array, 3 components, halo `DERIVATIVE_HALO`: I_x, I_y, I_t
    flow: LaneData,  # lane array, 2 components: (u₀, v₀), px/frame
    # lane array, 1 component: weight of the constraints at each pixel; 0 outside the image
    mask: LaneData,
    # lane array, 3, 6 or 9 components: (p, q, c) of brightness, if its weight is above 0, then of
    # both derivatives of the image, if the weight of the gradient is above 0
    out: LaneData,
    # lane array, 6 components: Σ w_i J_i with the robust weights at (u₀, v₀)
    # (`tisfm.kernels.solve.weight_update`)
    tensor: LaneData | None = None,
    *,
    # brightness, gradient: weights of the two terms; at least one above 0
    brightness: float,
    gradient: float,
    # ζ, grey levels per px; None for constraints without normalisation
    normalization: float | None,
    scales: Sequence[float],  # m_i ε² of each term in use (`tisfm.kernels.model.robust`)
) -> Launch:
    """Write the constraints of brightness and of gradient constancy, linearised about a flow.

    With frame 1 warped by (u₀, v₀), constancy is I_t + ∇I·(u − u₀, v − v₀) = 0, or p u + q v + c
    = 0 in the whole flow (u, v), with (p, q) = ∇I and c = I_t − ∇I·(u₀, v₀). With (u₀, v₀) = 0 it
    is eq. 3 of the paper that docs/method.md cites. Gradient constancy is the same with I_x and
    with I_y in place of I.

    With normalisation, each squared constraint is divided by |∇I|² + ζ². It is then the squared
    distance, in px, of (u, v) from the line of its solutions, for any contrast of the image.

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
    count = constraint_count(brightness, gradient)
    grid.check(derivatives, 3, "derivatives", halo=DERIVATIVE_HALO)
    grid.check(flow, 2, "flow")
    grid.check(mask, 1, "mask")
    grid.check(out, 3 * count, "out")
    if tensor is not None:
        grid.check(tensor, 6, "tensor")
    return _constancy_constraints[grid.lanes].bind(
        derivatives, flow, mask, brightness, gradient,
        1.0 if normalization is None else normalization**2 + MIN_DIVISOR,
        0.0 if normalization is None else 1.0, *scale_pairs(scales), count, tensor is not None,
        grid.is_serial, out, out if tensor is None else tensor,
    )  # fmt: skip


def constraint_count(brightness: float, gradient: float) -> int:
    """Return the number of constraints per pixel."""
    return int(brightness > 0) + 2 * int(gradient > 0)


@lane_kernel
def _constancy_constraints(
    derivatives: LaneArray(3),  # (3, H+4, S+4)
    flow: LaneArray(3),  # (2, H+2, S+2)
    mask: LaneArray(3),  # (1, H+2, S+2)
    brightness: ti.f32,
    gradient: ti.f32,
    squared_normalization: ti.f32,  # ζ² + ε; 1 without normalisation
    is_normalized: ti.f32,  # 1 or 0
    inverse_scale0: ti.f32,
    scale0: ti.f32,
    inverse_scale1: ti.f32,
    scale1: ti.f32,
    count: ti.template(),
    with_tensor: ti.template(),
    is_serial: ti.template(),
    out: LaneArray(3),  # (3 count, H+2, S+2)
    tensor: LaneArray(3),  # (6, H+2, S+2), written if `with_tensor`
):
    ti.loop_config(serialize=is_serial)
    for row, position in ti.ndrange(out.shape[1] - 2, out.shape[2] - 2):
        y, s = row + 1, position + 1
        u, v = flow[0, y, s], flow[1, y, s]
        # Taichi compiles only the derivatives that the constraints in use need.
        ix, iy = derivatives[0, y + 1, s + 1], derivatives[1, y + 1, s + 1]
        it = derivatives[2, y + 1, s + 1]
        ixx = _x_derivative(derivatives, 0, y + 1, s + 1)
        ixy = _x_derivative(derivatives, 1, y + 1, s + 1)
        iyy = _y_derivative(derivatives, 1, y + 1, s + 1)
        # Differentiation is linear: the temporal change of I_x is the x derivative of I_t.
        itx = _x_derivative(derivatives, 2, y + 1, s + 1)
        ity = _y_derivative(derivatives, 2, y + 1, s + 1)
        brightness_weight, gradient_weight = brightness * mask[0, y, s], gradient * mask[0, y, s]
        weighted_derivatives = (
            (brightness_weight, ix, iy, it),
            (gradient_weight, ixx, ixy, itx),
            (gradient_weight, ixy, iyy, ity),
        )
        constraints = ti.static(
            _weighted_constraints(
                weighted_derivatives, count, squared_normalization, is_normalized, u, v
            )
        )
        for i in ti.static(range(count)):
            for k in ti.static(range(3)):
                out[3 * i + k, y, s] = constraints[i][k]
        if ti.static(with_tensor):
            scales = ti.static([(inverse_scale0, scale0), (inverse_scale1, scale1)])
            _, sums = ti.static(robust_data(terms_of(constraints), scales, u, v))
            for k in ti.static(range(6)):
                tensor[k, y, s] = sums[k]


def _weighted_constraints(
    weighted_derivatives: tuple,
    count: int,
    squared_normalization: Any,
    is_normalized: Any,
    u: Any,
    v: Any,
) -> list:
    """Return (p, q, c) of the constraints in use, times the root of the weight."""
    constraints = []
    for weight, ix, iy, it in {
        1: weighted_derivatives[:1],
        2: weighted_derivatives[1:],
        3: weighted_derivatives,
    }[count]:
        root = bind(ti.sqrt(weight / (squared_normalization + is_normalized * (ix * ix + iy * iy))))
        constraints.append((bind(root * ix), bind(root * iy), bind(root * (it - ix * u - iy * v))))
    return constraints


@ti.func
def _x_derivative(array: ti.template(), k: ti.template(), y, s):
    inner_weight, outer_weight = ti.static(8.0 / 12.0, 1.0 / 12.0)
    inner = array[k, y, s + 1] - array[k, y, s - 1]
    return inner_weight * inner - outer_weight * (array[k, y, s + 2] - array[k, y, s - 2])


@ti.func
def _y_derivative(array: ti.template(), k: ti.template(), y, s):
    inner_weight, outer_weight = ti.static(8.0 / 12.0, 1.0 / 12.0)
    inner = array[k, y + 1, s] - array[k, y - 1, s]
    return inner_weight * inner - outer_weight * (array[k, y + 2, s] - array[k, y - 2, s])
