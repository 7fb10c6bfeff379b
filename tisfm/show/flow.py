"""Optical flow as colours and as arrows."""

import functools
import math
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tisfm.errors import InputError
from tisfm.metrics.valid_pixels import is_known
from tisfm.show.arrays import as_flow, check_limit
from tisfm.show.palette import FLOW_PERCENTILE

# Hues of the wheel (Baker et al.): number of steps from each corner of the colour cube to the next.
# There are more steps where the eye distinguishes more hues.
_HUE_STEPS = (
    ((255, 0, 0), 15),  # red to yellow
    ((255, 255, 0), 6),  # yellow to green
    ((0, 255, 0), 4),  # green to cyan
    ((0, 255, 255), 11),  # cyan to blue
    ((0, 0, 255), 13),  # blue to magenta
    ((255, 0, 255), 6),  # magenta to red
)
_BRIGHTNESS_BEYOND_LIMIT = 0.75  # brightness of motion beyond the limit, as in the benchmark


class Arrows(NamedTuple):
    """Arrows of a flow field on a regular grid: four arrays of the same length.

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.show import quiver_points
    >>> arrows = quiver_points(np.ones((48, 64, 2)), 16)
    >>> bool((arrows.u == 1).all() and (arrows.v == 1).all())
    True
    """

    x: NDArray[np.intp]  # column of the tail
    y: NDArray[np.intp]  # row of the tail
    u: NDArray[np.floating[Any]]  # px, to the right
    v: NDArray[np.floating[Any]]  # px, downwards


def flow_radius(flow: ArrayLike) -> NDArray[np.floating[Any]]:
    """Return the length of the flow at each pixel; NaN if unknown.

    Parameters
    ----------
    flow : (H, W, 2) array_like
        Flow (u, v), px. NaN and components beyond 1e9 are unknown.

    Returns
    -------
    (H, W) floating ndarray
        Length, px.

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.show import flow_radius
    >>> flow_radius(np.array([[[3.0, 4.0]]])).tolist()
    [[5.0]]
    """
    values = as_flow("flow", flow)
    is_known_flow = is_known(values[..., 0]) & is_known(values[..., 1])
    values = np.where(is_known_flow[..., None], values, 0)
    radius = np.hypot(values[..., 0], values[..., 1])
    radius[~is_known_flow] = np.nan
    return radius


def usual_length(flow: ArrayLike) -> float:
    """Return the 98th percentile of the length of a flow, px.

    Parameters
    ----------
    flow : (H, W, 2) array_like
        Flow (u, v), px. NaN and components beyond 1e9 are unknown.

    Returns
    -------
    float
        The percentile over known vectors, px; 0.0 if all vectors are unknown.

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.show import usual_length
    >>> 0 < usual_length(np.full((12, 16, 2), 3.0)) < 5
    True
    """
    radius = flow_radius(flow)
    known_lengths = radius[np.isfinite(radius)]
    return float(np.percentile(known_lengths, FLOW_PERCENTILE)) if known_lengths.size else 0.0


def flow_to_color(
    flow: ArrayLike, *, limit: float | None = None, beyond: Literal["darker", "same"] = "darker"
) -> NDArray[np.uint8]:
    """Show flow as colours: direction as hue, length as saturation.

    No motion is white. Motion to the right is red, downwards yellow, to the left cyan to blue and
    upwards violet. Colours are fully saturated at `limit`. Longer motion is darkened by the factor
    0.75, or has the colour of the limit.

    Parameters
    ----------
    flow : (H, W, 2) array_like
        Flow (u, v), px, v downwards. Unknown flow, NaN or beyond 1e9, is black.
    limit : float, optional
        Length of full saturation, px. By default the greatest known length, so that no motion is
        darkened. Give the same limit for all frames of a sequence, and for pictures to compare.
    beyond : {"darker", "same"}
        Colour of motion beyond the limit: darker, as in the benchmark, or the colour of the limit,
        which avoids false edges if the limit is a percentile.

    Returns
    -------
    (H, W, 3) uint8 ndarray
        Colours red, green, blue.

    Raises
    ------
    ValueError
        If `flow` is not (H, W, 2), `limit` is negative or not finite, or `beyond` is unknown.

    Notes
    -----
    The wheel of Baker et al. has 55 hues. Here the last hue runs into the first, so that the colour
    of flow to the right does not jump with the sign of v. Published pictures differ from
    pictures of this function by at most one of the 55 steps of hue.

    References
    ----------
    S. Baker et al., "A database and evaluation methodology for optical flow", International
    Journal of Computer Vision 92 (2011) 1-31, doi:10.1007/s11263-010-0390-2.

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.show import flow_to_color
    >>> flow_to_color(np.zeros((1, 1, 2))).tolist()  # no motion is white
    [[[255, 255, 255]]]
    """
    values = as_flow("flow", flow)
    if beyond not in ("darker", "same"):
        raise InputError(f"beyond is {beyond!r}, expected darker or same")
    radius = flow_radius(values)
    is_known_flow = np.isfinite(radius)
    if limit is None:
        max_length = float(np.max(radius, where=is_known_flow, initial=0.0))
    else:
        max_length = check_limit("limit", limit)
    u = np.where(is_known_flow, values[..., 0], 0)
    v = np.where(is_known_flow, values[..., 1], 0)
    hue = _hue(u, v)
    # With a limit of 0, motion is either zero or beyond the limit.
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        share = np.where(radius > 0, np.minimum(radius / max_length, 2), 0)[..., None].astype(
            np.float32
        )
    color_beyond = hue * np.float32(_BRIGHTNESS_BEYOND_LIMIT) if beyond == "darker" else hue
    color = np.where(share <= 1, 255 - share * (255 - hue), color_beyond)
    color[~is_known_flow] = 0
    return np.rint(color).astype(np.uint8)


