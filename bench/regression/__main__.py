"""``python -m bench.regression --before CHECKOUT``: this code beside that of another checkout.

Both interpret the same pairs in processes of their own, on the same threads, and the answers are
set side by side: rendered scenes, and the real ones of ``--data`` or TISFM_DATA. Then both are
timed in turns, and their starts. The tables are left in bench/results.
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

from bench.regression.checkout import Checkout, Paired, interpretation, starts
from bench.regression.pairs import QUICK_SIZE, SIZE, TIMED_SIZE, Pair, recorded, rendered
from bench.regression.report import Case, Findings, difference, markdown, out_of_bounds
from bench.shared.contest_command import check_counts, choose
from bench.shared.results import RESULTS, ROOT, machine
from bench.shared.sequences import data_folder
from bench.shared.worker import Worker, WorkerDied
from tisfm.settings import Preset

PARTS = ("answers", "times", "starts")
POSE_GIVEN = "camera, pose given"
MOTIONS = ("field", "camera", POSE_GIVEN, "objects")
TIMED = (
    ("fast", "field"),
    ("balanced", "field"),
    ("accurate", "field"),
    ("balanced", "camera"),
    ("balanced", "objects"),
)
QUICK_ROUNDS = 3


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(prog="python -m bench.regression", description=__doc__)
    parser.add_argument("--before", type=Path, required=True, metavar="DIR", help="checkout")
    parser.add_argument("--after", type=Path, default=ROOT, metavar="DIR", help="default: this one")
    parser.add_argument("--python-before", metavar="PATH", help="its interpreter; default: this")
    parser.add_argument("--only", nargs="+", choices=PARTS, default=list(PARTS))
    presets = list(get_args(Preset))
    parser.add_argument("--preset", nargs="+", choices=presets, default=presets, metavar="PRESET")
    parser.add_argument("--motion", nargs="+", choices=MOTIONS, default=list(MOTIONS))
    parser.add_argument("--pairs", nargs="+", metavar="WORD", help="pairs with a WORD in the name")
    parser.add_argument("--data", type=Path, metavar="DIR", help="sequences; default: TISFM_DATA")
    parser.add_argument("--threads", type=int, default=2, metavar="N")
    parser.add_argument("--rounds", type=int, default=20, metavar="N", help="of every timing")
    parser.add_argument("--quick", action="store_true", help="small scenes, no data, three rounds")
    parser.add_argument("--output", metavar="NAME", help="name of the file in bench/results")
    options = parser.parse_args(arguments)
    check_counts(parser, options)
    for folder in (options.before, options.after):
        if not (folder / "tisfm" / "__init__.py").is_file():
            parser.error(f"{folder} is no checkout of this project: it has no tisfm/__init__.py")
    if options.quick:
        options.rounds = QUICK_ROUNDS
    return options


def find_pairs(options: argparse.Namespace) -> tuple[list[Pair], dict[str, str]]:
    """Return the pairs that the options ask for, and why others are missing."""
    pairs = rendered(*(QUICK_SIZE if options.quick else SIZE))
    missing: dict[str, str] = {}
    data = None if options.quick else data_folder(options.data)
    if data is not None:
        real, missing = recorded(data)
        pairs += real
    return choose(pairs, options.pairs, what="pair", name=lambda pair: pair.name), missing


def request(pair: Path, preset: str, motion: str, answer: Path | None = None) -> dict[str, Any]:
    """Return what a worker is asked."""
    return {
        "pair": str(pair),
        "settings": {"name": preset, "motion": motion.partition(",")[0]},
        "pose": motion == POSE_GIVEN,
        "answer": None if answer is None else str(answer),
        "times": 1,
    }


def compare(workers: Sequence[Worker], pair: Pair, preset: str, motion: str, path: Path) -> Case:
    """Let both sides interpret a pair; return how the answers differ."""
    answers = [path.with_name(f"answer-{side}.npz") for side in (0, 1)]
    statuses = []
    for worker, answer in zip(workers, answers, strict=True):
        answer.unlink(missing_ok=True)
        try:
            statuses.append(worker.ask(request(path, preset, motion, answer))["status"])
        except WorkerDied as death:
            statuses.append(str(death))
    answered = all(answer.exists() for answer in answers)
    return Case(
        pair=pair.name,
        preset=preset,
        motion=motion,
        before=statuses[0],
        after=statuses[1],
        difference=difference(*answers) if answered else None,
    )


def measure(options: argparse.Namespace, console: Console) -> Findings:
    """Do what the options ask for."""
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
        times: list[Paired] = []
        static, moving, _ = rendered(*(QUICK_SIZE if options.quick else TIMED_SIZE))
        paths = {pair.name: pair.store(folder) for pair in (static, moving)}
        if "times" in options.only:
            for preset, motion in TIMED:
                pair = moving if motion == "objects" else static
                asked = request(paths[pair.name], preset, motion)
                name = f"{preset}, {motion}, {pair.name}"
                times.append(interpretation(name, workers, asked, options.rounds))
                console.print(name, *times[-1].ratios(), highlight=False)
        if "starts" in options.only:
            asked = request(paths[static.name], "balanced", "field")
            rounds = max(options.rounds // 4, 2)
            times += starts(checkouts, asked, rounds, threads=options.threads, exchange=folder)
    conditions = {
        **machine(),
        "threads": options.threads,
        "before": revision(options.before),
        "after": revision(options.after),
    }
    return Findings(conditions=conditions, cases=cases, times=times, missing=missing)


def revision(folder: Path) -> str:
    """Return the commit of a checkout, and whether files differ from it, where git knows."""
    command = ["git", "-C", str(folder), "describe", "--always", "--dirty", "--exclude=*"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return "unknown revision"
    return done.stdout.strip()


def main(arguments: list[str] | None = None) -> int:
    """Return 0, 1 where something is out of bounds, or 2 where nothing could be compared."""
    options = parse(arguments)
    try:
        found = measure(options, Console(stderr=True))
    except (OSError, ValueError, RuntimeError, WorkerDied) as error:
        print(f"bench.regression: {error}", file=sys.stderr)
        return 2
    RESULTS.mkdir(exist_ok=True)
    name = options.output or ("smoke-regression" if options.quick else "regression")
    (RESULTS / f"{name}.md").write_text(markdown(found), encoding="utf-8")
    print(markdown(found))
    return 1 if any(out_of_bounds(found)) else 0


if __name__ == "__main__":
    sys.exit(main())
