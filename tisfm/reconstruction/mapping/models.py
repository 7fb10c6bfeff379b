"""Poses and points from matches of views, found and adjusted by pycolmap.

pycolmap runs with one thread and fixed seeds: the same input gives the same bits.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tisfm.camera import Camera
from tisfm.reconstruction.mapping.database import (
    MIN_SHARED,
    PIXEL_CENTRE,
    Directions,
    colmap_camera,
    database_of,
    pairs_of,
    pycolmap,
)
from tisfm.reconstruction.mapping.incremental import (
    MAX_POSE_ERROR,
    MIN_INLIER_SHARE,
    OUTLIER_PIXELS,
    grow_from_poses,
    grow_models,
    shows_parallax,
)
from tisfm.reconstruction.mapping.model_scores import Coverage, MatchScore
from tisfm.reconstruction.result.calibration import Calibrate
from tisfm.reconstruction.tracks.tracker import Observations
from tisfm.reconstruction.tracks.triangulation import (
    TrackPoints,
    points_of_tracks,
    triangulate_tracks,
)
from tisfm.reconstruction.tracks.views import View, choose_long_tracks

# Share of the area of the frames: models that explain at least this show the static scene. Set by
# hand.
MIN_COVERAGE = 0.75


@dataclass(frozen=True, kw_only=True)
class Model:
    """Views and points in one coordinate system."""

    poses: dict[int, np.ndarray]  # dict of int to (4, 4) float64: camera to world, by frame
    points: TrackPoints  # positions of tracks, in the world
    # How well the model explains the matches of its views (`MatchScore`). It is 0 for a model from
    # submaps and for a continued model.
    score: float = 0.0


@dataclass(frozen=True, kw_only=True)
class ViewGraph:
    """Views with their tracks and matches, from which models are built."""

    views: list[View]  # views with their longest tracks
    # dict of (int, int) to (N, 2) int32: for pairs of indices of views: indices of matching points
    pairs: dict[tuple[int, int], np.ndarray]
    shape: tuple[int, int]  # height and width of the frames, px
    focal_known: bool = True  # whether the focal length is known, or is a guess

    @classmethod
    def of(
        cls,
        views: Sequence[View],
        matches: Mapping[tuple[int, int], np.ndarray],
        shape: tuple[int, int],
        *,
        focal_known: bool = True,
    ) -> "ViewGraph":
        """Return the graph of views; arguments are those of `find_models`."""
        kept = choose_long_tracks([view.observations for view in views], max(shape))
        few = [replace(view, observations=seen) for view, seen in zip(views, kept, strict=True)]
        return cls(views=few, pairs=pairs_of(few, matches), shape=shape, focal_known=focal_known)

    def part(self, first: int, last: int) -> "ViewGraph":
        """Return the graph of the views from `first` to before `last`."""
        inside = range(first, last)
        pairs = {
            (one - first, other - first): both
            for (one, other), both in self.pairs.items()
            if one in inside and other in inside
        }
        return replace(self, views=self.views[first:last], pairs=pairs)

    def grow_models(self, camera: Camera, calibrate: Calibrate = "nothing") -> list[Any]:
        """Return pycolmap's reconstructions, the largest first.

        Each has the focal length of the camera, or its own estimate, and maybe a radial
        coefficient. Models may follow a moving object that has more points than the static scene.
        So if much of the area of the frames is unexplained, other models are built from the
        unexplained matches. They replace the first models if they explain more area.
        """
        found = self._grown(self.pairs, camera, calibrate)
        cover = Coverage(self.views, self.pairs, self.shape)
        explained = cover.explained(found)
        while found and cover.share(explained) < MIN_COVERAGE:
            rest = {**self.pairs, **{pair: self.pairs[pair][~e] for pair, e in explained.items()}}
            rest = {pair: both for pair, both in rest.items() if len(both) >= MIN_SHARED}
            others = self._grown(rest, camera, calibrate)
            by_others = cover.explained(others)
            if cover.share(by_others) <= cover.share(explained):
                break
            found, explained = others, by_others
        return found

    def _grown(
        self, pairs: Mapping[tuple[int, int], np.ndarray], camera: Camera, calibrate: Calibrate
    ) -> list[Any]:
        known = colmap_camera(camera, self.shape, calibrate)
        directions = Directions(self.views, pairs, camera, self.shape)
        with database_of(self.views, pairs, known) as database:
            return grow_models(
                database,
                directions,
                len(self.views),
                MatchScore(self.views, pairs, self.shape),
                calibrate,
                focal_known=self.focal_known,
            )

    def shows_parallax(self, camera: Camera) -> bool:
        """Return whether enough pairs of views show parallax with the focal length of a camera."""
        directions = Directions(self.views, self.pairs, camera, self.shape)
        with database_of(self.views, self.pairs, colmap_camera(camera, self.shape)) as database:
            return shows_parallax(database, directions)

    def score(self, reconstructions: Sequence[Any]) -> float:
        """Return how well pycolmap's reconstructions explain the matches: their mean score."""
        score = MatchScore(self.views, self.pairs, self.shape)
        return sum(map(score.score, reconstructions)) / max(score.matches(), 1)

    def matches(self) -> int:
        """Return the number of matches."""
        return sum(map(len, self.pairs.values()))

    def continue_model(self, camera: Camera, known: Mapping[int, np.ndarray]) -> Any:
        """Return pycolmap's reconstruction, continued from fixed known poses, by frame."""
        matrices = {
            number: np.linalg.inv(known[view.frame])[:3]
            for number, view in enumerate(self.views, start=1)
            if view.frame in known
        }
        known_camera = colmap_camera(camera, self.shape)
        with database_of(self.views, self.pairs, known_camera) as database:
            return grow_from_poses(database, matrices)

    def models(
        self, reconstructions: Sequence[Any], views: Sequence[View], camera: Camera
    ) -> list[Model]:
        """Return models of pycolmap's reconstructions, with points of all tracks of the views."""
        models = [self.model(one) for one in reconstructions]
        return [_with_others(model, views, camera, self.shape) for model in models]

    def model(self, reconstruction: Any) -> Model:
        """Return the model of a reconstruction, with the points of its adjusted tracks."""
        score = MatchScore(self.views, self.pairs, self.shape).score(reconstruction)
        return replace(_model(reconstruction, self.views), score=score)


