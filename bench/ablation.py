"""``python -m bench.ablation``: effect of each changed setting on errors and time, in one run.

The changes of a preset are in `CHANGES`. All variants run on the same pairs, in turns. The tables
and all figures are written to bench/results.
"""

import argparse
import sys
from collections.abc import Mapping
from typing import Any, get_args

from bench.shared.command import (
    Pairs,
    choose,
    load_pairs,
    options_parser,
    output_name,
    run_with_progress,
)
from bench.shared.contest import Contest, interpretation
from bench.shared.contest_report import show, write
from bench.shared.results import RESULTS, machine, wide_console
from tisfm import runtime
from tisfm.settings import Preset, Settings

# Name of a change → settings that differ from the preset.
CHANGES: dict[str, dict[str, Any]] = {
    "no gradient constancy": {"gradient": 0.0, "brightness": 1.0},
    "no brightness constancy": {"brightness": 0.0},
    # Without robust weights the data term weighs more: the best λ̂ of 300, 500 and 1000.
    "quadratic data": {"data_contrast": None, "smoothness": 500.0},
    "no image-driven edges": {"image_edges": 0.0},
    "edges per component": {"joint_edges": False},
    "one stiffness": {"stiffness": (1, 1, 1, 1, 1, 1)},
    "a stiffer τ3": {"stiffness": (1, 1, 1, 10, 10, 0.3)},
    "quadratic smoothness": {"contrast": None},
    "no presmoothing": {"presmoothing": 0.0},
    "cube derivatives": {"derivatives": "cube"},
    "translation model": {"model": "translation"},
    "pyramid factor 0.5": {"pyramid_factor": 0.5},
    "pyramid factor 0.8": {"pyramid_factor": 0.8},
    "half the resolution": {"finest_level": 1},
    "one warp": {"warps": 1},
    "five warps": {"warps": 5},
    "as few warps on coarse levels": {"coarse_warps": 2},
    "twice the warps on coarse levels": {"coarse_warps": 16},
    "over-relaxation 1.9": {"relaxation": 1.9},
    "half the smoothness": {"smoothness": 11.0},
    "twice the smoothness": {"smoothness": 44.0},
    # In grey levels, λ̂ and ε have other magnitudes: the best λ̂ of 200, 1000 and 3000.
    "not normalised": {"normalization": None, "data_contrast": 1.0, "smoothness": 1000.0},
}


def variants(preset: Preset, changes: Mapping[str, Mapping[str, Any]]) -> dict[str, Settings]:
    """Return name → settings; raise a ValueError that names an impossible change."""
    settings = {}
    for name, change in changes.items():
        try:
            settings[name] = Settings.preset(preset, **change)
        except (TypeError, ValueError) as error:
            raise ValueError(f"the change {name!r} is impossible: {error}") from None
    return settings


def compare(options: argparse.Namespace, pairs: Pairs) -> Contest:
    base = Settings.preset(options.preset)
    reference = f"preset {options.preset}"
    settings = variants(options.preset, CHANGES)
    names = choose(list(settings), options.only, kind="change", name=str)
    missing = dict(pairs.missing)
    missing.update({name: "the same as the preset" for name in names if settings[name] == base})
    methods = [interpretation(reference, base)]
    methods += [interpretation(name, settings[name]) for name in names if name not in missing]
    runtime.start(threads=options.threads)
    return run_with_progress(
        methods,
        pairs,
        options,
        reference=reference,
        conditions={"pairs": pairs.source, "threads": options.threads, **machine()},
        missing=missing,
    )


def remarks() -> list[str]:
    """Return the notes: the settings of each change, and the meaning of the percentages."""
    return [
        "In parentheses: the difference to the unchanged preset.",
        *(
            f"{name}: " + ", ".join(f"{key} = {value!r}" for key, value in change.items())
            for name, change in CHANGES.items()
        ),
    ]


def main(arguments: list[str] | None = None) -> int:
    """Return 0, 1 if a variant failed on a pair, or 2 if nothing could be run."""
    names = ("data", "pairs", "only", "threads", "rounds", "smoke", "output")
    parser = options_parser("ablation", __doc__, *names)
    parser.add_argument("--preset", choices=get_args(Preset), default="accurate")
    options = parser.parse_args(arguments)
    try:
        contest = compare(options, load_pairs(options))
    except (OSError, ValueError) as error:
        print(f"bench.ablation: {error}", file=sys.stderr)
        return 2
    path = RESULTS / (output_name(options, "ablation"))
    title = f"Changes of the preset {options.preset}"
    write(contest, path, title=title, remarks=remarks(), changes=True)
    show(contest, wide_console(), changes=True)
    return 1 if contest.failures() else 0


if __name__ == "__main__":
    sys.exit(main())
