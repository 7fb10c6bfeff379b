"""Results to look at: a reconstruction with exact truth, and runs."""

import json
from pathlib import Path

import cv2
import numpy as np

import tisfm
from tests.reconstruction.films import along
from tests.rendered import room_film
from tisfm.folders.run_record import FORMAT
from tisfm.reconstruction.result.folder import PICTURES, write_depth, write_labels, write_record
from tisfm.reconstruction.result.moving_object import MovingObject
from tisfm.reconstruction.result.reconstruction import Reconstruction
from tisfm.status import Status

HEIGHT, WIDTH = 45, 61
DEVIATION = 0.02  # of all depth, as a share


def film(count=5):
    """Return frames of a room, with exact depth and poses."""
    return room_film(along(count), HEIGHT, WIDTH, samples=1, noise=0)


def write_reconstruction(folder, count=5, *, changes=None, things=False):
    """Write a film as a reconstruction; return the film.

    The last frame but one has no pose if `changes` says so, and a thing may move through it.
    """
    shot = film(count)
    folder = Path(folder)
    for part in ("depth", PICTURES):
        (folder / part).mkdir(parents=True)
    for k in range(count):
        inverse = (1 / shot.depth[k]).astype(np.float32)
        write_depth(folder, k, inverse, DEVIATION * inverse)
        cv2.imwrite(str(folder / PICTURES / f"{k:06d}.jpg"), shot.frames[k])
        if things:
            labels = np.zeros((HEIGHT, WIDTH), np.uint8)
            labels[10:20, 10:20] = 2
            write_labels(folder, k, labels)
    given = {
        "poses": shot.poses,
        "piece": np.zeros(count, np.int32),
        "unit": (1.0,),
        "position_deviation": np.full((count, 3), 0.01),
        "rotation_deviation": np.full((count, 3), 0.1),
        "status": (Status("converged"),) * count,
        "keyframes": (0,),
        "camera": shot.camera,
        "settings": tisfm.Settings.preset("fast", motion="objects" if things else "camera"),
        "names": tuple(f"f{k}" for k in range(count)),
        "times": tuple(0.1 * k for k in range(count)),
        "shape": (HEIGHT, WIDTH),
        "folder": folder,
        "depth_error": np.full(count, 0.02),
        "depth_share": np.ones(count),
        "version": tisfm.__version__,
        "objects": (thing(count),) if things else (),
    }
    write_record(folder, Reconstruction(**{**given, **(changes or {})}))
    return shot


def thing(count):
    """A thing that goes to the right by 0.2 a frame."""
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, 0, 3] = 0.2 * np.arange(count)
    poses[:, 2, 3] = 2
    return MovingObject(
        id=2,
        frames=tuple(range(count)),
        boxes=np.tile(np.array([10, 10, 10, 10], np.int32), (count, 1)),
        poses=poses,
        extent=np.ones(3),
        scale_from="contact",
    )


def write_run(folder, count=4, *, motion="camera", start=0, with_poses=False):
    """Write a film as `tisfm run` would, pair by pair, with the true motion; return the film."""
    shot = film(count + 1)
    folder = Path(folder)
    folder.mkdir(exist_ok=True)
    for k in range(start, count):
        pair(shot, k, motion, with_poses=with_poses).save(folder / f"f{k}.npz", compact=True)
    write_record_of(folder, shot, range(count), motion, with_poses=with_poses)
    return shot


def pair(shot, k, motion, *, with_poses=False):
    """Return the true interpretation of a pair."""
    pose = np.linalg.inv(shot.poses[k + 1]) @ shot.poses[k]
    twist = tisfm.rigid.rigid_twist(pose[:3, :3], pose[:3, 3])
    length = float(np.linalg.norm(twist[:3]))
    twist[:3] /= length  # so it is also where poses are given, which depth has the unit of
    inverse = ((1.0 if with_poses else length) / shot.depth[k]).astype(np.float32)
    shape = inverse.shape
    rho = np.empty((6, *shape), np.float32)
    rho[:3] = shot.camera.focal * twist[:3, None, None] * length / shot.depth[k]
    rho[3:] = shot.camera.focal * twist[3:, None, None]
    occlusion = np.zeros(shape, bool)
    occlusion[:, :3] = True
    confidence = np.tile(np.linspace(0, 1, shape[1], dtype=np.float32), (shape[0], 1))
    confidence[occlusion] = 0
    rigid = motion != "field"
    nothing = np.zeros(0)
    return tisfm.Interpretation(
        rho=rho,
        flow=np.full((*shape, 2), (2.0, -1.0), np.float32),
        inverse_depth=inverse,
        confidence=confidence,
        occlusion=occlusion,
        frame=shot.frames[k],
        camera=shot.camera,
        settings=tisfm.Settings.preset("fast", motion=motion),
        status=Status("converged", "it is well"),
        history=tisfm.status.History(
            level=nothing.astype(np.int32),
            warp=nothing.astype(np.int32),
            energy=nothing,
            half_quadratic=nothing,
            change=nothing,
        ),
        version=tisfm.__version__,
        inverse_depth_std=DEVIATION * inverse if rigid else None,
        motions=twist[None] if rigid else None,
        labels=np.zeros(shape, np.int32) if rigid else None,
    )


def rows_of(shot, k, with_poses):
    """Return the rows of (R | t) of a pair, as a record has them."""
    pose = np.linalg.inv(shot.poses[k + 1]) @ shot.poses[k]
    twist = tisfm.rigid.rigid_twist(pose[:3, :3], pose[:3, 3])
    if not with_poses:
        twist[:3] /= np.linalg.norm(twist[:3])
    return tisfm.rigid.pose_matrix(twist)[:3].tolist()


def write_record_of(folder, shot, numbers, motion, *, with_poses=False, files=(".npz",)):
    """Write ``run.json`` of the pairs with these numbers."""
    pairs = {}
    for k in numbers:
        result = pair(shot, k, motion, with_poses=with_poses)
        twists = None if result.motions is None else result.motions.tolist()
        pairs[f"f{k}"] = {
            "number": k,
            "status": "converged",
            "message": "it is well",
            "grade": "good",
            "depth_error": 0.02,
            "times": [0.1 * k, 0.1 * k + 0.1],
            "motions": None if twists is None else [rows_of(shot, k, with_poses)],
            "twists": twists,
            "files": {ending: [1, 1] for ending in files},
        }
    about = {
        "format": FORMAT,
        "version": tisfm.__version__,
        "settings": {"motion": motion},
        "outputs": ["npz"],
        "pairs": pairs,
    }
    (Path(folder) / "run.json").write_text(json.dumps(about))