def find_models(
    views: Sequence[View],  # in the order of their frames
    # mapping of (int, int) to (N, 2) int array: for pairs of indices of views, the smaller first:
    # indices of their detected points that match
    matches: Mapping[tuple[int, int], np.ndarray],
    camera: Camera,  # pinhole camera
    shape: tuple[int, int],  # height and width of the frames, px
    *,
    # Whether the focal length is known. If it is a guess, a path cannot begin where all matches lie
    # in one plane.
    focal_known: bool = True,
) -> list[Model]:  # The largest model first. Each view is in at most one model.
    """Find poses of views and points of tracks.

    References
    ----------
    Schönberger and Frahm, "Structure-from-motion revisited", CVPR 2016, doi 10.1109/CVPR.2016.445:
    incremental mapping, with pycolmap's steps.
    """
    shared = ViewGraph.of(views, matches, shape, focal_known=focal_known)
    return shared.models(shared.grow_models(camera), views, camera)


def continue_model(
    # views, matches, camera, shape: as for `find_models`
    views: Sequence[View],
    matches: Mapping[tuple[int, int], np.ndarray],
    camera: Camera,
    shape: tuple[int, int],
    # mapping of int to (4, 4) array: camera to world, by frame, for at least two views
    known: Mapping[int, np.ndarray],
) -> Model:  # in the axes and the unit of the known poses, with the known poses unchanged
    """Find poses of more views, and points; the known poses of some views are fixed."""
    shared = ViewGraph.of(views, matches, shape)
    model = _model(shared.continue_model(camera, known), shared.views)
    poses = {**model.poses, **{f: known[f] for f in known if f in model.poses}}
    return _with_others(Model(poses=poses, points=model.points), views, camera, shape)


