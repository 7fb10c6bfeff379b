"""The camera path of a sequence, estimated from tracks and matches of views."""

from bisect import bisect_left
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from tisfm.camera import Camera
from tisfm.reconstruction.calibration.self_calibration import (
    find_models_and_focal,
    undistort_observations,
    undistort_points,
)
from tisfm.reconstruction.causes.cause_search import CauseSearch
from tisfm.reconstruction.frames.disk_cache import DiskCache
from tisfm.reconstruction.mapping.models import (
    Model,
    find_models,
    pose_from_points,
    readjust_models,
)
from tisfm.reconstruction.mapping.settings import MAPPING
from tisfm.reconstruction.mapping.solution import FocalEstimate, PathSolution, Piece
from tisfm.reconstruction.path.missing_poses import MissingPoses, split_runs
from tisfm.reconstruction.result.calibration import Calibrate
from tisfm.reconstruction.rolling_shutter.correction import ReadoutCorrection, find_corrected_path
from tisfm.reconstruction.rotation.rotation_search import RotationSearch
from tisfm.reconstruction.rotation.settings import ROTATION
from tisfm.reconstruction.submaps.joining import focal_from_submaps, models_from_submaps
from tisfm.reconstruction.submaps.settings import SUBMAPS
from tisfm.reconstruction.tracks.sequence_tracks import SequenceTracker, SequenceTracks
from tisfm.reconstruction.tracks.tracker import Observations
from tisfm.reconstruction.tracks.views import View
from tisfm.shutter import RollingShutterMotion
from tisfm.status import Status


@dataclass(frozen=True, kw_only=True)
class CameraPath:
    """Poses of frames, in pieces, and the reasons for missing poses."""

    # pieces in the order of their first frames; each frame is in at most one piece
    pieces: tuple[Piece, ...]
    missing: Mapping[int, Status]  # reason for each frame that is in no piece
    observations: Sequence[Observations]  # tracks in every frame
    # Camera with the focal length of the path, and with distortion if distortion was estimated.
    # Poses, points and tracks belong to its pinhole, without distortion.
    camera: Camera
    # the estimate, if the focal length was to be estimated and a path was found
    focal: FocalEstimate | None = None
    # With a rolling shutter: the motion during readout. Poses, points and tracks are those of
    # middle rows.
    rolling: RollingShutterMotion | None = None
    # (N,) float64: focal length of each frame over that of the first frame; None if it is constant.
    # Poses, points and tracks belong to the focal length of the first frame.
    zoom: np.ndarray | None = None
    score: float = 0.0  # as for `PathSolution`
    # why the camera cannot be right, and what to do; "" if nothing says so
    objection: str = ""

    @property
    def pieces_with_positions(self) -> list[Piece]:
        """The pieces in which the camera does more than turn."""
        return [piece for piece in self.pieces if not piece.only_turns]


