"""The focal length of an unknown camera, estimated together with the camera path.

The adjustment starts from several focal lengths, since it ends in the nearest local minimum. The
result that explains most matches of views is used. Its uncertainty comes from parts of the model,
each adjusted from another focal length. If the motion does not show the focal length, the focal
lengths of the parts differ.
"""

import copy
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import cv2
import numpy as np

from tisfm.camera import MAX_FOCAL, MIN_FOCAL, Camera
from tisfm.reconstruction.calibration.settings import CALIBRATION
from tisfm.reconstruction.mapping.database import pycolmap
from tisfm.reconstruction.mapping.incremental import robust_adjustment
from tisfm.reconstruction.mapping.models import Model, ViewGraph, find_models
from tisfm.reconstruction.mapping.settings import MAPPING
from tisfm.reconstruction.mapping.solution import FocalEstimate
from tisfm.reconstruction.result.calibration import Calibrate
from tisfm.reconstruction.tracks.tracker import Observations
from tisfm.reconstruction.tracks.views import View


def find_models_and_focal(
    # views, matches, shape: as for `tisfm.reconstruction.mapping.models.find_models`
    views: Sequence[View],
    matches: Mapping[tuple[int, int], np.ndarray],
    camera: Camera,  # a pinhole with a known centre; its focal length is a guess
    shape: tuple[int, int],
    calibrate: Calibrate,  # ``"radial"`` estimates a radial coefficient too
    *,
    # largest standard deviation of an estimate that replaces the guess, as a share of the focal
    # length
    max_deviation: float,
) -> tuple[list[Model], FocalEstimate | None]:
    """Find poses of views, points of tracks, and the focal length that fits them best.

    Returns models and the estimate. The models have the estimated focal length, or the guess if the
    guess is as good. The estimate is None if no focal length leads to a path, or if few views show
    parallax with the estimated focal length.
    """
    graph = ViewGraph.from_views(views, matches, shape, is_focal_known=False)
    start_focal = _find_start_focal(graph, camera, calibrate)
    reconstructions = _grow_models(graph, camera, start_focal, calibrate) if start_focal else []
    if not reconstructions:
        models = find_models(views, matches, camera, shape, is_focal_known=False)
        return models, _guess_estimate(camera) if models else None
    _adjust(reconstructions[0], calibrate)
    estimate = _estimate_focal(reconstructions[0], camera, shape, calibrate)
    estimate = replace(estimate, max_deviation=max_deviation)
    if not estimate.is_useful:
        return find_models(views, matches, camera, shape, is_focal_known=False), estimate
    estimated_camera = estimate.apply_to(camera)
    if not estimate.radial and not graph.shows_parallax(estimated_camera):
        return [], None
    if not estimate.is_certain and not estimate.radial:
        # A rotation seen with a wrong focal length may look like a path. Such a path does not
        # appear again if models start with the estimated focal length: then there is no path. New
        # models may be bent too: they are used only with a good score.
        new_models = find_models(views, matches, estimated_camera, shape, is_focal_known=False)
        score = graph.score(reconstructions) * graph.match_count()
        if (
            not new_models
            or sum(model.score for model in new_models) >= CALIBRATION.min_shape_score * score
        ):
            return new_models, estimate
    for model in reconstructions[1:]:
        _set_focal(model, estimate.focal, estimate.radial)
        _adjust(model, "nothing")
    undistorted_views = [
        replace(
            view, observations=undistort_observations(view.observations, estimated_camera, shape)
        )
        for view in views
    ]
    return graph.make_models(
        reconstructions, undistorted_views, estimated_camera.pinhole()
    ), estimate


def undistort_observations(
    observations: Observations, camera: Camera, shape: tuple[int, int]
) -> Observations:
    """Return the tracks of a camera with distortion as a pinhole would see them.

    Tracks outside the frame are left out.
    """
    if camera.is_pinhole or not len(observations.points):
        return observations
    height, width = shape
    points = undistort_points(observations.points, camera, shape)
    is_inside = ((points >= 0) & (points <= (width - 1, height - 1))).all(axis=1)
    return Observations(points=points[is_inside], tracks=observations.tracks[is_inside])


