"""The radial distortion of a lens that a path was solved without.

A path that was solved without the distortion may be so bent that no adjustment leads to the right
one. So the path is solved again from tracks from which several distortions were removed. The
distortion is then adjusted, with the tracks as the frames show them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tisfm.camera import Camera
from tisfm.reconstruction.calibration.bundle_residuals import COMMON
from tisfm.reconstruction.calibration.camera_adjustment import AdjustedCamera, adjust_camera
from tisfm.reconstruction.mapping.solution import FocalEstimate
from tisfm.reconstruction.path.camera_path import CameraPath
from tisfm.reconstruction.path.path_bundle import (
    adjust_largest_piece,
    compare_costs,
    count_posed_frames,
    count_views,
    has_other_focal,
)
from tisfm.reconstruction.path.path_solver import PathSolver
from tisfm.reconstruction.path.settings import REVISION
from tisfm.reconstruction.path.undistortion import undistort_tracks, undistort_views

ADVICE = "give the camera with its distortion"


@dataclass(frozen=True, kw_only=True, eq=False)
class _LensPath:
    """A path of tracks without distortion, and the camera adjusted with the distorted tracks."""

    path: CameraPath
    adjusted: AdjustedCamera

    @property
    def radial(self) -> float:
        """k1, in units of the focal length of the path."""
        return float(self.adjusted.common[1])

    @property
    def radial_deviation(self) -> float:
        """Standard deviation of k1."""
        return float(self.adjusted.common_deviation[1])


def revise_lens(path: CameraPath, solver: PathSolver, instants: np.ndarray) -> CameraPath:
    """Return the path without a distortion k1 that the tracks show.

    Otherwise the path itself is returned. Either has an objection if the tracks fit another focal
    length than the stated one, or a lens that one coefficient does not describe.
    """
    is_focal_known = solver.calibrate == "nothing"
    free: tuple[str, ...] = () if is_focal_known else ("focal",)
    base = adjust_largest_piece(path, solver.tracks.shape, free)
    refocused = _solve_with_other_focal(solver, instants) if is_focal_known else None
    lens = _solve_lens(base, solver, instants, free)
    if lens is not None and not _shows_lens(path, base, refocused, lens, solver):
        lens = None
    if lens is None:
        return replace(path, objection=_object_to_focal(base, refocused, solver.camera))
    radial = lens.radial
    estimate = lens.path.focal or FocalEstimate(focal=lens.path.camera.focal, deviation=0.0)
    return replace(
        lens.path,
        camera=replace(lens.path.camera, distortion=(radial, 0.0, 0.0, 0.0)),
        focal=replace(
            estimate,
            radial=radial,
            radial_deviation=lens.radial_deviation,
            shows_distortion=False,
        ),
        objection=_object_to_lens(lens, solver),
    )


def _solve_lens(
    base: AdjustedCamera,  # the camera without distortion, adjusted with the tracks
    solver: PathSolver,
    instants: np.ndarray,
    free: Sequence[str],
) -> _LensPath | None:
    """Return the path whose tracks fit a distortion k1 best; None if there is none.

    No strong distortion is tried if the weak ones have paths and fit no better than none: each try
    solves the path.
    """
    corner = float(np.hypot(*solver.camera.center_for(*solver.tracks.shape)))
    unit = (solver.camera.focal / corner) ** 2
    best: _LensPath | None = None
    for starts in (REVISION.weak_lens_starts, REVISION.strong_lens_starts):
        if best is not None and compare_costs(best.adjusted, base) > REVISION.max_weak_lens_cost:
            return None
        for start in starts:
            lens = _solve_with(start * unit, solver, instants, free)
            if best is None or (
                lens is not None and compare_costs(lens.adjusted, best.adjusted) < 1
            ):
                best = lens
    if best is None:
        return None
    for _ in range(REVISION.lens_rounds):
        # the coefficient in units of the focal length that the solver starts with
        radial = best.radial * (solver.camera.focal / best.path.camera.focal) ** 2
        refined = _solve_with(radial, solver, instants, free)
        if refined is None:
            break
        best = refined
    return best


def _solve_with(
    radial: float, solver: PathSolver, instants: np.ndarray, free: Sequence[str]
) -> _LensPath | None:
    """Return the path after the distortion k1 was removed from tracks, and k1 adjusted then."""
    shape = solver.tracks.shape
    camera = replace(solver.camera, distortion=(radial, 0.0, 0.0, 0.0))
    tracks = replace(
        solver.tracks,
        observations=undistort_tracks(solver.tracks.observations, camera, shape),
        views=undistort_views(solver.tracks.views, camera, shape),
    )
    path = replace(solver, tracks=tracks, joins_pieces=False).solve(instants)
    if count_views(path) < REVISION.min_views:
        return None
    if path.focal is not None and not path.focal.is_useful:
        return None
    adjusted = adjust_largest_piece(
        path,
        shape,
        (*free, "k1"),
        solver.tracks.observations,
        radial=radial * (path.camera.focal / solver.camera.focal) ** 2,
    )
    return _LensPath(path=path, adjusted=adjusted)


def _solve_with_other_focal(solver: PathSolver, instants: np.ndarray) -> AdjustedCamera | None:
    """Return the camera of a path that was solved as if the focal length was unknown."""
    solver = replace(solver, calibrate="focal", is_focal_known=False, joins_pieces=False)
    path = solver.solve(instants)
    if not path.pieces_with_positions or path.focal is None or not path.focal.is_useful:
        return None
    return adjust_largest_piece(path, solver.tracks.shape, ("focal",))


def _shows_lens(
    path: CameraPath,
    base: AdjustedCamera,
    refocused: AdjustedCamera | None,
    lens: _LensPath,
    solver: PathSolver,
) -> bool:
    """Return whether a distortion is significant, and explains what no pinhole explains."""
    estimate = lens.path.focal
    is_focal_known = solver.is_focal_known if estimate is None else estimate.is_certain
    corner = float(np.hypot(*solver.camera.center_for(*solver.tracks.shape)))
    displacement = abs(lens.radial) * (corner / lens.path.camera.focal) ** 2
    return (
        is_focal_known
        and count_posed_frames(lens.path) >= count_posed_frames(path)
        and displacement > REVISION.min_displacement
        and abs(lens.radial) > REVISION.min_lens_significance * lens.radial_deviation
        and compare_costs(lens.adjusted, base) < REVISION.max_distorted_cost
        and (refocused is None or compare_costs(lens.adjusted, refocused) < REVISION.max_lens_cost)
    )


def _object_to_focal(base: AdjustedCamera, refocused: AdjustedCamera | None, camera: Camera) -> str:
    """Return what contradicts a stated focal length, and advice; "" if nothing does."""
    if refocused is None or compare_costs(refocused, base) > REVISION.max_cost:
        return ""
    if not has_other_focal(refocused, camera):
        return ""
    share = 100 * (refocused.focal / camera.focal - 1)
    return (
        f"the tracks fit a focal length that is {abs(share):.0f} % "
        f"{'longer' if share > 0 else 'shorter'} than the stated one: pose and depth are probably "
        'wrong. Check the focal length, or use calibrate="focal" (--calibrate focal)'
    )


def _object_to_lens(lens: _LensPath, solver: PathSolver) -> str:
    """Return what contradicts one coefficient of a lens, and advice; "" if nothing does."""
    adjusted = lens.adjusted
    full = adjust_camera(adjusted.bundle, adjusted.focal, COMMON, radial=lens.radial)
    if compare_costs(full, adjusted) < REVISION.max_cost:
        return (
            f"the lens distorts in a way that one radial coefficient (k1 = {lens.radial:.2f}) does "
            f"not describe: pose and depth are probably wrong. {ADVICE.capitalize()}"
        )
    if solver.calibrate != "nothing":
        return ""
    free = adjust_camera(adjusted.bundle, adjusted.focal, ("focal", "k1"), radial=lens.radial)
    is_better = compare_costs(free, adjusted) <= REVISION.max_lens_cost
    if not (is_better and has_other_focal(free, solver.camera)):
        return ""
    return (
        f"the lens distorts (k1 = {lens.radial:.2f}), and the tracks do not fit the stated focal "
        f"length: pose and depth are probably wrong. {ADVICE.capitalize()}, or use "
        'calibrate="radial" (--calibrate radial)'
    )
