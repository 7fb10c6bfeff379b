"""A zoom, or the distortion of a lens, that a path was solved without.

A path is solved with one focal length for all frames. Its tracks are then adjusted with a richer
camera: a focal length for each frame, and a distorting lens. Only if the richer camera explains
them clearly better, the path is solved again without the zoom, or without the distortion. If
neither is shown, but another camera fits the tracks better than the stated one, the path says so.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tisfm.camera import Camera
from tisfm.reconstruction.calibration.bundle_residuals import COMMON
from tisfm.reconstruction.calibration.camera_adjustment import AdjustedCamera, adjust_camera
from tisfm.reconstruction.frames.disk_cache import DiskCache
from tisfm.reconstruction.mapping.models import ViewGraph
from tisfm.reconstruction.mapping.settings import MAPPING
from tisfm.reconstruction.path.camera_path import CameraPath
from tisfm.reconstruction.path.hidden_zoom import (
    CameraComparison,
    find_hidden_zoom,
    object_to_hidden_zoom,
)
from tisfm.reconstruction.path.lens_revision import revise_lens
from tisfm.reconstruction.path.path_bundle import (
    adjust_largest_piece,
    choose_frames,
    choose_largest_piece,
    compare_costs,
    count_posed_frames,
    count_views,
    has_other_focal,
    make_bundle,
)
from tisfm.reconstruction.path.path_solver import PathSolver
from tisfm.reconstruction.path.settings import REVISION
from tisfm.reconstruction.submaps.settings import SUBMAPS
from tisfm.reconstruction.tracks.sequence_tracks import SequenceTracks
from tisfm.reconstruction.tracks.tracker import Observations
from tisfm.reconstruction.tracks.views import View


def revise_path(
    path: CameraPath,
    solver: PathSolver,  # it solved the path
    instants: np.ndarray,  # as for `PathSolver.solve`
    *,
    may_distort: bool,  # whether the lens may distort: no distortion is stated or estimated
) -> CameraPath:
    """Return the path with the zoom or the distortion that its tracks show.

    Otherwise the path itself is returned, with an objection if its camera does not fit its tracks,
    or with a doubt if its focal length is not known well.
    """
    if not 0 < count_views(path) <= SUBMAPS.max_views:
        return path
    free = () if solver.calibrate == "nothing" else ("focal",)
    fits_badly = _fits_badly(path, solver.tracks)
    max_cost = REVISION.max_cost_of_poor_path if fits_badly else REVISION.max_cost
    windows = compare_cameras(path, free, solver.tracks.shape)
    revised = path
    is_poor = any(window.rich.cost < max_cost * window.base.cost for window in windows)
    if is_poor and count_views(path) >= REVISION.min_views:
        zoomed = _solve_zoom(path, solver, instants, free)
        if zoomed is not None and _shows_zoom(path, zoomed, solver):
            return zoomed.path
        if may_distort:
            revised = revise_lens(path, solver, instants)
    if revised.objection or not revised.camera.is_pinhole:
        return revised
    objection = object_to_hidden_zoom(find_hidden_zoom(windows, free))
    is_certain = solver.is_focal_known if path.focal is None else path.focal.is_certain
    if not is_certain:
        # A wrong focal length may look like a zoom: that is no contradiction.
        return replace(revised, doubt=objection)
    return replace(revised, objection=objection)


def _fits_badly(path: CameraPath, tracks: SequenceTracks) -> bool:
    """Return whether a path explains the matches of views less than a right path does."""
    count = ViewGraph.from_views(tracks.views, tracks.matches, tracks.shape).match_count()
    return path.score < MAPPING.min_mean_score * count


def compare_cameras(
    path: CameraPath,
    free: Sequence[str],  # unknowns of the camera that the path was solved with
    shape: tuple[int, int],  # height and width of the frames, px
) -> list[CameraComparison]:
    """Return, for windows of frames of the largest piece, how a richer camera fits them."""
    frames = choose_frames(path)
    windows = []
    for begin in range(0, len(frames), REVISION.window_frames):
        window = frames[begin : begin + REVISION.window_frames]
        if len(window) < REVISION.min_views:
            continue
        bundle = make_bundle(path, shape, window)
        base = adjust_camera(
            bundle, path.camera.focal, free, scales=(MAPPING.outlier_pixels,),
            steps=REVISION.base_steps,
        )  # fmt: skip
        rich = adjust_camera(
            base.bundle, base.focal, COMMON, has_zoom=True, scales=(MAPPING.outlier_pixels,),
            steps=REVISION.rich_steps,
        )  # fmt: skip
        windows.append(CameraComparison(base=base, rich=rich))
    return windows


@dataclass(frozen=True, kw_only=True, eq=False)
class _ZoomedPath:
    """A path of tracks without zoom, and the camera that its tracks were adjusted with."""

    path: CameraPath
    # with the zoom that remains in the tracks of the path: less than `REVISION.zoom_tolerance`
    adjusted: AdjustedCamera
    # fitted to the tracks of the first path: a constant focal length, and a distortion k1
    constant: AdjustedCamera


def _solve_zoom(
    path: CameraPath, solver: PathSolver, instants: np.ndarray, free: Sequence[str]
) -> _ZoomedPath | None:
    """Return the path after the zoom was removed from the tracks; None if no zoom explains them.

    A path that was solved with a wrong zoom is bent. So the zoom is found in rounds. Several pieces
    have a zoom each, whose ratio is unknown: such a path keeps its focal length. So does a piece
    with joints, since the images that join its parts still have the zoom.

    A round takes as long as the first path. So if the focal length is stated, the first path
    decides whether a round begins: a zoom has to fit its tracks exactly, and better than a constant
    camera. If the focal length is estimated, the first path may be too bent for that.
    """
    if len(path.pieces_with_positions) != 1 or any(piece.joints for piece in path.pieces):
        return None
    if solver.calibrate == "nothing" and not solver.is_focal_known:
        return None  # a wrong focal length may look like a zoom
    constant = adjust_largest_piece(path, solver.tracks.shape, ("focal", "k1"))
    total = np.zeros(len(solver.tracks.observations))
    for solves_left in reversed(range(REVISION.zoom_rounds + 1)):
        if len(path.pieces_with_positions) != 1 or count_views(path) < REVISION.min_views:
            return None
        adjusted, change = _find_remaining_zoom(path, free, total, solver.tracks.shape)
        decides = solves_left == REVISION.zoom_rounds and solver.calibrate == "nothing"
        if decides and not _fits_better(adjusted, constant, REVISION.max_first_zoom_cost):
            return None
        if np.abs(change).max() < REVISION.zoom_tolerance:
            zoomed = replace(path, zoom=np.exp(total))
            return _ZoomedPath(path=zoomed, adjusted=adjusted, constant=constant)
        if solves_left:
            total += change
            tracks = unzoom_tracks(solver.tracks, total, solver.camera)
            path = replace(solver, tracks=tracks, joins_pieces=False).solve(instants)
    return None


def _find_remaining_zoom(
    path: CameraPath,
    free: Sequence[str],  # as for `adjust_camera`
    removed_zoom: np.ndarray,  # (N,): by frame, logarithm of the zoom that was removed before
    shape: tuple[int, int],  # height and width of the frames, px
) -> tuple[AdjustedCamera, np.ndarray]:
    """Return the camera that the tracks fit, and the logarithm of the zoom of all frames, (N,).

    Frames that are no views of the largest piece have the zoom of the views beside them.
    """
    views = list(choose_largest_piece(path).views)
    adjusted = adjust_largest_piece(
        path,
        shape,
        free,
        has_zoom=True,
        removed_zoom=removed_zoom[views] - removed_zoom[views[0]],
    )
    change = np.interp(np.arange(len(removed_zoom)), views, adjusted.zoom)
    return adjusted, change - change[0]


def _shows_zoom(path: CameraPath, zoomed: _ZoomedPath, solver: PathSolver) -> bool:
    """Return whether a zoom is significant, and explains what no constant camera explains."""
    zoom, adjusted = zoomed.path.zoom, zoomed.adjusted
    if zoom is None or not _fits_better(adjusted, zoomed.constant, REVISION.max_zoom_cost):
        return False
    deviation = float(adjusted.zoom_deviation.max())
    extent = float(np.log(zoom.max() / zoom.min()))
    if extent < max(REVISION.min_zoom, REVISION.min_zoom_significance * deviation):
        return False
    if count_posed_frames(zoomed.path) < count_posed_frames(path):
        return False
    if solver.calibrate != "nothing":
        # With an uncertain focal length, a forward motion may look like a zoom.
        return zoomed.path.focal is not None and zoomed.path.focal.is_certain
    # A wrong stated focal length may look like a zoom. Then the tracks show another focal length.
    free = adjust_camera(adjusted.bundle, adjusted.focal, ("focal",), has_zoom=True)
    return not has_other_focal(free, solver.camera)


def _fits_better(zoomed: AdjustedCamera, constant: AdjustedCamera, max_cost: float) -> bool:
    """Return whether a zoom is exact, and costs at most `max_cost` of a constant camera."""
    is_exact = zoomed.zoom_deviation.max() <= REVISION.max_zoom_deviation
    return bool(is_exact and compare_costs(zoomed, constant) <= max_cost)


def unzoom_tracks(
    tracks: SequenceTracks,
    zoom: np.ndarray,  # (N,) float64: by frame, the logarithm of the zoom
    camera: Camera,  # pinhole camera of the frames
) -> SequenceTracks:
    """Return tracks and views as a camera would see them that does not zoom."""
    center = np.array(camera.center_for(*tracks.shape))

    def unzoom_points(points: np.ndarray, frame: int) -> np.ndarray:
        return (points - center) * np.exp(-zoom[frame]) + center

    observations = DiskCache(Observations.to_arrays, Observations.from_arrays)
    for frame, in_frame in enumerate(tracks.observations):
        observations.append(replace(in_frame, points=unzoom_points(in_frame.points, frame)))
    views = DiskCache(View.to_arrays, View.from_arrays)
    for view in tracks.views:
        in_view = replace(
            view.observations, points=unzoom_points(view.observations.points, view.frame)
        )
        views.append(
            replace(view, observations=in_view, detected=unzoom_points(view.detected, view.frame))
        )
    return replace(tracks, observations=observations, views=views)
