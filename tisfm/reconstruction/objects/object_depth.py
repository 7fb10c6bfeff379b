"""The moving objects of a sequence: their paths, and their depth within the depth of the frames."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from tisfm.reconstruction.frames.prepared_frames import PreparedFrames
from tisfm.reconstruction.objects.object_path import ObjectPath, find_object_path
from tisfm.reconstruction.objects.object_scale import find_object_scale, trimmed_extent
from tisfm.reconstruction.result.folder import depth_path, read_depth, write_depth
from tisfm.reconstruction.result.moving_object import MovingObject, ScaleFrom, labelled_objects
from tisfm.settings import Settings

NO_PATH = "the camera has no path where it is seen, or another one than the longest"


def objects_with_depth(
    frames: PreparedFrames,  # with labels
    folder: Path,  # the folder of the depth files
    poses: np.ndarray,  # (N, 4, 4) array: camera to world; NaN for a frame without a pose
    # (N,) int array: the piece of each frame; −1 for none. Objects are placed in the largest piece.
    piece: np.ndarray,
    settings: Settings,
    *,
    with_depth: bool = True,  # whether depth is found in addition to paths
    # known lengths of objects by their ids, in the unit of the poses
    sizes: Mapping[int, float] | None = None,
) -> tuple[MovingObject, ...]:
    """Return the moving objects. Their depth is written into the depth files of the frames."""

    def static_depth(frame: int) -> np.ndarray:
        return read_depth(folder, frame, frames.shape)[0]

    valid = piece[piece >= 0]
    largest = int(np.bincount(valid).argmax()) if len(valid) else 0
    world = np.where((piece == largest)[:, None, None], poses, np.nan)
    result = []
    for obj in labelled_objects(len(poses), frames.labels):
        path = find_object_path(obj, frames, frames.labels, settings, with_depth=with_depth)
        if isinstance(path, str):
            result.append(replace(obj, message=path))
            continue
        poses_in_world = {
            number: pose
            for number, pose in path.piece.poses.items()
            if np.isfinite(world[path.frames[number]]).all()
        }
        if not poses_in_world:
            result.append(replace(obj, message=NO_PATH))
            continue
        path = replace(
            path,
            piece=replace(path.piece, poses=poses_in_world),
            depths=[depth for depth in path.depths if depth.frame in poses_in_world],
        )
        size = (sizes or {}).get(obj.id)
        scale, scale_from = find_object_scale(path, obj.id, static_depth, frames.labels, size)
        result.append(with_world_path(obj, path, world, scale, scale_from))
        for depth in path.depths:
            frame = path.frames[depth.frame]
            if not depth_path(folder, frame).exists():
                continue
            object_pixels = (frames.labels(frame) == obj.id) & np.isfinite(depth.inverse_depth)
            inverse_depth, deviation = read_depth(folder, frame, frames.shape)
            inverse_depth[object_pixels] = depth.inverse_depth[object_pixels] / scale
            deviation[object_pixels] = depth.deviation[object_pixels] / scale
            write_depth(folder, frame, inverse_depth, deviation)
    return tuple(result)


def with_world_path(
    obj: MovingObject,
    path: ObjectPath,
    poses: np.ndarray,  # (N, 4, 4) array: poses of the camera, camera to world
    scale: float,  # length of the unit of `path`, in the unit of the world
    scale_from: ScaleFrom,
) -> MovingObject:
    """Return an object with its path in the world."""
    points = path.points()
    centering = np.eye(4)
    centering[:3, 3] = -np.median(points, axis=0)
    indices = {frame: k for k, frame in enumerate(obj.frames)}
    object_poses = obj.poses.copy()
    for number, pose in path.piece.poses.items():
        frame = path.frames[number]
        object_to_camera = np.linalg.inv(
            centering @ pose
        )  # pose of the object, in the unit of `path`
        object_to_camera[:3, 3] *= scale
        object_poses[indices[frame]] = poses[frame] @ object_to_camera
    return replace(
        obj, poses=object_poses, extent=scale * trimmed_extent(points), scale_from=scale_from
    )
