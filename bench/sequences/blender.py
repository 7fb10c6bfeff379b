"""``python -m bench.sequences.blender``: an exported reconstruction, opened in Blender.

A sequence is reconstructed from whole frames, and from a part of each frame whose middle is not on
the optical axis. Both are exported as a moving camera and as points. Blender reads the files as
docs/exports.md describes, and projects the points. The table, left in bench/results, has the
differences from the reconstruction. Blender runs as a Python with bpy (``pip install bpy``) in its
own environment, because it needs another NumPy.
"""

import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from scipy.spatial.transform import Rotation

import tisfm
from bench.sequences.entries import parse_one
from bench.shared.command import options_parser
from bench.shared.results import (
    RESULTS,
    Bar,
    Table,
    exit_code,
    machine,
    markdown_page,
    write_results,
)
from tisfm.exports import write_gltf_cameras, write_points
from tisfm.formats import read_image
from tisfm.settings import Preset

SEQUENCE = "tartanair"
PART = (400, 500)  # rows and columns, from the upper left corner
POINTS = 2000  # compared points
RATE = 25  # frames per second
BARS = {
    "of the camera's position, share of the path's extent": 1e-5,
    "of its rotation, deg": 1e-3,
    "of its vertical angle, deg": 1e-3,
    "of points, px": 0.01,
    "of their colours, of 255": 0.01,
}
_Y_UP = np.diag([1.0, -1.0, -1.0, 1.0])
_Z_UP = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])


def differences(
    result: tisfm.Reconstruction, views: dict[str, NDArray[Any]], frames: Sequence[int]
) -> dict[str, float]:
    """Return the largest differences between Blender and a reconstruction, by name of `BARS`.

    `views` is the result of `views_in_blender`; `frames` are the numbers of the rendered frames.
    """
    cloud = result.points()
    positions, colors = cloud.positions[views["points"]], cloud.colors[views["points"]]
    poses = result.poses[list(frames)]
    expected = _Z_UP @ _Y_UP @ poses @ _Y_UP
    between = expected[:, :3, :3].transpose(0, 2, 1) @ views["poses"][:, :3, :3]
    angles = np.degrees(Rotation.from_matrix(between).magnitude())
    extent = np.linalg.norm(np.ptp(poses[:, :3, 3], axis=0))
    distances = np.linalg.norm(expected[:, :3, 3] - views["poses"][:, :3, 3], axis=1)
    height, width = result.shape
    cx, cy = result.camera.center_for(height, width)
    offsets = []
    for pose, (across, up, ahead) in zip(poses, views["positions"].transpose(0, 2, 1), strict=True):
        x, y, depth = ((positions - pose[:3, 3]) @ pose[:3, :3]).T
        with np.errstate(divide="ignore", invalid="ignore"):
            column, row = (result.camera.focal * c / depth for c in (x, y))
        column, row = column + cx + 0.5, row + cy + 0.5
        is_inside = (depth > 0) & (column > 0) & (column < width) & (row > 0) & (row < height)
        offset = np.hypot(across * width - column, (1 - up) * height - row)
        offsets.append(np.where(ahead > 0, offset, np.inf)[is_inside])
    angle = 2 * np.arctan(height / 2 / result.camera.focal)
    values = (
        distances.max() / extent,
        angles.max(),
        abs(np.degrees(float(views["angle"]) - angle)),
        np.concatenate(offsets).max(),
        np.abs(255 * _to_srgb(views["colors"][:, :3]) - colors).max(),
    )
    return dict(zip(BARS, map(float, values), strict=True))


def views_in_blender(
    python: str, result: tisfm.Reconstruction, folder: Path, frames: Sequence[int]
) -> dict[str, NDArray[Any]]:
    """Export a reconstruction; return the views of Blender, and the numbers of its points."""
    folder.mkdir()
    write_gltf_cameras(result, folder, frames_per_second=RATE)
    write_points(result, folder, suffix="glb")
    count = len(result.points())
    points = np.unique(np.linspace(0, count - 1, POINTS).astype(int))
    request, answer = folder / "request.npz", folder / "answer.npz"
    np.savez(request, frames=frames, points=points, rate=RATE)
    reader = Path(__file__).with_name("blender_reader.py")
    subprocess.run([python, reader, folder, request, answer], check=True, stdout=sys.stderr)
    with np.load(answer) as views:
        return {**views, "points": points}


def report(figures: dict[str, dict[str, float]], conditions: dict[str, Any]) -> str:
    rows = [
        [name, *(f"{errors[name]:.2g}" for errors in figures.values()), f"{bar:g}"]
        for name, bar in BARS.items()
    ]
    caption = "Largest differences from the reconstruction:"
    table = Table(["", *figures, "bar"], rows)
    return markdown_page("# An export in Blender", conditions, caption, table)


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and write; return 1 if a bar is missed."""
    parser = options_parser("sequences.blender", __doc__, "data", "output", output="blender")
    parser.add_argument("--preset", choices=get_args(Preset), default="fast")
    parser.add_argument("--python", required=True, metavar="FILE", help="a Python that has bpy")
    options, loaded = parse_one(parser, arguments, SEQUENCE)
    frames = np.stack([read_image(file) for file in loaded.frames])
    whole_camera = loaded.camera
    if whole_camera is None:
        parser.error(f"{SEQUENCE} does not state its camera")
    part_camera = tisfm.Camera(
        focal=whole_camera.focal, center=whole_camera.center_for(*frames.shape[1:3])
    )
    settings = tisfm.Settings.preset(options.preset, motion="camera")
    cases = {
        "whole frames": (frames, whole_camera),
        "a part of each": (np.ascontiguousarray(frames[:, : PART[0], : PART[1]]), part_camera),
    }
    figures, version = {}, ""
    with tempfile.TemporaryDirectory() as folder:
        for k, (name, (images, camera)) in enumerate(cases.items()):
            result = tisfm.reconstruct(
                images, camera=camera, settings=settings, folder=Path(folder) / f"result{k}"
            )
            numbers = range(len(result))
            views = views_in_blender(options.python, result, Path(folder) / f"export{k}", numbers)
            figures[name], version = differences(result, views, numbers), str(views["version"])
    conditions = {
        "command": "python -m bench.sequences.blender --python FILE",
        "sequence": SEQUENCE,
        "preset": options.preset,
        "points": f"{len(views['points'])} in each of {len(numbers)} frames",
        "Blender": version,
        **machine(),
    }
    text = report(figures, conditions)
    Console(markup=False, highlight=False).print(text)
    write_results(RESULTS / options.output, text)
    return exit_code(
        Bar(name, errors[name], bar) for errors in figures.values() for name, bar in BARS.items()
    )


def _to_srgb(light: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return amounts of light as sRGB (IEC 61966-2-1)."""
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)


if __name__ == "__main__":
    sys.exit(main())
