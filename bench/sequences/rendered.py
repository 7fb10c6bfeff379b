"""``python -m bench.sequences.rendered``: sequences with exact truth, and bounds of their errors.

Films of a rendered room, with patterned and with bare walls: a round trip, blanked frames, a turn
without parallax, a mesh, depth from an increasing number of frames, a rolling shutter. Rendered
frames are kept in a temporary folder. The table, all figures and a picture of the error over the
number of frames are written to bench/results.
"""

import argparse
import itertools
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, get_args

import numpy as np
from matplotlib.figure import Figure
from rich.console import Console

import tisfm
from bench.sequences.rendered_films import (
    COUNTS,
    SIZE,
    FilmParameters,
    depth_in_one_scale,
    depth_of_pair,
    depth_of_window,
    end_gap,
    flicker,
    keyframe_path,
    path_error,
    poses_of_segment,
    round_trip_path,
    scale_change,
    shake_path,
    share_of_mesh,
    turn_path,
    walk_path,
)
from bench.shared.command import command_text, options_parser
from bench.shared.figures import CURVES, tidy
from bench.shared.results import (
    RESULTS,
    Bar,
    Table,
    exit_code,
    machine,
    markdown_page,
    write_results,
)
from tisfm import runtime
from tisfm.scenes import Film
from tisfm.settings import Preset

SMOKE_SIZE = 96, 128  # px, height and width
ROOMS = {"pattern": True, "bare": False}  # name → whether the walls have a pattern
READOUT = 0.8  # readout time of the rolling shutter, as a share of the frame interval

Errors = dict[str, list[float]]  # room → error of depth for each number of frames