@dataclass(frozen=True, kw_only=True)
class PathSolver:
    """Finds the camera path from tracks and views."""

    tracks: SequenceTracks
    camera: Camera  # pinhole camera of the frames
    # The part of the camera that is estimated with the path. Except for ``"nothing"``, the focal
    # length of `camera` is a guess.
    calibrate: Calibrate = "nothing"
    # largest standard deviation of an estimate that replaces the guess, as a share of the focal
    # length
    max_deviation: float = field(default_factory=lambda: MAPPING.max_useful_deviation)
    # readout time of the shutter, in intervals between frames; None if it is estimated
    readout: float | None = None
    # Whether the focal length is known. With a guess, a path cannot begin where all points lie in
    # one plane.
    is_focal_known: bool = True
    frames: Sequence[int] | None = None  # the frames that get a pose; by default all
    # frame → (H, W) uint8: images that show why frames have no pose; None if they are not at hand
    grey: Callable[[int], np.ndarray] | None = None

    def solve(
        self,
        # (N,) array: time of each frame, in intervals between frames of the source; by default 0,
        # 1, 2, …
        instants: np.ndarray | None = None,
    ) -> CameraPath:
        """Return the camera path."""
        tracks = self.tracks
        if not len(tracks.observations):
            return CameraPath(pieces=(), missing={}, observations=(), camera=self.camera)
        solution = self._solve_views(tracks.views, tracks.observations, self.camera, self.calibrate)
        rolling = None
        if self.readout != 0 and solution.pieces:
            count = len(tracks.observations)
            instants = np.arange(count) if instants is None else np.asarray(instants)
            solution, rolling = self._correct_readout(solution, instants)
        solution = self._add_rotations(solution)
        return CameraPath(
            pieces=tuple(sorted(solution.pieces, key=lambda piece: min(piece.poses))),
            missing=self.find_missing(solution),
            observations=solution.observations,
            camera=solution.camera,
            focal=solution.focal,
            rolling=rolling,
            score=solution.score,
        )

    @property
    def _uses_known_focal(self) -> bool:
        return self.is_focal_known and self.calibrate == "nothing"

    def find_new_models(
        self,
        views: Sequence[View],
        matches: Mapping[tuple[int, int], np.ndarray],
        camera: Camera,
        calibrate: Calibrate,
    ) -> tuple[list[Model], FocalEstimate | None]:
        """Return the models of views, and the estimated focal length or None."""
        shape = self.tracks.shape
        if calibrate != "nothing":
            return find_models_and_focal(
                views, matches, camera, shape, calibrate, max_deviation=self.max_deviation
            )
        return find_models(
            views, matches, camera, shape, is_focal_known=self._uses_known_focal
        ), None

    def readjust(
        self,
        views: Sequence[View],  # corrected for the readout time
        observations: Sequence[Observations],  # tracks in every frame, corrected as well
        pieces: Sequence[Piece],  # start values of the poses
        camera: Camera,  # pinhole camera
    ) -> PathSolution:
        """Return the path of corrected views, adjusted from the poses of an earlier path."""
        shape, matches = self.tracks.shape, self.tracks.matches
        if len(views) > SUBMAPS.max_views:
            models = models_from_submaps(
                views, matches, camera, shape, observations, is_focal_known=self._uses_known_focal
            )
        else:
            start_poses = [{frame: piece.poses[frame] for frame in piece.views} for piece in pieces]
            models = readjust_models(views, matches, camera, shape, start_poses)
        return self._solve_from_models(models, views, observations, camera)

    def find_missing(
        self, solution: PathSolution, *, are_turns_found: bool = True
    ) -> Mapping[int, Status]:
        """Return the reason for each frame without a pose; it is found when it is asked for.

        `are_turns_found` says whether frames in which the camera only turns have orientations.
        """
        if not solution.missing_frames:
            return {}
        search = CauseSearch(
            observations=solution.observations,
            views=undistort_views(solution.views, solution.camera, self.tracks.shape),
            matches=self.tracks.matches,
            camera=solution.camera.pinhole(),
            shape=self.tracks.shape,
            grey=self.grey,
        )
        return MissingPoses(
            frames=solution.missing_frames,
            search=search,
            has_pieces=bool(solution.pieces),
            distinct_count=self.tracks.distinct_count,
            is_focal_known=self._uses_known_focal,
            are_turns_found=are_turns_found,
        )

    def complete_solution(
        self,
        pieces: Sequence[Piece],
        views: Sequence[View],
        observations: Sequence[Observations],
        camera: Camera,
        focal: FocalEstimate | None = None,
        score: float = 0.0,
    ) -> PathSolution:
        """Return pieces as a solution, after the frames between their views got poses."""
        frames = range(len(observations)) if self.frames is None else self.frames
        pieces, missing_frames = add_remaining_frames(
            pieces, observations, frames, camera.pinhole(), self.tracks.shape
        )
        return PathSolution(
            pieces=pieces,
            missing_frames=missing_frames,
            views=views,
            observations=observations,
            camera=camera,
            focal=focal,
            score=score,
        )

    def _add_rotations(self, solution: PathSolution) -> PathSolution:
        """Return the solution with pieces in which the camera only turns.

        If there is no other piece, and the focal length is to be estimated, the rotations show it.
        """
        runs = [
            run for run in split_runs(solution.missing_frames) if len(run) >= ROTATION.min_frames
        ]
        if not runs:
            return solution
        is_focal_known = self.calibrate == "nothing" or bool(solution.pieces)
        search = RotationSearch(
            observations=solution.observations,
            views=undistort_views(solution.views, solution.camera, self.tracks.shape),
            matches=self.tracks.matches,
            camera=solution.camera.pinhole(),
            shape=self.tracks.shape,
            max_deviation=self.max_deviation,
        )
        while runs:
            run = runs.pop(0)
            found = search.find_piece(run, is_focal_known=is_focal_known)
            if found is None:
                continue
            piece, estimate = found
            solution = replace(
                solution,
                pieces=[*solution.pieces, piece],
                missing_frames=[k for k in solution.missing_frames if k not in piece.poses],
            )
            rest = [frame for frame in run if frame not in piece.poses]
            if len(rest) >= ROTATION.min_frames:  # another pan, as after a cut
                runs.insert(0, rest)
            if estimate is not None:  # of the first run; later runs have this focal length too
                solution = replace(
                    solution, camera=estimate.apply_to(solution.camera), focal=estimate
                )
                search = replace(search, camera=solution.camera.pinhole())
                is_focal_known = True
        return solution

    def _correct_readout(
        self, solution: PathSolution, instants: np.ndarray
    ) -> tuple[PathSolution, RollingShutterMotion | None]:
        """Return the path of middle rows, and the motion of frames while their rows were read."""
        pinhole = solution.camera.pinhole()
        corrected_solution, rolling = find_corrected_path(
            solution,
            partial(self.readjust, camera=pinhole),
            self.tracks.matches,
            instants,
            self.readout,
            self.tracks.shape,
        )
        if rolling is None:
            return solution, None
        if len(corrected_solution.views) <= SUBMAPS.max_views:
            # A path that is bent by the readout effect may stay bent. So another path is built from
            # the corrected tracks, without a start from the first path.
            calibrate: Calibrate = "focal" if self.calibrate == "focal" else "nothing"
            rebuilt_solution = self._solve_views(
                corrected_solution.views, corrected_solution.observations, pinhole, calibrate
            )
            if rebuilt_solution.pieces and rebuilt_solution.focal is None:
                rebuilt_solution = self.readjust(
                    corrected_solution.views,
                    corrected_solution.observations,
                    rebuilt_solution.pieces,
                    pinhole,
                )
            is_useful = rebuilt_solution.focal is None or rebuilt_solution.focal.is_useful
            if rebuilt_solution.score > corrected_solution.score and is_useful:
                corrected_solution = rebuilt_solution
        if corrected_solution.focal is None:
            corrected_solution = replace(
                corrected_solution, camera=solution.camera, focal=solution.focal
            )
        # The last solution has poses for more frames: the motion of these frames is added.
        correction = ReadoutCorrection(
            solution.observations,
            corrected_solution.pieces,
            instants,
            rolling.readout,
            0.0,
            rolling.camera,
            self.tracks.shape,
        ).rolling
        rates = {**correction.rates, **rolling.rates}
        inverse_depth = {**correction.inverse_depth, **rolling.inverse_depth}
        return corrected_solution, replace(rolling, rates=rates, inverse_depth=inverse_depth)

    def _solve_views(
        self,
        views: Sequence[View],
        tracks: Sequence[Observations],
        camera: Camera,
        calibrate: Calibrate,
    ) -> PathSolution:
        """Return the path through views and tracks in every frame."""
        matches, shape, focal = self.tracks.matches, self.tracks.shape, None
        if len(views) > SUBMAPS.max_views:  # submaps bound the memory
            if calibrate != "nothing":
                focal = focal_from_submaps(
                    views, matches, camera, shape, calibrate, max_deviation=self.max_deviation
                )
                if focal is None:  # no submap has a path
                    return self._solve_from_models([], views, tracks, camera)
            estimated_camera = camera if focal is None else focal.apply_to(camera)
            observations = undistort_tracks(tracks, estimated_camera, shape)
            undistorted_views = undistort_views(views, estimated_camera, shape)
            models = models_from_submaps(
                undistorted_views,
                matches,
                estimated_camera.pinhole(),
                shape,
                observations,
                is_focal_known=self._uses_known_focal,
            )
            return self._solve_from_models(models, views, observations, estimated_camera, focal)
        models, focal = self.find_new_models(views, matches, camera, calibrate)
        estimated_camera = camera if focal is None else focal.apply_to(camera)
        return self._solve_from_models(
            models,
            views,
            undistort_tracks(tracks, estimated_camera, shape),
            estimated_camera,
            focal,
        )

    def _solve_from_models(
        self,
        models: Sequence[Model],
        views: Sequence[View],
        observations: Sequence[Observations],
        camera: Camera,
        focal: FocalEstimate | None = None,
    ) -> PathSolution:
        """Return the solution with the poses of models and of the frames between their views."""
        pieces, score = list(map(make_piece, models)), sum(model.score for model in models)
        return self.complete_solution(pieces, views, observations, camera, focal, score)


