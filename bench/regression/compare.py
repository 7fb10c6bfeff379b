"""Two answers side by side: by how much they differ."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

VISIBLE = 1e-3  # px; a difference of flow that is more than rounding
FLOOR = 0.01  # of the median inverse depth, below which differences are relative to that


@dataclass(frozen=True, kw_only=True)
class Difference:
    """How far the answers of two checkouts to one case lie apart.

    Attributes
    ----------
    flow_max, flow_median : float
        Of the absolute differences of u and v, px/frame.
    visible : float
        Share of the pixels whose flow differs by more than `VISIBLE`.
    depth_max, depth_median : float
        Of the differences of inverse depth, relative to that before.
    labels, occlusion : float
        Shares of the pixels where they differ.
    same : bool
        Whether every array is the same in every bit.
    """

    flow_max: float
    flow_median: float
    visible: float
    depth_max: float
    depth_median: float
    labels: float
    occlusion: float
    same: bool


def difference(before: Path, after: Path) -> Difference:
    """Return the differences of two stored answers."""
    with np.load(before) as first, np.load(after) as second:
        old, new = dict(first), dict(second)
    flow = _apart(old["flow"], new["flow"]).max(axis=-1)
    depth = relative(old["inverse_depth"], new["inverse_depth"])
    return Difference(
        flow_max=float(flow.max()),
        flow_median=float(np.median(flow)),
        visible=float((flow > VISIBLE).mean()),
        depth_max=float(depth.max()),
        depth_median=float(np.median(depth)),
        labels=_share(old.get("labels"), new.get("labels")),
        occlusion=_share(old["occlusion"], new["occlusion"]),
        same=old.keys() == new.keys()
        and all(np.array_equal(old[k], new[k], equal_nan=old[k].dtype.kind == "f") for k in old),
    )


def relative(before: NDArray, after: NDArray) -> NDArray:
    """Return |after − before| over |before|, or over a share of its median where that is more."""
    apart = _apart(before, after)
    known = np.abs(before[np.isfinite(before)])
    floor = FLOOR * float(np.median(known)) if known.size else 0.0
    unit = np.maximum(np.abs(before), floor)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(apart > 0, apart / np.where(np.isfinite(unit), unit, 1.0), 0.0)


def _apart(before: NDArray, after: NDArray) -> NDArray:
    """Return |after − before|: 0 where both are the same or both NaN, else inf without a number."""
    old, new = np.asarray(before, np.float64), np.asarray(after, np.float64)
    same = (old == new) | (np.isnan(old) & np.isnan(new))
    with np.errstate(invalid="ignore"):
        gap = np.abs(new - old)
    return np.where(same, 0.0, np.where(np.isfinite(gap), gap, np.inf))


def _share(before: NDArray | None, after: NDArray | None) -> float:
    """Return the share of places that differ; all do where only one side has the array."""
    if before is None or after is None:
        return 0.0 if before is after else 1.0
    return float((before != after).mean())