class Checks:
    """Renders films, reconstructs them, and measures the figures that have bounds.

    With `smoke`, films are small and short. The seeds determine the textures and the noise.
    """

    def __init__(self, settings: tisfm.Settings, *, smoke: bool, seeds: list[int]) -> None:
        self._settings, self._smoke, self._seeds = settings, smoke, seeds
        self.errors: Errors = {}

    def bars_of(self, kind: str, room: str) -> Iterator[Bar]:
        """Yield the bars of a kind of film in a room."""
        makers: dict[str, Callable[[str, int], Iterator[Bar]]] = {
            "trip": self._trip,
            "blanked": self._blanked,
            "turn": self._turn,
            "walk": self._walk,
            "frames": self._frames,
            "shutter": self._shutter,
        }
        # A single seed, because the film is long.
        seeds = self._seeds[:1] if kind == "trip" else self._seeds
        for seed in seeds:
            yield from makers[kind](room, seed)

    def _film(
        self, name: str, poses: np.ndarray, room: str, seed: int, readout: float = 0.0
    ) -> Film:
        height, width = SMOKE_SIZE if self._smoke else SIZE
        return FilmParameters(
            name=name,
            poses=poses,
            textured=ROOMS[room],
            seed=seed,
            height=height,
            width=width,
            readout=readout,
        ).film()

    @contextmanager
    def _reconstruct(self, film: Film) -> Iterator[tisfm.Reconstruction]:
        with tempfile.TemporaryDirectory(prefix="tisfm-rendered-") as folder:
            yield tisfm.reconstruct(
                film.frames, camera=film.camera, settings=self._settings, folder=Path(folder)
            )

    def _trip(self, room: str, seed: int) -> Iterator[Bar]:
        count = 16 if self._smoke else 200
        film = self._film("trip", round_trip_path(count), room, seed)
        with self._reconstruct(film) as result:
            name = f"round trip of {count} frames, {room}, seed {seed}"
            in_one_piece = len(np.unique(result.piece)) == 1 and result.piece[0] == 0
            yield Bar(f"{name}: frames with a pose", float((result.piece == 0).sum()), count, False)
            yield Bar(
                f"{name}: gap, % of the path",
                end_gap(result.poses, film.poses) if in_one_piece else None,
                0.3,
            )
            yield Bar(f"{name}: ATE, %", path_error(result.poses, film.poses), None)

    def _blanked(self, room: str, seed: int) -> Iterator[Bar]:
        count, blank = (12, 2) if self._smoke else (40, 10)
        film = self._film("walk", walk_path(count), room, seed)
        frames = film.frames.copy()
        first = (count - blank) // 2
        frames[first : first + blank] = 0
        with self._reconstruct(replace(film, frames=frames)) as result:
            poses = poses_of_segment(result)
        name = f"{blank} of {count} frames blanked, {room}, seed {seed}"
        posed = float((result.piece == 0).sum())
        yield Bar(f"{name}: the other frames in one piece", posed, count - blank, False)
        yield Bar(f"{name}: ATE, %", path_error(poses, film.poses), None)

    def _turn(self, room: str, seed: int) -> Iterator[Bar]:
        part = 6 if self._smoke else 20
        film = self._film("turn", turn_path(part, part, part), room, seed)
        with self._reconstruct(film) as result:
            poses = result.poses
        name = f"{part} frames of rotation, {room}, seed {seed}"
        change = None
        if np.isfinite(poses).all():
            change = scale_change(poses, film.poses, slice(0, part), slice(2 * part, None))
        yield Bar(f"{name}: change of scale, %", change, 2.0)

    def _walk(self, room: str, seed: int) -> Iterator[Bar]:
        count = 12 if self._smoke else 40
        film = self._film("walk", walk_path(count), room, seed)
        with self._reconstruct(film) as result:
            name = f"walk of {count} frames, {room}, seed {seed}"
            in_one_piece = bool((result.piece == 0).all())
            yield Bar(f"{name}: ATE, %", path_error(result.poses, film.poses), None)
            share = share_of_mesh(film, result) if in_one_piece else None
            yield Bar(f"{name}: mesh within 2 % of the depth, %", share, 95.0, False)
            ratio = flicker(film, result, self._settings) if in_one_piece else None
            yield Bar(f"{name}: flicker, over the flicker of pairs", ratio, 1 / 3)

    def _frames(self, room: str, seed: int) -> Iterator[Bar]:
        film = self._film("frames", keyframe_path(max(COUNTS)), room, seed)
        depths = [depth_of_window(film, count, self._settings) for count in COUNTS]
        errors = [error for error, _ in depths]
        self.errors[f"{room}, seed {seed}"] = errors
        name = f"depth from frames, {room}, seed {seed}"
        pair = depth_of_pair(film, self._settings)
        yield Bar(f"{name}: error of the pair alone, %", 100 * pair, None)
        yield Bar(f"{name}: error of {COUNTS[0]} frames, %", 100 * errors[0], None)
        yield Bar(
            f"{name}: largest rise with more frames, %",
            100 * max(after / before - 1 for before, after in itertools.pairwise(errors)),
            0.0,
        )
        fall = 100 * (1 - errors[-1] / pair)
        yield Bar(f"{name}: error at {COUNTS[-1]} frames below the pair's, %", fall, 50.0, False)
        yield Bar(f"{name}: within one deviation, %, at least", depths[-1][1], 60.0, False)
        yield Bar(f"{name}: within one deviation, %, at most", depths[-1][1], 75.0)

    def _shutter(self, room: str, seed: int) -> Iterator[Bar]:
        film = self._film("shaken", shake_path(12 if self._smoke else 24), room, seed, READOUT)
        name = f"rows read within {READOUT:g} of an interval, {room}, seed {seed}"
        ate: list[float] = []
        for readout, treatment in ((0.0, "ignored"), (None, "estimated and undone")):
            camera = replace(film.camera, readout=readout)
            with self._reconstruct(replace(film, camera=camera)) as result:
                ate.append(path_error(poses_of_segment(result), film.poses))
                yield Bar(f"{name}, {treatment}: ATE, %", ate[-1], None)
                error = 100 * depth_in_one_scale(film, result)
                yield Bar(f"{name}, {treatment}: error of depth, %", error, None)
        estimated = result.calibration.readout
        yield Bar(f"{name}: estimated readout", estimated, None)
        yield Bar(f"{name}: ATE, undone over ignored", ate[1] / ate[0], 1 / 3)


