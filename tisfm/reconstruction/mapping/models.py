"""Poses and points from matches of views, found and adjusted by pycolmap.

pycolmap runs with one thread and fixed seeds: the same input gives the same bits.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tisfm.camera import Camera
from tisfm.reconstruction.mapping.database import (
    PIXEL_CENTRE,
    MatchDirections,
    colmap_camera,
    match_pairs,
    open_database,
    pycolmap,
)
from tisfm.reconstruction.mapping.incremental import grow_from_poses, grow_models, shows_parallax
from tisfm.reconstruction.mapping.model_scores import Coverage, MatchScorer
from tisfm.reconstruction.mapping.rival import Rival
from tisfm.reconstruction.mapping.settings import MAPPING
from tisfm.reconstruction.result.calibration import Calibrate
from tisfm.reconstruction.tracks.tracker import Observations
from tisfm.reconstruction.tracks.triangulation import (
    TrackPoints,
    points_of_tracks,
    triangulate_tracks,
)
from tisfm.reconstruction.tracks.views import View, choose_long_tracks


@dataclass(frozen=True, kw_only=True)
class Model:
    """Views and points in one coordinate system."""

    poses: dict[int, np.ndarray]  # dict of int to (4, 4) float64: camera to world, by frame
    points: TrackPoints  # positions of tracks, in the world
    # Sum of the scores of the matches of its views (`MatchScorer`). It is 0 for a model that is
    # joined from submaps (models of parts of the sequence) or continues an earlier model.
    score: float = 0.0
    rival: Rival | None = None  # the motion that lost, if it came near


@dataclass(frozen=True, kw_only=True)
class ViewGraph:
    """Views with their tracks and matches; builds models from them."""

    views: list[View]  # views with their longest tracks
    # by pair of view indices: (N, 2) int32, the indices of matching points
    pairs: dict[tuple[int, int], np.ndarray]
    shape: tuple[int, int]  # height and width of the frames, px
    is_focal_known: bool = True  # whether the focal length is known; otherwise it is a guess

    @classmethod
    def from_views(
        cls,
        views: Sequence[View],
        matches: Mapping[tuple[int, int], np.ndarray],
        shape: tuple[int, int],
        *,
        is_focal_known: bool = True,
    ) -> "ViewGraph":
        """Return the graph of views; the arguments are as for `find_models`."""
        tracks = choose_long_tracks([view.observations for view in views], max(shape))
        views = [
            replace(view, observations=view_tracks)
            for view, view_tracks in zip(views, tracks, strict=True)
        ]
        pairs = match_pairs(views, matches)
        return cls(views=views, pairs=pairs, shape=shape, is_focal_known=is_focal_known)

    def subgraph(self, first: int, last: int) -> "ViewGraph":
        """Return the graph of the views with indices from `first` to `last` − 1."""
        indices_of_views = range(first, last)
        pairs = {
            (earlier - first, later - first): indices
            for (earlier, later), indices in self.pairs.items()
            if earlier in indices_of_views and later in indices_of_views
        }
        return replace(self, views=self.views[first:last], pairs=pairs)

    def grow_models(
        self,
        camera: Camera,
        calibrate: Calibrate = "nothing",
        rivals: dict[int, Rival] | None = None,  # filled, as in `incremental.grow_models`
    ) -> list[Any]:
        """Return pycolmap's reconstructions, the largest first.

        Each reconstruction has the focal length of the camera, or its own estimate, and a radial
        coefficient if it is calibrated. Models may follow a moving object that has more points than
        the static scene. So if much of the area of the frames is unexplained, other models are
        built from the unexplained matches. They replace the first models if they explain more area.
        """
        models = self._build_models(self.pairs, camera, calibrate, rivals)
        coverage = Coverage(self.views, self.pairs, self.shape)
        explained_matches = coverage.explained_matches(models)
        while models and coverage.explained_area(explained_matches) < MAPPING.min_coverage:
            unexplained = {
                **self.pairs,
                **{
                    pair: self.pairs[pair][~is_explained]
                    for pair, is_explained in explained_matches.items()
                },
            }
            unexplained = {
                pair: indices
                for pair, indices in unexplained.items()
                if len(indices) >= MAPPING.min_observations
            }
            other_rivals: dict[int, Rival] = {}
            other_models = self._build_models(unexplained, camera, calibrate, other_rivals)
            other_matches = coverage.explained_matches(other_models)
            if coverage.explained_area(other_matches) <= coverage.explained_area(explained_matches):
                break
            models, explained_matches = other_models, other_matches
            if rivals is not None:
                rivals.clear()
                rivals.update(other_rivals)
        return models

    def _build_models(
        self,
        pairs: Mapping[tuple[int, int], np.ndarray],
        camera: Camera,
        calibrate: Calibrate,
        rivals: dict[int, Rival] | None,
    ) -> list[Any]:
        directions = MatchDirections(self.views, pairs, camera, self.shape)
        adjusted_camera = colmap_camera(camera, self.shape, calibrate)
        with open_database(self.views, pairs, adjusted_camera) as database:
            return grow_models(
                database,
                directions,
                len(self.views),
                MatchScorer(self.views, pairs, self.shape),
                calibrate,
                is_focal_known=self.is_focal_known,
                rivals=rivals,
            )

    def shows_parallax(self, camera: Camera) -> bool:
        """Return whether enough pairs of views show parallax with the focal length of a camera."""
        directions = MatchDirections(self.views, self.pairs, camera, self.shape)
        with open_database(self.views, self.pairs, colmap_camera(camera, self.shape)) as database:
            return shows_parallax(database, directions)

    def score(self, reconstructions: Sequence[Any]) -> float:
        """Return the mean score of the matches in pycolmap's reconstructions, from 0 to 1."""
        scorer = MatchScorer(self.views, self.pairs, self.shape)
        return sum(map(scorer.score, reconstructions)) / max(scorer.match_count(), 1)

    def match_count(self) -> int:
        """Return the number of matches."""
        return sum(map(len, self.pairs.values()))

    def continue_model(self, camera: Camera, known_poses: Mapping[int, np.ndarray]) -> Any:
        """Return pycolmap's reconstruction, continued from fixed poses, by frame."""
        inverse_poses = {
            number: np.linalg.inv(known_poses[view.frame])[:3]
            for number, view in enumerate(self.views, start=1)
            if view.frame in known_poses
        }
        known_camera = colmap_camera(camera, self.shape)
        with open_database(self.views, self.pairs, known_camera) as database:
            return grow_from_poses(database, inverse_poses)

    def make_models(
        self, reconstructions: Sequence[Any], views: Sequence[View], camera: Camera
    ) -> list[Model]:
        """Return models of pycolmap's reconstructions, with points of all tracks of the views."""
        models = [self.make_model(reconstruction) for reconstruction in reconstructions]
        return [_add_track_points(model, views, camera, self.shape) for model in models]

    def make_model(self, reconstruction: Any) -> Model:
        """Return the model of a reconstruction, with the points of its adjusted tracks."""
        score = MatchScorer(self.views, self.pairs, self.shape).score(reconstruction)
        return replace(_model_of_reconstruction(reconstruction, self.views), score=score)


