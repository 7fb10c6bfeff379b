"""The focal length of a sequence whose camera is not known, found together with its path.

It is sought from several beginnings, since an adjustment ends in the valley that it begins in: the
one that explains most of what views have in common counts. How far to trust it is told by parts of
that, each adjusted from elsewhere: where the motion does not show the focal length, they disagree.
"""

import copy
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import cv2
import numpy as np

from tisfm.camera import LONGEST, SHORTEST, Camera
from tisfm.reconstruction.mapping.colmap import pycolmap
from tisfm.reconstruction.mapping.incremental import robust_adjustment
from tisfm.reconstruction.mapping.models import Model, ViewGraph, find_models
from tisfm.reconstruction.mapping.solution import MAX_USEFUL_DEVIATION, FocalEstimate
from tisfm.reconstruction.result.calibration import Calibrate
from tisfm.reconstruction.tracks.tracker import Observations
from tisfm.reconstruction.tracks.views import View

# Values without a stated source were set by hand.

# Focal lengths that an adjustment starts from, as multiples of the guess.
START_FACTORS = (1.0, 0.42, 2.4)
# Mean score per match, 0 to 1: a model with a higher score is not bent.
MIN_STRAIGHT_SCORE = 0.5
# Views in each of the two windows that starts are compared on.
WINDOW_VIEWS = 16
# Observations that are divided among the parts of the uncertainty estimate.
MAX_PART_OBSERVATIONS = 6000
# Steps of the final adjustment.
MAX_STEPS = 150
# Relative change of the squared residuals that ends the final adjustment.
STEP_TOLERANCE = 1e-6
# Parts of a model whose focal lengths are compared for the uncertainty.
PART_COUNT = 6
# The focal length of a part starts at this multiple of the estimate, or at its inverse.
PART_START_FACTOR = 1.2
# Share of the way back to the estimate: a part that returns less shows no focal length.
MIN_RETURN = 0.1
# Standard deviation of the estimate per spread of the parts, both of the logarithm.
SPREAD_TO_DEVIATION = 0.7
# Share of the focal length by which a distorting lens changes the estimate: with a larger change,
# which exceeds the spread of the parts too, the lens seems to distort.
MIN_BEND = 0.03


def find_models_and_focal(
    views: Sequence[View],
    matches: Mapping[tuple[int, int], np.ndarray],
    camera: Camera,
    shape: tuple[int, int],
    calibrate: Calibrate,
    *,
    limit: float = MAX_USEFUL_DEVIATION,
) -> tuple[list[Model], FocalEstimate | None]:
    """Find poses of views and points of tracks, and the focal length with which they fit best.

    Parameters
    ----------
    views, matches, shape
        As for `tisfm.reconstruction.mapping.models.find_models`.
    camera : Camera
        A pinhole, whose centre is known and whose focal length is a guess.
    calibrate : {"focal", "radial"}
        Whether a radial coefficient is sought as well.
    limit : float
        Of the focal length: with a larger deviation, what is found is no better than the guess.

    Returns
    -------
    models : list of Model
        With that focal length, or with the guess if it is as good.
    found : FocalEstimate or None
        None if no path is found with any, or if few views show parallax with the one that is found.
    """
    shared = ViewGraph.of(views, matches, shape, focal_known=False)
    begun = _best_start(shared, camera, calibrate)
    found = [] if begun is None else _grown(shared, camera, begun, calibrate)
    if not found:
        models = find_models(views, matches, camera, shape, focal_known=False)
        return models, _unknown(camera) if models else None
    _adjust(found[0], calibrate)
    estimate = replace(_estimate(found[0], camera, shape, calibrate), limit=limit)
    if not estimate.is_of_use:
        return find_models(views, matches, camera, shape, focal_known=False), estimate
    if not estimate.radial and not shared.shows_parallax(estimate.taken(camera)):
        return [], None
    if not estimate.is_seen and not estimate.radial:
        # What a wrong focal length has made of a turn may look like a path: from the one that was
        # found it is not begun. But what comes of the same focal length may be bent as well.
        again = find_models(views, matches, estimate.taken(camera), shape, focal_known=False)
        explained = shared.score(found) * shared.matches()
        if not again or sum(model.score for model in again) >= MIN_STRAIGHT_SCORE * explained:
            return again, estimate
    for other in found[1:]:
        _set(other, estimate.focal, estimate.radial)
        _adjust(other, "nothing")
    lens = estimate.taken(camera)
    straight_views = [
        replace(view, seen=undistort_observations(view.seen, lens, shape)) for view in views
    ]
    return shared.models(found, straight_views, lens.pinhole()), estimate