KINDS = ("trip", "blanked", "turn", "walk", "frames", "shutter")
# Options that appear in the results.
RECORDED_OPTIONS = ("preset", "kinds", "rooms", "seeds", "threads", "smoke")


def parse(arguments: list[str] | None) -> argparse.Namespace:
    parser = options_parser(
        "sequences.rendered", __doc__, "threads", "smoke", "output", output="rendered"
    )
    add = parser.add_argument
    add("--kinds", nargs="+", choices=KINDS, default=list(KINDS), help="of films")
    add("--rooms", nargs="+", choices=list(ROOMS), default=list(ROOMS))
    add("--preset", choices=get_args(Preset), default="balanced")
    add("--seeds", nargs="+", type=int, default=[0, 1], metavar="N", help="a round trip has one")
    options = parser.parse_args(arguments)
    if min(options.seeds) < 0:
        parser.error(f"--seeds has {min(options.seeds)}: expected at least 0")
    if options.smoke:
        options.seeds = options.seeds[:1]
    return options


def draw(errors: Errors, path: Path) -> None:
    figure = Figure(figsize=(6, 4), dpi=150, layout="constrained")
    axes = figure.add_subplot()
    for color, (name, values) in zip(itertools.cycle(CURVES), errors.items(), strict=False):
        axes.plot(COUNTS, 100 * np.array(values), "o-", color=color, label=name)
    axes.set_xlabel("frames, the keyframe included")
    axes.set_ylabel("mean error of the keyframe's depth, %")
    axes.set_ylim(bottom=0)
    axes.set_xticks(COUNTS)
    tidy(axes)
    axes.legend()
    figure.savefig(path)


def write(conditions: dict[str, Any], bars: list[Bar], errors: Errors, path: Path) -> None:
    """Write PATH.md, PATH.json and, if depth was estimated from several frames, PATH.png."""
    rows = []
    for bar in bars:
        value = "not measured" if bar.value is None else f"{bar.value:.3g}"
        bound = "" if bar.bound is None else f"{'≤' if bar.at_most else '≥'} {bar.bound:.3g}"
        verdict = "" if bar.bound is None else "met" if bar.is_met else "**not met**"
        rows.append([bar.name, value, bound, verdict])
    blocks: list[str | Table] = [Table(["", "figure", "bar", ""], rows)]
    if errors:
        blocks.append("Mean relative error of a keyframe's depth, %, by the number of frames:")
        rows = [[name, *(f"{100 * v:.2f}" for v in values)] for name, values in errors.items()]
        blocks.append(Table(["", *map(str, COUNTS)], rows))
        draw(errors, path.with_suffix(".png"))
    record = {"conditions": conditions, "bars": [asdict(bar) for bar in bars], "errors": errors}
    write_results(path, markdown_page("# Sequences on rendered films", conditions, *blocks), record)


def main(arguments: list[str] | None = None) -> int:
    """Return 0, or 1 if a bar was missed, which a smoke run ignores."""
    options = parse(arguments)
    runtime.start(threads=options.threads)
    settings = tisfm.Settings.preset(options.preset, motion="camera")
    checks = Checks(settings, smoke=options.smoke, seeds=options.seeds)
    size = SMOKE_SIZE if options.smoke else SIZE
    conditions = {
        "command": command_text("sequences.rendered", options, RECORDED_OPTIONS),
        "size": f"{size[0]}×{size[1]} px",
        "threads": options.threads,
        **machine(),
    }
    console, bars = Console(), list[Bar]()
    for kind in options.kinds:
        for room in options.rooms:
            for bar in checks.bars_of(kind, room):
                console.print(str(bar), highlight=False, soft_wrap=True)
                bars.append(bar)
            write(conditions, bars, checks.errors, RESULTS / options.output)
    return 0 if options.smoke else exit_code(bars)


if __name__ == "__main__":
    sys.exit(main())
