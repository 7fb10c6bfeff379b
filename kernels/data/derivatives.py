"""Spatial and temporal derivatives of a pair of frames.

A lane array holds an image as vertical strips (`tisfm.kernels.layout.lanes`).
"""

import taichi as ti

from tisfm.kernels.layout.images import IMAGE_HALO
from tisfm.kernels.layout.lanes import LaneArray, LaneData, LaneGrid, lane_kernel
from tisfm.kernels.layout.launch import Launch, operation

DERIVATIVE_HALO = 2  # px: second derivatives read two pixels to each side
SCHEMES = ("cube", "five_tap")


@operation
def derivatives(
    grid: LaneGrid,
    # frame0, frame1: lane arrays, 1 component, halo `IMAGE_HALO`: frame 0, and frame 1 warped to it
    frame0: LaneData,
    frame1: LaneData,
    # lane array, 3 components, halo `DERIVATIVE_HALO`: I_x, I_y in grey levels per px and I_t in
    # grey levels per frame. Halo and padding hold the derivatives of the image with its border
    # repeated.
    out: LaneData,
    *,
    # ``"cube"``: first differences averaged over the 2×2×2 cube of pixels to the south-east (Horn
    # and Schunck 1981, doi 10.1016/0004-3702(81)90024-2), an estimate at (x+½, y+½, t+½).
    # ``"five_tap"``: (1, −8, 0, 8, −1)/12 on the mean of both frames and the difference of the
    # frames, an estimate at (x, y, t+½) of fourth order in space. I_t is exactly 0 where the frames
    # agree at all pixels of the stencil.
    scheme: str,
) -> Launch:
    """Compute (I_x, I_y, I_t)."""
    grid.check(frame0, 1, "frame0", halo=IMAGE_HALO)
    grid.check(frame1, 1, "frame1", halo=IMAGE_HALO)
    grid.check(out, 3, "out", halo=DERIVATIVE_HALO)
    if scheme not in SCHEMES:
        raise ValueError(f"scheme is {scheme!r}: expected one of {SCHEMES}")
    kernel = _cube if scheme == "cube" else _five_tap
    return kernel[grid.lanes].bind(frame0, frame1, grid.is_serial, out)


@lane_kernel
def _cube(
    frame0: LaneArray(3),  # (1, H+8, S+8)
    frame1: LaneArray(3),  # (1, H+8, S+8)
    is_serial: ti.template(),
    out: LaneArray(3),  # (3, H+4, S+4)
):
    ti.loop_config(serialize=is_serial)
    for row, position in ti.ndrange(out.shape[1], out.shape[2]):
        y, s = row + 2, position + 2
        a, b = frame0[0, y, s], frame0[0, y, s + 1]
        c, d = frame0[0, y + 1, s], frame0[0, y + 1, s + 1]
        e, f = frame1[0, y, s], frame1[0, y, s + 1]
        g, h = frame1[0, y + 1, s], frame1[0, y + 1, s + 1]
        out[0, row, position] = 0.25 * ((b - a) + (d - c) + (f - e) + (h - g))
        out[1, row, position] = 0.25 * ((c - a) + (d - b) + (g - e) + (h - f))
        # Fast math may reorder sums and leave a rounding error where both frames agree, so I_t is
        # set to 0 there.
        zero, one = 0.0 * a, 0.0 * a + 1.0
        is_equal = ti.select(e == a, one, zero)
        is_equal = ti.select(f == b, is_equal, zero)
        is_equal = ti.select(g == c, is_equal, zero)
        is_equal = ti.select(h == d, is_equal, zero)
        change = 0.25 * ((e - a) + (f - b) + (g - c) + (h - d))
        out[2, row, position] = ti.select(is_equal > 0.0, zero, change)


@lane_kernel
def _five_tap(
    frame0: LaneArray(3),  # (1, H+8, S+8)
    frame1: LaneArray(3),  # (1, H+8, S+8)
    is_serial: ti.template(),
    out: LaneArray(3),  # (3, H+4, S+4)
):
    # weights for the sum of both frames, which is twice their mean
    inner_weight, outer_weight = ti.static(8.0 / 24.0, 1.0 / 24.0)
    ti.loop_config(serialize=is_serial)
    for row, position in ti.ndrange(out.shape[1], out.shape[2]):
        y, s = row + 2, position + 2
        inner_x = frame0[0, y, s + 1] + frame1[0, y, s + 1] - frame0[0, y, s - 1]
        outer_x = frame0[0, y, s + 2] + frame1[0, y, s + 2] - frame0[0, y, s - 2]
        inner_y = frame0[0, y + 1, s] + frame1[0, y + 1, s] - frame0[0, y - 1, s]
        outer_y = frame0[0, y + 2, s] + frame1[0, y + 2, s] - frame0[0, y - 2, s]
        out[0, row, position] = inner_weight * (inner_x - frame1[0, y, s - 1]) - outer_weight * (
            outer_x - frame1[0, y, s - 2]
        )
        out[1, row, position] = inner_weight * (inner_y - frame1[0, y - 1, s]) - outer_weight * (
            outer_y - frame1[0, y - 2, s]
        )
        out[2, row, position] = frame1[0, y, s] - frame0[0, y, s]
