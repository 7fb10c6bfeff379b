"""Depth of moving objects whose motion shows none, from the places where they stand.

The motion of people, animals and small things shows no depth. But they stand on the ground, and
their size hardly changes. The static depth just below the feet of an object is the depth of the
object in one frame, and its depth times its height in the image is constant. Both are fitted
together over all frames, smoothly in time.
"""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from tisfm.grade import GRADES
from tisfm.reconstruction.objects.settings import OBJECTS, STANDING
from tisfm.reconstruction.result.moving_object import MovingObject, ScaleFrom


@dataclass(frozen=True, kw_only=True, eq=False)
class StandingDepth:
    """One inverse depth for an object in each of its frames."""

    frames: tuple[int, ...]
    inverse_depth: np.ndarray  # (n,) float64: 1/unit of the world
    deviation: np.ndarray  # (n,) float64: its standard deviation
    scale_from: ScaleFrom


@dataclass(frozen=True, kw_only=True)
class FrameMeasures:
    """An object in one frame; a number is NaN where the frame does not show it."""

    frame: int
    contact: float  # inverse depth of the ground at the feet
    slope: float  # relative change of the inverse depth of the ground over the object's height
    around: float  # inverse depth of the nearest surroundings
    height: float  # px; NaN where its upper or lower end is not seen
    length: float  # px: longer side of the box; NaN where the border of the frame cuts it
    thickness: float  # deviation of depth within the object, as a share of its distance


def measure_objects(
    objects: Iterable[MovingObject],
    focal: float,  # px
    # Returns the static inverse depth of a frame and its deviation, (H, W) each; None for a frame
    # without depth.
    static_depth: Callable[[int], tuple[np.ndarray, np.ndarray] | None],
    labels_of: Callable[[int], np.ndarray],  # returns the labels of a frame, (H, W)
) -> dict[int, list[FrameMeasures]]:
    """Return the measures of each object, by its id, in the order of the frames."""
    boxes: dict[int, dict[int, np.ndarray]] = {}
    for obj in objects:
        for frame, box in zip(obj.frames, obj.boxes, strict=True):
            boxes.setdefault(frame, {})[obj.id] = box
    measures: dict[int, list[FrameMeasures]] = {}
    for frame in sorted(boxes):
        labels, static = labels_of(frame), static_depth(frame)
        for object_id, box in boxes[frame].items():
            measure = _measure(frame, labels, object_id, box, focal, static)
            measures.setdefault(object_id, []).append(measure)
    return measures


def find_standing_depth(
    measures: Sequence[FrameMeasures],  # in the order of the frames
    focal: float,  # px
    *,
    # known length of the object along the longer side of its box, in the unit of the world
    size: float | None = None,
    given_labels: Collection[int] = (),  # frames whose labels the user gave
) -> StandingDepth | None:
    """Return the depth of an object in its frames; None if nothing shows how far away it is."""
    contact, slope, around, height, length, thickness = (
        np.array([getattr(measure, name) for measure in measures])
        for name in ("contact", "slope", "around", "height", "length", "thickness")
    )
    frames = tuple(measure.frame for measure in measures)
    scale_from: ScaleFrom
    label_std = np.zeros(len(measures))
    if size is not None and np.isfinite(length).any():
        scale_from, inverse_depth, std = "size", length / (focal * size), STANDING.size_std
    elif np.isfinite(contact).sum() >= min(STANDING.min_contacts, len(measures)):
        scale_from, inverse_depth, std = "contact", contact, STANDING.contact_std
        end_std = [
            STANDING.exact_end_std if frame in given_labels else STANDING.end_std
            for frame in frames
        ]
        label_std = np.array(end_std) * float(np.nanmedian(slope))
    elif np.isfinite(around).any():
        scale_from, inverse_depth, std = "around", around, STANDING.around_std
        label_std += STANDING.around_std
    else:
        return None
    logs, deviation, residual = _fit(np.array(frames), np.log(inverse_depth), height, std)
    relative = np.sqrt(deviation**2 + residual**2 + label_std**2 + thickness**2)
    return StandingDepth(
        frames=frames,
        inverse_depth=np.exp(logs),
        deviation=relative * np.exp(logs),
        scale_from=scale_from,
    )


def find_standing_depths(
    measures: Mapping[int, Sequence[FrameMeasures]],  # by object id
    piece: np.ndarray,  # (N,) int: piece of the camera path that has each frame; −1 for none
    focal: float,  # px
    *,
    # known lengths of objects by their ids, in the unit of the largest piece
    sizes: Mapping[int, float],
    largest_piece: int,
    given_labels: Collection[int] = (),  # frames whose labels the user gave
) -> dict[int, list[StandingDepth]]:
    """Return the depth of each object, by its id, for each piece, which has a unit of its own."""
    depths: dict[int, list[StandingDepth]] = {}
    for object_id, of_object in measures.items():
        for number in sorted({int(piece[measure.frame]) for measure in of_object} - {-1}):
            depth = find_standing_depth(
                [item for item in of_object if piece[item.frame] == number],
                focal,
                size=sizes.get(object_id) if number == largest_piece else None,
                given_labels=given_labels,
            )
            if depth is not None:
                depths.setdefault(object_id, []).append(depth)
    return depths


