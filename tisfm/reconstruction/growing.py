"""Models grown view by view: a first pair, then whatever sees enough of what is known."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from tisfm.reconstruction.calibration import Calibrate
from tisfm.reconstruction.colmap import pycolmap
from tisfm.reconstruction.places import OnePlace

FEWEST = 15  # observations that two views, or a view and the points, share
LEAST_SEEN = 0.15  # of the observations of known points: inliers of a view that is added
INLIER = 6.0  # px: of a view that is added
SMALLEST = 3  # views of a model
# px: residuals beyond count less and less in adjustments of all; and where all is to move first
OUTLYING, ROUGHLY = 0.5, 3.0
GROWN = 1.5  # times as many views, or points, as when all of them were adjusted the last time
# Of adjustments of all, while a model grows and at its end: steps at most, and the relative change
# of the sum of squares that is none.
GROWING, ENDING = (10, 1e-4), (50, 1e-5)
# Of first pairs: triangulation angles in degrees, the first that finds one counts; the parallax
# from where on more is no better, rad; and how many are tried.
ANGLES, ENOUGH_PARALLAX, TRIED = (4.0, 1.0), 0.03, 24
NEAREST, ROUNDS = 5e-4, 5  # rad: of parallax, noise has no more; and of the fit of a homography
BETTER = 2.5  # times: than a homography, a motion explains the directions of a first pair
QUANTILE = 0.75  # of the parallax of two views
EXPLAINED = 0.65  # of all matched observations: a model that explains as many is right
STARTS, ELSEWHERE = 3, 4  # models that are grown otherwise; views from one beginning to another
NARROWEST = 0.5  # degrees: of the directions that a point is seen in

Pairs = Mapping[tuple[int, int], tuple[np.ndarray, np.ndarray]]


def grown(database: Any, pairs: Pairs, count: int, calibrate: Calibrate = "nothing") -> list[Any]:
    """Return pycolmap's reconstructions of the views in a database, the largest first.

    Parameters
    ----------
    database : pycolmap.Database
    pairs : mapping of (int, int) to two (N, 3) arrays
        For pairs of views, whose numbers begin with 1: directions of unit length to the same
        points.
    count : int
        Of views.
    calibrate : {"nothing", "focal", "radial"}
        What of the camera is adjusted with the rest, from what it is on.
    """
    cache = _cache(database)
    mapper = pycolmap().IncrementalMapper(cache)
    options = _options(calibrate)
    left = set(range(1, count + 1)) & set(cache.images)
    promising = _promising(pairs)
    found = []
    while len(left) >= SMALLEST:
        reconstruction = _one(mapper, cache, options, pairs, promising, left)
        if reconstruction is None:
            break
        left -= set(reconstruction.reg_image_ids())
        found.append(reconstruction)
    return sorted(found, key=lambda one: (-one.num_reg_images(), min(one.reg_image_ids())))


def grown_from(
    database: Any,
    known: Mapping[int, np.ndarray],
    *,
    fixed: bool = True,
    left: Collection[int] | None = None,
) -> Any:
    """Return pycolmap's reconstruction of views, grown from those whose poses are known.

    Parameters
    ----------
    database : pycolmap.Database
    known : mapping of int to (3, 4) array
        World to camera, of two views at least, whose numbers begin with 1.
    fixed : bool
        Whether these stay where they are, or are adjusted with the rest.
    left : collection of int, optional
        The views that may be added; by default all others.
    """
    cache = _cache(database)
    mapper = pycolmap().IncrementalMapper(cache)
    options = _options()
    options.mapper.fix_existing_frames = fixed
    reconstruction = pycolmap().Reconstruction()
    reconstruction.load(cache)
    known = {number: pose for number, pose in known.items() if number in cache.images}
    if len(known) < 2:  # the others share nothing with any view
        return reconstruction
    for number, pose in known.items():
        reconstruction.frame(number).rig_from_world = pycolmap().Rigid3d(pose)
        reconstruction.register_frame(number)
    mapper.begin_reconstruction(reconstruction)
    for number in known:
        mapper.triangulate_image(options.triangulation, number)
    others = set(cache.images) if left is None else set(cache.images) & set(left)
    _grow(mapper, reconstruction, options, others - set(known), roughly=not fixed)
    mapper.end_reconstruction(False)
    return reconstruction


def _cache(database: Any) -> Any:
    settings = pycolmap().DatabaseCacheOptions()
    settings.min_num_matches = FEWEST
    return pycolmap().DatabaseCache.create(database, settings)


def _one(
    mapper: Any,
    cache: Any,
    options: Any,
    pairs: Pairs,
    promising: Sequence[tuple[int, int]],
    left: set[int],
) -> Any | None:
    """Return a reconstruction of some of the views that are left, None if there is none.

    A first pair may leave the motion open, and a model that is grown from it is bent: it explains
    little. Then others are grown, and the one that explains most counts.
    """
    best, most, begun = None, 0, list[int]()
    possible = [pair for pair in promising if left.issuperset(pair)]
    for pair in _starts(mapper, options, pairs, possible):
        if any(abs(number - other) < ELSEWHERE for number in pair[:2] for other in begun):
            continue
        begun += pair[:2]
        reconstruction = pycolmap().Reconstruction()
        mapper.begin_reconstruction(reconstruction)
        mapper.register_initial_image_pair(options.mapper, *pair)
        mapper.triangulate_image(options.triangulation, pair[0])
        _grow(mapper, reconstruction, options, left)
        mapper.end_reconstruction(False)
        explained = reconstruction.compute_num_observations()
        if reconstruction.num_reg_images() >= SMALLEST and explained > most:
            best, most = reconstruction, explained
        matched = sum(map(cache.correspondence_graph.num_observations_for_image, left))
        if most > EXPLAINED * matched or len(begun) >= 2 * STARTS:
            break
    return best


def _starts(
    mapper: Any, options: Any, pairs: Pairs, promising: Sequence[tuple[int, int]]
) -> Iterator[tuple[int, int, Any]]:
    """Give pairs that serve as a beginning, with the motion from the first to the second."""
    for angle in ANGLES:
        options.mapper.init_min_tri_angle = angle
        for first, second in promising[:TRIED]:
            motion = mapper.estimate_initial_two_view_geometry(options.mapper, first, second)
            if motion is not None and _needed(motion.matrix(), *pairs[first, second]):
                yield first, second, motion


def _needed(motion: np.ndarray, before: np.ndarray, after: np.ndarray) -> bool:
    """Return whether a motion, (3, 4), explains directions much better than any homography.

    With a way of its own for each point, a motion explains noise a little better as well.
    """
    normal = np.cross(motion[:, 3], before @ motion[:, :3].T)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    away = np.abs((after * normal).sum(axis=1))
    return bool(np.median(_parallax(before, after)) > BETTER * np.median(away))


def _grow(
    mapper: Any, reconstruction: Any, options: Any, left: set[int], *, roughly: bool = False
) -> None:
    """Grow a reconstruction; `roughly` if all of it has to move first."""
    local = options.get_local_bundle_adjustment()
    one_place = OnePlace(mapper, reconstruction)

    def adjust_all(
        refinements: int, limits: tuple[int, float] = GROWING, outlying: float = OUTLYING
    ) -> tuple[int, int]:
        mapper.iterative_global_refinement(
            refinements,
            1e-3,
            options.mapper,
            _adjustment(options, *limits, outlying),
            options.triangulation,
            normalize_reconstruction=not options.mapper.fix_existing_frames,
        )
        return reconstruction.num_reg_images(), reconstruction.num_points3D()

    if roughly:
        adjust_all(3, ENDING, ROUGHLY)
    views, points = adjust_all(2)
    if points == 0:
        return
    while True:
        for number in mapper.find_next_images(options.mapper, False):
            if number in left and mapper.register_next_image(options.mapper, number):
                break
        else:
            break
        mapper.triangulate_image(options.triangulation, number)
        one_place.delete(number)
        mapper.iterative_local_refinement(
            1, 1e-3, options.mapper, local, options.triangulation, number
        )
        one_place.delete(number)
        now = reconstruction.num_reg_images(), reconstruction.num_points3D()
        if now[0] >= GROWN * views or now[1] >= GROWN * points:
            views, points = adjust_all(1)
    adjust_all(1)
    adjust_all(1, ENDING)


def _promising(pairs: Pairs) -> list[tuple[int, int]]:
    """Return pairs of views to begin with, the best first.

    They share many points that neither a turn of the camera nor a plane explains: either leaves
    the motion open.
    """
    worth = {}
    for pair, (before, after) in pairs.items():
        if len(before) >= 2 * FEWEST:
            parallax = _parallax(before, after)
            if np.median(parallax) > NEAREST:
                worth[pair] = len(before) * min(
                    float(np.quantile(parallax, QUANTILE)), ENOUGH_PARALLAX
                )
    return sorted(worth, key=lambda one: (-worth[one], one))


def _parallax(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Return the angles that a homography leaves between directions, (N,), rad."""
    x, y, z = after.T[:, :, None]
    nothing = np.zeros_like(before)
    equations = np.stack(  # of the nine entries of H, row by row: after × (H before) = 0
        [
            np.hstack([nothing, -z * before, y * before]),
            np.hstack([z * before, nothing, -x * before]),
            np.hstack([-y * before, x * before, nothing]),
        ]
    )
    weights = np.ones(len(before))
    for _ in range(ROUNDS):
        weighted = (equations * weights[:, None]).reshape(-1, 9)
        moved = before @ np.linalg.eigh(weighted.T @ weighted)[1][:, 0].reshape(3, 3).T
        moved /= np.maximum(np.linalg.norm(moved, axis=1, keepdims=True), 1e-12)
        left = np.linalg.norm(np.cross(after, moved), axis=1)
        weights = 1 / np.sqrt(left + NEAREST)
    return np.asarray(left)


