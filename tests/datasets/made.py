"""Small datasets of every layout, made from a rendered scene."""

import struct

import cv2
import numpy as np

from tests.rendered import static_scene
from tisfm.formats import write_flo, write_kitti_flow, write_png
from tisfm.rigid import pose_matrix

H, W = 30, 44
SCENE = static_scene("sideways", H, W)
COLOUR = [np.dstack([frame, 255 - frame, frame // 2]) for frame in (SCENE.frame0, SCENE.frame1)]
FLOW = np.round(SCENE.flow * 64) / 64  # as KITTI's PNG stores it
OCCLUDED = ~SCENE.visible
HOLE = np.zeros((H, W), bool)
HOLE[3:6, 4:9] = True


def unknown(flow, mask, value=np.nan):
    """Return the flow with a value where a mask is set."""
    out = flow.copy()
    out[mask] = value
    return out


def put(path, data, *, write=write_png):
    path.parent.mkdir(parents=True, exist_ok=True)
    write(path, data)


def put_frames(*paths, frames=COLOUR):
    for path, frame in zip(paths, frames, strict=True):
        put(path, frame)


def mask_picture(mask):
    return np.where(mask, 255, 0).astype(np.uint8)


def make_middlebury(root):
    for name in ("Blocks", "Room"):
        put_frames(root / name / "frame10.png", root / name / "frame11.png")
        put(root / name / "flow10.flo", unknown(FLOW, HOLE, 1.7e9), write=write_flo)
    put_frames(root / "NoTruth" / "frame10.png", root / "NoTruth" / "frame11.png")


def make_middlebury_original(root):
    put_frames(*(root / "other-data" / "Blocks" / f"frame{k}.png" for k in (10, 11)))
    put(
        root / "other-gt-flow" / "Blocks" / "flow10.flo",
        unknown(FLOW, HOLE, 1.7e9),
        write=write_flo,
    )


def make_kitti(root, images="image_2", calibration="calib_cam_to_cam"):
    for k in (0, 12):
        put_frames(*(root / "training" / images / f"{k:06d}_{n}.png" for n in (10, 11)))
        truth = unknown(FLOW, HOLE)
        put(root / "training" / "flow_occ" / f"{k:06d}_10.png", truth, write=write_kitti_flow)
        visible = unknown(truth, OCCLUDED)
        put(root / "training" / "flow_noc" / f"{k:06d}_10.png", visible, write=write_kitti_flow)
        text = root / "training" / calibration / f"{k:06d}.txt"
        text.parent.mkdir(exist_ok=True)
        key = "P_rect_{:02d}" if calibration == "calib_cam_to_cam" else "P{}"
        lines = ["calib_time: 09-Jan-2012 13:57:47"]
        for camera in range(4):
            focal = 700 + camera
            values = [focal, 0, 22, -3, 0, focal, 15, 0.2, 0, 0, 1, 0]
            lines.append(f"{key.format(camera)}: " + " ".join(f"{v:.6e}" for v in values))
        text.write_text("\n".join(lines))


def make_sintel(root, passes=("clean", "final")):
    training = root / "training"
    for name in passes:
        for k in (1, 2, 3):
            put(training / name / "alley_1" / f"frame_{k:04d}.png", COLOUR[min(k, 2) - 1])
    for k in (1, 2):
        stem = f"alley_1/frame_{k:04d}"
        put(training / "flow" / f"{stem}.flo", FLOW, write=write_flo)
        put(training / "occlusions" / f"{stem}.png", mask_picture(OCCLUDED))
        put(training / "invalid" / f"{stem}.png", mask_picture(HOLE))
        cam = training / "camdata_left" / f"{stem}.cam"
        cam.parent.mkdir(parents=True, exist_ok=True)
        intrinsics = [1120.0, 0, 21.5, 0, 1120.0, 14.5, 0, 0, 1]
        cam.write_bytes(struct.pack("<f9d12d", 202021.25, *intrinsics, *range(12)))


def make_sintel_flat(root):
    put_frames(root / "frame_0002.png", root / "frame_0003.png")
    put(root / "gt" / "frame_0002.flo", FLOW, write=write_flo)
    put(root / "gt" / "frame_0002.png", COLOUR[0])
    put(root / "gt" / "occlusions" / "frame_0002.png", mask_picture(OCCLUDED))
    put(root / "gt" / "invalid" / "frame_0002.png", mask_picture(HOLE))


def make_yosemite(root):
    for k in (8, 9, 10):
        put(root / f"yos{k}.tif", COLOUR[k % 2][..., 0], write=write_tiff)
    put(root / "flow09_derived.flo", unknown(FLOW, HOLE, 1e10), write=write_flo)
    put(root / "sky_mask_derived.png", mask_picture(HOLE))


def write_tiff(path, image):
    assert cv2.imwrite(str(path), image)


def make_stereo(root):
    put_frames(root / "scene_left.png", root / "scene_right.png")
    disparity = np.where(HOLE, np.inf, 3.25).astype(np.float32)
    np.savez(root / "scene_disp.npz", disparity)
    put_frames(root / "left.png", root / "right.png")
    put(root / "disparity.png", np.where(HOLE, 0, 7).astype(np.uint8))
    put(root / "mask.png", np.dstack([mask_picture(~OCCLUDED)] * 3))
    put_frames(root / "lonely_left.png", root / "lonely_right.png")  # no truth: no pair


def world_poses(motion, count):
    """Return poses, camera to world, of a camera before which the scene moves each frame."""
    poses = [pose_matrix([0.3, -2, 1, 0.4, -0.2, 0.1])]
    while len(poses) < count:
        poses.append(poses[-1] @ np.linalg.inv(motion))
    return poses


MOTION = pose_matrix(SCENE.motions[0])
POSES = world_poses(MOTION, 5)


def write_rows(path, poses=POSES):
    rows = [" ".join(f"{value:.9g}" for value in pose[:3].ravel()) for pose in poses]
    path.write_text("\n".join(rows) + "\n")


def make_new_tsukuba(root):
    for k in range(4):
        put(root / f"rgb_{k:05d}.png", COLOUR[k % 2])
    write_rows(root / "poses_camera_to_world_3x4_cm.txt")


def make_sevenscenes(root, numbers=range(5), suffix="png"):
    raw = np.full((H, W), 1250, np.uint16)
    raw[HOLE], raw[0] = 65535, 0
    for k in numbers:
        put(root / f"frame-{k:06d}.color.{suffix}", COLOUR[k % 2], write=write_picture)
        put(root / f"frame-{k:06d}.depth.png", raw)
        np.savetxt(root / f"frame-{k:06d}.pose.txt", POSES[k])


def make_calibrated(root, names="0123"):
    for k, name in enumerate(names):
        put(root / "images" / f"{name}.png", COLOUR[k % 2])
        raw = np.full((H, W), 1250, np.uint16)
        raw[HOLE] = 0
        put(root / "depth" / f"{name}.png", raw)
    (root / "camera.txt").write_text("fx fy cx cy\n56.0 56.0 21.5 14.5\n")
    write_rows(root / "poses.txt", POSES[: len(names)])


def write_picture(path, image):
    assert cv2.imwrite(str(path), image[..., ::-1])


MAKERS = {
    "middlebury": make_middlebury,
    "middlebury original": make_middlebury_original,
    "kitti": make_kitti,
    "sintel": make_sintel,
    "sintel flat": make_sintel_flat,
    "yosemite": make_yosemite,
    "stereo": make_stereo,
    "new_tsukuba": make_new_tsukuba,
    "sevenscenes": make_sevenscenes,
    "calibrated": make_calibrated,
}


NAMES = {
    "middlebury": ["data/Blocks", "data/Room"],
    "middlebury original": ["data/Blocks"],
    "kitti": ["data/000000", "data/000012"],
    "sintel": [f"data {name}/alley_1/frame_{k:04d}" for name in ("clean", "final") for k in (1, 2)],
    "sintel flat": ["data/frame_0002"],
    "yosemite": ["data/yos9"],
    "stereo": ["data/data", "data/scene"],
    "new_tsukuba": [f"data/rgb_{k:05d}" for k in range(3)],
    "sevenscenes": [f"data/frame-{k:06d}" for k in range(2)],
    "calibrated": [f"data/{k}" for k in range(3)],
}


WITH_FLOW = set(MAKERS) - {"new_tsukuba", "sevenscenes", "calibrated"}
WITH_DEPTH = {"stereo", "sevenscenes", "calibrated"}
WITH_POSE = {"stereo", "new_tsukuba", "sevenscenes", "calibrated"}


def label(pair):
    return f"{pair.dataset}/{pair.name}"
