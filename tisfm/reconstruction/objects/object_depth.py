"""The moving objects of a sequence: their paths, and their depth within the depth of the frames."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from tisfm.reconstruction.frames.prepared_frames import PreparedFrames
from tisfm.reconstruction.objects.object_path import ObjectPath, find_object_path
from tisfm.reconstruction.objects.object_scale import find_object_scale, reach
from tisfm.reconstruction.result.folder import depth_path, read_depth, write_depth
from tisfm.reconstruction.result.moving_object import MovingObject, ScaleFrom, seen_objects
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

    def at_rest(frame: int) -> np.ndarray:
        return read_depth(folder, frame, frames.shape)[0]

    known = piece[piece >= 0]
    largest = int(np.bincount(known).argmax()) if len(known) else 0
    world = np.where((piece == largest)[:, None, None], poses, np.nan)
    found = []
    for obj in seen_objects(len(poses), frames.labels):
        found_path = find_object_path(obj, frames, frames.labels, settings, with_depth=with_depth)
        if isinstance(found_path, str):
            found.append(replace(obj, message=found_path))
            continue
        in_world = {
            number: pose
            for number, pose in found_path.piece.poses.items()
            if np.isfinite(world[found_path.frames[number]]).all()
        }
        if not in_world:
            found.append(replace(obj, message=NO_PATH))
            continue
        found_path = replace(
            found_path,
            piece=replace(found_path.piece, poses=in_world),
            depths=[depth for depth in found_path.depths if depth.frame in in_world],
        )
        size = (sizes or {}).get(obj.id)
        scale, scale_from = find_object_scale(found_path, obj.id, at_rest, frames.labels, size)
        found.append(place_object(obj, found_path, world, scale, scale_from))
        for depth in found_path.depths:
            frame = found_path.frames[depth.frame]
            if not depth_path(folder, frame).exists():
                continue
            mine = (frames.labels(frame) == obj.id) & np.isfinite(depth.inverse_depth)
            inverse_depth, deviation = read_depth(folder, frame, frames.shape)
            inverse_depth[mine] = depth.inverse_depth[mine] / scale
            deviation[mine] = depth.deviation[mine] / scale
            write_depth(folder, frame, inverse_depth, deviation)
    return tuple(found)


def place_object(
    obj: MovingObject,
    found_path: ObjectPath,
    poses: np.ndarray,  # (N, 4, 4) array: poses of the camera, camera to world
    scale: float,  # length of the unit of `found_path`, in the unit of the world
    scale_from: ScaleFrom,
) -> MovingObject:
    """Return an object with its path in the world."""
    points = found_path.points()
    moved = np.eye(4)
    moved[:3, 3] = -np.median(points, axis=0)
    at = {frame: k for k, frame in enumerate(obj.frames)}
    found = obj.poses.copy()
    for number, pose in found_path.piece.poses.items():
        frame = found_path.frames[number]
        own_to_camera = np.linalg.inv(moved @ pose)  # pose of the object, in the unit of found_path
        own_to_camera[:3, 3] *= scale
        found[at[frame]] = poses[frame] @ own_to_camera
    return replace(obj, poses=found, extent=scale * reach(points), scale_from=scale_from)