def _options(calibrate: Calibrate = "nothing") -> Any:
    options = pycolmap().IncrementalPipelineOptions()
    options.ba_refine_focal_length = calibrate != "nothing"
    options.ba_refine_extra_params = calibrate == "radial"
    options.ba_local_function_tolerance = 1e-5
    options.mapper.abs_pose_refine_focal_length = False
    options.mapper.abs_pose_refine_extra_params = False
    options.mapper.abs_pose_min_num_inliers = FEWEST
    options.mapper.abs_pose_min_inlier_ratio = LEAST_SEEN
    options.mapper.init_min_num_inliers = 2 * FEWEST
    options.triangulation.min_angle = options.mapper.filter_min_tri_angle = NARROWEST
    options.mapper.init_max_forward_motion = 1.0  # the angle says whether it serves
    for part in (options, options.mapper):
        part.num_threads = 1
    for part in (options, options.mapper, options.triangulation):
        part.random_seed = 0
    return options


def _adjustment(options: Any, steps: int, tolerance: float, outlying: float) -> Any:
    """Return what all views and points are adjusted by, robustly."""
    return robust(options.get_global_bundle_adjustment(), steps, tolerance, outlying)


def robust(adjustment: Any, steps: int, tolerance: float, outlying: float = OUTLYING) -> Any:
    """Return pycolmap's options of an adjustment, made robust, of so many steps at most."""
    adjustment.print_summary = False
    adjustment.ceres.loss_function_type = pycolmap().LossFunctionType.CAUCHY
    adjustment.ceres.loss_function_scale = outlying
    solver = adjustment.ceres.solver_options
    solver.num_threads = 1
    solver.max_num_iterations, solver.function_tolerance = steps, tolerance
    return adjustment
