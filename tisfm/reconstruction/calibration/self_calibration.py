"""The focal length of an unknown camera, estimated together with the camera path.

The adjustment starts from several focal lengths, since it ends in the nearest local minimum. The
result that explains most matches of views counts. Its uncertainty comes from parts of the model,
each adjusted from another focal length: if the motion does not show the focal length, they differ.
"""

import copy
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import cv2
import numpy as np

from tisfm.camera import LONGEST, SHORTEST, Camera
from tisfm.reconstruction.mapping.database import pycolmap
from tisfm.reconstruction.mapping.incremental import robust_adjustment
from tisfm.reconstruction.mapping.models import Model, ViewGraph, find_models
from tisfm.reconstruction.mapping.solution import MAX_USEFUL_DEVIATION, FocalEstimate
from tisfm.reconstruction.result.calibration import Calibrate
from tisfm.reconstruction.tracks.tracker import Observations
from tisfm.reconstruction.tracks.views import View

# Values without a stated source were set by hand.

# Focal lengths that an adjustment starts from, as multiples of the guess.
START_FACTORS = (1.0, 0.42, 2.4)
# Mean score per match, 0 to 1: a model with at least this score has the right shape: it is not
# bent.
MIN_STRAIGHT_SCORE = 0.5
# Views in each of the two windows on which start values are compared.
WINDOW_VIEWS = 16
# Observations that the uncertainty estimate uses, in all its parts together.
MAX_PART_OBSERVATIONS = 6000
# Steps of the final adjustment.
MAX_STEPS = 150
# Relative change of the squared residuals that ends the final adjustment.
STEP_TOLERANCE = 1e-6
# Parts of a model whose focal lengths are compared for the uncertainty.
PART_COUNT = 6
# The focal length of a part starts at this multiple of the estimate, or at its inverse.
PART_START_FACTOR = 1.2
# Share of the change from start value to estimate: a part that changes less does not show the focal
# length.
MIN_RETURN = 0.1
# Standard deviation of the estimate per spread of the parts, both of the logarithm.
SPREAD_TO_DEVIATION = 0.7
# Change of the logarithm of the focal length if distortion is estimated too: if the change is
# larger than this and than the spread of the parts, the lens seems to distort.
MIN_BEND = 0.03


def find_models_and_focal(
    # views, matches, shape: as for `tisfm.reconstruction.mapping.models.find_models`
    views: Sequence[View],
    matches: Mapping[tuple[int, int], np.ndarray],
    camera: Camera,  # a pinhole with a known centre; its focal length is a guess
    shape: tuple[int, int],
    calibrate: Calibrate,  # ``"radial"`` estimates a radial coefficient too
    *,
    # share of the focal length: an estimate with a larger standard deviation is no better than the
    # guess
    max_deviation: float = MAX_USEFUL_DEVIATION,
) -> tuple[list[Model], FocalEstimate | None]:
    """Find poses of views, points of tracks, and the focal length that fits them best.

    Returns models, models with the estimated focal length, or with the guess if the guess is as
    good; found, none if no focal length leads to a path, or if few views show parallax with the
    estimate.
    """
    shared = ViewGraph.of(views, matches, shape, focal_known=False)
    begun = _best_start(shared, camera, calibrate)
    found = [] if begun is None else _grown(shared, camera, begun, calibrate)
    if not found:
        models = find_models(views, matches, camera, shape, focal_known=False)
        return models, _unknown(camera) if models else None
    _adjust(found[0], calibrate)
    estimate = replace(_estimate(found[0], camera, shape, calibrate), max_deviation=max_deviation)
    if not estimate.is_useful:
        return find_models(views, matches, camera, shape, focal_known=False), estimate
    if not estimate.radial and not shared.shows_parallax(estimate.apply_to(camera)):
        return [], None
    if not estimate.is_certain and not estimate.radial:
        # A rotation seen with a wrong focal length may look like a path. Such a path does not
        # appear again if models start with the estimated focal length: then there is no path. New
        # models may be bent too: they count only with a good score.
        again = find_models(views, matches, estimate.apply_to(camera), shape, focal_known=False)
        explained = shared.score(found) * shared.matches()
        if not again or sum(model.score for model in again) >= MIN_STRAIGHT_SCORE * explained:
            return again, estimate
    for other in found[1:]:
        _set(other, estimate.focal, estimate.radial)
        _adjust(other, "nothing")
    lens = estimate.apply_to(camera)
    straight_views = [
        replace(view, observations=undistort_observations(view.observations, lens, shape))
        for view in views
    ]
    return shared.models(found, straight_views, lens.pinhole()), estimate


def undistort_observations(
    seen: Observations, lens: Camera, shape: tuple[int, int]
) -> Observations:
    """Return where a pinhole would see the tracks; tracks outside the frame are left out."""
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
    """Return the focal length of a reconstruction, with its uncertainty from the parts."""
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
    # If the data do not determine the focal length, the adjustment leaves the start value.
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
        shows_distortion=abs(bend) > max(MIN_BEND, deviation),
    )


def _unknown(guess: Camera) -> FocalEstimate:
    return FocalEstimate(focal=guess.focal, deviation=math.inf)


def _is_possible(focal: float) -> bool:
    """Return whether a camera may have this focal length: an adjustment has no bounds."""
    return SHORTEST <= focal <= LONGEST


def _bend(whole: Any) -> float:
    """Return the change of the log focal length when distortion is estimated too."""
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

    The start value may come from windows whose models are bent, for example where the camera
    follows a moving object.
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
    """Return the focal length, px, that explains the matches in windows of views best."""
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
    """Return views and points of each part: halves of the time, and halves of the image.

    Points that most views see come first, until there are MAX_PART_OBSERVATIONS observations.
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
    """Return the observed positions of a point, (N, 2), px."""
    images = whole.images
    return np.array(
        [images[one.image_id].points2D[one.point2D_idx].xy for one in point.track.elements]
    )


def _of_part(
    whole: Any, part: tuple[set[int], set[int]], begun: float, calibrate: Calibrate
) -> tuple[float, float]:
    """Return the focal length, px, and k1 of a part, adjusted from another focal length."""
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
    """Adjust poses, points and the unknown part of the camera until convergence."""
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
    """Return the focal length, px, and k1, which is 0 if it is not estimated."""
    focal, _, _, *radial = next(iter(whole.cameras.values())).params
    return float(focal), float(radial[0]) if radial else 0.0


def _set(whole: Any, focal: float, radial: float) -> None:
    camera = next(iter(whole.cameras.values()))
    _, cx, cy, *rest = camera.params
    camera.params = [focal, cx, cy, *([radial] if rest else [])]
