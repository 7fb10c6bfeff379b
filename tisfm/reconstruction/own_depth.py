"""The things of a sequence: each with its path, and its depth in that of the frames."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from tisfm.reconstruction.folder import depth_path, read_depth, write_depth
from tisfm.reconstruction.frames import PreparedFrames
from tisfm.reconstruction.moving_object import MovingObject, seen_objects
from tisfm.reconstruction.own_path import own_path, placed
from tisfm.settings import Settings


def objects_with_depth(
    frames: PreparedFrames,
    folder: Path,
    poses: np.ndarray,
    piece: np.ndarray,
    settings: Settings,
    *,
    with_depth: bool = True,
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
    """

    def at_rest(frame: int) -> np.ndarray:
        return read_depth(folder, frame, frames.shape)[0]

    known = piece[piece >= 0]
    largest = int(np.bincount(known).argmax()) if len(known) else 0
    world = np.where((piece == largest)[:, None, None], poses, np.nan)
    found = []
    for thing in seen_objects(len(poses), frames.labels):
        own = own_path(thing, frames, frames.labels, settings, with_depth=with_depth)
        if isinstance(own, str):
            found.append(replace(thing, message=own))
            continue
        thing, scale = placed(thing, own, world, at_rest, frames.labels)
        found.append(thing)
        for depth in own.depths:
            frame = own.frames[depth.frame]
            if piece[frame] != largest or not depth_path(folder, frame).exists():
                continue
            mine = (frames.labels(frame) == thing.id) & np.isfinite(depth.inverse_depth)
            inverse_depth, deviation = read_depth(folder, frame, frames.shape)
            inverse_depth[mine] = depth.inverse_depth[mine] / scale
            deviation[mine] = depth.deviation[mine] / scale
            write_depth(folder, frame, inverse_depth, deviation)
    return tuple(found)
