"""``python -m bench.sensitivity [NAME …]``: change of the errors if a setting is halved or doubled.

NAME is the settings object of a stage, such as ``tisfm.reconstruction.tracks.settings.TRACKS``; by
default, all stages are measured. Their numbers are changed one at a time. Inputs are rendered
scenes and, if a folder of real sequences is named, real pairs and sequences. The tables are left in
bench/results.
"""

import importlib
import math
import multiprocessing
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import fields, replace
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bench.shared.results import RESULTS, Table, machine, markdown_page, write_results

if TYPE_CHECKING:
    from bench.depth.pairs import DepthPair

FACTORS = {"halved": 0.5, "doubled": 2.0}
SEQUENCES = ("new_tsukuba", "tartanair")  # real sequences
RENDERED = (
    "camera", "checks", "window", "objects", "film", "lens", "shutter", "chunks", "bodies", "paths",
)  # fmt: skip
INPUTS = ("flow", *RENDERED, "pairs", *SEQUENCES)
KINDS = ("sideways+rotation", "forward")  # of rendered pairs of a static scene
STEP = (0.05, 0.0, 0.02, 0.0, 0.01, 0.0)  # m and rad per frame, of the rendered film
READOUT = 0.8  # of the film with a rolling shutter, share of the time between frames
CHUNK = 12  # frames of a chunk of the rendered film in chunks, of 24 frames
Figures = dict[str, float]
Changes = dict[str, float] | str  # % by figure, empty for the same bits; or the message of an error
Row = tuple[str, float, list[Changes]]  # setting, value, and changes for each factor
Group = tuple[Sequence[str], Sequence[Row], Figures]  # settings objects, their rows, and the base
MOTION, RECONSTRUCTION = "tisfm.motion", "tisfm.reconstruction"
STAGES_OF_PAIRS = (
    "settings.EGOMOTION", "settings.DEPTH", "settings.GLOBAL", "settings.SPARSE",
    "camera_settings.LIGHT", "camera_settings.INTRINSICS", "camera_settings.FIXED",
)  # fmt: skip
STAGES = {  # settings objects by the inputs that reach them
    ("camera", "pairs"): [f"{MOTION}.{name}" for name in STAGES_OF_PAIRS],
    ("flow", "objects"): [f"{MOTION}.settings.PROPOSALS"],
    ("checks",): [f"{MOTION}.settings.CHECKS"],
    ("window",): [f"{MOTION}.settings.PREVIOUS"],
    ("objects",): [f"{MOTION}.objects.settings.OBJECTS"],
    ("film",): [
        f"{RECONSTRUCTION}.{name}"
        for name in (
            "tracks.settings.TRACKS",
            "mapping.settings.MAPPING",
            "geometry.settings.GEOMETRY",
            "frames.settings.FRAME_FLOW",
            "depth.settings.DEPTH",
            "depth.settings.OUTLINES",
        )
    ],
    ("lens",): [f"{RECONSTRUCTION}.calibration.settings.CALIBRATION"],
    ("shutter",): [f"{RECONSTRUCTION}.rolling_shutter.settings.ROLLING_SHUTTER"],
    ("chunks",): [
        f"{RECONSTRUCTION}.chunks.settings.CHUNKING",
        f"{RECONSTRUCTION}.submaps.settings.SUBMAPS",
    ],
    ("bodies",): [
        f"{RECONSTRUCTION}.objects.settings.OBJECTS",
        f"{RECONSTRUCTION}.objects.settings.STANDING",
    ],
    ("paths",): [
        "tisfm.grade.GRADES",
        *(
            f"{RECONSTRUCTION}.{name}"
            for name in (
                "path_checks.settings.PATH_CHECKS",
                "result.path_check.LIMITS",
                "path.settings.REVISION",
                "path.settings.POSE_DEVIATION",
                "joints.settings.JOINTS",
                "rotation.settings.ROTATION",
                "causes.settings.CAUSES",
            )
        ),
    ],
}


def settings_of(path: str) -> Any:
    """Return the settings object of a dotted path."""
    module, _, name = path.rpartition(".")
    settings = getattr(importlib.import_module(module), name)
    fields(settings)  # a TypeError if it is no dataclass
    return settings


