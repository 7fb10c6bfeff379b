"""``python -m bench.window --data DIR``: flow from three frames against flow from two.

Frames t−1, t and t+1. The flow from t to t+1 is computed from the pair alone, and with `window=3`.
Errors are separate for pixels that are occluded at t+1 (hidden, or outside the image) and for all
others. Pair and window are timed one after the other; the result is the median of the ratios.

DIR has the folders ``sintel_alley`` and ``sintel_cave`` (frames 1 to 4 of a sequence of MPI Sintel,
and ``gt`` with the flow from frame 2 to 3, occlusions and invalid pixels). Without DIR, only
rendered sequences are measured, with seeds that were not used to develop the method.
"""

import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import cv2
import numpy as np

import tisfm
from bench.shared.command import options_parser
from bench.shared.contest import measure_time
from bench.shared.results import RESULTS, Table, machine, markdown_page, write_results
from tisfm import runtime
from tisfm.formats import read_flo, read_image
from tisfm.scenes import SyntheticPair, room, room_film, three_blocks, two_blocks
from tisfm.sources import FrameSource
from tisfm.window import Window

SEEDS = (10, 11)  # not used to develop the method
# Height and width, px; factor of the motion.
SPEEDS = ((240, 320, 1.0), (240, 320, 3.0), (480, 640, 2.0))
ROOM_MOTIONS = {"sideways": (0.08, 0.0, 0.0), "forward": (0.02, 0.0, 0.12)}  # m/frame
REPETITIONS = 5  # timed calls of pair and window
MIN_HIDDEN_RATIO = 1.02  # times the visible depth: a farther point is hidden
HEAD = (
    "", "occluded, %", "EPE occluded: pair", "window", "change", "elsewhere: pair", "window",
    "change", "occlusion F1, pair / window", "pair, ms", "time, window / pair",
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Triple:
    """Frames t−1, t and t+1, the flow from t to t+1, (H, W, 2), and the occluded pixels of t."""

    name: str
    frames: list[np.ndarray]
    flow: np.ndarray
    occluded_pixels: np.ndarray
    known_pixels: np.ndarray
    camera: tisfm.Camera


def leaves_image(flow: np.ndarray) -> np.ndarray:
    """Return the pixels whose flow, (H, W, 2), ends outside the image."""
    height, width = flow.shape[:2]
    x, y = flow[..., 0] + np.arange(width), flow[..., 1] + np.arange(height)[:, None]
    return (x < 0) | (x > width - 1) | (y < 0) | (y > height - 1)


def sintel(folder: Path, name: str) -> Triple:
    """Read frames 1 to 3."""
    frames = [np.asarray(read_image(folder / f"frame_000{k}.png")) for k in (1, 2, 3)]
    flow = np.asarray(read_flo(folder / "gt" / "frame_0002.flo"))
    mask = np.asarray(read_image(folder / "gt" / "occlusions" / "frame_0002.png")) > 0
    hidden = np.asarray(mask.reshape(*flow.shape[:2], -1).any(axis=-1))
    return Triple(
        name=name,
        frames=frames,
        flow=flow,
        occluded_pixels=hidden | leaves_image(flow),
        known_pixels=np.asarray(np.isfinite(flow).all(axis=-1)),
        camera=tisfm.Camera(600.0),
    )


def triple_of_pairs(name: str, earlier: SyntheticPair, pair: SyntheticPair) -> Triple:
    """Return the frames of two pairs of a scene, from t back to t−1 and on to t+1."""
    return Triple(
        name=name,
        frames=[earlier.frame1, pair.frame0, pair.frame1],
        flow=pair.flow,
        occluded_pixels=~pair.visible,
        known_pixels=np.asarray(np.isfinite(pair.flow).all(axis=-1)),
        camera=pair.camera,
    )


def blocks(
    make: Callable[..., SyntheticPair], height: int, width: int, speed: float, seed: int
) -> Triple:
    """Render blocks that keep their 3D velocities."""
    small = make(8, 12)
    camera, block_motions_per_frame = -small.motions[0], (small.motions - small.motions[0])[2:]
    before, after = (
        make(
            height,
            width,
            seed=seed,
            camera_motion=f * camera,
            block_motions=f * block_motions_per_frame,
        )
        for f in (-speed, speed)
    )
    name = f"{make.__name__}, {width}×{height}, {speed:g} times its speed"
    return triple_of_pairs(name, before, after)


def bare_room(height: int, width: int, seed: int) -> Triple:
    """Render a room with bare walls, for a camera with constant velocity."""
    motion = np.array([0.12, 0.0, 0.08, 0.003, 0.01, 0.006])
    before, after = (room(height, width, seed=seed, camera_motion=f * motion) for f in (-1, 1))
    return triple_of_pairs(f"room, bare, {width}×{height}", before, after)


def papered_room(height: int, width: int, seed: int, direction: str) -> Triple:
    """Render a film of a room with papered walls; the flow follows from depth and poses."""
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[:, :3, 3] = np.outer((-1, 0, 1), ROOM_MOTIONS[direction])
    film = room_film(poses, height, width, seed=seed, textured=True)
    depth, camera = film.depth[1].astype(np.float64), film.camera
    cx, cy = camera.center_for(height, width)
    x, y = np.arange(width) - cx, (np.arange(height) - cy)[:, None]
    points = np.stack([x * depth, y * depth, camera.focal * depth]) / camera.focal
    later_points = points - np.array(ROOM_MOTIONS[direction])[:, None, None]
    flow = np.stack(
        [camera.focal * later_points[k] / later_points[2] - (x, y)[k] for k in (0, 1)], axis=-1
    )
    target = (flow + np.stack(np.broadcast_arrays(x + cx, y + cy), axis=-1)).astype(np.float32)
    visible_depth = cv2.remap(film.depth[2], target[..., 0], target[..., 1], cv2.INTER_NEAREST)
    hidden = later_points[2] > MIN_HIDDEN_RATIO * visible_depth
    return Triple(
        name=f"room, papered, {direction}, {width}×{height}",
        frames=list(film.frames),
        flow=flow,
        occluded_pixels=hidden | leaves_image(flow),
        known_pixels=later_points[2] > 0,
        camera=camera,
    )


def triples(data: Path | None) -> Iterator[list[Triple]]:
    """Yield the triples of each row; its errors are means over them."""
    if data is not None:
        yield [sintel(data / "sintel_alley", "Sintel alley_1")]
        for kind in ("clean", "final"):
            yield [sintel(data / "sintel_cave" / kind, f"Sintel cave_2, {kind}")]
    for make in (two_blocks, three_blocks):
        for size in SPEEDS:
            yield [blocks(make, *size, seed) for seed in SEEDS]
    yield [bare_room(240, 320, seed) for seed in SEEDS]
    for direction in ROOM_MOTIONS:
        yield [papered_room(240, 320, seed, direction) for seed in SEEDS]


def measure(triple: Triple, settings: tisfm.Settings, repetitions: int) -> dict[str, float]:
    first, last = FrameSource(triple.frames)

    window = Window()
    first.interpret(camera=triple.camera, settings=settings, window=window)
    previous = window.previous

    interpret = partial(measure_time, last.interpret, camera=triple.camera, settings=settings)

    def interpret_window() -> tuple[tisfm.Interpretation, float]:
        window.previous = previous
        return interpret(window=window)

    values = {"share": float(triple.occluded_pixels.mean())}
    for name, work in (("pair", interpret), ("window", interpret_window)):
        result, _ = work()
        error = np.linalg.norm(result.flow - triple.flow, axis=-1)
        occluded_pixels = triple.occluded_pixels & triple.known_pixels
        values[f"{name}_occluded"] = float(error[occluded_pixels].mean())
        values[f"{name}_elsewhere"] = float(
            error[~triple.occluded_pixels & triple.known_pixels].mean()
        )
        true_positives = np.count_nonzero(result.occlusion & triple.occluded_pixels)
        total = np.count_nonzero(result.occlusion) + np.count_nonzero(triple.occluded_pixels)
        values[f"{name}_f1"] = 2 * true_positives / total
    times = np.array([[interpret()[1], interpret_window()[1]] for _ in range(repetitions)])
    values["seconds"] = float(np.median(times[:, 0]))
    values["ratio"] = float(np.median(times[:, 1] / times[:, 0]))
    return values


def row(name: str, values: dict[str, float]) -> list[str]:
    cells = [f"{100 * values['share']:.1f}"]
    for part in ("occluded", "elsewhere"):
        pair, window = (values[f"{method}_{part}"] for method in ("pair", "window"))
        cells += [f"{pair:.3f}", f"{window:.3f}", f"{100 * (window / pair - 1):+.0f} %"]
    cells += [f"{values['pair_f1']:.2f} / {values['window_f1']:.2f}"]
    return [name, *cells, f"{1000 * values['seconds']:.0f}", f"{values['ratio']:.2f}"]


def main(arguments: list[str] | None = None) -> int:
    parser = options_parser("window", __doc__, "data", "threads", "output")
    parser.add_argument("--presets", nargs="+", default=["balanced", "fast", "accurate"])
    parser.add_argument("--repetitions", type=int, default=REPETITIONS)
    options = parser.parse_args(arguments)
    runtime.start(threads=options.threads)
    sequences = list(triples(options.data))
    results: dict[str, dict[str, dict[str, float]]] = {}
    sections: list[str | Table] = []
    for preset in options.presets:
        settings = tisfm.Settings.preset(preset)
        results[preset], rows = {}, []
        for sequence in sequences:
            name = sequence[0].name
            values = [measure(triple, settings, options.repetitions) for triple in sequence]
            results[preset][name] = {
                key: float(np.mean([entry[key] for entry in values])) for key in values[0]
            }
            rows.append(row(name, results[preset][name]))
            print(preset, "|", " | ".join(rows[-1]), flush=True)
        sections += [f"## `{preset}`", Table(HEAD, rows)]
    conditions = {"threads": options.threads, "repetitions": options.repetitions, **machine()}
    notes = (
        "End-point error, px, of the flow from frame t to t+1: by the pair alone, and with "
        "`window=3`, which also uses frame t−1. Occluded pixels are hidden at t+1 or leave the "
        f"image. Rendered rows are means of {len(SEEDS)} seeds. The ratio of times is the median "
        "over runs in turn."
    )
    text = markdown_page("# Three frames against two", conditions, notes, *sections)
    write_results(RESULTS / (options.output or "window"), text, {**conditions, "found": results})
    return 0


if __name__ == "__main__":
    sys.exit(main())