def readjust_models(
    # views, matches, camera, shape: as for `find_models`
    views: Sequence[View],
    matches: Mapping[tuple[int, int], np.ndarray],
    camera: Camera,
    shape: tuple[int, int],
    # sequence of mapping of int to (4, 4) array: camera to world, by frame, for each model
    known: Sequence[Mapping[int, np.ndarray]],
) -> list[Model]:
    """Find poses of views and points of tracks, starting from approximate poses.

    Returns one model for each set of poses. A view without a pose joins the first model that it
    fits.
    """
    shared = ViewGraph.of(views, matches, shape)
    number = {view.frame: k for k, view in enumerate(views, start=1)}
    left = set(number.values()) - {number[frame] for poses in known for frame in poses}
    found = []
    with database_of(shared.views, shared.pairs, colmap_camera(camera, shape)) as database:
        for poses in known:
            matrices = {number[frame]: np.linalg.inv(pose)[:3] for frame, pose in poses.items()}
            model = grow_from_poses(database, matrices, fixed=False, left=left)
            left -= set(model.reg_image_ids())
            found.append(model)
    return [model for model in shared.models(found, views, camera) if model.poses]


def pose_from_points(
    seen: Observations, points: Mapping[int, np.ndarray], camera: Camera, shape: tuple[int, int]
) -> np.ndarray | None:
    """Return the pose of a frame, (4, 4) camera to world, from tracks whose points are known.

    None is returned if too few tracks agree.
    """
    known, world = points_of_tracks(seen, points)
    if len(known) < MIN_SHARED:
        return None
    estimation = pycolmap().AbsolutePoseEstimationOptions()
    estimation.ransac.max_error = MAX_POSE_ERROR
    estimation.ransac.random_seed = 0
    refinement = pycolmap().AbsolutePoseRefinementOptions()
    refinement.loss_function_scale = OUTLIER_PIXELS
    refinement.gradient_tolerance = 1e-4
    found = pycolmap().estimate_and_refine_absolute_pose(
        seen.points[known] + PIXEL_CENTRE,
        world,
        colmap_camera(camera, shape),
        estimation,
        refinement,
    )
    if found is None or found["num_inliers"] < max(MIN_SHARED, MIN_INLIER_SHARE * len(known)):
        return None
    return _matrix(found["cam_from_world"])


def _model(reconstruction: Any, views: Sequence[View]) -> Model:
    poses: dict[int, np.ndarray] = {}
    points: dict[int, np.ndarray] = {}
    for number, image in reconstruction.images.items():
        if not image.has_pose:
            continue
        poses[views[number - 1].frame] = _matrix(image.cam_from_world())
    # A track may be split into several points: the point with most observations counts.
    for point in sorted(reconstruction.points3D.values(), key=lambda point: point.track.length()):
        for element in point.track.elements:
            tracks = views[element.image_id - 1].observations.tracks
            if element.point2D_idx < len(tracks):
                points[int(tracks[element.point2D_idx])] = np.array(point.xyz)
    return Model(poses=dict(sorted(poses.items())), points=TrackPoints.of(points))


def _with_others(
    model: Model, views: Sequence[View], camera: Camera, shape: tuple[int, int]
) -> Model:
    """Add the points of the tracks that the adjustment did not use."""
    seen = [view.observations for view in views if view.frame in model.poses]
    poses = {k: model.poses[frame] for k, frame in enumerate(sorted(model.poses))}
    return replace(model, points=triangulate_tracks(seen, poses, camera, shape) | model.points)


def _matrix(cam_from_world: Any) -> np.ndarray:
    """Return the (4, 4) matrix camera to world."""
    return np.vstack([cam_from_world.inverse().matrix(), [0, 0, 0, 1]])
