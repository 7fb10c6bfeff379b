"""``python -m bench.regression --before CHECKOUT``: results and speed against another checkout.

Both checkouts interpret the same pairs in their own processes with the same number of threads:
rendered scenes, and real pairs of ``--data`` or TISFM_DATA. Their results are compared. Then
interpretations and starts of both are timed in turns. The tables are written to bench/results.
"""

import argparse
import contextlib
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, get_args

from rich.console import Console

from bench.regression.checkout import Checkout, PairedTimes, measure_interpretation, measure_starts
from bench.regression.pairs import QUICK_SIZE, SIZE, TIMED_SIZE, Pair, real_pairs, scene_pairs
from bench.regression.report import Case, Findings, difference, markdown, out_of_bounds
from bench.shared.command import choose, options_parser
from bench.shared.results import RESULTS, ROOT, machine, write_results
from bench.shared.sequences import data_folder
from bench.shared.worker import Worker, WorkerDied
from tisfm.settings import Preset

PARTS = ("answers", "times", "starts")
POSE_GIVEN = "camera, pose given"
MOTIONS = ("field", "camera", POSE_GIVEN, "objects")
TIMED_CASES = (
    ("fast", "field"),
    ("balanced", "field"),
    ("accurate", "field"),
    ("balanced", "camera"),
    ("balanced", "objects"),
)
QUICK_ROUNDS = 3  # timed rounds of a quick run


def parse(arguments: list[str] | None) -> argparse.Namespace:
    presets = list(get_args(Preset))
    parser = options_parser(
        "regression",
        __doc__,
        *("preset", "pairs", "data", "threads", "rounds", "output"),
        preset=presets,
        rounds=20,
    )
    add = parser.add_argument
    add("--before", type=Path, required=True, metavar="DIR", help="checkout")
    add("--after", type=Path, default=ROOT, metavar="DIR", help="default: this one")
    add("--python-before", metavar="PATH", help="interpreter of --before; default: this one")
    add("--only", nargs="+", choices=PARTS, default=list(PARTS))
    add("--motion", nargs="+", choices=MOTIONS, default=list(MOTIONS))
    add("--quick", action="store_true", help="small scenes, no data, three rounds")
    options = parser.parse_args(arguments)
    for folder in (options.before, options.after):
        if not (folder / "tisfm" / "__init__.py").is_file():
            parser.error(f"{folder} is no checkout of this project: it has no tisfm/__init__.py")
    if options.quick:
        options.rounds = QUICK_ROUNDS
    return options


def find_pairs(options: argparse.Namespace) -> tuple[list[Pair], dict[str, str]]:
    """Return the pairs that the options name, and why others are missing."""
    pairs = scene_pairs(*(QUICK_SIZE if options.quick else SIZE))
    missing: dict[str, str] = {}
    data = None if options.quick else data_folder(options.data)
    if data is not None:
        real, missing = real_pairs(data)
        pairs += real
    return choose(pairs, options.pairs, kind="pair", name=lambda pair: pair.name), missing


def request(pair: Path, preset: str, motion: str, answer: Path | None = None) -> dict[str, Any]:
    return {
        "pair": str(pair),
        "settings": {"name": preset, "motion": motion.partition(",")[0]},
        "pose": motion == POSE_GIVEN,
        "answer": None if answer is None else str(answer),
        "times": 1,
    }


def compare(workers: Sequence[Worker], pair: Pair, preset: str, motion: str, path: Path) -> Case:
    """Let both checkouts interpret a pair; return the difference of the results."""
    answers = [path.with_name(f"answer-{side}.npz") for side in (0, 1)]
    statuses = []
    for worker, answer in zip(workers, answers, strict=True):
        answer.unlink(missing_ok=True)
        try:
            statuses.append(worker.ask(request(path, preset, motion, answer))["status"])
        except WorkerDied as death:
            statuses.append(str(death))
    are_complete = all(answer.exists() for answer in answers)
    return Case(
        pair=pair.name,
        preset=preset,
        motion=motion,
        before=statuses[0],
        after=statuses[1],
        difference=difference(*answers) if are_complete else None,
    )


def measure(options: argparse.Namespace, console: Console) -> Findings:
    python = Path(options.python_before or sys.executable)
    checkouts = [
        Checkout(name="before", folder=options.before, python=python),
        Checkout(name="after", folder=options.after, python=Path(sys.executable)),
    ]
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="tisfm-regression-")))
        workers = []
        for checkout in checkouts:
            workers.append(checkout.worker(options.threads, folder))
            stack.callback(workers[-1].close)
            checkout.check(workers[-1])
        cases: list[Case] = []
        missing: dict[str, str] = {}
        if "answers" in options.only:
            pairs, missing = find_pairs(options)
            for pair in pairs:
                path = pair.store(folder)
                for preset in options.preset:
                    for motion in options.motion:
                        if motion != POSE_GIVEN or pair.pose is not None:
                            cases.append(compare(workers, pair, preset, motion, path))
                            console.print(" ".join(cases[-1].cells()), highlight=False)
        times: list[PairedTimes] = []
        static, moving, _ = scene_pairs(*(QUICK_SIZE if options.quick else TIMED_SIZE))
        paths = {pair.name: pair.store(folder) for pair in (static, moving)}
        if "times" in options.only:
            for preset, motion in TIMED_CASES:
                pair = moving if motion == "objects" else static
                question = request(paths[pair.name], preset, motion)
                name = f"{preset}, {motion}, {pair.name}"
                times.append(measure_interpretation(name, workers, question, options.rounds))
                console.print(name, *times[-1].ratios(), highlight=False)
        if "starts" in options.only:
            question = request(paths[static.name], "balanced", "field")
            rounds = max(options.rounds // 4, 2)
            times += measure_starts(
                checkouts, question, rounds, threads=options.threads, exchange=folder
            )
    conditions = {
        **machine(),
        "threads": options.threads,
        "before": revision(options.before),
        "after": revision(options.after),
    }
    return Findings(conditions=conditions, cases=cases, times=times, missing=missing)


def revision(folder: Path) -> str:
    """Return the commit of a checkout, marked if files differ from it."""
    command = ["git", "-C", str(folder), "describe", "--always", "--dirty", "--exclude=*"]
    try:
        process_result = subprocess.run(command, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return "unknown revision"
    return process_result.stdout.strip()


def main(arguments: list[str] | None = None) -> int:
    """Return 0, 1 if a figure is out of bounds, or 2 if nothing could be compared."""
    options = parse(arguments)
    try:
        findings = measure(options, Console(stderr=True))
    except (OSError, ValueError, RuntimeError, WorkerDied) as error:
        print(f"bench.regression: {error}", file=sys.stderr)
        return 2
    name = options.output or ("smoke-regression" if options.quick else "regression")
    write_results(RESULTS / name, markdown(findings))
    print(markdown(findings))
    return 1 if any(out_of_bounds(findings)) else 0


if __name__ == "__main__":
    sys.exit(main())
