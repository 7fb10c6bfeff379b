"""``python -m bench.untextured``: flow, depth and confidence in parts without texture.

Scenes are `tisfm.scenes.bare_patches`, rounded to 8 bits. In some rows, Gaussian noise is added to
both frames before rounding. A bare pixel is more than `MARGIN` px from texture and from the outline
of the block.
"""

import sys
from dataclasses import dataclass, replace

import cv2
import numpy as np

import tisfm
from bench.shared.command import options_parser
from bench.shared.results import RESULTS, Table, cell, machine, markdown_page, write_results
from tisfm import runtime
from tisfm.horn_schunck import horn_schunck
from tisfm.scenes import SyntheticPair, bare_patches
from tisfm.settings import Preset

MARGIN = 8  # px
LOW_CONFIDENCE = 0.3  # confidence below which a pixel counts as doubtful
SEEDS = (0, 1, 2)
NOISE = (2, 5)  # grey levels
COLUMNS = {
    "textured": "EPE textured, px",
    "wall_left": "bare, within the wall's texture",
    "block": "bare, on the block",
    "wall": "bare, all of the wall",
    "depth_textured": "depth error textured",
    "depth_bare": "bare",
    "low_bare": f"confidence below {LOW_CONFIDENCE}: bare, %",
    "low_textured": "textured, %",
}


@dataclass(frozen=True)
class Method:
    """Settings, or None for Horn and Schunck, and the noise of the frames, grey levels."""

    settings: tisfm.Settings | None
    noise: float = 0.0


def add_noise(pair: SyntheticPair, sigma: float, seed: int) -> SyntheticPair:
    """Add Gaussian noise to both frames, and round to 8 bits."""
    rng = np.random.default_rng(seed)
    frames = (frame + rng.normal(0, sigma, frame.shape) for frame in (pair.frame0, pair.frame1))
    frame0, frame1 = (np.clip(np.rint(frame), 0, 255).astype(np.uint8) for frame in frames)
    return replace(pair, frame0=frame0, frame1=frame1)


def bare_pixels(pair: SyntheticPair) -> np.ndarray:
    """Return the bare pixels, (H, W) bool."""
    outline = np.zeros(pair.labels.shape, bool)
    outline[:, 1:] = np.diff(pair.labels, axis=1) != 0
    candidates = (~pair.textured & ~outline).astype(np.uint8)
    return cv2.distanceTransform(candidates, cv2.DIST_L2, 5) > MARGIN


def measure(pair: SyntheticPair, settings: tisfm.Settings | None) -> dict[str, float]:
    """Measure one scene; without settings, the flow of Horn and Schunck, which gives no depth."""
    bare, textured = bare_pixels(pair), pair.textured & pair.visible
    is_left_half = np.arange(pair.labels.shape[1]) < pair.labels.shape[1] // 2
    result = None
    if settings is None:
        flow = horn_schunck(pair.frame0, pair.frame1)
    else:
        result = tisfm.interpret(pair.frame0, pair.frame1, camera=pair.camera, settings=settings)
        flow = result.flow
    error = np.linalg.norm(flow - pair.flow, axis=-1)
    values = {
        "textured": error[textured].mean(),
        "wall_left": error[bare & (pair.labels == 0) & is_left_half].mean(),
        "block": error[bare & (pair.labels == 1)].mean(),
        "wall": error[bare & (pair.labels == 0)].mean(),
    }
    if result is not None:
        scale = np.median(pair.depth[textured]) / np.median(result.depth[textured])
        depth_error = np.abs(result.depth * scale - pair.depth) / pair.depth
        values |= {
            "depth_textured": depth_error[textured].mean(),
            "depth_bare": depth_error[bare].mean(),
            "low_bare": 100 * (result.confidence[bare] < LOW_CONFIDENCE).mean(),
            "low_textured": 100 * (result.confidence[textured] < LOW_CONFIDENCE).mean(),
        }
    return {name: float(value) for name, value in values.items()}


def methods() -> dict[str, Method]:
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


def table(means: dict[str, dict[str, float]]) -> Table:
    """Return the means: a row for every method."""
    rows = [
        [name, *(cell(values.get(key), ".3g") for key in COLUMNS)] for name, values in means.items()
    ]
    return Table(["", *COLUMNS.values()], rows)


def main(arguments: list[str] | None = None) -> int:
    parser = options_parser("untextured", __doc__, "threads", "output")
    parser.add_argument("--height", type=int, default=240, help="px")
    parser.add_argument("--width", type=int, default=320, help="px")
    options = parser.parse_args(arguments)
    runtime.start(threads=options.threads)
    scenes = {seed: bare_patches(options.height, options.width, seed=seed) for seed in SEEDS}
    values_by_method = {
        name: [
            measure(
                add_noise(scene, method.noise, seed) if method.noise else scene, method.settings
            )
            for seed, scene in scenes.items()
        ]
        for name, method in methods().items()
    }
    means = {
        name: {key: float(np.mean([row[key] for row in rows])) for key in rows[0]}
        for name, rows in values_by_method.items()
    }
    conditions = {
        "scenes": f"`tisfm.scenes.bare_patches`, {options.height}×{options.width}, means of "
        f"{len(SEEDS)} seeds",
        "threads": options.threads,
        **machine(),
    }
    notes = (
        f"Bare: more than {MARGIN} px from texture and from the outline of the block. Depth by eq. "
        "24, in the scale of the textured pixels. Noise is Gaussian and independent in both "
        "frames; other rows have only the noise of rounding to 8 bits."
    )
    print(markdown_page(table(means)))
    text = markdown_page("# Parts without texture", conditions, table(means), notes)
    record = {**conditions, "size": [options.height, options.width], "found": values_by_method}
    write_results(RESULTS / (options.output or "untextured"), text, record)
    return 0


if __name__ == "__main__":
    sys.exit(main())
