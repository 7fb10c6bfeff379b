"""Conversion of images to lane arrays and back."""

import numpy as np
import taichi as ti

from tisfm.kernels.layout.lanes import (
    LaneArray,
    LaneData,
    LaneGrid,
    lane_count,
    lane_kernel,
    lane_of,
    store_lane,
)
from tisfm.kernels.layout.launch import Launch, operation

IMAGE_HALO = 4  # px: second derivatives apply a stencil of two pixels to each side twice


def image_to_lanes(
    grid: LaneGrid,
    image: np.ndarray,  # (H, W) float32
    out: LaneData,  # lane array, any halo
    *,
    component: int = 0,
) -> None:
    """Copy an image into a component of a lane array; halo and padding repeat its border."""
    grid.check_image(image, "image")
    halo = (out.shape[1] - grid.height) // 2
    grid.check(out, out.shape[0], "out", halo=halo)
    if not 0 <= component < out.shape[0]:
        raise ValueError(f"component is {component}: out has {out.shape[0]}")
    _image_to_lanes[grid.lanes](image, halo, component, grid.is_serial, out)


@lane_kernel
def _image_to_lanes(
    image: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    halo: ti.i32,
    component: ti.i32,
    is_serial: ti.template(),
    out: LaneArray(3),  # (k, H+2·halo, S+2·halo)
):
    strip = out.shape[2] - 2 * halo
    ti.loop_config(serialize=is_serial)
    for row, position in ti.ndrange(out.shape[1], out.shape[2]):
        y = ti.max(0, ti.min(row - halo, image.shape[0] - 1))
        for lane in range(ti.static(lane_count(out))):
            x = ti.max(0, ti.min(lane * strip + position - halo, image.shape[1] - 1))
            store_lane(out, component, row, position, lane, image[y, x])


def lanes_to_images(
    grid: LaneGrid,
    array: LaneData,  # lane array
    out: np.ndarray,  # (k, H, W) float32
    *,
    component: int = 0,  # the first of the k components
) -> None:
    """Copy components of a lane array into a stack of images."""
    grid.check(array, array.shape[0], "array")
    grid.check_image(out, "out", components=out.shape[0])
    if not 0 <= component <= array.shape[0] - out.shape[0]:
        raise ValueError(
            f"component is {component}: array has {array.shape[0]}, and out takes {out.shape[0]}"
        )
    _lanes_to_images[grid.lanes](array, component, out)


@lane_kernel
def _lanes_to_images(
    array: LaneArray(3),  # (component + k or more, H+2, S+2)
    component: ti.i32,
    out: ti.types.ndarray(dtype=ti.f32, ndim=3),  # (k, H, W)
):
    strip = array.shape[2] - 2
    lanes = ti.static(lane_count(array))
    # Every lane has its own columns; the last lane may have fewer columns than the others.
    full_columns = ti.max(0, out.shape[2] - (lanes - 1) * strip)
    for k, y in ti.ndrange(out.shape[0], out.shape[1]):
        for s in range(full_columns):
            values = array[component + k, y + 1, s + 1]
            for lane in range(lanes):
                out[k, y, lane * strip + s] = lane_of(values, lane, lanes)
        for lane in ti.static(range(lanes)):
            for s in range(full_columns, ti.min(strip, out.shape[2] - lane * strip)):
                out[k, y, lane * strip + s] = lane_of(
                    array[component + k, y + 1, s + 1], lane, lanes
                )


@operation
def multiply(
    grid: LaneGrid,
    factor: LaneData,  # lane array, 1 component or as many as `out`
    out: LaneData,  # lane array
) -> Launch:
    """Multiply a lane array in place, by a factor for each component or for all."""
    grid.check(out, out.shape[0], "out")
    grid.check(factor, factor.shape[0], "factor")
    if factor.shape[0] not in (1, out.shape[0]):
        raise ValueError(f"factor has {factor.shape[0]} components: expected 1 or {out.shape[0]}")
    return _multiply[grid.lanes].bind(factor, out)


@lane_kernel
def _multiply(
    factor: LaneArray(3),  # (1 or k, H+2, S+2)
    out: LaneArray(3),  # (k, H+2, S+2), in place
):
    for k, y, s in ti.ndrange(out.shape[0], out.shape[1], out.shape[2]):
        factor_index = ti.min(k, factor.shape[0] - 1)
        out[k, y, s] = out[k, y, s] * factor[factor_index, y, s]
