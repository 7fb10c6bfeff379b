"""Images into lanes and back."""

import taichi as ti

from tisfm.kernels.lanes import (
    LaneArray,
    LaneGrid,
    lane_count,
    lane_kernel,
    lane_of,
    store_lane,
)

IMAGE_HALO = 2  # derivatives look two pixels to each side


def image_to_lanes(grid: LaneGrid, image, out) -> None:
    """Lay an image into lanes, repeating its border in the halo and in the padding.

    Parameters
    ----------
    grid : LaneGrid
    image : (H, W) float32
    out : lane array, 1 component, halo `IMAGE_HALO`
    """
    grid.check_image(image, "image")
    grid.check(out, 1, "out", halo=IMAGE_HALO)
    _image_to_lanes[grid.lanes](image, out)


@lane_kernel
def _image_to_lanes(
    image: ti.types.ndarray(dtype=ti.f32, ndim=2),  # (H, W)
    out: LaneArray(3),  # (1, H+4, S+4)
):
    halo = ti.static(IMAGE_HALO)
    strip = out.shape[2] - 2 * halo
    for row, position in ti.ndrange(out.shape[1], out.shape[2]):
        y = ti.max(0, ti.min(row - halo, image.shape[0] - 1))
        for lane in ti.static(range(lane_count(out))):
            x = ti.max(0, ti.min(lane * strip + position - halo, image.shape[1] - 1))
            store_lane(out, 0, row, position, lane, image[y, x])


def lanes_to_images(grid: LaneGrid, array, out) -> None:
    """Copy a lane array into a stack of images.

    Parameters
    ----------
    grid : LaneGrid
    array : lane array, k components
    out : (k, H, W) float32
    """
    grid.check(array, out.shape[0], "array")
    grid.check_image(out, "out", components=out.shape[0])
    _lanes_to_images[grid.lanes](array, out)


@lane_kernel
def _lanes_to_images(
    array: LaneArray(3),  # (k, H+2, S+2)
    out: ti.types.ndarray(dtype=ti.f32, ndim=3),  # (k, H, W)
):
    strip = array.shape[2] - 2
    lanes = ti.static(lane_count(array))
    for k, y, s in ti.ndrange(out.shape[0], out.shape[1], strip):
        value = array[k, y + 1, s + 1]
        for lane in ti.static(range(lanes)):
            x = lane * strip + s
            if x < out.shape[2]:
                out[k, y, x] = lane_of(value, lane, lanes)