def undistort_observations(
    seen: Observations, lens: Camera, shape: tuple[int, int]
) -> Observations:
    """Return where a pinhole would see the tracks; those that it would not are left out."""
    if lens.is_pinhole or not len(seen.points):
        return seen
    height, width = shape
    points = undistort_points(seen.points, lens, shape)
    inside = ((points >= 0) & (points <= (width - 1, height - 1))).all(axis=1)
    return Observations(points=points[inside], tracks=seen.tracks[inside])


def undistort_points(points: np.ndarray, lens: Camera, shape: tuple[int, int]) -> np.ndarray:
    """Return where a pinhole would see points, (N, 2), px."""
    if lens.is_pinhole or not len(points):
        return points
    cx, cy = lens.center_for(*shape)
    matrix = np.array([[lens.focal, 0, cx], [0, lens.focal, cy], [0, 0, 1]])
    found = cv2.undistortPoints(points[:, None], matrix, np.array(lens.distortion), P=matrix)
    return np.asarray(found[:, 0])


def _estimate(
    whole: Any, camera: Camera, shape: tuple[int, int], calibrate: Calibrate
) -> FocalEstimate:
    """Return the focal length of a reconstruction, and what its parts say of it."""
    focal, radial = _found(whole)
    if not _is_possible(focal):
        return _unknown(camera)
    starts = [focal * PART_START_FACTOR ** (1 if k % 2 else -1) for k in range(PART_COUNT)]
    parts = [
        _of_part(whole, part, start, calibrate)
        for part, start in zip(_parts(whole, camera, shape), starts, strict=True)
    ]
    focals = np.array([one for one, _ in parts])
    if not all(map(_is_possible, focals)):
        return _unknown(camera)
    # Where the focal length may be anything, an adjustment leaves it where it was.
    stayed = np.abs(np.log(focals / starts)) < MIN_RETURN * math.log(PART_START_FACTOR)
    if stayed.sum() > len(parts) / 2:
        return _unknown(camera)
    off = np.stack([np.log(focals / focal), [one - radial for _, one in parts]], axis=1)
    deviation, radial_deviation = SPREAD_TO_DEVIATION * np.sqrt(np.mean(off**2, axis=0))
    bend = 0.0 if calibrate == "radial" else _bend(whole)
    return FocalEstimate(
        focal=focal,
        deviation=focal * math.hypot(deviation, bend),
        radial=radial,
        radial_deviation=float(radial_deviation),
        bent=abs(bend) > max(MIN_BEND, deviation),
    )


def _unknown(guess: Camera) -> FocalEstimate:
    return FocalEstimate(focal=guess.focal, deviation=math.inf)


def _is_possible(focal: float) -> bool:
    """Return whether a camera may have it: an adjustment is free to end anywhere."""
    return SHORTEST <= focal <= LONGEST


def _bend(whole: Any) -> float:
    """Return by how much the focal length changes, as a logarithm, if the lens may distort."""
    bent = copy.deepcopy(whole)
    camera = next(iter(bent.cameras.values()))
    params = [*camera.params, 0.0]
    camera.model = pycolmap().CameraModelId.SIMPLE_RADIAL
    camera.params = params
    _adjust(bent, "radial")
    focal = _found(bent)[0]
    return math.log(focal / _found(whole)[0]) if _is_possible(focal) else math.inf


def _grown(shared: ViewGraph, camera: Camera, begun: float, calibrate: Calibrate) -> list[Any]:
    """Return reconstructions from a focal length, or from another if they explain too little.

    Windows may be explained by what is bent, as where the camera follows something that moves.
    """
    best = shared.grow_models(replace(camera, focal=begun), calibrate)
    if best and shared.score(best) >= MIN_STRAIGHT_SCORE:
        return best
    for times in START_FACTORS:
        others = shared.grow_models(replace(camera, focal=times * camera.focal), calibrate)
        if (
            others
            and shared.score(others) > shared.score(best)
            and _is_possible(_found(others[0])[0])
        ):
            best = others
    return best