def _measure(
    frame: int,
    labels: np.ndarray,  # (H, W)
    object_id: int,
    box: np.ndarray,  # (4,): left, top, width and height of the label, px
    focal: float,  # px
    static: tuple[np.ndarray, np.ndarray] | None,  # inverse depth and deviation, (H, W) each
) -> FrameMeasures:
    """Measure an object in a frame."""
    left, top, width, height = (int(side) for side in box)
    frame_height, frame_width = labels.shape
    margin = STANDING.cut_distance
    ends_above = top > margin
    has_feet = top + height < frame_height - margin
    is_whole = ends_above and has_feet and left > margin and left + width < frame_width - margin
    contact = slope = around = float("nan")
    if static is not None:
        # the part of the frame with the object, its surroundings, and the ground below it
        reach = max(OBJECTS.ring_width, round(STANDING.ground_reach * height))
        rows = slice(max(top - OBJECTS.ring_width, 0), top + height + reach)
        columns = slice(max(left - reach, 0), left + width + reach)
        inverse_depth, deviation = (array[rows, columns].astype(np.float64) for array in static)
        is_object = labels[rows, columns] == object_id
        is_usable = (labels[rows, columns] == 0) & np.isfinite(deviation) & (inverse_depth > 0)
        if has_feet:
            contact, slope = _find_contact(is_object, inverse_depth, is_usable)
            has_feet = np.isfinite(contact)
        around = _find_around(is_object, inverse_depth, is_usable)
    return FrameMeasures(
        frame=frame,
        contact=contact,
        slope=slope,
        around=around,
        height=float(height) if ends_above and has_feet else float("nan"),
        length=float(max(width, height)) if is_whole else float("nan"),
        thickness=STANDING.thickness * min(width, height) / focal,
    )


def _find_contact(
    is_object: np.ndarray,  # (h, w) bool
    inverse_depth: np.ndarray,  # (h, w) float64: static
    is_usable: np.ndarray,  # (h, w) bool: pixels with static depth
) -> tuple[float, float]:
    """Return the inverse depth of the ground at the feet of an object, and its slope.

    The ground is the plane of most pixels below the feet, and a little above them: what stands on
    it in front of the object, or is seen below feet that lack a label, is not in this plane. The
    slope is the relative change of its inverse depth over the object's height. A surface that does
    not come nearer downwards is no ground; both numbers are NaN then, or if the feet are hidden.
    """
    unknown = float("nan"), float("nan")
    object_rows = np.flatnonzero(is_object.any(axis=1))
    foot, height = int(object_rows[-1]), int(object_rows[-1] - object_rows[0] + 1)
    first = max(foot - round(STANDING.ground_above * height), 0)
    rows, columns = np.nonzero(is_usable[first:])
    if len(rows) < STANDING.min_ground_pixels:
        return unknown
    step = 1 + len(rows) // STANDING.max_ground_pixels
    rows, columns = rows[::step] + first, columns[::step]
    # The inverse depth of a plane is linear in the frame: value at the feet, slopes right and down.
    center = float(np.flatnonzero(is_object[foot]).mean())
    basis = np.stack([np.ones(len(rows)), columns - center, rows - foot], axis=1)
    plane = _fit_most(basis, inverse_depth[rows, columns])
    if plane is None or plane[0] <= 0:
        return unknown
    slope = float(plane[2] * height / plane[0])
    if slope < STANDING.min_slope:
        return unknown
    # Below feet that are hidden, there is another object, or what hides them.
    lowest = is_object[foot - round(STANDING.foot_share * height) : foot + 1]
    feet = np.flatnonzero(lowest.any(axis=0))
    y, x = np.ix_(foot + STANDING.hidden_distance + np.arange(STANDING.hidden_rows), feet)
    y = y[y[:, 0] < len(is_object)]
    expected = plane[0] + plane[1] * (x - center) + plane[2] * (y - foot)
    is_near = np.abs(inverse_depth[y, x] - expected) < STANDING.hidden_tolerance * expected
    if not (is_near & is_usable[y, x]).mean() >= STANDING.min_seen_share:
        return unknown
    return float(plane[0]), slope


