"""Data in the layouts of datasets, made of rendered scenes."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from tests.evaluation.evaluated import CALIBRATION, HOLE, MOTION, SCENES, put
from tisfm.evaluation import files, pairs
from tisfm.formats import write_flo, write_kitti_flow
from tisfm.status import Status


@pytest.fixture(autouse=True)
def coarse_pictures(monkeypatch):
    """Draw with few pixels, which is what takes the time here."""
    monkeypatch.setattr(files, "_DPI", 60)


@pytest.fixture
def data(tmp_path):
    """Two Middlebury pairs, one of KITTI and one of Yosemite's."""
    folder = tmp_path / "data"
    for name, scene in zip(("A", "B"), SCENES, strict=True):
        put(folder / "mid" / name / "frame10.png", scene.frame0)
        put(folder / "mid" / name / "frame11.png", scene.frame1)
        flow = np.where(HOLE[..., None], 1e10, scene.flow)
        put(folder / "mid" / name / "flow10.flo", flow, write_flo)
    scene = SCENES[0]
    road = folder / "road" / "training"
    colour = [np.dstack([frame] * 3) for frame in (scene.frame0, scene.frame1)]
    put(road / "image_2" / "000003_10.png", colour[0])
    put(road / "image_2" / "000003_11.png", colour[1])
    put(road / "flow_occ" / "000003_10.png", scene.flow, write_kitti_flow)
    visible = np.where(scene.visible[..., None], scene.flow, np.nan)
    put(road / "flow_noc" / "000003_10.png", visible, write_kitti_flow)
    put(road / "calib" / "000003.txt", None, lambda path, _: path.write_text(CALIBRATION))
    put(folder / "valley" / "yos9.png", scene.frame0)
    put(folder / "valley" / "yos10.png", scene.frame1)
    put(folder / "valley" / "flow09.flo", scene.flow, write_flo)
    put(folder / "valley" / "sky_mask.png", HOLE.astype(np.uint8))
    return folder


@pytest.fixture
def sequences(tmp_path):
    """Three frames of New Tsukuba and six of 7-Scenes' layout, and a stereo pair."""
    folder = tmp_path / "sequences"
    scene = SCENES[0]
    frames = [scene.frame0, scene.frame1]
    poses = [np.linalg.matrix_power(np.linalg.inv(MOTION), k) for k in range(6)]
    for k in range(3):
        put(folder / "lab" / f"rgb_{k:05d}.png", frames[k % 2])
    rows = "\n".join(" ".join(map(str, pose[:3].ravel())) for pose in poses)
    (folder / "lab" / "poses_camera_to_world_3x4_cm.txt").write_text(rows)
    for k, pose in enumerate(poses):
        stem = folder / "chess" / f"frame-{k:06d}"
        put(Path(f"{stem}.color.png"), frames[k % 2])
        put(Path(f"{stem}.depth.png"), np.rint(500 * scene.depth).astype(np.uint16))
        np.savetxt(f"{stem}.pose.txt", pose)
    put(folder / "two" / "block_left.png", scene.frame0)
    put(folder / "two" / "block_right.png", scene.frame1)
    disparity = np.where(HOLE, np.nan, -scene.flow[..., 0]).astype(np.float32)
    put(folder / "two" / "block_disp.npy", disparity, np.save)
    return folder


@pytest.fixture
def camera_results(monkeypatch):
    """Lists of the poses that were given to interpretations, and of what these say.

    Of the latter motion, depth and status are put in, for each pair in order.
    """
    asked, given = [], []
    original = pairs.interpret

    def interpret(frame0, frame1, *, camera=None, settings, pose=None):
        plain = replace(settings, motion="field")
        result = original(frame0, frame1, camera=camera, settings=plain)
        if frame0.shape[0] == 64:  # the pair that warms up
            return result
        asked.append(pose)
        motion, depth, status = given[len(asked) - 1]
        return SimpleNamespace(
            flow=result.flow,
            occlusion=result.occlusion,
            depth=np.broadcast_to(np.float32(depth), frame0.shape[:2]),
            motions=np.array([motion]),
            status=Status(status, "a word of advice"),
        )

    monkeypatch.setattr(pairs, "interpret", interpret)
    return asked, given