def undistort_points(points: np.ndarray, camera: Camera, shape: tuple[int, int]) -> np.ndarray:
    """Return points of a camera with distortion, (N, 2) px, as a pinhole would see them."""
    if camera.is_pinhole or not len(points):
        return points
    cx, cy = camera.center_for(*shape)
    matrix = np.array([[camera.focal, 0, cx], [0, camera.focal, cy], [0, 0, 1]])
    undistorted = cv2.undistortPoints(
        points[:, None], matrix, np.array(camera.distortion), P=matrix
    )
    return np.asarray(undistorted[:, 0])


def _estimate_focal(
    model: Any, camera: Camera, shape: tuple[int, int], calibrate: Calibrate
) -> FocalEstimate:
    """Return the focal length of a reconstruction, with its uncertainty from the parts."""
    focal, radial = _focal_and_radial(model)
    if not _is_possible(focal):
        return _guess_estimate(camera)
    subsets = _split(model, camera, shape)
    starts = [
        focal * CALIBRATION.part_start_factor ** (1 if k % 2 else -1) for k in range(len(subsets))
    ]
    parts = [
        _calibrate_part(model, subset, start, calibrate)
        for subset, start in zip(subsets, starts, strict=True)
    ]
    focals = np.array([part_focal for part_focal, _ in parts])
    if not all(map(_is_possible, focals)):
        return _guess_estimate(camera)
    # If the data do not determine the focal length, the adjustment hardly changes the start value.
    min_change = CALIBRATION.min_relative_change * math.log(CALIBRATION.part_start_factor)
    is_unchanged = np.abs(np.log(focals / starts)) < min_change
    if is_unchanged.sum() > len(parts) / 2:
        return _guess_estimate(camera)
    errors = np.stack([np.log(focals / focal), [k1 - radial for _, k1 in parts]], axis=1)
    deviation, radial_deviation = CALIBRATION.spread_to_deviation * np.sqrt(
        np.mean(errors**2, axis=0)
    )
    log_change = 0.0 if calibrate == "radial" else _log_focal_change(model)
    return FocalEstimate(
        focal=focal,
        deviation=focal * math.hypot(deviation, log_change, CALIBRATION.shared_deviation),
        radial=radial,
        radial_deviation=float(radial_deviation),
        shows_distortion=abs(log_change) > max(CALIBRATION.min_log_focal_change, deviation),
    )


def _guess_estimate(guess: Camera) -> FocalEstimate:
    """Return an estimate with infinite deviation: the guess is used."""
    return FocalEstimate(focal=guess.focal, deviation=math.inf)


def _is_possible(focal: float) -> bool:
    """Return whether a camera may have this focal length, px: an adjustment has no bounds."""
    return MIN_FOCAL <= focal <= MAX_FOCAL


def _log_focal_change(model: Any) -> float:
    """Return the change of the log focal length when distortion is estimated too."""
    distorted = copy.deepcopy(model)
    camera = next(iter(distorted.cameras.values()))
    params = [*camera.params, 0.0]
    camera.model = pycolmap().CameraModelId.SIMPLE_RADIAL
    camera.params = params
    _adjust(distorted, "radial")
    focal = _focal_and_radial(distorted)[0]
    return math.log(focal / _focal_and_radial(model)[0]) if _is_possible(focal) else math.inf


def _grow_models(
    graph: ViewGraph, camera: Camera, start_focal: float, calibrate: Calibrate
) -> list[Any]:
    """Return reconstructions from a focal length, or from another one if they explain too little.

    The start value may come from windows whose models are bent, for example where the camera
    follows a moving object.
    """
    best_models = graph.grow_models(replace(camera, focal=start_focal), calibrate)
    if best_models and graph.score(best_models) >= CALIBRATION.min_shape_score:
        return best_models
    for factor in CALIBRATION.start_factors:
        candidates = graph.grow_models(replace(camera, focal=factor * camera.focal), calibrate)
        if (
            candidates
            and graph.score(candidates) > graph.score(best_models)
            and _is_possible(_focal_and_radial(candidates[0])[0])
        ):
            best_models = candidates
    return best_models


