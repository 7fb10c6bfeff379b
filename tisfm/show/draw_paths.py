"""Paths of the camera and of things that move, from above and from the side, into axes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tisfm.checks import unmasked
from tisfm.errors import InputError
from tisfm.metrics import Similarity, align
from tisfm.show.axes import (
    Sizes,
    few_ticks,
    name_axis,
    plot_axes,
    style_plot,
    write_inside,
    write_plainly,
)
from tisfm.show.palette import ESTIMATE, INK, OTHER, as_hex, color_ramp, colors_of_categories

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.lines import Line2D

PathView = Literal["above", "side"]

_MOST_POINTS = 2000  # of a line
_SHADES = 40, 215  # of the ramp: its ends are lost on a dark page or on a light one
_ROOM = 0.58  # of the longest side, around the middle
_MOST_LEGEND = 0.7  # of the width of axes
_FLATTEST = 0.35  # of the spread in space: what hardly moves aside is not blown up

# Axes that are drawn with their signs, and how they are called.
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
    """Draw the path of a camera, beside the true one if there is one.

    It begins at the circle and ends at the square, early dark and late light. Axes are those of
    the first camera: of the truth if there is one, else of the path.

    Parameters
    ----------
    poses : (N, 4, 4) array_like
        Camera to world; NaN where a frame has none.
    axes : matplotlib.axes.Axes, optional
        Where it is drawn; by default in a figure of its own, ``axes.figure``.
    view : {"above", "side"}
        From above, Z over X, or from the right side, up over Z.
    truth : (N, 4, 4) array_like, optional
        True poses, NaN where they are not known. Each piece is brought nearest to them by a
        similarity (`tisfm.metrics.align`), and drawn in their unit.
    piece : (N,) array_like of int, optional
        The piece that a frame belongs to, each with a scale of its own; below 0 for none. Without
        a truth the largest is drawn alone, as there is nothing to hold them together.
    unit : str
        Unit of what is drawn.
    title : str, optional
        Text above the plot.

    Returns
    -------
    matplotlib.axes.Axes
        What it was drawn into.

    Raises
    ------
    ValueError
        If a shape is wrong, numbers of frames differ, `piece` has other than integers, or `view` is
        another.
    ImportError
        If Matplotlib is not installed.

    Examples
    --------
    >>> import tisfm
    >>> from tisfm.show import draw_path, save_figure
    >>> result = tisfm.Reconstruction.load("walk")
    >>> axes = draw_path(result.poses, view="above", piece=result.piece)
    >>> save_figure("path.png", axes.figure, dpi=60)
    """
    _check_view(view)
    given = _poses("poses", poses)
    true = None if truth is None else _poses("truth", truth)
    number = np.zeros(len(given), np.int64) if piece is None else _piece(piece)
    for name, others in (("truth", true), ("piece", number)):
        if others is not None and len(others) != len(given):
            raise InputError(f"{name} has {len(others)} frames but poses have {len(given)}")
    number = np.where(_posed(given), number, -1)
    pieces, counts = np.unique(number[number >= 0], return_counts=True)
    target = plot_axes(4.4, 3.9) if axes is None else axes
    sizes = style_plot(target, title)
    if true is None:
        pieces = pieces[[int(np.argmax(counts))]] if len(pieces) else pieces
        lines = [given[number == k, :3, 3] for k in pieces]
        lines = _in_first_axes(lines, given[number == pieces[0]][0]) if lines else []
        name = "path" if len(counts) < 2 else f"largest of {len(counts)} pieces"
        _finish(target, sizes, lines, [], view, unit, name)
        return target
    lines, errors = [], []
    for k in pieces:
        mine = number == k
        both = mine & _posed(true)
        if not both.any():
            continue
        fitted = align(given[both, :3, 3], true[both, :3, 3])
        lines.append(fitted.apply(given[mine, :3, 3]))
        errors.append(fitted.apply(given[both, :3, 3]) - true[both, :3, 3])
    known = true[_posed(true)]
    name = "no pose to compare"
    if lines:
        rmse = float(np.sqrt(np.square(np.concatenate(errors)).sum(axis=1).mean()))
        name = f"found, rmse {rmse:.3g} {unit}"
    if len(known):
        lines = _in_first_axes(lines, known[0])
        (of_truth,) = _in_first_axes([known[:, :3, 3]], known[0])
        _finish(target, sizes, lines, [of_truth], view, unit, name)
    else:
        _finish(target, sizes, [], [], view, unit, "no true pose")
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
    """Draw the paths of things that move on their own, in the colours of their labels.

    Parameters
    ----------
    objects : mapping of int to (n, 4, 4) array_like
        Poses of each, object to world, by its number; NaN where they are not known. Of a
        reconstruction: ``{thing.id: thing.poses for thing in result.objects}``.
    axes : matplotlib.axes.Axes, optional
        Where it is drawn; by default in a figure of its own, ``axes.figure``.
    view : {"above", "side"}
        As for `draw_path`.
    camera : (N, 4, 4) array_like, optional
        Poses of the camera, which is drawn too.
    unit : str
        Unit of what is drawn.
    title : str, optional
        Text above the plot.

    Returns
    -------
    matplotlib.axes.Axes
        What it was drawn into.

    Raises
    ------
    ValueError
        If a shape is wrong, a number is negative, or `view` is another.
    ImportError
        If Matplotlib is not installed.

    Examples
    --------
    >>> from tisfm.scenes import bodies_film, bodies_path
    >>> from tisfm.show import draw_object_paths, save_figure
    >>> film = bodies_film(bodies_path(5), 24, 32)
    >>> axes = draw_object_paths(dict(enumerate(film.body_poses, 1)), camera=film.poses)
    >>> save_figure("things.png", axes.figure, dpi=60)
    """
    _check_view(view)
    if any(number < 0 for number in objects):
        raise InputError(f"objects are {sorted(objects)}: expected numbers from 0")
    given = {number: _poses(f"object {number}", poses) for number, poses in objects.items()}
    places = {number: poses[_posed(poses), :3, 3] for number, poses in given.items()}
    places = {number: line for number, line in places.items() if len(line)}
    target = plot_axes(4.4, 3.9) if axes is None else axes
    sizes = style_plot(target, title)
    lines = list(places.values())
    if camera is not None:
        path = _poses("camera", camera)
        path = path[_posed(path), :3, 3]
        if len(path):
            lines.append(path)
            _draw_line(target, path, view, sizes, color=INK, style="--", name="camera")
            _mark_ends(target, path, view, sizes, colors=(INK, INK))
    for number, line in places.items():
        color = as_hex(colors_of_categories(np.array(number)))
        _draw_line(target, line, view, sizes, color=color, name=f"object {number}")
        _mark_ends(target, line, view, sizes, colors=(color, color))
    _frame(target, sizes, lines, view, unit)
    if not places:
        write_inside(target, sizes, "no object has a pose")
    if lines:
        _legend(target, sizes)
    return target


def _finish(
    axes: Axes,
    sizes: Sizes,
    lines: list[NDArray[np.float64]],
    truth: list[NDArray[np.float64]],
    view: PathView,
    unit: str,
    name: str,
) -> None:
    """Draw paths that are early dark and late light, the truth dashed, and the frame of both."""
    from matplotlib.lines import Line2D

    handles = []
    for line in truth:
        _draw_line(axes, line, view, sizes, color=INK, style="--", name="truth")
        handles.append(Line2D([], [], color=INK, linestyle="--", linewidth=sizes.line))
    for line in lines:
        _draw_shaded(axes, line, view, sizes)
        _mark_ends(axes, line, view, sizes, colors=(ESTIMATE, OTHER))
    _frame(axes, sizes, [*lines, *truth], view, unit)
    if not lines:
        write_inside(axes, sizes, "no pose" if name == "path" else name)
        return
    middle = as_hex(color_ramp("confidence")[sum(_SHADES) // 2])
    handles.append(Line2D([], [], color=middle, linewidth=2 * sizes.line))
    _legend(axes, sizes, handles, ["truth"] * len(truth) + [name])


def _draw_line(
    axes: Axes,
    places: NDArray[np.float64],
    view: PathView,
    sizes: Sizes,
    *,
    color: str,
    name: str,
    style: str = "-",
) -> None:
    x, y = _seen(_thinned(places), view)
    wide, order = (1.8, 2) if style == "-" else (0.8, 2.5)  # what is dashed lies on top
    axes.plot(
        x, y, color=color, linestyle=style, linewidth=wide * sizes.line, label=name, zorder=order
    )


def _draw_shaded(axes: Axes, places: NDArray[np.float64], view: PathView, sizes: Sizes) -> None:
    """Draw a path that is dark where it begins and light where it ends."""
    from matplotlib.collections import LineCollection

    ends = np.stack(_seen(_thinned(places), view), axis=1)
    segments = np.stack([ends[:-1], ends[1:]], axis=1)
    levels = np.linspace(*_SHADES, len(segments)).astype(int)
    colors = color_ramp("confidence")[levels] / 255
    axes.add_collection(
        LineCollection(list(segments), colors=colors, linewidths=2 * sizes.line, capstyle="round")
    )


def _mark_ends(
    axes: Axes,
    places: NDArray[np.float64],
    view: PathView,
    sizes: Sizes,
    *,
    colors: tuple[str, str],
) -> None:
    x, y = _seen(places, view)
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


def _frame(
    axes: Axes,
    sizes: Sizes,
    lines: list[NDArray[np.float64]],
    view: PathView,
    unit: str,
) -> None:
    """Give both directions one scale, and name them."""
    _, _, across, up = _VIEWS[view]
    name_axis(axes, sizes, f"{across} ({unit})", f"{up} ({unit})")
    axes.set_aspect("equal", adjustable="box")
    few_ticks(axes, sizes)
    if not lines:
        axes.set(xlim=(-1, 1), ylim=(-1, 1))
        return
    places = np.concatenate(lines)
    x, y = _seen(places, view)
    spread = np.ptp(places, axis=0).max()
    half = _ROOM * max(np.ptp(x), np.ptp(y), _FLATTEST * spread, 1e-9)
    for set_limits, values in ((axes.set_xlim, x), (axes.set_ylim, y)):
        middle = (values.min() + values.max()) / 2
        set_limits(middle - half, middle + half)


def _legend(
    axes: Axes, sizes: Sizes, handles: list[Line2D] | None = None, names: Sequence[str] = ()
) -> None:
    """Say what lines are: where there is room, else above the axes."""
    given = (handles, names) if handles is not None else ()
    longest = max(map(len, names or axes.get_legend_handles_labels()[1]))
    needed = (longest * 0.6 + 4) * sizes.inch * axes.figure.dpi
    place: dict[str, Any] = {"loc": "best"}
    if needed > _MOST_LEGEND * axes.get_window_extent().width:
        place = {"loc": "lower right", "bbox_to_anchor": (1.0, 1.0), "borderaxespad": 0.2}
        lines = len(names) or len(axes.get_legend_handles_labels()[1])
        if axes.get_title():
            axes.set_title(axes.get_title(), pad=(1.6 * lines + 1.2) * sizes.text, parse_math=False)
    legend = axes.legend(
        *given,
        **place,
        fontsize=sizes.text,
        labelcolor=INK,
        framealpha=0.7,
        handlelength=1.6,
        borderpad=0.3,
    )
    write_plainly(legend)


def _in_first_axes(
    lines: list[NDArray[np.float64]], first: NDArray[np.float64]
) -> list[NDArray[np.float64]]:
    """Return places in the axes of a camera, whose pose is given."""
    rigid = Similarity(
        scale=1.0, rotation=first[:3, :3].T, translation=-first[:3, :3].T @ first[:3, 3]
    )
    return [rigid.apply(line) for line in lines]


def _seen(
    places: NDArray[np.float64], view: PathView
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return what is across and what is up of places, (M, 3)."""
    (across, to_right), (up, upwards), _, _ = _VIEWS[view]
    return to_right * places[:, across], upwards * places[:, up]


def _thinned(places: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return so few places that they are drawn in no time, evenly, with the first and last."""
    kept = np.unique(np.linspace(0, len(places) - 1, _MOST_POINTS).astype(int))
    return places[kept]


def _posed(poses: NDArray[np.float64]) -> NDArray[np.bool_]:
    return np.asarray(np.isfinite(poses).all(axis=(1, 2)))


def _poses(name: str, poses: ArrayLike) -> NDArray[np.float64]:
    given = unmasked(poses, name, np.float64)
    if given.ndim != 3 or given.shape[1:] != (4, 4):
        raise InputError(f"{name} has the shape {given.shape}, expected (N, 4, 4)")
    return given


def _piece(piece: ArrayLike) -> NDArray[np.integer]:
    given = unmasked(piece, "piece")
    if given.ndim != 1:
        raise InputError(f"piece has the shape {given.shape}, expected (N,)")
    if given.dtype.kind not in "iu" and given.size:
        raise InputError(f"piece has dtype {given.dtype}, expected integers, below 0 for none")
    return given.astype(np.int64)  # which has room for -1


def _check_view(view: str) -> None:
    if view not in _VIEWS:
        raise InputError(f"view is {view!r}, expected one of {', '.join(get_args(PathView))}")
