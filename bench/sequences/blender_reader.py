"""Reads an export in Blender; run by Blender's own Python, without tisfm.

``python blender_reader.py FOLDER REQUEST ANSWER``: FOLDER has ``camera.gltf``, ``points.glb`` and
``lens.json``; REQUEST, a ``.npz``, has the numbers of frames and points, and the frames per second.
ANSWER, another ``.npz``, gets the version of Blender, the camera's pose in each frame in Blender's
axes, the position of each point in each frame, the colours of the points, and the vertical angle.
"""

import json
import sys
from pathlib import Path

import bpy
import numpy as np
from bpy_extras.object_utils import world_to_camera_view


def main(folder: Path, request: Path, answer: Path) -> None:
    """Read an export as docs/exports.md describes."""
    request_data = np.load(request)
    lens = json.loads((folder / "lens.json").read_text())
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.fps = int(request_data["rate"])
    scene.render.resolution_x, scene.render.resolution_y = lens["width"], lens["height"]
    for name in ("camera.gltf", "points.glb"):
        bpy.ops.import_scene.gltf(filepath=str(folder / name))
    scene.camera = next(item for item in bpy.data.objects if item.type == "CAMERA")
    cloud = next(item for item in bpy.data.objects if item.type == "MESH")
    angle = scene.camera.data.angle_y
    for name, value in lens["blender"].items():
        setattr(scene.camera.data, name, value)
    points = [cloud.matrix_world @ cloud.data.vertices[int(k)].co for k in request_data["points"]]
    poses, positions = [], []
    for frame in request_data["frames"]:
        scene.frame_set(int(frame))
        poses.append(np.array(scene.camera.matrix_world))
        positions.append([world_to_camera_view(scene, scene.camera, point) for point in points])
    colors = cloud.data.color_attributes["Color"].data
    np.savez(
        answer,
        poses=np.array(poses),
        positions=np.array(positions),
        colors=np.array([colors[int(k)].color for k in request_data["points"]]),
        angle=angle,
        version=bpy.app.version_string,
    )


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
