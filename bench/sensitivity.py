"""``python -m bench.sensitivity NAME …``: change of the errors if a constant is halved or doubled.

NAME is a number or a tuple of numbers of a module (``tisfm.motion.camera.CONSTANT``), or a frozen
dataclass or its instance, whose fields are changed one at a time. Each case runs in its own
process, which sets the value before other modules import it. Inputs are rendered scenes and, if a
folder of real sequences is named, real pairs and sequences. The table is left in bench/results.
"""

import importlib
import json
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import fields, is_dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from bench.shared.results import (
    EMPTY_CELL,
    RESULTS,
    ROOT,
    Table,
    cell,
    machine,
    markdown_page,
    write_results,
)

FACTORS = {"halved": 0.5, "doubled": 2.0}
SEQUENCES = ("new_tsukuba", "tartanair")  # real sequences
INPUTS = ("flow", "camera", "film", *SEQUENCES)
STEP = (0.05, 0.0, 0.02, 0.0, 0.01, 0.0)  # m and rad per frame, of the rendered film
Figures = dict[str, float]


def find(path: str) -> tuple[Any, str, Any]:
    """Return the module of a constant, its name in the module, and its value."""
    module, _, name = path.rpartition(".")
    owner = importlib.import_module(module)
    return owner, name, getattr(owner, name)


def numbers_of(value: Any) -> dict[str, float]:
    """Return suffix → number for all numbers in a constant; a plain number has the suffix ""."""
    if is_dataclass(value):
        parts = {f".{f.name}": getattr(value, f.name, None) for f in fields(value)}
    elif isinstance(value, tuple):
        parts = {f"[{index}]": part for index, part in enumerate(value)}
    else:
        number = isinstance(value, (int, float)) and not isinstance(value, bool)
        return {"": value} if number else {}
    return {name + rest: n for name, part in parts.items() for rest, n in numbers_of(part).items()}


def scaled(value: Any, suffix: str, factor: float) -> Any:
    """Return a constant with one number scaled; an integer stays an integer, at least 1."""
    if not suffix:
        return max(1, round(value * factor)) if isinstance(value, int) else value * factor
    if isinstance(value, tuple):
        index, _, rest = suffix[1:].partition("]")
        part = scaled(value[int(index)], rest, factor)
        return (*value[: int(index)], part, *value[int(index) + 1 :])
    name = suffix[1:].partition("[")[0].partition(".")[0]
    part = scaled(getattr(value, name), suffix[1 + len(name) :], factor)
    return replace(value, **{name: part})


def change(path: str, suffix: str, factor: float) -> None:
    """Scale one number of a constant, in its module and in modules that have imported it."""
    owner, name, value = find(path)
    if isinstance(value, type):  # a dataclass: its defaults are changed
        changed, init = scaled(value(), suffix, factor), value.__init__  # type: ignore[misc]
        positional = [f.name for f in fields(changed) if f.init and not f.kw_only]
        count = len(init.__defaults__ or ())
        init.__defaults__ = tuple(getattr(changed, n) for n in positional[-count:] if count)
        init.__kwdefaults__ = {n: getattr(changed, n) for n in init.__kwdefaults__ or {}}
        return
    changed = scaled(value, suffix, factor)
    for module in [owner, *(m for n, m in list(sys.modules.items()) if n.startswith("tisfm"))]:
        if vars(module).get(name) is value:
            setattr(module, name, changed)


