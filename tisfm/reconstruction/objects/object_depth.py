"""The things of a sequence: each with its path, and its depth in that of the frames."""

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
    frames: PreparedFrames,
    folder: Path,
    poses: np.ndarray,
    piece: np.ndarray,
    settings: Settings,
    *,
    with_depth: bool = True,
    sizes: Mapping[int, float] | None = None,
) -> tuple[MovingObject, ...]:
    """Return the things that move on their own; their depth is written into that of frames.

    Parameters
    ----------
    frames : PreparedFrames
        With labels.
    folder : Path
        Where depth lies.
    poses : (N, 4, 4) array
        Camera to world; NaN for a frame without one.
    piece : (N,) int array
        That a frame belongs to; −1 for none. Things are placed in the largest.
    settings : Settings
    with_depth : bool
        Or the paths alone.
    sizes : mapping of int to float, optional
        Lengths of things by their ids, in the unit of the poses, where they are known.
    """

    def at_rest(frame: int) -> np.ndarray:
        return read_depth(folder, frame, frames.shape)[0]

    known = piece[piece >= 0]
    largest = int(np.bincount(known).argmax()) if len(known) else 0
    world = np.where((piece == largest)[:, None, None], poses, np.nan)
    found = []
    for thing in seen_objects(len(poses), frames.labels):
        own = find_object_path(thing, frames, frames.labels, settings, with_depth=with_depth)
        if isinstance(own, str):
            found.append(replace(thing, message=own))
            continue
        in_world = {
            number: pose
            for number, pose in own.piece.poses.items()
            if np.isfinite(world[own.frames[number]]).all()
        }
        if not in_world:
            found.append(replace(thing, message=NO_PATH))
            continue
        own = replace(
            own,
            piece=replace(own.piece, poses=in_world),
            depths=[depth for depth in own.depths if depth.frame in in_world],
        )
        size = (sizes or {}).get(thing.id)
        scale, scale_from = find_object_scale(own, thing.id, at_rest, frames.labels, size)
        found.append(placed(thing, own, world, scale, scale_from))
        for depth in own.depths:
            frame = own.frames[depth.frame]
            if not depth_path(folder, frame).exists():
                continue
            mine = (frames.labels(frame) == thing.id) & np.isfinite(depth.inverse_depth)
            inverse_depth, deviation = read_depth(folder, frame, frames.shape)
            inverse_depth[mine] = depth.inverse_depth[mine] / scale
            deviation[mine] = depth.deviation[mine] / scale
            write_depth(folder, frame, inverse_depth, deviation)
    return tuple(found)


def placed(
    thing: MovingObject, own: ObjectPath, poses: np.ndarray, scale: float, scale_from: ScaleFrom
) -> MovingObject:
    """Return a thing with its path in the world.

    Parameters
    ----------
    thing : MovingObject
    own : ObjectPath
    poses : (N, 4, 4) array
        Of the camera, camera to world.
    scale : float
        What its own unit is in the world's.
    scale_from : {"size", "contact", "around", "none"}
    """
    points = own.points()
    moved = np.eye(4)
    moved[:3, 3] = -np.median(points, axis=0)
    at = {frame: k for k, frame in enumerate(thing.frames)}
    found = thing.poses.copy()
    for number, pose in own.piece.poses.items():
        frame = own.frames[number]
        own_to_camera = np.linalg.inv(moved @ pose)  # of the object, in its own unit
        own_to_camera[:3, 3] *= scale
        found[at[frame]] = poses[frame] @ own_to_camera
    return replace(thing, poses=found, extent=scale * reach(points), scale_from=scale_from)
