"""Paths of the camera and of moving objects, from above and from the side, into axes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tisfm.checks import check_unmasked
from tisfm.errors import InputError
from tisfm.metrics import Similarity, align
from tisfm.show.axes import (
    Sizes,
    disable_formulas,
    label_axes,
    limit_ticks,
    plot_axes,
    style_plot,
    write_centered,
)
from tisfm.show.palette import (
    CONTRAST_COLOR,
    RESULT_COLOR,
    TEXT_COLOR,
    as_hex,
    color_ramp,
    colors_of_categories,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.lines import Line2D

PathView = Literal["above", "side"]

# Set by hand.
_MAX_POINTS = 2000  # points of a drawn line
_SHADE_RANGE = 40, 215  # levels of the ramp, 0 to 255, that are visible on dark and light pages
_HALF_SIDE_RATIO = 0.58  # half side of the plot divided by the largest extent of the path
_MAX_LEGEND_WIDTH = 0.7  # width of a legend inside the axes, divided by the axes' width
# Extent of the plot divided by the largest extent of the path: small motion is not enlarged.
_MIN_EXTENT = 0.35

# For both axes of a plot: index and sign of the coordinate in space; then the names of both axes.
_VIEWS: dict[PathView, tuple[tuple[int, int], tuple[int, int], str, str]] = {
    "above": ((0, 1), (2, 1), "X, right", "Z, forward"),
    "side": ((2, 1), (1, -1), "Z, forward", "−Y, up"),
}


def draw_path(
    poses: ArrayLike,
    *,
    axes: Axes | None = None,
    view: PathView = "above",
    truth: ArrayLike | None = None,
    piece: ArrayLike | None = None,
    unit: str = "relative",
    title: str | None = None,
) -> Axes:
    """Draw the path of a camera, and the true path if it is given.

    The path begins at the circle and ends at the square; early parts are dark, late parts light.
    The axes are the axes of the first camera of the true path if it is given, else of the path.

    Parameters
    ----------
    poses : (N, 4, 4) array_like
        Camera to world; NaN for a frame without a pose.
    axes : matplotlib.axes.Axes, optional
        Axes to draw into; by default those of a new figure, ``axes.figure``.
    view : {"above", "side"}
        From above, Z over X, or from the right side, up over Z.
    truth : (N, 4, 4) array_like, optional
        True poses, NaN if unknown. Each piece is aligned to the true poses by a similarity
        (`tisfm.metrics.align`), and drawn in their unit.
    piece : (N,) array_like of int, optional
        Number of the piece of each frame; below 0 for no piece. The frames of a piece are connected
        and share a scale. Without true poses only the largest piece is drawn, because the scales of
        the pieces differ.
    unit : str
        Unit of the drawn positions.
    title : str, optional
        Text above the plot.

    Returns
    -------
    matplotlib.axes.Axes
        The axes.

    Raises
    ------
    ValueError
        If a shape is wrong, numbers of frames differ, `piece` has no integers, or `view` is
        unknown.

    Examples
    --------
    >>> import tisfm
    >>> from tisfm.show import draw_path, save_figure
    >>> result = tisfm.Reconstruction.load("walk")
    >>> axes = draw_path(result.poses, view="above", piece=result.piece)
    >>> save_figure("path.png", axes.figure, dpi=60)
    """
    _check_view(view)
    path = _check_poses("poses", poses)
    true_path = None if truth is None else _check_poses("truth", truth)
    piece_numbers = np.zeros(len(path), np.int64) if piece is None else _check_piece(piece)
    for name, array in (("truth", true_path), ("piece", piece_numbers)):
        if array is not None and len(array) != len(path):
            raise InputError(f"{name} has {len(array)} frames but poses have {len(path)}")
    piece_numbers = np.where(_has_pose(path), piece_numbers, -1)
    pieces, counts = np.unique(piece_numbers[piece_numbers >= 0], return_counts=True)
    target = plot_axes(4.4, 3.9) if axes is None else axes
    sizes = style_plot(target, title)
    if true_path is None:
        pieces = pieces[[int(np.argmax(counts))]] if len(pieces) else pieces
        lines = [path[piece_numbers == piece_number, :3, 3] for piece_number in pieces]
        lines = _to_camera_axes(lines, path[piece_numbers == pieces[0]][0]) if lines else []
        name = "path" if len(counts) < 2 else f"largest of {len(counts)} pieces"
        _draw_camera_paths(target, sizes, lines, [], view, unit, name)
        return target
    lines, errors = [], []
    for piece_number in pieces:
        in_piece = piece_numbers == piece_number
        has_both = in_piece & _has_pose(true_path)
        if not has_both.any():
            continue
        similarity = align(path[has_both, :3, 3], true_path[has_both, :3, 3])
        lines.append(similarity.apply(path[in_piece, :3, 3]))
        errors.append(similarity.apply(path[has_both, :3, 3]) - true_path[has_both, :3, 3])
    true_poses = true_path[_has_pose(true_path)]
    name = "no pose to compare"
    if lines:
        rmse = float(np.sqrt(np.square(np.concatenate(errors)).sum(axis=1).mean()))
        name = f"path, rmse {rmse:.3g} {unit}"
    if len(true_poses):
        lines = _to_camera_axes(lines, true_poses[0])
        (true_line,) = _to_camera_axes([true_poses[:, :3, 3]], true_poses[0])
        _draw_camera_paths(target, sizes, lines, [true_line], view, unit, name)
    else:
        _draw_camera_paths(target, sizes, [], [], view, unit, "no true pose")
    return target


def draw_object_paths(
    objects: Mapping[int, ArrayLike],
    *,
    axes: Axes | None = None,
    view: PathView = "above",
    camera: ArrayLike | None = None,
    unit: str = "relative",
    title: str | None = None,
) -> Axes:
    """Draw the paths of moving objects, in the colours of their labels.

    Parameters
    ----------
    objects : mapping of int to (n, 4, 4) array_like
        Poses of each object, object to world, by its number; NaN if unknown. For a reconstruction:
        ``{item.id: item.poses for item in result.objects}``.
    axes : matplotlib.axes.Axes, optional
        Axes to draw into; by default those of a new figure, ``axes.figure``.
    view : {"above", "side"}
        As for `draw_path`.
    camera : (N, 4, 4) array_like, optional
        Poses of the camera, to draw its path too.
    unit : str
        Unit of the drawn positions.
    title : str, optional
        Text above the plot.

    Returns
    -------
    matplotlib.axes.Axes
        The axes.

    Raises
    ------
    ValueError
        If a shape is wrong, a number is negative, or `view` is unknown.

    Examples
    --------
    >>> from tisfm.scenes import bodies_film, bodies_path
    >>> from tisfm.show import draw_object_paths, save_figure
    >>> film = bodies_film(bodies_path(5), 24, 32)
    >>> axes = draw_object_paths(dict(enumerate(film.body_poses, 1)), camera=film.poses)
    >>> save_figure("objects.png", axes.figure, dpi=60)
    """
    _check_view(view)
    if any(number < 0 for number in objects):
        raise InputError(f"objects are {sorted(objects)}: expected numbers from 0")
    object_poses = {
        number: _check_poses(f"object {number}", poses) for number, poses in objects.items()
    }
    positions = {number: poses[_has_pose(poses), :3, 3] for number, poses in object_poses.items()}
    positions = {number: line for number, line in positions.items() if len(line)}
    target = plot_axes(4.4, 3.9) if axes is None else axes
    sizes = style_plot(target, title)
    lines = list(positions.values())
    if camera is not None:
        path = _check_poses("camera", camera)
        path = path[_has_pose(path), :3, 3]
        if len(path):
            lines.append(path)
            _draw_line(target, path, view, sizes, color=TEXT_COLOR, style="--", name="camera")
            _mark_ends(target, path, view, sizes, colors=(TEXT_COLOR, TEXT_COLOR))
    for number, line in positions.items():
        color = as_hex(colors_of_categories(np.array(number)))
        _draw_line(target, line, view, sizes, color=color, name=f"object {number}")
        _mark_ends(target, line, view, sizes, colors=(color, color))
    _set_up_axes(target, sizes, lines, view, unit)
    if not positions:
        write_centered(target, sizes, "no object has a pose")
    if lines:
        _draw_legend(target, sizes)
    return target


def _draw_camera_paths(
    axes: Axes,
    sizes: Sizes,
    lines: list[NDArray[np.float64]],  # (n, 3) positions of each piece
    true_lines: list[NDArray[np.float64]],  # the same of the true path, if known
    view: PathView,
    unit: str,
    name: str,
) -> None:
    """Draw shaded paths, the true path dashed, the axes and the legend."""
    from matplotlib.lines import Line2D

    handles = []
    for line in true_lines:
        _draw_line(axes, line, view, sizes, color=TEXT_COLOR, style="--", name="truth")
        handles.append(Line2D([], [], color=TEXT_COLOR, linestyle="--", linewidth=sizes.line))
    for line in lines:
        _draw_shaded_line(axes, line, view, sizes)
        _mark_ends(axes, line, view, sizes, colors=(RESULT_COLOR, CONTRAST_COLOR))
    _set_up_axes(axes, sizes, [*lines, *true_lines], view, unit)
    if not lines:
        write_centered(axes, sizes, "no pose" if name == "path" else name)
        return
    middle = as_hex(color_ramp("confidence")[sum(_SHADE_RANGE) // 2])
    handles.append(Line2D([], [], color=middle, linewidth=2 * sizes.line))
    _draw_legend(axes, sizes, handles, ["truth"] * len(true_lines) + [name])


def _draw_line(
    axes: Axes,
    positions: NDArray[np.float64],
    view: PathView,
    sizes: Sizes,
    *,
    color: str,
    name: str,
    style: str = "-",
) -> None:
    x, y = _project(_subsample(positions), view)
    relative_width, z_order = (1.8, 2) if style == "-" else (0.8, 2.5)  # dashed lines lie on top
    axes.plot(
        x,
        y,
        color=color,
        linestyle=style,
        linewidth=relative_width * sizes.line,
        label=name,
        zorder=z_order,
    )


def _draw_shaded_line(
    axes: Axes, positions: NDArray[np.float64], view: PathView, sizes: Sizes
) -> None:
    """Draw a path that is dark at its beginning and light at its end."""
    from matplotlib.collections import LineCollection

    ends = np.stack(_project(_subsample(positions), view), axis=1)
    segments = np.stack([ends[:-1], ends[1:]], axis=1)
    levels = np.linspace(*_SHADE_RANGE, len(segments)).astype(int)
    colors = color_ramp("confidence")[levels] / 255
    axes.add_collection(
        LineCollection(list(segments), colors=colors, linewidths=2 * sizes.line, capstyle="round")
    )


def _mark_ends(
    axes: Axes,
    positions: NDArray[np.float64],
    view: PathView,
    sizes: Sizes,
    *,
    colors: tuple[str, str],
) -> None:
    x, y = _project(positions, view)
    for index, marker, color in ((0, "o", colors[0]), (-1, "s", colors[1])):
        axes.plot(
            x[[index]],
            y[[index]],
            marker=marker,
            color=color,
            markersize=5 * sizes.line,
            linestyle="none",
            zorder=3,
        )


def _set_up_axes(
    axes: Axes, sizes: Sizes, lines: list[NDArray[np.float64]], view: PathView, unit: str
) -> None:
    """Give both axes one scale, and name them."""
    _, _, x_name, y_name = _VIEWS[view]
    label_axes(axes, sizes, f"{x_name} ({unit})", f"{y_name} ({unit})")
    axes.set_aspect("equal", adjustable="box")
    limit_ticks(axes, sizes)
    if not lines:
        axes.set(xlim=(-1, 1), ylim=(-1, 1))
        return
    positions = np.concatenate(lines)
    x, y = _project(positions, view)
    extent = np.ptp(positions, axis=0).max()
    half_side = _HALF_SIDE_RATIO * max(np.ptp(x), np.ptp(y), _MIN_EXTENT * extent, 1e-9)
    for set_limits, values in ((axes.set_xlim, x), (axes.set_ylim, y)):
        middle = (values.min() + values.max()) / 2
        set_limits(middle - half_side, middle + half_side)


def _draw_legend(
    axes: Axes, sizes: Sizes, handles: list[Line2D] | None = None, names: Sequence[str] = ()
) -> None:
    """Draw the legend inside the axes, or above the axes if the legend is wide."""
    legend_arguments = (handles, names) if handles is not None else ()
    longest_name = max(map(len, names or axes.get_legend_handles_labels()[1]))
    needed_width = (longest_name * 0.6 + 4) * sizes.text_inches * axes.figure.dpi
    placement: dict[str, Any] = {"loc": "best"}
    if needed_width > _MAX_LEGEND_WIDTH * axes.get_window_extent().width:
        placement = {"loc": "lower right", "bbox_to_anchor": (1.0, 1.0), "borderaxespad": 0.2}
        lines = len(names) or len(axes.get_legend_handles_labels()[1])
        if axes.get_title():
            axes.set_title(axes.get_title(), pad=(1.6 * lines + 1.2) * sizes.text, parse_math=False)
    legend = axes.legend(
        *legend_arguments,
        **placement,
        fontsize=sizes.text,
        labelcolor=TEXT_COLOR,
        framealpha=0.7,
        handlelength=1.6,
        borderpad=0.3,
    )
    disable_formulas(legend)


def _to_camera_axes(
    lines: list[NDArray[np.float64]], camera_pose: NDArray[np.float64]
) -> list[NDArray[np.float64]]:
    """Return lines of positions, (n, 3) each, in the axes of a camera with a given pose."""
    to_camera = Similarity(
        scale=1.0,
        rotation=camera_pose[:3, :3].T,
        translation=-camera_pose[:3, :3].T @ camera_pose[:3, 3],
    )
    return [to_camera.apply(line) for line in lines]


def _project(
    positions: NDArray[np.float64], view: PathView
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the coordinates of positions, (M, 3), along both axes of a view."""
    (x_index, x_sign), (y_index, y_sign), _, _ = _VIEWS[view]
    return x_sign * positions[:, x_index], y_sign * positions[:, y_index]