def find_models(
    views: Sequence[View],  # in the order of their frames
    # by pair of view indices, the smaller index first: (N, 2) int array, the indices of their
    # detected points that match
    matches: Mapping[tuple[int, int], np.ndarray],
    camera: Camera,  # pinhole camera
    shape: tuple[int, int],  # height and width of the frames, px
    *,
    # Whether the focal length is known. If it is a guess, a path cannot begin where all matches lie
    # in one plane.
    is_focal_known: bool = True,
) -> list[Model]:  # The largest model first. Each view is in at most one model.
    """Find poses of views and points of tracks.

    References
    ----------
    Schönberger and Frahm, "Structure-from-motion revisited", CVPR 2016, doi 10.1109/CVPR.2016.445:
    incremental mapping, with pycolmap's steps.
    """
    graph = ViewGraph.from_views(views, matches, shape, is_focal_known=is_focal_known)
    rivals: dict[int, Rival] = {}
    models = graph.make_models(graph.grow_models(camera, rivals=rivals), views, camera)
    rival_of_frame = {graph.views[number - 1].frame: rival for number, rival in rivals.items()}
    return [replace(model, rival=rival_of_frame.get(min(model.poses))) for model in models]


def continue_model(
    # views, matches, camera, shape: as for `find_models`
    views: Sequence[View],
    matches: Mapping[tuple[int, int], np.ndarray],
    camera: Camera,
    shape: tuple[int, int],
    # by frame, for at least two views: (4, 4) array, camera to world
    known_poses: Mapping[int, np.ndarray],
) -> Model:  # in the axes and the unit of the known poses, with the known poses unchanged
    """Find the poses of more views, and points; the known poses stay fixed."""
    graph = ViewGraph.from_views(views, matches, shape)
    model = _model_of_reconstruction(graph.continue_model(camera, known_poses), graph.views)
    poses = {
        **model.poses,
        **{frame: known_poses[frame] for frame in known_poses if frame in model.poses},
    }
    return _add_track_points(Model(poses=poses, points=model.points), views, camera, shape)