def numbers_of(settings: Any) -> dict[tuple[str, int | None], float]:
    """Return (field, index in a tuple or None) → number for all numbers of a settings object."""
    found = {}
    for name in (field.name for field in fields(settings)):
        value = getattr(settings, name)
        parts = enumerate(value) if isinstance(value, tuple) else [(None, value)]
        for index, part in parts:
            if isinstance(part, (int, float)) and not isinstance(part, bool):
                found[name, index] = part
    return found


def scaled(value: float, factor: float) -> float:
    """Return a number times a factor; an integer stays an integer, at least 1."""
    return max(1, round(value * factor)) if isinstance(value, int) else value * factor


@contextmanager
def changed(settings: Any, name: str, index: int | None, factor: float) -> Iterator[None]:
    """Scale one number of a settings object inside a ``with`` block."""
    value = getattr(settings, name)
    new: Any = scaled(value, factor) if index is None else list(value)
    if index is not None:
        new[index] = scaled(value[index], factor)
        new = tuple(new)
    object.__setattr__(settings, name, new)  # modules share this frozen object
    try:
        yield
    finally:
        object.__setattr__(settings, name, value)


def inputs(data: Path | None) -> dict[str, Callable[[], Figures]]:
    """Return name → function that measures the figures of an input."""
    import cv2

    import tisfm
    from bench.depth.methods import OwnMethod
    from bench.depth.scores import score
    from bench.sequences.entries import MAX_DEPTH, data_entries
    from bench.sequences.rendered_films import depth_in_one_scale, path_error
    from bench.shared.sequences import find_pairs, scene_pairs
    from bench.trust.worker import run_sequence
    from tisfm.evaluation.sequences import compare_sequence
    from tisfm.metrics import depth_errors, endpoint_error, label_scores, pose_errors
    from tisfm.reconstruction.chunks.entry import reconstruct_in_chunks
    from tisfm.rigid import pose_matrix

    method = OwnMethod(preset="fast", motion="camera")
    fast = tisfm.Settings.preset("fast", motion="camera")
    with_objects = tisfm.Settings.preset("fast", motion="objects")

    def flow() -> Figures:
        pairs = find_pairs(data)[0] if data else scene_pairs(96, 128)
        found = [tisfm.interpret(pair.frame0, pair.frame1).flow for pair in pairs]
        errors = [endpoint_error(f, pair.truth) for f, pair in zip(found, pairs, strict=True)]
        return {"EPE, px": float(np.mean(errors))}

    def camera() -> Figures:
        figures = []
        for pair in rendered()["camera"]:
            result = tisfm.interpret(pair.frame0, pair.frame1, camera=pair.camera, settings=fast)
            assert result.motions is not None  # this motion model has them
            errors = pose_errors(pose_matrix(result.motions[0]), pose_matrix(pair.motions[0]))
            depth = depth_errors(result.depth, pair.depth, align="median").abs_rel
            figures.append((errors.rotation, depth, str(result.status) == "converged"))
        rotation, depth, converged = np.mean(figures, axis=0).tolist()
        return {"rotation, °": rotation, "abs-rel": depth, "converged": converged}

    def checks() -> Figures:
        statuses = []
        for frames, options in rendered()["checks"]:
            found = tisfm.interpret(*frames, settings=fast, **options)
            statuses.append(str(found.status) == "converged")
        return {"converged": float(np.mean(statuses))}

    def window() -> Figures:
        errors = []
        for triple in rendered()["window"]:
            *_, last = tisfm.interpret_sequence(triple.frames, window=3, camera=triple.camera)
            errors.append(endpoint_error(last.flow, triple.flow))
        return {"EPE, px": float(np.mean(errors))}

    def pairs() -> Figures:
        scores = [score(method.run(pair)[0], pair) for pair in pairs_of_groups(data)]

        def mean_of(name: str) -> float:
            values = [getattr(each, name) for each in scores]
            return float(np.mean([value for value in values if value is not None]))

        return {
            "abs-rel": mean_of("abs_rel_all"),
            "direction, °": mean_of("direction"),
            "rotation, °": mean_of("rotation"),
            "converged": float(np.mean([each.status == "converged" for each in scores])),
        }

    def objects() -> Figures:
        pair = rendered()["objects"]
        result = tisfm.interpret(
            pair.frame0, pair.frame1, camera=pair.camera, settings=with_objects
        )
        assert result.labels is not None  # this motion model has them
        depth = depth_errors(result.depth, pair.depth, align="median").abs_rel
        return {"abs-rel": depth, "IoU": label_scores([result.labels], [pair.labels]).iou}

    def bodies() -> Figures:
        film = rendered()["bodies"]
        result = tisfm.reconstruct(film.frames, camera=film.camera, settings=with_objects)
        labels = [result.labels(frame) for frame in range(len(film.frames))]
        path = path_error(result.poses, film.poses)
        return {"path, %": path, "IoU": label_scores(labels, film.labels).iou}

    def film() -> Figures:
        film = rendered()["film"]
        result = tisfm.reconstruct(film.frames, camera=film.camera, settings=fast)
        depth = depth_in_one_scale(film, result)
        return {"path, %": path_error(result.poses, film.poses), "depth error": depth}

    def lens() -> Figures:
        film = rendered()["lens"]
        result = tisfm.reconstruct(
            film.frames, settings=fast, calibrate="radial", depth_of="keyframes"
        )
        focal = 100 * abs(result.camera.focal / film.camera.focal - 1)
        return {"path, %": path_error(result.poses, film.poses), "focal length, %": focal}

    def shutter() -> Figures:
        film = rendered()["shutter"]
        camera = replace(film.camera, readout=None)
        result = tisfm.reconstruct(film.frames, camera=camera, settings=fast, depth_of="none")
        error = abs(result.calibration.readout - READOUT)
        return {"path, %": path_error(result.poses, film.poses), "readout": error}

    def chunks() -> Figures:
        film = rendered()["chunks"]
        with TemporaryDirectory() as folder:
            for number, frame in enumerate(film.frames):
                cv2.imwrite(f"{folder}/{number:02d}.png", frame)
            result = reconstruct_in_chunks(
                folder,
                Path(folder, "result"),
                camera=film.camera,
                settings=fast,
                chunk=CHUNK,
                map_unordered=lambda make, items: ((k, make(item)) for k, item in enumerate(items)),
            )
            depth = depth_in_one_scale(film, result)
        return {"path, %": path_error(result.poses, film.poses), "depth error": depth}

    def paths() -> Figures:
        verdicts = [run_sequence(case, None, is_smoke=True) for case in rendered()["paths"]]
        frames = [verdict["statuses"].get("contradicted", 0) for verdict in verdicts]
        return {
            "contradicted films": float(np.mean([count > 0 for count in frames])),
            "green": float(np.mean([verdict["green"] for verdict in verdicts])),
            "posed": float(np.mean([verdict["posed"] for verdict in verdicts])),
            "masked": float(np.mean([verdict["masked"] for verdict in verdicts])),
        }

    def sequence(name: str) -> Figures:
        assert data is not None  # real sequences are inputs only with a folder
        entry = next(e for e in data_entries(data)[0] if e.name == name)
        loaded = entry.load()
        result = tisfm.reconstruct(loaded.frames, camera=loaded.camera, settings=fast)
        found = compare_sequence(
            entry.sequence, loaded, result, camera=result.camera, max_depth=MAX_DEPTH
        )
        depth = {} if found.depth is None else {"depth error": found.depth.error}
        return {"path, %": 100 * (found.pieces[0].share or np.nan)} | depth

    real = {name: partial(sequence, name) for name in SEQUENCES if data}
    made = (camera, checks, window, objects, film, lens, shutter, chunks, bodies, paths)
    return {"flow": flow, **dict(zip(RENDERED, made, strict=True)), "pairs": pairs, **real}


