"""Flow, depth and confidence in parts without texture: ``python -m bench.untextured``.

Scenes are `tisfm.scenes.bare_patches`, rounded to 8 bits and, in some rows, with Gaussian noise
before, on both frames. A bare pixel is more than `MARGIN` px from texture and from
the block's outline.
"""

import argparse
import json
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

import tisfm
from bench.shared.results import RESULTS, machine
from tisfm import runtime
from tisfm.horn_schunck import horn_schunck
from tisfm.scenes import SyntheticPair, bare_patches
from tisfm.settings import Preset

MARGIN = 8  # px
LOW = 0.3  # confidence
SEEDS = (0, 1, 2)
NOISE = (2, 5)  # grey levels
COLUMNS = {
    "textured": "EPE textured, px",
    "wall_left": "bare, within the wall's texture",
    "block": "bare, on the block",
    "wall": "bare, all of the wall",
    "depth_textured": "depth error textured",
    "depth_bare": "bare",
    "low_bare": f"confidence below {LOW}: bare, %",
    "low_textured": "textured, %",
}


@dataclass(frozen=True)
class Method:
    """Settings, None for Horn and Schunck; and the noise of the frames, grey levels."""

    settings: tisfm.Settings | None
    noise: float = 0.0


def noisy(pair: SyntheticPair, sigma: float, seed: int) -> SyntheticPair:
    """Add Gaussian noise to both frames, and round to 8 bits."""
    rng = np.random.default_rng(seed)
    frames = (frame + rng.normal(0, sigma, frame.shape) for frame in (pair.frame0, pair.frame1))
    frame0, frame1 = (np.clip(np.rint(frame), 0, 255).astype(np.uint8) for frame in frames)
    return replace(pair, frame0=frame0, frame1=frame1)


def bare_parts(pair: SyntheticPair) -> np.ndarray:
    """Return the bare pixels, (H, W) bool."""
    outline = np.zeros(pair.labels.shape, bool)
    outline[:, 1:] = np.diff(pair.labels, axis=1) != 0
    plain = (~pair.textured & ~outline).astype(np.uint8)
    return cv2.distanceTransform(plain, cv2.DIST_L2, 5) > MARGIN


def measure(pair: SyntheticPair, settings: tisfm.Settings | None) -> dict[str, float]:
    """Measure one scene; without settings, Horn and Schunck's flow, which has no depth."""
    bare, textured = bare_parts(pair), pair.textured & pair.visible
    left = np.arange(pair.labels.shape[1]) < pair.labels.shape[1] // 2
    result = None
    if settings is None:
        flow = horn_schunck(pair.frame0, pair.frame1)
    else:
        result = tisfm.interpret(pair.frame0, pair.frame1, camera=pair.camera, settings=settings)
        flow = result.flow
    error = np.linalg.norm(flow - pair.flow, axis=-1)
    values = {
        "textured": error[textured].mean(),
        "wall_left": error[bare & (pair.labels == 0) & left].mean(),
        "block": error[bare & (pair.labels == 1)].mean(),
        "wall": error[bare & (pair.labels == 0)].mean(),
    }
    if result is not None:
        scale = np.median(pair.depth[textured]) / np.median(result.depth[textured])
        depth_error = np.abs(result.depth * scale - pair.depth) / pair.depth
        values |= {
            "depth_textured": depth_error[textured].mean(),
            "depth_bare": depth_error[bare].mean(),
            "low_bare": 100 * (result.confidence[bare] < LOW).mean(),
            "low_textured": 100 * (result.confidence[textured] < LOW).mean(),
        }
    return {name: float(value) for name, value in values.items()}


def methods() -> dict[str, Method]:
    """Return name → method."""
    preset = tisfm.Settings.preset
    presets: tuple[Preset, ...] = ("paper", "fast", "balanced", "accurate")
    return {
        **{f"`{name}`": Method(preset(name)) for name in presets},
        "`balanced`, `image_edges=0`": Method(preset("balanced", image_edges=0.0)),
        "`balanced`, `coarse_warps=3`": Method(preset("balanced", coarse_warps=3)),
        **{
            f"`balanced`, noise of {sigma} grey levels": Method(preset("balanced"), noise=sigma)
            for sigma in NOISE
        },
        "Horn–Schunck": Method(None),
    }


def table(means: dict[str, dict[str, float]]) -> str:
    """Return the means as a Markdown table."""
    lines = ["| | " + " | ".join(COLUMNS.values()) + " |", "|---" * (len(COLUMNS) + 1) + "|"]
    for name, values in means.items():
        cells = [f"{values[key]:.3g}" if key in values else "–" for key in COLUMNS]
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def main(arguments: list[str] | None = None) -> int:
    """Measure, print and write the table."""
    parser = argparse.ArgumentParser(prog="python -m bench.untextured", description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=RESULTS)
    parser.add_argument("--height", type=int, default=240)
    parser.add_argument("--width", type=int, default=320)
    parser.add_argument("--threads", type=int, default=2, metavar="N")
    options = parser.parse_args(arguments)
    if options.threads < 1:
        parser.error(f"--threads is {options.threads}: expected at least 1")
    runtime.start(threads=options.threads)
    scenes = {seed: bare_patches(options.height, options.width, seed=seed) for seed in SEEDS}
    found = {
        name: [
            measure(noisy(scene, method.noise, seed) if method.noise else scene, method.settings)
            for seed, scene in scenes.items()
        ]
        for name, method in methods().items()
    }
    means = {
        name: {key: float(np.mean([row[key] for row in rows])) for key in rows[0]}
        for name, rows in found.items()
    }
    text = table(means)
    print(text)
    options.output.mkdir(parents=True, exist_ok=True)
    conditions = {
        "scenes": f"`tisfm.scenes.bare_patches`, {options.height}×{options.width}, means of "
        f"{len(SEEDS)} seeds",
        "threads": options.threads,
        **machine(),
    }
    heading = "# Parts without texture\n\n"
    heading += "".join(f"- {name}: {value}\n" for name, value in conditions.items())
    notes = (
        f"\nBare: more than {MARGIN} px from texture and from the block's outline. Depth by "
        "eq. 24, in the scale of the textured pixels. Noise is Gaussian, independent in both "
        "frames, and none but that of 8-bit rounding where none is named.\n"
    )
    (options.output / "untextured.md").write_text(heading + "\n" + text + notes, encoding="utf-8")
    record = {**conditions, "size": [options.height, options.width], "found": found}
    (options.output / "untextured.json").write_text(json.dumps(record, indent=1), encoding="utf-8")
    return 0