def readjust_models(
    # views, matches, camera, shape: as for `find_models`
    views: Sequence[View],
    matches: Mapping[tuple[int, int], np.ndarray],
    camera: Camera,
    shape: tuple[int, int],
    # for each model, by frame: (4, 4) array, camera to world
    known_poses: Sequence[Mapping[int, np.ndarray]],
) -> list[Model]:
    """Find poses of views and points of tracks, starting from approximate poses.

    Returns one model for each set of poses. A view without a pose joins the first model that it
    fits.
    """
    graph = ViewGraph.from_views(views, matches, shape)
    numbers = {view.frame: k for k, view in enumerate(views, start=1)}
    remaining = set(numbers.values()) - {numbers[frame] for poses in known_poses for frame in poses}
    reconstructions = []
    with open_database(graph.views, graph.pairs, colmap_camera(camera, shape)) as database:
        for poses in known_poses:
            inverse_poses = {
                numbers[frame]: np.linalg.inv(pose)[:3] for frame, pose in poses.items()
            }
            model = grow_from_poses(
                database, inverse_poses, are_poses_fixed=False, allowed_views=remaining
            )
            remaining -= set(model.reg_image_ids())
            reconstructions.append(model)
    return [model for model in graph.make_models(reconstructions, views, camera) if model.poses]


def pose_from_points(
    observations: Observations,
    points: Mapping[int, np.ndarray],
    camera: Camera,
    shape: tuple[int, int],
) -> np.ndarray | None:
    """Return the pose of a frame, (4, 4) camera to world, from tracks whose points are known.

    None is returned if too few tracks agree.
    """
    has_point, world = points_of_tracks(observations, points)
    if len(has_point) < MAPPING.min_observations:
        return None
    estimation = pycolmap().AbsolutePoseEstimationOptions()
    estimation.ransac.max_error = MAPPING.max_pose_error
    estimation.ransac.random_seed = 0
    refinement = pycolmap().AbsolutePoseRefinementOptions()
    refinement.loss_function_scale = MAPPING.outlier_pixels
    refinement.gradient_tolerance = MAPPING.pose_tolerance
    estimate = pycolmap().estimate_and_refine_absolute_pose(
        observations.points[has_point] + PIXEL_CENTRE,
        world,
        colmap_camera(camera, shape),
        estimation,
        refinement,
    )
    min_inliers = max(MAPPING.min_observations, MAPPING.min_inlier_share * len(has_point))
    if estimate is None or estimate["num_inliers"] < min_inliers:
        return None
    return _pose_matrix(estimate["cam_from_world"])


def _model_of_reconstruction(reconstruction: Any, views: Sequence[View]) -> Model:
    poses: dict[int, np.ndarray] = {}
    points: dict[int, np.ndarray] = {}
    for number, image in reconstruction.images.items():
        if not image.has_pose:
            continue
        poses[views[number - 1].frame] = _pose_matrix(image.cam_from_world())
    # A track may be split into several points: the point with most observations counts.
    for point in sorted(reconstruction.points3D.values(), key=lambda point: point.track.length()):
        for element in point.track.elements:
            tracks = views[element.image_id - 1].observations.tracks
            if element.point2D_idx < len(tracks):
                points[int(tracks[element.point2D_idx])] = np.array(point.xyz)
    return Model(poses=dict(sorted(poses.items())), points=TrackPoints.from_mapping(points))


def _add_track_points(
    model: Model, views: Sequence[View], camera: Camera, shape: tuple[int, int]
) -> Model:
    """Add the points of the tracks that the adjustment did not use."""
    tracks = [view.observations for view in views if view.frame in model.poses]
    poses = {k: model.poses[frame] for k, frame in enumerate(sorted(model.poses))}
    return replace(model, points=triangulate_tracks(tracks, poses, camera, shape) | model.points)


def _pose_matrix(cam_from_world: Any) -> np.ndarray:
    """Return the (4, 4) matrix camera to world."""
    return np.vstack([cam_from_world.inverse().matrix(), [0, 0, 0, 1]])