@cache
def rendered() -> dict[str, Any]:
    """Return name → rendered pair or film, made once in a process."""
    from bench.trust.cases import Case
    from bench.trust.films import Disturbance
    from bench.window import blocks
    from tisfm.rigid import pose_matrix
    from tisfm.scenes import (
        bare_patches,
        bodies_film,
        bodies_path,
        room,
        room_film,
        static_scene,
        three_blocks,
        two_blocks,
    )

    def poses(twists: NDArray) -> NDArray:
        return np.array([pose_matrix(twist) for twist in twists])

    steady = np.outer(np.arange(24), STEP)
    at = np.arange(12)
    shaken = np.stack(
        [0.04 * at, 0.01 * np.sin(at), 0.02 * at, 0.03 * np.sin(0.9 * at),
         0.04 * np.cos(0.7 * at) - 0.04, 0.02 * np.sin(1.3 * at)], axis=1
    )  # fmt: skip
    arc = np.array(
        [(0.8 * s, 0.15 * np.sin(3 * s), 0.3 * s**2, 0.1 * np.sin(3 * s), -0.35 * s, 0.3 * s)
         for s in np.linspace(-1, 1, 10)]
    )  # fmt: skip
    good, other = static_scene("forward", 120, 160), bare_patches(120, 160, seed=3)
    bare = room(120, 160)
    noise = np.random.default_rng(0).integers(0, 256, (3, 120, 160), dtype=np.uint8)
    replaced = good.frame1.copy()
    replaced[30:90, 40:120] = noise[2, 30:90, 40:120]
    stripes = np.tile((np.arange(160) // 8 % 2 * 120 + 60).astype(np.uint8), (120, 1))
    true = pose_matrix(good.motions[0])
    return {
        "checks": [
            ((good.frame0, good.frame1), {"camera": good.camera}),
            ((good.frame0, other.frame0), {"camera": good.camera}),
            ((noise[0], noise[1]), {}),
            ((good.frame0, replaced), {"camera": good.camera}),
            ((stripes, np.roll(stripes, 3, axis=1)), {}),
            ((good.frame0, good.frame1), {"camera": good.camera, "pose": true}),
            ((good.frame0, good.frame1), {"camera": good.camera, "pose": np.linalg.inv(true)}),
            ((good.frame0, (good.frame1 * 0.6).astype(np.uint8)), {"camera": good.camera}),
            ((bare.frame0, bare.frame1), {"camera": bare.camera}),
            ((bare.frame0, bare.frame0), {"camera": bare.camera}),
        ],
        "window": [
            blocks(make, 120, 160, 2.0, seed)
            for make in (two_blocks, three_blocks)
            for seed in (0, 1)
        ],
        "lens": room_film(poses(arc), 180, 240, samples=2),
        "shutter": room_film(poses(shaken), 120, 160, textured=True, samples=1, readout=READOUT),
        "chunks": room_film(poses(steady), 96, 128, textured=True),
        "camera": [*(static_scene(kind, 120, 160) for kind in KINDS), bare_patches(120, 160)],
        "objects": three_blocks(180, 240),
        "film": room_film(poses(steady[:8]), 96, 128, textured=True),
        "bodies": bodies_film(bodies_path(10), 150, 200),
        "paths": [
            Case(task="sequence", scene=scene, disturbance=Disturbance(kind=kind, strength=size))
            for scene, kind, size in (
                ("room 0", "clean", 0.0),
                ("street 0", "clean", 0.0),
                ("room 1", "overlay", 0.3),
                ("room 0", "zoom", 0.01),
                ("room 2", "pan", 0.02),
                ("room 0", "fixed noise", 12.0),
            )
        ],
    }


@cache
def pairs_of_groups(data: Path | None) -> "list[DepthPair]":
    """Return the first pair of some groups of `bench.depth`, loaded once in a process."""
    from bench.depth.pairs import (
        HAND_HELD,
        OFFICE,
        POSE_GIVEN,
        RENDERED_ROOM,
        ROOM,
        SPACED,
        STEREO,
        WIDE_BASELINE,
        data_entries,
        scene_entries,
    )

    groups = (RENDERED_ROOM, ROOM, ROOM + POSE_GIVEN, OFFICE, SPACED, HAND_HELD)
    entries = scene_entries(120, 160) + (data_entries(data)[0] if data else [])
    first = {entry.group: entry for entry in reversed(entries)}
    return [first[name].load() for name in (*groups, WIDE_BASELINE, STEREO) if name in first]


@cache
def unchanged(chosen: tuple[str, ...], data: Path | None) -> Figures:
    """Return the figures with unchanged settings, measured once in a process."""
    return measure(chosen, data)


def measure(chosen: tuple[str, ...], data: Path | None) -> Figures:
    """Return the figures of the chosen inputs."""
    found = inputs(data)
    figures = {name: found[name]() for name in chosen if name in found}
    return {
        f"{name}: {key}": value for name, each in figures.items() for key, value in each.items()
    }


def row_of(case: tuple[str, str, int | None], chosen: tuple[str, ...], data: Path | None) -> Row:
    """Return the changes of all figures if one number is halved and doubled."""
    warnings.simplefilter("ignore")  # the notes of the library on its inputs
    path, name, index = case
    settings = settings_of(path)
    base = unchanged(chosen, data)
    changes: list[Changes] = []
    for factor in FACTORS.values():
        with changed(settings, name, index, factor):
            try:
                found = measure(chosen, data)
            except Exception as error:
                changes.append(f"{type(error).__name__}: {error}")
                continue
        same = found == base
        changes.append({} if same else {key: 100 * (found[key] / base[key] - 1) for key in base})
    title = f"{path.rpartition('.')[2]}.{name}" + ("" if index is None else f"[{index}]")
    return title, numbers_of(settings)[name, index], changes


def largest(changes: Changes) -> tuple[float, str]:
    """Return the largest change, %, and its cell: ``none`` for the same bits."""
    if isinstance(changes, str):
        return math.inf, changes
    if not changes:
        return 0.0, "none"
    key = max(changes, key=lambda key: abs(np.nan_to_num(changes[key], nan=math.inf)))
    size = float(np.nan_to_num(abs(changes[key]), nan=math.inf))
    return size, f"{changes[key]:+.2g} ({key})"


def section(names: Sequence[str], rows: Sequence[Row], base: Figures) -> tuple[str, str, Table]:
    """Return heading, note and table of a group: settings by their largest change."""
    ranked = sorted(rows, key=lambda row: -max(largest(changes)[0] for changes in row[2]))
    cells = [
        [name, f"{number:g}", *(largest(change)[1] for change in changes)]
        for name, number, changes in ranked
        if any(changes)
    ]
    table = Table(["setting", "value", "halved, %", "doubled, %"], cells, text_columns=1)
    same = [name for name, _, changes in rows if not any(changes)]
    figures = ", ".join(f"{key} {value:.4g}" for key, value in base.items())
    note = (
        f"Unchanged settings: {figures}. {len(same)} of {len(rows)} numbers leave these figures "
        f"the same: {', '.join(same) or 'none'}."
    )
    return f"## {', '.join(names)}", note, table


def report(groups: Sequence[Group]) -> str:
    """Return the report, with a section for each group."""
    note = (
        "Largest change of a figure if one number of a settings object is halved or doubled, in %, "
        "and the figure. `nan`: no path, or no depth. Each section has the settings of a stage, "
        "and begins with the figures of its inputs."
    )
    blocks = (block for group in groups for block in section(*group))
    return markdown_page("# Sensitivity to settings", machine(), note, *blocks)


def plan(names: Sequence[str], inputs_: Sequence[str]) -> list[tuple[tuple[str, ...], list[str]]]:
    """Return (inputs, settings objects) of the groups that are measured together."""
    if inputs_:
        return [(tuple(inputs_), list(names))]
    chosen = [
        (group, [name for name in stages if name in (names or stages)])
        for group, stages in STAGES.items()
    ]
    planned = [(group, stages) for group, stages in chosen if stages]
    others = [name for name in names if all(name not in stages for _, stages in planned)]
    return planned + ([(INPUTS, others)] if others else [])


def main(arguments: list[str] | None = None) -> int:
    """Measure, print and write the tables; return 0, or 2 if there are no such settings."""
    from bench.shared.command import options_parser
    from bench.shared.sequences import data_folder

    parser = options_parser("sensitivity", __doc__, "data", "smoke", "output")
    parser.add_argument(
        "names", nargs="*", metavar="NAME", help="settings objects; default: all stages"
    )
    parser.add_argument(
        "--inputs", nargs="+", choices=INPUTS, default=(), help="default: those of each stage"
    )
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    options = parser.parse_args(arguments)
    data = None if options.smoke else data_folder(options.data)
    groups: list[Group] = []
    for chosen, paths in plan(options.names, options.inputs):
        try:
            cases = [(path, *key) for path in paths for key in numbers_of(settings_of(path))]
        except (AttributeError, ImportError, TypeError) as error:
            print(f"bench.sensitivity: {error}", file=sys.stderr)
            return 2
        rows = []
        with ProcessPoolExecutor(options.jobs, multiprocessing.get_context("spawn")) as pool:
            base = pool.submit(unchanged, chosen, data)
            for row in pool.map(partial(row_of, chosen=chosen, data=data), cases):
                print(
                    row[0], f"{row[1]:g}", *(largest(c)[1] for c in row[2]), sep=" | ", flush=True
                )
                rows.append(row)
        groups.append((paths, rows, base.result()))
    write_results(RESULTS / (options.output or "sensitivity"), report(groups), groups)
    return 0


if __name__ == "__main__":
    sys.exit(main())