def make_piece(model: Model) -> Piece:
    """Return the views and points of a model as a piece of the path."""
    return Piece(poses=model.poses, views=tuple(model.poses), points=model.points)


def find_path(
    # for each frame: grey levels, ignored pixels and image motion, the arguments of
    # `SequenceTracker.add`
    frames: Iterable[tuple[np.ndarray, np.ndarray | None, np.ndarray | None]],
    # camera, readout, is_focal_known: as for `PathSolver`
    camera: Camera,
    *,
    cells: int | None = None,  # as for `SequenceTracker`
    readout: float | None = None,
    is_focal_known: bool = True,
) -> CameraPath:
    """Track frames, and return the camera path."""
    tracker = SequenceTracker(camera, cells=cells)
    for frame in frames:
        tracker.add(*frame)
    solver = PathSolver(
        tracks=tracker.finish(), camera=camera, readout=readout, is_focal_known=is_focal_known
    )
    return solver.solve()


def undistort_tracks(
    tracks: Sequence[Observations], camera: Camera, shape: tuple[int, int]
) -> Sequence[Observations]:
    """Return the tracks of every frame as a pinhole would see them."""
    if camera.is_pinhole:
        return tracks
    undistorted = DiskCache(Observations.to_arrays, Observations.from_arrays)
    for observations in tracks:
        undistorted.append(undistort_observations(observations, camera, shape))
    return undistorted