def _fit_most(basis: np.ndarray, values: np.ndarray) -> np.ndarray | None:
    """Return the linear combination of columns, (n, 3), that fits most of the values; or None.

    Combinations through three values at random are compared (RANSAC). The best one is fitted to all
    values that are near it.
    """
    random = np.random.default_rng(0)
    samples = random.integers(len(values), size=(STANDING.trials, 3))
    matrices = basis[samples]
    is_regular = np.abs(np.linalg.det(matrices)) > STANDING.min_determinant
    if not is_regular.any():
        return None
    planes = np.linalg.solve(matrices[is_regular], values[samples][is_regular][..., None])[..., 0]
    is_near = np.abs(planes @ basis.T - values) < STANDING.ground_tolerance * values
    best = is_near[is_near.sum(axis=1).argmax()]
    if best.mean() < STANDING.min_ground_share:
        return None
    return np.linalg.lstsq(basis[best], values[best], rcond=None)[0]


def _find_around(
    is_object: np.ndarray,  # (h, w) bool
    inverse_depth: np.ndarray,  # (h, w) float64: static
    is_usable: np.ndarray,  # (h, w) bool: pixels with static depth
) -> float:
    """Return the inverse depth of the nearest surroundings; NaN if there are none.

    The object hides them. So it is at least as near.
    """
    window = np.ones((2 * OBJECTS.ring_width + 1,) * 2, np.uint8)
    ring = (cv2.dilate(is_object.astype(np.uint8), window) > 0) & is_usable
    if not ring.any():
        return float("nan")
    return float(np.quantile(inverse_depth[ring], OBJECTS.nearest_quantile))


def _fit(
    frames: np.ndarray,  # (n,) int, increasing
    # (n,): logarithm of inverse depth, NaN where it was not measured; once at least it was
    measured: np.ndarray,
    height: np.ndarray,  # (n,): height of the object in the frame, px; NaN where it is unknown
    measured_std: float,  # standard deviation of `measured`
) -> tuple[np.ndarray, np.ndarray, float]:
    """Fit logarithms of inverse depth that are smooth in time, for an object of constant height.

    A label without feet ends too early: its height is too small, and the ground below it too far
    away. So errors of this sign have a smaller weight.

    Returns the logarithms, (n,), their standard deviations, (n,), and the standard deviation of
    the measured ones from them.
    """
    count = len(frames)
    has_measure, has_height = np.flatnonzero(np.isfinite(measured)), np.flatnonzero(height > 0)
    # The last unknown is −log(f S), for a height S: then log(height) = x_k − x_n.
    identity = sparse.eye_array(count + 1, format="csr")
    terms: list[tuple[sparse.csr_array, np.ndarray, np.ndarray | float]] = [
        (identity[has_measure], measured[has_measure], measured_std),
        (
            identity[has_height] - identity[np.full(len(has_height), count)],
            np.log(height[has_height]),
            STANDING.height_std,
        ),
    ]
    if count > 1:
        steps = np.diff(frames).astype(np.float64)
        shape = (count - 1, count + 1)
        change = sparse.diags_array(
            [-1 / steps, 1 / steps], offsets=[0, 1], shape=shape, format="csr"
        )
        bend = change[1:] - change[:-1]
        terms += [
            (change, np.zeros(count - 1), STANDING.change_std / np.sqrt(steps)),
            (bend, np.zeros(count - 2), STANDING.bend_std),
        ]
    matrix = sparse.vstack([rows for rows, _, _ in terms], format="csr")
    target = np.concatenate([values for _, values, _ in terms])
    precision = 1 / np.concatenate([np.broadcast_to(std, len(values)) for _, values, std in terms])
    data_count = len(has_measure) + len(has_height)
    tiny = sparse.eye_array(count + 1) * STANDING.min_precision  # for unknowns without data
    weight = np.ones(len(target))
    solution = np.zeros(count + 1)
    for _ in range(STANDING.iterations):
        scaled = sparse.diags_array(weight * precision**2)
        factor = splu((matrix.T @ scaled @ matrix + tiny).tocsc())
        solution = factor.solve(matrix.T @ (scaled @ target))
        residual = ((matrix @ solution - target) * precision)[:data_count]
        weight[:data_count] = 1 / (1 + residual**2)  # Cauchy's loss
        weight[:data_count][residual > 0] *= STANDING.short_weight
    chosen = np.unique(np.linspace(0, count - 1, STANDING.max_variances).astype(int))
    units = np.zeros((count + 1, len(chosen)))
    units[chosen, np.arange(len(chosen))] = 1.0
    variances = np.take_along_axis(factor.solve(units), chosen[None], axis=0)[0]
    variance = np.interp(np.arange(count), chosen, variances)
    misfit = np.abs(solution[has_measure] - measured[has_measure])
    return solution[:count], np.sqrt(variance), float(np.median(misfit)) / GRADES.median_ratio
