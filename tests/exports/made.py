"""Folders of results that are made up, not found."""

import cv2
import numpy as np

import tisfm
from tests.trajectory.paths import random_path
from tisfm.reconstruction.result.folder import (
    DEPTH,
    PICTURES,
    write_depth,
    write_labels,
    write_record,
)
from tisfm.reconstruction.result.moving_object import MovingObject
from tisfm.status import Status

SHAPE = (31, 45)  # odd
CAMERA = tisfm.Camera(40.0)


def ramp(frame, shape=SHAPE):
    """Return the inverse depth of a frame: near on the right, with a hole, and some behind."""
    height, width = shape
    across = np.linspace(0.2, 1.0, width, dtype=np.float32)
    inverse_depth = np.tile(across * np.float32(1 + 0.1 * frame), (height, 1))
    inverse_depth[3:6, 10:14] = np.nan
    return inverse_depth


def picture(frame, shape=SHAPE):
    """Return a smooth picture in colours."""
    y, x = np.mgrid[: shape[0], : shape[1]]
    waves = [np.sin(0.3 * x + 0.2 * y * k + frame) for k in range(3)]
    return np.uint8(128 + 100 * np.stack(waves, axis=-1))


def made(
    folder,
    *,
    count=6,
    piece=None,
    times=None,
    with_depth=None,
    camera=CAMERA,
    shape=SHAPE,
    poses=None,
    names=None,
    labelled=False,
):
    """Write a reconstruction into a folder, and return it as it is read."""
    (folder / DEPTH).mkdir(parents=True)
    (folder / PICTURES).mkdir()
    piece = np.zeros(count, np.int32) if piece is None else np.array(piece, np.int32)
    if poses is None:
        poses = random_path(np.random.default_rng(0), count)
    poses = np.where((piece < 0)[:, None, None], np.nan, poses)
    with_depth = range(count) if with_depth is None else with_depth
    objects = ()
    if labelled:
        objects = (
            MovingObject(
                id=2,
                frames=(1,),
                boxes=np.array([[4, 5, 6, 7]], np.int32),
                poses=np.full((1, 4, 4), np.nan),
                extent=np.full(3, np.nan),
            ),
        )
    for frame in range(count):
        if frame in with_depth:
            write_depth(folder, frame, ramp(frame, shape), 0.01 * ramp(frame, shape))
        bgr = cv2.cvtColor(picture(frame, shape), cv2.COLOR_RGB2BGR)
        cv2.imwrite(str(folder / PICTURES / f"{frame:06d}.jpg"), bgr)
        if labelled:
            labels = np.zeros(shape, np.uint8)
            labels[5:12, 4:10] = 2 * (frame == 1)
            write_labels(folder, frame, labels)
    motion = "objects" if labelled else "camera"
    result = tisfm.Reconstruction(
        poses=poses,
        piece=piece,
        unit=(1.0,) * (int(piece.max()) + 1),
        position_deviation=np.full((count, 3), 0.01),
        rotation_deviation=np.full((count, 3), 0.1),
        status=(Status("converged", ""),) * count,
        depth_error=np.where(np.isin(np.arange(count), list(with_depth)), 0.0067, np.nan),
        depth_share=np.isin(np.arange(count), list(with_depth)).astype(float),
        keyframes=tuple(frame for frame in with_depth if piece[frame] >= 0),
        camera=camera,
        settings=tisfm.Settings.preset("fast", motion=motion),
        names=tuple(f"f{k}" for k in range(count)) if names is None else names,
        times=(None,) * count if times is None else times,
        shape=shape,
        folder=folder,
        version=tisfm.__version__,
        objects=objects,
    )
    write_record(folder, result)
    return tisfm.Reconstruction.load(folder)
