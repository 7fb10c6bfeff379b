"""How large frames may be: rows beyond what 32 bits count in products, and a clear refusal."""

import numpy as np
import pytest
import taichi as ti

import tisfm
from tests.draws import nightly_except
from tisfm.kernels.layout.lanes import LaneGrid, aligned_zeros, first_row


@ti.kernel
def _borders(height: ti.i32, bands: ti.i32, out: ti.types.ndarray(dtype=ti.i32, ndim=1)):
    for band in range(bands + 1):
        out[band] = first_row(band, height, bands)


@pytest.mark.parametrize("height", [1, 37, 92_681, 400_000, 4_194_303])
@pytest.mark.parametrize("rows", [4, 16, 96])
def test_bands_share_the_rows_of_any_image(height, rows):
    bands = max(1, height // rows)
    out = np.empty(bands + 1, np.int32)
    _borders(height, bands, out)
    expected = np.arange(bands + 1, dtype=np.int64) * height // bands
    np.testing.assert_array_equal(out, expected)


@pytest.mark.parametrize("lanes", nightly_except(16, of=[8, 16]))
def test_all_rows_of_a_long_frame_are_computed(lanes):
    """Bands of weights, sweeps and warps: 200,000 rows, up to the last one."""
    from tisfm.kernels.data.warp import warp
    from tisfm.kernels.layout.images import IMAGE_HALO
    from tisfm.kernels.solve.linear_system import LinearSystem
    from tisfm.solver.sampling import spline_taps

    height = 200_000
    grid = LaneGrid(height, 4, lanes)
    tensor, weights, rho, previous = (grid.allocate(k) for k in (6, 2, 1, 1))
    rho.fill(1)
    system = LinearSystem(
        grid=grid,
        tensor=tensor,
        weights=weights,
        x_hat=grid.columns(grid.column_index()),
        y_hat=aligned_zeros((height + 2,)),
        alpha=1.0,
        stiffness=(1.0,),
    )
    constraints = grid.allocate(3)
    constraints[0], constraints[2] = 1, -2  # D = 2
    options = {"contrast": 1.0, "scales": (np.inf,)}
    sums = system.bind_weight_update(rho, previous, constraints, grid.edge_mask(), **options)()
    columns = lanes * grid.strip_width
    assert sums.size == pytest.approx(np.sqrt(height * columns), rel=1e-6)
    system.sweep(rho, relaxation=1.0, sweeps=2)
    assert rho[0, 1:-1, 1:-1].min() > 1.4  # all of them were drawn to 2

    image = np.arange(height * 4, dtype=np.float32).reshape(height, 4)
    warped, mask = grid.allocate(1, halo=IMAGE_HALO), grid.allocate(1)
    warp(grid, image, spline_taps(image), grid.allocate(2), warped, mask)
    columns_of_first_lane = warped[0, 4:-4, 4 : 4 + grid.strip_width, 0]
    np.testing.assert_array_equal(columns_of_first_lane, image[:, : grid.strip_width])


LARGE = [(20_000, 20_000), (4, 5_000_000), (5_000_000, 4)]


@pytest.mark.parametrize("size", nightly_except((5_000_000, 4), of=LARGE), ids=str)
def test_frames_beyond_what_kernels_index_are_refused(size):
    for large in LARGE:
        with pytest.raises(ValueError, match=r"frames of .* px are larger than kernels can index"):
            LaneGrid(*large, 16)
    frame = np.broadcast_to(np.uint8(7), size)
    with pytest.raises(ValueError, match="scale them down, or cut them into tiles"):
        tisfm.interpret(frame, frame)
