"""The camera path of a sequence, estimated from tracks and matches of views."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from tisfm.camera import Camera
from tisfm.reconstruction.calibration.self_calibration import find_models_and_focal
from tisfm.reconstruction.causes.cause_search import CauseSearch
from tisfm.reconstruction.joints.joint_search import join_pieces
from tisfm.reconstruction.mapping.models import Model, find_models, readjust_models
from tisfm.reconstruction.mapping.settings import MAPPING
from tisfm.reconstruction.mapping.solution import FocalEstimate, PathSolution, Piece
from tisfm.reconstruction.path.camera_path import CameraPath
from tisfm.reconstruction.path.missing_poses import MissingPoses
from tisfm.reconstruction.path.remaining_frames import add_remaining_frames
from tisfm.reconstruction.path.turning_pieces import add_turning_pieces
from tisfm.reconstruction.path.undistortion import undistort_tracks, undistort_views
from tisfm.reconstruction.result.calibration import Calibrate
from tisfm.reconstruction.rolling_shutter.correction import ReadoutCorrection, find_corrected_path
from tisfm.reconstruction.submaps.joining import focal_from_submaps, models_from_submaps
from tisfm.reconstruction.submaps.settings import SUBMAPS
from tisfm.reconstruction.tracks.sequence_tracks import SequenceTracker, SequenceTracks
from tisfm.reconstruction.tracks.tracker import Observations
from tisfm.reconstruction.tracks.views import View
from tisfm.shutter import RollingShutterMotion
from tisfm.status import Status


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
    # frame → (H, W) uint8: images that join pieces, and that show why frames have no pose; None if
    # they are not at hand
    grey: Callable[[int], np.ndarray] | None = None
    # Whether pieces are joined by their images. The images have to belong to the tracks: tracks
    # without a zoom, for instance, differ from images with it.
    joins_pieces: bool = True
    # By frame, (4, 4) camera to world, of two views: the poses that a path without calibration
    # begins with; None if it begins with a pair that its tracks show
    start: Mapping[int, np.ndarray] | None = None

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
        solution = self._join_pieces(solution)
        rolling = None
        if self.readout != 0 and solution.pieces:
            count = len(tracks.observations)
            instants = np.arange(count) if instants is None else np.asarray(instants)
            solution, rolling = self._correct_readout(solution, instants)
        solution = add_turning_pieces(
            solution,
            tracks,
            is_focal_known=self.calibrate == "nothing",
            max_deviation=self.max_deviation,
        )
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
        if self.start is not None:
            return readjust_models(views, matches, camera, shape, [self.start]), None
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
            rivals = {min(piece.views): piece.rival for piece in pieces if piece.views}
            models = [
                replace(model, rival=rivals.get(min(model.poses)))
                for model in readjust_models(views, matches, camera, shape, start_poses)
            ]
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

    def _join_pieces(self, solution: PathSolution) -> PathSolution:
        """Return the solution with pieces joined by their images, and frames between them posed."""
        camera = solution.camera
        if self.grey is None or not self.joins_pieces or not camera.is_pinhole:
            return solution
        pieces = join_pieces(solution.pieces, solution.observations, camera, self.grey)
        if len(pieces) == len(solution.pieces):
            return solution
        return self.complete_solution(
            pieces,
            solution.views,
            solution.observations,
            camera,
            solution.focal,
            solution.score,
        )

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
            # It has no joints: a joined piece would fall apart.
            is_whole = len(rebuilt_solution.pieces) <= len(corrected_solution.pieces)
            if rebuilt_solution.score > corrected_solution.score and is_useful and is_whole:
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
    return Piece(
        poses=model.poses, views=tuple(model.poses), points=model.points, rival=model.rival
    )


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
