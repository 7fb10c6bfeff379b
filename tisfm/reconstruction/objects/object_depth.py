"""Moving objects in the world: the scale, the path and the depth of each.

The motion of an object gives its path in an arbitrary unit. The scale is the factor from this unit
to the unit of the world. The scale comes from a known size, or from the contact of the object with
the ground, or, roughly, from the depth around the object. An object without a path has the depth of
the place where it stands.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from tisfm.motion.objects.depth import contact_scale
from tisfm.reconstruction.frames.prepared_frames import PreparedFrames
from tisfm.reconstruction.objects.object_path import ObjectPath, find_object_path
from tisfm.reconstruction.objects.settings import OBJECTS
from tisfm.reconstruction.objects.standing_depth import (
    StandingDepth,
    find_standing_depths,
    measure_objects,
)
from tisfm.reconstruction.result.folder import depth_path, read_depth, write_depth
from tisfm.reconstruction.result.moving_object import MovingObject, ScaleFrom, labelled_objects
from tisfm.settings import Settings

STANDING_MESSAGES = {
    "contact": "its depth is that of the place where it stands",
    "around": "its depth is roughly that of its surroundings",
    "size": "its depth follows from its size",
}
NO_PATH = "the camera has no pose in its frames, or none in the largest piece of the path"


def find_object_scale(
    path: ObjectPath,
    object_id: int,  # label of the object
    # returns the static inverse depth of a frame, (H, W), 1/unit of the world
    static_depth: Callable[[int], np.ndarray],
    labels_of: Callable[[int], np.ndarray],  # returns the labels of a frame, (H, W)
    # known length of the object, as `longest_side` measures it, in the unit of the world
    size: float | None = None,
) -> tuple[float, ScaleFrom]:
    """Return the scale of an object, and the source of the scale."""
    if size is not None:
        box_length = longest_side(path.points())
        return (size / box_length, "size") if box_length > 0 else (1.0, "none")
    contact_scales, ring_scales = [], []
    for depth in path.depths:
        frame = path.frames[depth.frame]
        background, labels = static_depth(frame), labels_of(frame)
        object_pixels = labels == object_id
        valid = object_pixels & np.isfinite(depth.deviation) & (depth.inverse_depth > 0)
        if not valid.any() or not np.isfinite(background).any():
            continue
        depth_map = np.where(object_pixels, depth.inverse_depth, background).astype(np.float32)
        depth_ratio = contact_scale(depth_map, labels, object_pixels & ~valid, object_id)
        if depth_ratio is not None:  # inverse depth of the background / that of the object
            contact_scales.append(1 / depth_ratio)
        window = np.ones((2 * OBJECTS.ring_width + 1,) * 2, np.uint8)
        ring = (cv2.dilate(np.uint8(object_pixels), window) > 0) & (labels == 0) & (background > 0)
        if ring.any():
            # The object occludes its surroundings. So it is at least as near as their nearest part.
            nearest = np.quantile(background[ring], OBJECTS.nearest_quantile)
            ring_scales.append(float(np.median(depth.inverse_depth[valid]) / nearest))
    if len(contact_scales) >= max(2, len(path.depths) / 4):
        return float(np.median(contact_scales)), "contact"
    if ring_scales:
        return float(np.median(ring_scales)), "around"
    return 1.0, "none"


def trimmed_extent(points: np.ndarray) -> np.ndarray:
    """Return the extent of points, (N, 3), along each axis, (3,), without the outermost points."""
    low, high = np.quantile(points, [OBJECTS.trimmed_share, 1 - OBJECTS.trimmed_share], axis=0)
    return np.asarray(high - low)


def longest_side(points: np.ndarray) -> float:
    """Return the longest side of the box with the least surface around points, (N, 3).

    `trimmed_extent` measures the sides. They do not depend on the orientation of the points.
    """
    sample = points[:: 1 + len(points) // OBJECTS.max_box_points]
    random = np.random.default_rng(0)
    rotations = Rotation.from_quat(random.normal(size=(OBJECTS.box_trials, 4))).as_matrix()
    extents = np.stack([trimmed_extent(sample @ rotation) for rotation in rotations])
    areas = (extents * np.roll(extents, 1, axis=1)).sum(axis=1)
    return float(extents[areas.argmin()].max())


def objects_with_depth(
    frames: PreparedFrames,  # with labels
    folder: Path,  # the folder of the depth files
    poses: np.ndarray,  # (N, 4, 4) array: camera to world; NaN for a frame without a pose
    # (N,) int array: the piece of the camera path that has each frame; −1 for none. Objects get
    # poses in the largest piece.
    piece: np.ndarray,
    settings: Settings,
    *,
    with_depth: bool = True,  # whether depth is computed in addition to paths
    # known lengths of objects by their ids, in the unit of the poses
    sizes: Mapping[int, float] | None = None,
    given_labels: Collection[int] = (),  # frames whose labels the user gave
) -> tuple[MovingObject, ...]:
    """Return the moving objects. Their depth is written into the depth files of the frames.

    In frames in which its motion shows no depth, an object gets the depth of the place where it
    stands.
    """

    def static_depth(frame: int) -> np.ndarray:
        return read_depth(folder, frame, frames.shape)[0]

    is_largest = piece == _find_largest_piece(piece)
    world_poses = np.where(is_largest[:, None, None], poses, np.nan)
    moving_objects = []
    without_depth: dict[int, set[int]] = {}  # frames of each object, by its id
    for obj in labelled_objects(len(poses), frames.labels):
        without_depth[obj.id] = set(obj.frames)
        path = find_object_path(obj, frames, settings, with_depth=with_depth)
        if isinstance(path, str):
            moving_objects.append(replace(obj, message=path))
            continue
        has_pose = np.asarray(np.isfinite(world_poses[path.frames]).all(axis=(1, 2)))
        object_poses = {k: pose for k, pose in path.model.poses.items() if has_pose[k]}
        if not object_poses:
            moving_objects.append(replace(obj, message=NO_PATH))
            continue
        depths = [depth for depth in path.depths if depth.frame in object_poses]
        path = replace(path, model=replace(path.model, poses=object_poses), depths=depths)
        size = (sizes or {}).get(obj.id)
        scale, scale_from = find_object_scale(path, obj.id, static_depth, frames.labels, size)
        moving_objects.append(with_world_path(obj, path, world_poses, scale, scale_from))
        for depth in path.depths:
            frame = path.frames[depth.frame]
            if not depth_path(folder, frame).exists():
                continue
            object_pixels = (frames.labels(frame) == obj.id) & np.isfinite(depth.inverse_depth)
            inverse_depth, deviation = read_depth(folder, frame, frames.shape)
            inverse_depth[object_pixels] = depth.inverse_depth[object_pixels] / scale
            deviation[object_pixels] = depth.deviation[object_pixels] / scale
            write_depth(folder, frame, inverse_depth, deviation)
            if object_pixels.any() and scale_from != "none":
                without_depth[obj.id].discard(frame)
    if not with_depth:
        return tuple(moving_objects)
    standing_depths = _find_standing_depths(
        frames, folder, piece, moving_objects, without_depth, sizes or {}, given_labels
    )
    _write_standing_depths(frames, folder, standing_depths, without_depth)
    return tuple(
        _with_standing_depth(obj, standing_depths.get(obj.id, [])) for obj in moving_objects
    )


def _find_standing_depths(
    frames: PreparedFrames,
    folder: Path,
    piece: np.ndarray,  # (N,) int
    objects: Sequence[MovingObject],
    without_depth: Mapping[int, set[int]],  # frames of each object, by its id
    sizes: Mapping[int, float],
    given_labels: Collection[int],
) -> dict[int, list[StandingDepth]]:
    """Return the depth from the places where they stand of objects that lack depth, by id."""

    def static_depth(frame: int) -> tuple[np.ndarray, np.ndarray] | None:
        is_written = depth_path(folder, frame).exists()
        return read_depth(folder, frame, frames.shape) if is_written else None

    lacking = [obj for obj in objects if without_depth[obj.id]]
    focal = frames.camera.focal
    return find_standing_depths(
        measure_objects(lacking, focal, static_depth, frames.labels),
        piece,
        focal,
        sizes=sizes,
        largest_piece=_find_largest_piece(piece),
        given_labels=given_labels,
    )


def _find_largest_piece(piece: np.ndarray) -> int:
    """Return the piece, (N,) int, that has most frames; 0 without a piece."""
    known = piece[piece >= 0]
    return int(np.bincount(known).argmax()) if len(known) else 0


def _write_standing_depths(
    frames: PreparedFrames,
    folder: Path,
    standing_depths: Mapping[int, Sequence[StandingDepth]],  # by object id
    without_depth: Mapping[int, set[int]],  # frames of each object, by its id
) -> None:
    """Write depth from the places where objects stand into the frames that lack it."""
    by_frame: dict[int, dict[int, tuple[float, float]]] = {}
    for object_id, depths in standing_depths.items():
        for depth in depths:
            for frame, *values in zip(
                depth.frames, depth.inverse_depth, depth.deviation, strict=True
            ):
                if frame in without_depth[object_id] and depth_path(folder, frame).exists():
                    by_frame.setdefault(frame, {})[object_id] = (values[0], values[1])
    for frame, of_objects in by_frame.items():
        inverse_depth, deviation = read_depth(folder, frame, frames.shape)
        labels = frames.labels(frame)
        for object_id, (value, value_deviation) in of_objects.items():
            inverse_depth[labels == object_id] = value
            deviation[labels == object_id] = value_deviation
        write_depth(folder, frame, inverse_depth, deviation)


def _with_standing_depth(obj: MovingObject, depths: Sequence[StandingDepth]) -> MovingObject:
    """Return an object without poses with the source of its depth; others stay as they are."""
    if not depths or np.isfinite(obj.poses).any():
        return obj
    longest = max(depths, key=lambda depth: len(depth.frames))
    parts = [obj.message, STANDING_MESSAGES[longest.scale_from]]
    return replace(obj, scale_from=longest.scale_from, message="; ".join(filter(None, parts)))


def with_world_path(
    obj: MovingObject,
    path: ObjectPath,
    poses: np.ndarray,  # (N, 4, 4) array: poses of the camera, camera to world
    scale: float,  # length of the unit of `path`, in the unit of the world
    scale_from: ScaleFrom,
) -> MovingObject:
    """Return an object with its path and its extent in the world."""
    points = path.points()
    center_shift = np.eye(4)
    center_shift[:3, 3] = -np.median(points, axis=0)
    frame_indices = {frame: k for k, frame in enumerate(obj.frames)}
    object_poses = obj.poses.copy()
    for number, pose in path.model.poses.items():
        frame = path.frames[number]
        object_to_camera = np.linalg.inv(center_shift @ pose)  # in the unit of `path`
        object_to_camera[:3, 3] *= scale
        object_poses[frame_indices[frame]] = poses[frame] @ object_to_camera
    extent = scale * trimmed_extent(points)
    return replace(obj, poses=object_poses, extent=extent, scale_from=scale_from)