def undistort_views(
    views: Sequence[View], camera: Camera, shape: tuple[int, int]
) -> Sequence[View]:
    """Return views as a pinhole would see them."""
    if camera.is_pinhole:
        return views
    undistorted = DiskCache(View.to_arrays, View.from_arrays)
    for view in views:
        undistorted.append(
            View(
                frame=view.frame,
                observations=undistort_observations(view.observations, camera, shape),
                detected=undistort_points(view.detected, camera, shape),
            )
        )
    return undistorted


def add_remaining_frames(
    pieces: Sequence[Piece],
    observations: Sequence[Observations],  # tracks in every frame
    frames: Iterable[int],  # frames to add
    camera: Camera,  # pinhole camera of the frames
    shape: tuple[int, int],  # height and width of the frames, px
) -> tuple[list[Piece], list[int]]:
    """Add the frames between views to pieces; return the pieces and the frames without a piece."""
    piece_of_frame = {frame: k for k, piece in enumerate(pieces) for frame in piece.poses}
    sorted_frames = sorted(piece_of_frame)
    poses_of_pieces: list[dict[int, np.ndarray]] = [dict(piece.poses) for piece in pieces]
    missing_frames = []
    for frame in frames:
        if frame in piece_of_frame:
            continue
        for k in _find_nearest_pieces(frame, piece_of_frame, sorted_frames):
            pose = pose_from_points(observations[frame], pieces[k].points, camera, shape)
            if pose is not None:
                poses_of_pieces[k][frame] = pose
                break
        else:
            missing_frames.append(frame)
    return [
        replace(piece, poses=dict(sorted(poses.items())))
        for piece, poses in zip(pieces, poses_of_pieces, strict=True)
    ], missing_frames


def _find_nearest_pieces(
    frame: int, piece_of_frame: Mapping[int, int], sorted_frames: Sequence[int]
) -> list[int]:
    """Return the pieces of the nearest frames before and after a frame, without repetition."""
    after = bisect_left(sorted_frames, frame)
    neighbours = [*sorted_frames[max(0, after - 1) : after], *sorted_frames[after : after + 1]]
    neighbours.sort(key=lambda other: abs(other - frame))
    return list(dict.fromkeys(piece_of_frame[other] for other in neighbours))
