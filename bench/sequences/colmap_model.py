"""``python -m bench.sequences.colmap_model``: an exported reconstruction, read by COLMAP.

A sequence is reconstructed and exported as a model of COLMAP. pycolmap reads the model and
triangulates every point again from its image positions and poses. The table is left in
bench/results.
"""

import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pycolmap
from rich.console import Console

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
from tisfm.exports import write_colmap
from tisfm.settings import Preset

SEQUENCE = "tartanair"
# Bounds for that sequence, set by hand.
MIN_IMAGES = 30  # in the model
MIN_POINTS = 5000  # in the model
MAX_REPROJECTION = 1.0  # px
MIN_TRACK = 3  # frames
ERROR = "median reprojection error, px"


def figures(model: Any) -> dict[str, float]:
    """Return the contents of a model, and the errors of its points triangulated again."""
    images, points = model.images, model.points3D
    long_points = {number for number, point in points.items() if point.track.length() >= MIN_TRACK}
    tracks = [
        sum(point.has_point3D() and point.point3D_id in long_points for point in image.points2D)
        for image in images.values()
    ]
    errors: list[float] = []
    lost_count = 0
    for point in points.values():
        track_images = [images[element.image_id] for element in point.track.elements]
        positions = np.array(
            [
                image.points2D[element.point2D_idx].xy
                for image, element in zip(track_images, point.track.elements, strict=True)
            ]
        )
        triangulated = pycolmap.estimate_triangulation(
            positions,
            [image.cam_from_world() for image in track_images],
            [model.cameras[image.camera_id] for image in track_images],
        )
        if triangulated is None:
            lost_count += 1
            continue
        for image, position in zip(track_images, positions, strict=True):
            projection = image.project_point(triangulated["xyz"])
            errors.append(
                np.inf if projection is None else float(np.linalg.norm(projection - position))
            )
    return {
        "images": len(images),
        "points": len(points),
        f"least tracks of {MIN_TRACK} frames in an image": min(tracks),
        ERROR: float(np.median(errors)),
        "its 90th percentile, px": float(np.percentile(errors, 90)),
        "points that cannot be triangulated again": lost_count,
    }


def bars(figures: dict[str, float], frames: int) -> list[Bar]:
    name = f"least tracks of {MIN_TRACK} frames in an image"
    return [
        Bar(f"images of {frames}", figures["images"], MIN_IMAGES, at_most=False),
        Bar("points", figures["points"], MIN_POINTS, at_most=False),
        Bar(name, figures[name], 1, at_most=False),
        Bar(
            "median reprojection error, px",
            figures["median reprojection error, px"],
            MAX_REPROJECTION,
        ),
    ]


def report(figures: dict[str, float], bars: Sequence[Bar], conditions: dict[str, Any]) -> str:
    rows = [[name, f"{value:.4g}"] for name, value in figures.items()]
    title = "# A reconstruction as a model of COLMAP"
    return markdown_page(title, conditions, Table(["", ""], rows), list(map(str, bars)))


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and write; return 1 if a bar is missed."""
    parser = options_parser("sequences.colmap_model", __doc__, "data", "output", output="colmap")
    parser.add_argument("--preset", choices=get_args(Preset), default="balanced")
    options, loaded = parse_one(parser, arguments, SEQUENCE)
    settings = tisfm.Settings.preset(options.preset, motion="camera")
    with tempfile.TemporaryDirectory() as folder:
        result = tisfm.reconstruct(
            loaded.frames, camera=loaded.camera, settings=settings, folder=Path(folder) / "result"
        )
        write_colmap(result, Path(folder) / "model")
        values = figures(pycolmap.Reconstruction(str(Path(folder) / "model" / "sparse" / "0")))
    model_bars = bars(values, len(loaded.frames))
    conditions = {
        "command": "python -m bench.sequences.colmap_model",
        "sequence": SEQUENCE,
        "preset": options.preset,
        "pycolmap": pycolmap.__version__,
        **machine(),
    }
    text = report(values, model_bars, conditions)
    Console(markup=False, highlight=False).print(text)
    write_results(RESULTS / options.output, text)
    return exit_code(model_bars)


if __name__ == "__main__":
    sys.exit(main())
