"""``python -m bench.sequences.colmap_model``: what COLMAP reads of a reconstruction.

A sequence is reconstructed and exported as a model of COLMAP. pycolmap reads it, and triangulates
every point again from the positions and poses that it holds; the table is left in bench/results.
"""

import argparse
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
from rich.console import Console

import tisfm
from bench.sequences.entries import parsed
from bench.shared.results import RESULTS, Bar, machine
from tisfm.exports import write_colmap

SEQUENCE = "tartanair"
IMAGES, POINTS, REPROJECTION = 30, 5000, 1.0  # the bars of that sequence; the last in px
LEAST_TRACK = 3  # frames


def figures(model: Any) -> dict[str, float]:
    """Return what a model holds, and how well its points are triangulated again."""
    images, points = model.images, model.points3D
    long = {number for number, point in points.items() if point.track.length() >= LEAST_TRACK}
    tracks = [
        sum(place.has_point3D() and place.point3D_id in long for place in image.points2D)
        for image in images.values()
    ]
    errors: list[float] = []
    lost = 0
    for point in points.values():
        seen = [images[element.image_id] for element in point.track.elements]
        places = np.array(
            [
                image.points2D[element.point2D_idx].xy
                for image, element in zip(seen, point.track.elements, strict=True)
            ]
        )
        found = pycolmap.estimate_triangulation(
            places,
            [image.cam_from_world() for image in seen],
            [model.cameras[image.camera_id] for image in seen],
        )
        if found is None:
            lost += 1
            continue
        for image, place in zip(seen, places, strict=True):
            projected = image.project_point(found["xyz"])
            errors.append(np.inf if projected is None else float(np.linalg.norm(projected - place)))
    return {
        "images": len(images),
        "points": len(points),
        f"least tracks of {LEAST_TRACK} frames in an image": min(tracks),
        "median reprojection error, px": float(np.median(errors)),
        "its 90th percentile, px": float(np.percentile(errors, 90)),
        "points that cannot be triangulated again": lost,
    }


def bars(found: dict[str, float], frames: int) -> list[Bar]:
    """Return the figures that have a bar."""
    least = f"least tracks of {LEAST_TRACK} frames in an image"
    return [
        Bar(f"images of {frames}", found["images"], IMAGES, at_most=False),
        Bar("points", found["points"], POINTS, at_most=False),
        Bar(least, found[least], 1, at_most=False),
        Bar("median reprojection error, px", found["median reprojection error, px"], REPROJECTION),
    ]


def report(found: dict[str, float], held: Sequence[Bar], conditions: dict[str, Any]) -> str:
    """Return the results as Markdown."""
    lines = ["# A reconstruction as a model of COLMAP", ""]
    lines += [f"- {name}: {value}" for name, value in conditions.items()]
    lines += ["", "| | |", "| --- | ---: |"]
    lines += [f"| {name} | {value:.4g} |" for name, value in found.items()]
    return "\n".join([*lines, "", *(f"- {bar}" for bar in held), ""])


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and write; return 1 if a bar is missed."""
    parser = argparse.ArgumentParser(prog="python -m bench.sequences.colmap_model")
    options, loaded = parsed(
        parser, arguments, sequence=SEQUENCE, preset="balanced", output="colmap"
    )
    settings = tisfm.Settings.preset(options.preset, motion="camera")
    with tempfile.TemporaryDirectory() as place:
        result = tisfm.reconstruct(
            loaded.frames, camera=loaded.camera, settings=settings, folder=Path(place) / "result"
        )
        write_colmap(result, Path(place) / "model")
        found = figures(pycolmap.Reconstruction(str(Path(place) / "model" / "sparse" / "0")))
    held = bars(found, len(loaded.frames))
    conditions = {
        "command": "python -m bench.sequences.colmap_model",
        "sequence": SEQUENCE,
        "preset": options.preset,
        "pycolmap": pycolmap.__version__,
        **machine(),
    }
    text = report(found, held, conditions)
    Console(markup=False, highlight=False).print(text)
    (RESULTS / f"{options.output}.md").write_text(text, encoding="utf-8")
    return 0 if all(bar.met for bar in held) else 1


if __name__ == "__main__":
    sys.exit(main())