def color_wheel(size: int) -> NDArray[np.uint8]:
    """Draw the legend of `flow_to_color`: a disc whose pixels show the flow from its centre.

    Parameters
    ----------
    size : int
        Width and height, px. The rim of the disc is the flow of length `limit`.

    Returns
    -------
    (size, size, 3) uint8 ndarray
        Colours red, green, blue; white around the disc, with a smooth rim.

    Raises
    ------
    ValueError
        If `size` is less than 1.

    Examples
    --------
    >>> from tisfm.show import color_wheel
    >>> color_wheel(64).shape[:2]
    (64, 64)
    """
    if size < 1:
        raise InputError(f"size is {size}, expected 1 or more pixels")
    axis = (np.arange(size, dtype=np.float32) - (size - 1) / 2) * (2 / size)
    flow = np.stack(np.meshgrid(axis, axis), axis=2)
    radius = np.hypot(flow[..., 0], flow[..., 1])
    # Pixels beyond the rim have the hue of the rim, so that the rim blends into white.
    color = flow_to_color(flow / np.maximum(radius, 1)[..., None], limit=1 + 1e-6)
    opacity = np.clip((1 - radius) * (size / 2) + 0.5, 0, 1)[..., None]
    return np.rint(255 + opacity * (color.astype(np.float32) - 255)).astype(np.uint8)


def quiver_points(flow: ArrayLike, step: int) -> Arrows:
    """Choose arrows of a flow at the nodes of a regular grid, centred in the frame.

    Parameters
    ----------
    flow : (H, W, 2) array_like
        Flow (u, v), px. Nodes of unknown flow, NaN or beyond 1e9, are left out.
    step : int
        Distance between nodes, px.

    Returns
    -------
    Arrows
        Tails (x, y), column and row, and flow (u, v) at the tails, px.

    Raises
    ------
    ValueError
        If `flow` is not (H, W, 2) or `step` is less than 1.

    Examples
    --------
    >>> import numpy as np
    >>> from tisfm.show import quiver_points
    >>> arrows = quiver_points(np.ones((48, 64, 2)), 16)
    >>> len(arrows.x) == len(arrows.u)
    True
    """
    values = as_flow("flow", flow)
    if step < 1:
        raise InputError(f"step is {step}, expected 1 or more pixels")
    rows, columns = (_centred_nodes(length, step) for length in values.shape[:2])
    y, x = (grid.ravel() for grid in np.meshgrid(rows, columns, indexing="ij"))
    tails = values[y, x]
    is_known_flow = is_known(tails[:, 0]) & is_known(tails[:, 1])
    return Arrows(
        x[is_known_flow], y[is_known_flow], tails[is_known_flow, 0], tails[is_known_flow, 1]
    )


def _centred_nodes(length: int, step: int) -> NDArray[np.intp]:
    """Return node positions along a length, px, about half a step from both ends."""
    count = max(1, length // step)
    return (length - 1 - (count - 1) * step) // 2 + step * np.arange(count)


def _hue(u: NDArray[Any], v: NDArray[Any]) -> NDArray[np.float32]:
    """Return the saturated colour of each direction, interpolated between two hues."""
    wheel = _wheel()
    count = len(wheel)
    position = np.arctan2(v, u).astype(np.float32) * np.float32(count / (2 * math.pi))
    floor = np.floor(position)
    first = floor.astype(np.intp) % count
    return wheel[first] + (position - floor)[..., None] * _wheel_steps()[first]


@functools.cache
def _wheel() -> NDArray[np.float32]:
    """Return the 55 hues, (55, 3), red first."""
    corners = [np.array(corner, dtype=np.float32) for corner, _ in _HUE_STEPS]
    hues = [
        start + (end - start) * (step / count)
        for start, end, (_, count) in zip(
            corners, corners[1:] + corners[:1], _HUE_STEPS, strict=True
        )
        for step in range(count)
    ]
    return np.array(hues, dtype=np.float32)


@functools.cache
def _wheel_steps() -> NDArray[np.float32]:
    """Return the difference from each hue to the next, (55, 3), and from the last to the first."""
    wheel = _wheel()
    return np.roll(wheel, -1, axis=0) - wheel