def inputs(data: Path | None) -> dict[str, Callable[[], Figures]]:
    """Return name → function that measures the figures of an input."""
    import tisfm  # here and below: imported after the constant was changed
    from bench.sequences.entries import MAX_DEPTH, data_entries
    from bench.sequences.rendered_films import depth_in_one_scale, path_error
    from bench.shared.sequences import find_pairs, scene_pairs
    from tisfm.evaluation.sequences import compare_sequence
    from tisfm.metrics import depth_errors, endpoint_error, pose_errors
    from tisfm.rigid import pose_matrix
    from tisfm.scenes import room_film, static_scene

    fast = tisfm.Settings.preset("fast", motion="camera")

    def flow() -> Figures:
        pairs = find_pairs(data)[0] if data else scene_pairs(96, 128)
        found = [tisfm.interpret(pair.frame0, pair.frame1).flow for pair in pairs]
        errors = [endpoint_error(f, pair.truth) for f, pair in zip(found, pairs, strict=True)]
        return {"EPE, px": float(np.mean(errors))}

    def camera() -> Figures:
        pair = static_scene("sideways+rotation", 120, 160)
        result = tisfm.interpret(pair.frame0, pair.frame1, camera=pair.camera, settings=fast)
        assert result.motions is not None  # this motion model has them
        errors = pose_errors(pose_matrix(result.motions[0]), pose_matrix(pair.motions[0]))
        depth = depth_errors(result.depth, pair.depth).abs_rel
        return {"rotation, °": errors.rotation, "abs-rel": depth}

    def film() -> Figures:
        poses = np.array([pose_matrix(k * np.array(STEP)) for k in range(8)])
        film = room_film(poses, 96, 128, textured=True)
        result = tisfm.reconstruct(film.frames, camera=film.camera, settings=fast)
        depth = depth_in_one_scale(film, result)
        return {"path, %": path_error(result.poses, film.poses), "depth error": depth}

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
    return {"flow": flow, "camera": camera, "film": film, **real}


def measure(case: dict[str, Any]) -> Figures:
    """Return the figures of a case in this process."""
    if case["suffix"] is not None:
        change(case["path"], case["suffix"], case["factor"])
    found = inputs(case["data"] and Path(case["data"]))
    chosen = {name: run() for name, run in found.items() if name in case["inputs"]}
    return {f"{name}: {key}": v for name, figures in chosen.items() for key, v in figures.items()}


def in_process(case: dict[str, Any]) -> Figures | str:
    """Return the figures of a case from its own process, or its last message if it failed."""
    command = [sys.executable, "-m", "bench.sensitivity", "--case", json.dumps(case)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    last = ((done.stderr if done.returncode else done.stdout).strip().splitlines() or [""])[-1]
    return last if done.returncode else json.loads(last)


def rows_of(paths: Sequence[str], common: dict[str, Any], base: Figures) -> Iterator[list[str]]:
    """Yield a row for every changed number: the changes of the figures, %, and the largest."""
    for path in paths:
        for suffix, number in numbers_of(find(path)[2]).items():
            for word, factor in FACTORS.items():
                found = in_process({**common, "path": path, "suffix": suffix, "factor": factor})
                head = [f"{path}{suffix}", f"{number:g}", word]
                if isinstance(found, str):
                    yield [*head, *[EMPTY_CELL] * len(base), f"failed: {found}"]
                    continue
                changes = [100 * (found[key] / old - 1) for key, old in base.items()]
                largest = "none" if found == base else f"{max(map(abs, changes)):.2g}"
                yield [*head, *(cell(value, "+.2g") for value in changes), largest]


def main(arguments: list[str] | None = None) -> int:
    """Measure, print and write the table; return 0, or 2 if a constant cannot be measured."""
    if "--case" in (arguments or sys.argv):
        print(json.dumps(measure(json.loads((arguments or sys.argv)[-1]))))
        return 0
    from bench.shared.command import options_parser
    from bench.shared.sequences import data_folder

    parser = options_parser("sensitivity", __doc__, "data", "smoke", "output")
    parser.add_argument("names", nargs="+", metavar="NAME", help="constants or settings")
    parser.add_argument("--inputs", nargs="+", choices=INPUTS, default=INPUTS)
    options = parser.parse_args(arguments)
    data = None if options.smoke else data_folder(options.data)
    common = {"inputs": options.inputs, "data": data and str(data)}
    try:
        for path in options.names:
            find(path)  # fails for an unknown name
        base = in_process({**common, "suffix": None})
        if isinstance(base, str):
            raise ValueError(f"the inputs cannot be measured: {base}")
        rows = [["unchanged, absolute", "", "", *(f"{v:.4g}" for v in base.values()), ""]]
        for row in rows_of(options.names, common, base):
            print(*row, sep=" | ", flush=True)
            rows.append(row)
    except (AttributeError, ImportError, ValueError) as error:
        print(f"bench.sensitivity: {error}", file=sys.stderr)
        return 2
    table = Table(["constant", "value", "", *base, "largest change, %"], rows, text_columns=3)
    note = "Changes of the figures, %, if one number is halved or doubled; none: the same bits."
    text = markdown_page("# Sensitivity to constants", machine(), note, table)
    write_results(RESULTS / (options.output or "sensitivity"), text, {"base": base, "rows": rows})
    return 0


if __name__ == "__main__":
    sys.exit(main())