def _best_start(shared: ViewGraph, camera: Camera, calibrate: Calibrate) -> float | None:
    """Return the focal length, px, that explains the matches of views in windows best."""
    best, most = None, 0.0
    for times in START_FACTORS:
        explained, found = 0.0, []
        for window in _windows(shared):
            grown = window.grow_models(replace(camera, focal=times * camera.focal), calibrate)
            if grown and _is_possible(_found(grown[0])[0]):
                explained += window.score(grown[:1])
                found.append(_found(grown[0])[0])
        if explained > most:
            best, most = float(np.exp(np.mean(np.log(found)))), explained
    return best


def _windows(shared: ViewGraph) -> list[ViewGraph]:
    count = len(shared.views)
    if count <= 2 * WINDOW_VIEWS:
        return [shared]
    begins = (count // 4 - WINDOW_VIEWS // 2, count - count // 4 - WINDOW_VIEWS // 2)
    return [shared.part(begin, begin + WINDOW_VIEWS) for begin in begins]


def _parts(whole: Any, camera: Camera, shape: tuple[int, int]) -> list[tuple[set[int], set[int]]]:
    """Return views and points of parts: halves of the time, and of the image.

    Of the points, those that most views see, as many as are enough.
    """
    views = sorted(whole.reg_image_ids())
    lengths = {number: point.track.length() for number, point in whole.points3D.items()}
    points, count = set(), 0
    for number in sorted(lengths, key=lambda one: (-lengths[one], one)):
        if count < MAX_PART_OBSERVATIONS:
            points.add(number)
            count += lengths[number]
    half = max(2, len(views) // 2)
    parts = [(set(views[:half]), points), (set(views[-half:]), points)]
    center = camera.center_for(*shape)
    places = {number: _places(whole, whole.points3D[number]).mean(axis=0) for number in points}
    for axis in (0, 1):
        near = {number for number in points if places[number][axis] < center[axis]}
        parts += [(set(views), near), (set(views), points - near)]
    return parts


def _places(whole: Any, point: Any) -> np.ndarray:
    """Return where a point is seen, (N, 2), px."""
    images = whole.images
    return np.array(
        [images[one.image_id].points2D[one.point2D_idx].xy for one in point.track.elements]
    )


def _of_part(
    whole: Any, part: tuple[set[int], set[int]], begun: float, calibrate: Calibrate
) -> tuple[float, float]:
    """Return what some views and points lead to from another focal length, px, and k1."""
    views, points = part
    less = copy.deepcopy(whole)
    for number in sorted(set(less.reg_image_ids()) - views):
        less.deregister_frame(less.images[number].frame_id)
    few = [k for k, point in less.points3D.items() if k not in points or point.track.length() < 2]
    for number in few:
        less.delete_point3D(number)
    _set(less, begun, _found(whole)[1])
    _adjust(less, calibrate)
    return _found(less)


def _adjust(whole: Any, calibrate: Calibrate) -> None:
    """Adjust poses and points, and what is sought of the camera with them, to the end."""
    options = pycolmap().BundleAdjustmentOptions()
    options.refine_focal_length = calibrate != "nothing"
    options.refine_extra_params = calibrate == "radial"
    options.refine_principal_point = False
    scene = pycolmap().BundleAdjustmentConfig()
    for number in sorted(whole.reg_image_ids()):
        scene.add_image(number)
    scene.fix_gauge(pycolmap().BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    robust_adjustment(options, MAX_STEPS, STEP_TOLERANCE)
    pycolmap().create_default_bundle_adjuster(options, scene, whole).solve()


def _found(whole: Any) -> tuple[float, float]:
    """Return the focal length, px, and k1, 0 where it is not sought."""
    focal, _, _, *radial = next(iter(whole.cameras.values())).params
    return float(focal), float(radial[0]) if radial else 0.0


def _set(whole: Any, focal: float, radial: float) -> None:
    camera = next(iter(whole.cameras.values()))
    _, cx, cy, *rest = camera.params
    camera.params = [focal, cx, cy, *([radial] if rest else [])]