def _find_start_focal(graph: ViewGraph, camera: Camera, calibrate: Calibrate) -> float | None:
    """Return the focal length, px, that explains the matches in windows of views best."""
    best_focal, best_score = None, 0.0
    for factor in CALIBRATION.start_factors:
        score, focals = 0.0, []
        for window in _comparison_windows(graph):
            models = window.grow_models(replace(camera, focal=factor * camera.focal), calibrate)
            if models and _is_possible(_focal_and_radial(models[0])[0]):
                score += window.score(models[:1])
                focals.append(_focal_and_radial(models[0])[0])
        if score > best_score:
            best_focal, best_score = float(np.exp(np.mean(np.log(focals)))), score
    return best_focal


def _comparison_windows(graph: ViewGraph) -> list[ViewGraph]:
    count, size = len(graph.views), CALIBRATION.window_views
    if count <= 2 * size:
        return [graph]
    begins = (count // 4 - size // 2, count - count // 4 - size // 2)
    return [graph.subgraph(begin, begin + size) for begin in begins]


def _split(model: Any, camera: Camera, shape: tuple[int, int]) -> list[tuple[set[int], set[int]]]:
    """Return views and points of each part: halves of the time, and halves of the image.

    Points that most views see come first, until there are enough observations.
    """
    views = sorted(model.reg_image_ids())
    lengths = {number: point.track.length() for number, point in model.points3D.items()}
    points, count = set(), 0
    for number in sorted(lengths, key=lambda point_id: (-lengths[point_id], point_id)):
        if count < CALIBRATION.max_part_observations:
            points.add(number)
            count += lengths[number]
    half = max(2, len(views) // 2)
    parts = [(set(views[:half]), points), (set(views[-half:]), points)]
    center = camera.center_for(*shape)
    positions = {
        number: _image_positions(model, model.points3D[number]).mean(axis=0) for number in points
    }
    for axis in (0, 1):
        first_half = {number for number in points if positions[number][axis] < center[axis]}
        parts += [(set(views), first_half), (set(views), points - first_half)]
    return parts


def _image_positions(model: Any, point: Any) -> np.ndarray:
    """Return the observed positions of a point, (N, 2), px."""
    images = model.images
    return np.array(
        [
            images[element.image_id].points2D[element.point2D_idx].xy
            for element in point.track.elements
        ]
    )


def _calibrate_part(
    model: Any, part: tuple[set[int], set[int]], start_focal: float, calibrate: Calibrate
) -> tuple[float, float]:
    """Return the focal length, px, and k1 of a part, adjusted from another focal length."""
    views, points = part
    part_model = copy.deepcopy(model)
    for number in sorted(set(part_model.reg_image_ids()) - views):
        part_model.deregister_frame(part_model.images[number].frame_id)
    unused_points = [
        k for k, point in part_model.points3D.items() if k not in points or point.track.length() < 2
    ]
    for number in unused_points:
        part_model.delete_point3D(number)
    _set_focal(part_model, start_focal, _focal_and_radial(model)[1])
    _adjust(part_model, calibrate)
    return _focal_and_radial(part_model)


def _adjust(model: Any, calibrate: Calibrate) -> None:
    """Adjust poses, points and the unknown part of the camera until convergence."""
    options = pycolmap().BundleAdjustmentOptions()
    options.refine_focal_length = calibrate != "nothing"
    options.refine_extra_params = calibrate == "radial"
    options.refine_principal_point = False
    config = pycolmap().BundleAdjustmentConfig()
    for number in sorted(model.reg_image_ids()):
        config.add_image(number)
    config.fix_gauge(pycolmap().BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    robust_adjustment(
        options, CALIBRATION.final_steps, CALIBRATION.final_tolerance, MAPPING.outlier_pixels
    )
    pycolmap().create_default_bundle_adjuster(options, config, model).solve()


def _focal_and_radial(model: Any) -> tuple[float, float]:
    """Return the focal length, px, and k1, which is 0 if it is not estimated."""
    focal, _, _, *radial = next(iter(model.cameras.values())).params
    return float(focal), float(radial[0]) if radial else 0.0


def _set_focal(model: Any, focal: float, radial: float) -> None:
    camera = next(iter(model.cameras.values()))
    _, cx, cy, *radial_coefficients = camera.params
    camera.params = [focal, cx, cy, *([radial] if radial_coefficients else [])]
