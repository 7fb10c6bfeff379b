"""Lane arrays: a memory layout with which one source runs as SIMD on a CPU and as plain floats.

An image is cut into `lanes` vertical strips of equal width. Column x of the image lies in lane
``x // strip`` at strip position ``x % strip``. A lane array of k components is float32 of shape
(k, H + 2·halo, strip + 2·halo, lanes), without the last axis if lanes = 1. Eastern and western
neighbours lie in the same lane one strip position away, so a kernel loads and stores whole vectors
of lanes. The width of a strip is even, so red and black sites alternate alike in all lanes.

The halo columns repeat the border columns of the neighbouring strips. Rows and columns outside the
image are zero unless a function says otherwise. Columns from the image's width to
``lanes * strip`` are padding. Padding has no data, and no smoothness joins it to the image, so the
unknowns of a solver stay zero there.

On a GPU there is one lane, and the arrays of a grid stay on the device (``ti.ndarray``): `place`
copies an array there, and `on_host` copies it back.
"""

import math
import types
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import taichi as ti

from tisfm.kernels.layout import internals
from tisfm.kernels.layout.buffers import ALIGNMENT, buffers
from tisfm.kernels.layout.internals import bind  # stores a value in a kernel's variable
from tisfm.kernels.layout.launch import Kernel

LANES = (1, 8, 16)
CHUNK = 512  # iterations: Taichi gives a thread at least this number of a parallel loop
# pixels: up to this size, one thread finishes before other threads have started
MAX_SERIAL_PIXELS = 8192
INDEX_MASK = 2**29 - 1  # bit mask of indices; a lane array has at most as many elements
# largest number of components: a lane array holds weights of 6 unknowns on 2 edges; a stack of
# plain images has at most 7 images
MAX_COMPONENTS = 12
MAX_HALO = 4  # px: the halo of frames
MAX_INDEX = 2**31 - 1  # largest index of plain arrays: kernels have 32-bit indices

LaneData = Any  # a lane array: NumPy's, or ti.ndarray for arrays on a device


@dataclass(frozen=True)
class LaneArray:
    """Annotation of a kernel argument that is a lane array with `ndim` axes before the lanes."""

    ndim: int


@dataclass(frozen=True)
class SumArray:
    """Annotation of a kernel argument that holds sums: float64, or float32 for one lane.

    With one lane, kernels add up in float32 anyway, and not every GPU has float64.
    """

    ndim: int


def lane_kernel(function: Callable) -> dict[int, Kernel]:
    """Make a Taichi kernel for each lane count from one function.

    Arguments annotated with `LaneArray` become arrays of vectors of 8 or 16 lanes, or of plain
    floats. Arguments annotated with `SumArray` become arrays of float64 or float32. The kernel for
    n lanes is ``result[n]``.
    """

    def make_kernel(element: Any, sums: Any) -> Kernel:
        elements = {LaneArray: element, SumArray: sums}
        copy = types.FunctionType(
            function.__code__, function.__globals__, function.__name__, function.__defaults__
        )
        copy.__qualname__, copy.__module__ = function.__qualname__, function.__module__
        copy.__doc__ = function.__doc__
        copy.__annotations__ = {
            name: ti.types.ndarray(dtype=elements[type(kind)], ndim=kind.ndim)
            if type(kind) in elements
            else kind
            for name, kind in function.__annotations__.items()
        }
        return Kernel(copy)

    vector_kernels = {
        lanes: make_kernel(ti.types.vector(lanes, ti.f32), ti.f64) for lanes in LANES if lanes > 1
    }
    return {1: make_kernel(ti.f32, ti.f32), **vector_kernels}


def lane_count(array: Any) -> int:
    """Return the number of lanes of a kernel argument, while the kernel is being compiled."""
    shape = internals.element_shape(array)
    return shape[0] if shape else 1


@ti.func
def lane_of(value, lane: ti.template(), lanes: ti.template()):
    """Return one lane of a loaded value as a plain float."""
    result = 0.0
    if ti.static(lanes > 1):
        result = value[lane]
    else:
        result = value
    return result


@ti.func
def set_lane(value: ti.template(), lane: ti.template(), lanes: ti.template(), lane_value):
    """Replace one lane of a variable."""
    if ti.static(lanes > 1):
        value[lane] = lane_value
    else:
        value = lane_value


@ti.func
def store_lane(array: ti.template(), k, y, s, lane: ti.template(), value):
    """Write one lane of an element of a lane array."""
    if ti.static(lane_count(array) > 1):
        array[k, y, s][lane] = value
    else:
        array[k, y, s] = value


def component_starts(array: Any, count: int) -> list:
    """Return the start indices of the components of a lane array, for `element`, while compiling.

    Call it before loops, so that the indices are computed once.
    """
    plane = bind(array.shape[1] * array.shape[2])
    return [bind((k * plane) & INDEX_MASK) for k in range(count)]