def _subsample(positions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return at most `_MAX_POINTS` positions, in even steps, with the first and the last."""
    indices = np.unique(np.linspace(0, len(positions) - 1, _MAX_POINTS).astype(int))
    return positions[indices]


def _has_pose(poses: NDArray[np.float64]) -> NDArray[np.bool_]:
    return np.asarray(np.isfinite(poses).all(axis=(1, 2)))


def _check_poses(name: str, poses: ArrayLike) -> NDArray[np.float64]:
    array = check_unmasked(poses, name, np.float64)
    if array.ndim != 3 or array.shape[1:] != (4, 4):
        raise InputError(f"{name} has the shape {array.shape}, expected (N, 4, 4)")
    return array


def _check_piece(piece: ArrayLike) -> NDArray[np.integer]:
    array = check_unmasked(piece, "piece")
    if array.ndim != 1:
        raise InputError(f"piece has the shape {array.shape}, expected (N,)")
    if array.dtype.kind not in "iu" and array.size:
        raise InputError(
            f"piece has dtype {array.dtype}, expected integers, below 0 for frames of no piece"
        )
    return array.astype(np.int64)  # a type with negative values


def _check_view(view: str) -> None:
    if view not in _VIEWS:
        raise InputError(f"view is {view!r}, expected one of {', '.join(get_args(PathView))}")
