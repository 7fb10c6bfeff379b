"""The energy over the iterations, into axes."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from tisfm.errors import InputError
from tisfm.show.axes import label_axes, limit_ticks, plot_axes, style_plot, write_centered
from tisfm.show.palette import CONTRAST_COLOR, GRID_COLOR, RESULT_COLOR, TEXT_COLOR
from tisfm.status import History

if TYPE_CHECKING:
    from matplotlib.axes import Axes

CurveQuantity = Literal["energy", "change"]
# area for the legend, below the names of levels: left, bottom, width, height, as shares of the axes
_LEGEND_BOX = 0.0, 0.0, 1.0, 0.88
_MIN_CHANGE = 1e-12  # smallest change on a logarithmic axis; set by hand


def draw_energy(
    history: History,
    *,
    axes: Axes | None = None,
    quantity: CurveQuantity = "energy",
    title: str | None = None,
) -> Axes:
    """Draw the energy after every iteration, or the change by every iteration.

    Bands are the levels of the pyramid, from the coarsest on the left. Points are iterations. A
    line is broken at every new warp of the images: each warp has its own energy function, and the
    energy never rises within a warp.

    Parameters
    ----------
    history : tisfm.status.History
        `tisfm.Interpretation.history`.
    axes : matplotlib.axes.Axes, optional
        Axes to draw into; by default those of a new figure, ``axes.figure``.
    quantity : {"energy", "change"}
        The energy (eq. 6, 20) and its half-quadratic form (eq. 8, 21), or the relative change of
        the unknowns.
    title : str, optional
        Text above the plot.

    Returns
    -------
    matplotlib.axes.Axes
        The axes.

    Raises
    ------
    ValueError
        If `quantity` is unknown.

    Examples
    --------
    >>> import tisfm
    >>> from tisfm.scenes import two_blocks
    >>> from tisfm.show import draw_energy, save_figure
    >>> scene = two_blocks(48, 64)
    >>> result = tisfm.interpret(scene.frame0, scene.frame1, camera=scene.camera)
    >>> save_figure("energy.png", draw_energy(result.history).figure, dpi=60)
    """
    if quantity not in get_args(CurveQuantity):
        expected = ", ".join(get_args(CurveQuantity))
        raise InputError(f"quantity is {quantity!r}, expected one of {expected}")
    target = plot_axes(6.4, 3.2) if axes is None else axes
    sizes = style_plot(target, title)
    is_energy = quantity == "energy"
    y = "energy (any unit)" if is_energy else "relative change of the unknowns"
    label_axes(target, sizes, "iteration", y)
    count = len(history.energy)
    if not count:
        write_centered(target, sizes, "no iterations")
        return target
    target.set_xlim(-0.5, count - 0.5)
    limit_ticks(target, sizes)
    curves = [("energy", history.energy, RESULT_COLOR, "-")]
    if is_energy:
        curves.append(("half-quadratic", history.half_quadratic, CONTRAST_COLOR, "--"))
    else:
        curves = [("change", np.maximum(history.change, _MIN_CHANGE), RESULT_COLOR, "-")]
    if all((values > 0).all() and np.isfinite(values).all() for _, values, _, _ in curves):
        target.set_yscale("log")
    warps = np.flatnonzero(np.diff(history.level) | np.diff(history.warp)) + 1
    for name, values, color, style in curves:
        x = np.insert(np.arange(count, dtype=float), warps, np.nan)
        target.plot(
            x,
            np.insert(values.astype(float), warps, np.nan),
            color=color,
            linestyle=style,
            linewidth=sizes.line,
            marker="o" if style == "-" else None,
            markersize=2.2 * sizes.line,
            label=name,
        )
    for warp in warps:
        target.axvline(warp - 0.5, color=GRID_COLOR, linewidth=0.35 * sizes.line, linestyle=":")
    low, high = target.get_ylim()
    is_log = target.get_yscale() == "log"  # space at the top for the names of levels
    target.set_ylim(low, high * (high / low) ** 0.15 if is_log else high + 0.15 * (high - low))
    _draw_levels(target, history.level, sizes.text)
    if is_energy:
        target.legend(
            loc="best",
            bbox_to_anchor=_LEGEND_BOX,
            fontsize=sizes.text,
            labelcolor=TEXT_COLOR,
            framealpha=0.8,
        )
    return target


def _draw_levels(axes: Axes, level: np.ndarray, text: float) -> None:
    """Shade every other level, and name each level with enough space; `text` is in points."""
    starts = [0, *(np.flatnonzero(np.diff(level)) + 1), len(level)]
    box = axes.get_window_extent()
    character = 0.6 * text / 72 * axes.figure.dpi  # width, px
    for band, (start, stop) in enumerate(pairwise(starts)):
        if band % 2 == 0:
            axes.axvspan(start - 0.5, stop - 0.5, color=GRID_COLOR, alpha=0.12, linewidth=0)
        space = box.width * (stop - start) / len(level)
        name = f"level {level[start]}"
        if space < len(name) * character:
            name = str(level[start])
        if space >= (len(name) + 0.5) * character:
            axes.text(
                (start + stop - 1) / 2,
                0.985,
                name,
                transform=axes.get_xaxis_transform(),
                ha="center",
                va="top",
                fontsize=text,
                color=TEXT_COLOR,
            )