def element(array: Any, index: Any) -> Any:
    """Return an element of a lane array by one index, while compiling.

    The address from three indices takes seven instructions at each access, because 32-bit indices
    might overflow. Here, `index` is the sum of a start of `component_starts` and of
    ``(y * row + s) & INDEX_MASK`` with ``row = array.shape[2] & INDEX_MASK``. The masks show the
    compiler that no overflow is possible. Then the load instruction itself does most of the sum.
    """
    return internals.subscript(array, _indices(array, index))


@ti.func
def load(array: ti.template(), index):
    """Return an element by one index, as `element` does."""
    loaded = ti.static([bind(element(array, index))])
    return loaded[0]


@ti.func
def store(array: ti.template(), index, value):
    """Write an element by one index of the kind that `element` takes."""
    indices = ti.static(_indices(array, index))
    array[indices[0], indices[1], indices[2]] = value


def _indices(array: Any, index: Any) -> list:
    """Return (0, 0, index), or, if Taichi checks indices, the component, row and position."""
    if not internals.checks_indices():
        return [0, 0, index]
    rows, row = array.shape[1], array.shape[2]
    return [bind(index // (rows * row)), bind(index // row % rows), bind(index % row)]


@ti.func
def first_row(band, height, bands):
    """Return the first row of a band, if `bands` bands share the rows of an image evenly."""
    return ti.cast(ti.cast(band, ti.i64) * height // bands, ti.i32)  # product may need 64 bits


@ti.func
def refresh_halo(array: ti.template(), k, y):
    """Copy the border columns of the neighbouring strips into the halo columns of row y."""
    if ti.static(lane_count(array) > 1):
        strip = array.shape[2] - 2
        first, last = array[k, y, 1], array[k, y, strip]
        west, east = 0.0 * first, 0.0 * last
        for lane in range(ti.static(lane_count(array) - 1)):
            west[lane + 1] = last[lane]
            east[lane] = first[lane + 1]
        array[k, y, 0] = west
        array[k, y, strip + 1] = east


@dataclass(frozen=True)
class LaneGrid:
    """An image grid of `height` × `width` pixels cut into `lanes` strips."""

    # height, width: size of the image, px
    height: int
    width: int
    lanes: int = 8  # number of strips: 8 or 16 for SIMD on a CPU, 1 for plain floats
    on_device: bool = False  # whether arrays stay on the device; only for one lane

    def __post_init__(self) -> None:
        if self.height < 1 or self.width < 1:
            raise ValueError(f"a grid of {self.height} × {self.width} pixels has no pixel")
        if self.lanes not in LANES:
            raise ValueError(f"lanes is {self.lanes}: expected 1, 8 or 16")
        if self.on_device and self.lanes != 1:
            raise ValueError(f"lanes is {self.lanes} and on_device is True: expected 1 lane there")
        padded = (self.height + 2 * MAX_HALO) * (self.strip_width + 2 * MAX_HALO)
        if (
            MAX_COMPONENTS * padded > INDEX_MASK
            or MAX_COMPONENTS * self.height * self.width > MAX_INDEX
            or CHUNK * max(self.height, self.width) > MAX_INDEX
        ):
            raise ValueError(
                f"frames of {self.height} × {self.width} px are larger than kernels can index "
                f"(about {MAX_INDEX // MAX_COMPONENTS // 1_000_000} million pixels, fewer "
                "where they are very narrow): scale them down, or cut them into tiles"
            )

    @property
    def strip_width(self) -> int:
        """Columns per lane: even, so that red and black sites alternate equally in all lanes."""
        columns = -(-self.width // self.lanes)
        return columns + columns % 2

    @property
    def is_serial(self) -> bool:
        """Whether the image is so small that kernels are faster in one thread."""
        return self.lanes > 1 and self.height * self.width <= MAX_SERIAL_PIXELS

    def shape(self, components: int, halo: int = 1) -> tuple[int, ...]:
        """Return the shape of a lane array of this grid."""
        return (components, self.height + 2 * halo, *self._strip_shape(halo))

    def allocate(self, components: int, halo: int = 1, *, zeros: bool = True) -> LaneData:
        """Return a lane array of zeros, or of arbitrary values, aligned for vector loads."""
        shape = self.shape(components, halo)
        if self.on_device:
            return ti.ndarray(ti.f32, shape)
        return aligned_zeros(shape) if zeros else aligned_empty(shape)

    def place(self, array: np.ndarray, *, vectors: bool = False) -> LaneData:
        """Return a float32 array for the kernels of this grid: itself, or a copy on the device.

        `vectors` says whether the last axis of the array becomes vector elements.
        """
        if not self.on_device:
            return array
        copy = (
            ti.Vector.ndarray(array.shape[-1], ti.f32, array.shape[:-1])
            if vectors
            else ti.ndarray(ti.f32, array.shape)
        )
        copy.from_numpy(np.ascontiguousarray(array))
        return copy

    def copy(self, source: LaneData, out: LaneData) -> None:
        """Copy an array of this grid to another array of this grid."""
        if self.on_device:
            out.copy_from(source)
        else:
            out[...] = source

    def columns(
        self,
        values: np.ndarray,  # (lanes · strip,) array: one value per column, padding included
        halo: int = 1,
    ) -> np.ndarray:  # (strip + 2·halo[, lanes]) float32, zero in the halo
        """Return a value for each column as a NumPy array in the layout of a row of lane arrays."""
        table = aligned_zeros(self._strip_shape(halo))
        by_lane = np.asarray(values, np.float32).reshape(self.lanes, self.strip_width).T
        table[halo : halo + self.strip_width] = by_lane.reshape(
            table[halo : halo + self.strip_width].shape
        )
        return table

    def column_index(self) -> np.ndarray:
        """Return the index of every column, padding included, as float64."""
        return np.arange(self.lanes * self.strip_width, dtype=np.float64)

    def image_mask(self) -> np.ndarray:
        """Return a NumPy lane array of 1 component: 1 on pixels of the image, else 0."""
        mask = aligned_zeros(self.shape(1))
        mask[0, 1:-1] = self.columns(self.column_index() < self.width)
        return mask

    def edge_mask(self) -> LaneData:
        """Return a lane array of 2 components: 1 if a pixel has a neighbour in the image, else 0.

        The first component is for the eastern neighbour, the second for the southern neighbour.
        """
        edges = aligned_zeros(self.shape(2))
        edges[0, 1:-1] = self.columns(self.column_index() < self.width - 1)
        edges[1, 1:-2] = self.columns(self.column_index() < self.width)
        return self.place(edges)

    def check(self, array: LaneData, components: int, name: str, halo: int = 1) -> None:
        """Raise unless `array` is a lane array of this grid that a kernel can write."""
        check_array(array, self.shape(components, halo), name)

    def check_columns(self, table: LaneData, name: str, halo: int = 1) -> None:
        """Raise unless `table` has the shape that `columns` returns."""
        check_array(table, self._strip_shape(halo), name)

    def check_rows(self, table: LaneData, name: str) -> None:
        """Raise unless `table` has one float32 per row, halo included."""
        check_array(table, (self.height + 2,), name)

    def check_image(self, image: LaneData, name: str, components: int | None = None) -> None:
        """Raise unless `image` is a float32 image of this grid, or a stack of `components`."""
        size = (self.height, self.width)
        check_array(image, size if components is None else (components, *size), name, aligned=False)

    def _strip_shape(self, halo: int) -> tuple[int, ...]:
        columns = self.strip_width + 2 * halo
        return (columns,) if self.lanes == 1 else (columns, self.lanes)


def aligned_zeros(shape: tuple[int, ...]) -> np.ndarray:
    """Return float32 zeros whose first element lies on an `ALIGNMENT` boundary."""
    array = aligned_empty(shape)
    array.fill(0)
    return array


def aligned_empty(shape: tuple[int, ...]) -> np.ndarray:
    """Return a float32 array of arbitrary values, aligned as `aligned_zeros`."""
    return buffers.allocate_floats(math.prod(shape)).reshape(shape)


def on_host(array: LaneData) -> np.ndarray:
    """Return an array of a grid as a NumPy array: itself, or a copy from the device."""
    return array if isinstance(array, np.ndarray) else array.to_numpy()


def check_array(
    array: LaneData,
    shape: tuple[int, ...],
    name: str,
    dtype: type[np.generic] = np.float32,
    aligned: bool = True,
) -> None:
    """Raise unless `array` can be an argument of a kernel.

    For an array of floats on the device, only the shape is checked.

    Raises TypeError if it is not a NumPy array of this dtype.

    Raises ValueError if its shape differs, or it is not C-contiguous, writable and, if `aligned`,
    aligned.
    """
    if isinstance(array, ti.Ndarray) and array.dtype is ti.f32 and dtype is np.float32:
        shape_ = array.shape + array.element_shape
        if shape_ != tuple(shape):
            raise ValueError(f"{name} is {shape_}: expected {tuple(shape)}")
        return
    if not isinstance(array, np.ndarray) or array.dtype != dtype:
        dtype_ = getattr(array, "dtype", type(array).__name__)
        raise TypeError(f"{name} is {dtype_}: expected a NumPy array of {np.dtype(dtype).name}")
    if array.shape != tuple(shape):
        raise ValueError(f"{name} is {array.shape}: expected {tuple(shape)}")
    if not (array.flags.c_contiguous and array.flags.writeable):
        raise ValueError(f"{name} must be C-contiguous and writable")
    if aligned and array.__array_interface__["data"][0] % ALIGNMENT:
        raise ValueError(
            f"{name} must be aligned to {ALIGNMENT} bytes: allocate it with "
            "LaneGrid.allocate or aligned_zeros"
        )
