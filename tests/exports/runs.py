"""Folders of `tisfm run` that are made up, not found."""

import json
from dataclasses import asdict

import numpy as np

import tisfm
from tests.exports.made import CAMERA, SHAPE, picture, ramp
from tisfm.folders.run_record import FORMAT
from tisfm.running.pair_files import motion_rows
from tisfm.status import History, Status

TWIST = np.array([1.0, 0, 0, 0, 0.01, 0])


def run_of(folder, *, scales=(1.0, 1.0, 1.0), posed=False, motion="camera", camera=CAMERA):
    """Write the files of pairs p0, p1 … and their record; return the folder.

    Inverse depth of a pair is in multiples of its scale; all moves to the right, by 1, 2, … px.
    """
    folder.mkdir(parents=True)
    pairs = {}
    for k, scale in enumerate(scales):
        inverse_depth = np.nan_to_num(ramp(0)) * np.float32(scale)
        flow = np.zeros((*SHAPE, 2), np.float32)
        flow[..., 0] = k + 1
        occlusion = np.tile(np.arange(SHAPE[1]) < k, (SHAPE[0], 1))
        result = tisfm.Interpretation(
            rho=np.zeros((6, *SHAPE), np.float32),
            flow=flow,
            inverse_depth=inverse_depth,
            inverse_depth_std=np.full(SHAPE, 0.01, np.float32),
            confidence=np.where(occlusion, np.float32(0), np.float32(0.5)),
            occlusion=occlusion,
            frame=picture(k),
            camera=camera.pinhole(),
            settings=tisfm.Settings.preset("fast", motion=motion),
            status=Status("converged", ""),
            history=_NO_HISTORY,
            version=tisfm.__version__,
            motions=TWIST[None],
            labels=np.zeros(SHAPE, np.int32),
        )
        result.save(folder / f"p{k}.npz", compact=True)
        pose = tisfm.rigid.pose_matrix(3.0 * TWIST) if posed else None
        pairs[f"p{k}"] = {
            "number": k,
            "status": "converged",
            "message": "",
            "grade": "good",
            "depth_error": 0.02,
            "motions": motion_rows(result, pose=pose).tolist(),
            "twists": result.motions.tolist(),
            "frames": "",
            "times": [k / 10, (k + 1) / 10],
            "files": {},
        }
    record = {
        "format": FORMAT,
        "version": tisfm.__version__,
        "camera": asdict(camera),
        "settings": {"motion": motion},
        "outputs": ["npz"],
        "pairs": dict(reversed(pairs.items())),
    }
    (folder / "run.json").write_text(json.dumps(record))
    return folder


_NO_HISTORY = History(
    level=np.zeros(0, np.int32),
    warp=np.zeros(0, np.int32),
    energy=np.zeros(0),
    half_quadratic=np.zeros(0),
    change=np.zeros(0),
)
