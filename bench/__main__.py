"""``python -m bench``: times of the kernels and of the NumPy reference, in one table.

Each number of threads has a process of its own, since Taichi cannot change its number of threads.
The timings (JSON of pytest-benchmark), the memory and the table as Markdown are written to
bench/results.
"""

import argparse
import json
import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import get_args

from bench.pair_memory import measure_in_process
from bench.report import (
    LANES,
    LARGE,
    PAIR_SIZE,
    SELECTION,
    SIZE,
    THREADS,
    bars,
    collect,
    show,
    write_markdown,
)
from bench.shared.peer_process import THREAD_VARIABLES
from bench.shared.results import RESULTS, ROOT, wide_console
from tisfm.runtime import ARCHS
from tisfm.settings import Preset

# Package → module, for the packages that run the benchmarks.
RUNNERS = {"pytest": "pytest", "pytest-benchmark": "pytest_benchmark", "pytest-xdist": "xdist"}
PYTEST_FAILED = 1  # exit code of pytest if a test failed
DISAGREEMENT_TEXT = "an answer disagreed with the reference, or a benchmark failed: see above"
FULL_OPTIONS = {
    "sizes": ["240x320", "480x640", "1080x1920"],
    "threads": [1, 2],
    "lanes": ",".join(map(str, dict.fromkeys((LANES, 8, 1)))),
    "only": None,
    "seconds": 0.5,
    "memory": True,
    "contests": False,
    "output": "full",
}
SMOKE_OPTIONS = FULL_OPTIONS | {
    "sizes": ["96x128"],
    "lanes": str(LANES),
    "seconds": 0.05,
    "memory": False,
    "contests": True,
    "output": "smoke",
}
BAR_OPTIONS = FULL_OPTIONS | {
    "sizes": [f"{height}x{width}" for height, width in (PAIR_SIZE, SIZE, LARGE)],
    "threads": [THREADS],
    "lanes": str(LANES),
    "only": SELECTION,
    "seconds": 2.0,
    "output": "bars",
}


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """Read the command line; defaults depend on whether the run is full, smoke or bars."""
    parser = argparse.ArgumentParser(prog="python -m bench", description=__doc__)
    kind = parser.add_mutually_exclusive_group()
    kind.add_argument("--smoke", action="store_true", help="a small size, in about a minute")
    kind.add_argument(
        "--bars", action="store_true", help="only figures with bars; fails if one is missed"
    )
    parser.add_argument("--arch", choices=ARCHS, default="cpu", help="where kernels run")
    parser.add_argument("--sizes", nargs="+", metavar="HxW")
    parser.add_argument("--threads", nargs="+", type=int, metavar="N")
    parser.add_argument(
        "--only", metavar="KEYWORD", help="as for pytest -k; the word memory measures memory"
    )
    parser.add_argument("--full-reference", action="store_true", help="NumPy pairs at every size")
    parser.add_argument("--output", metavar="NAME", help="name of the files in bench/results")
    options = parser.parse_args(arguments)
    options.memory = options.contests = False if options.only else None
    for name, value in (
        SMOKE_OPTIONS if options.smoke else BAR_OPTIONS if options.bars else FULL_OPTIONS
    ).items():
        if getattr(options, name, None) is None:
            setattr(options, name, value)
    # Kernels have one lane on a GPU; memory, bars and contests are for the CPU.
    if options.arch != "cpu":
        if options.bars:
            parser.error("the bars hold for the CPU: leave --arch or --bars out")
        options.lanes, options.memory, options.contests = "1", False, False
        options.threads = [max(options.threads)]
        options.output = f"{options.output}-{options.arch}"
    return options


def missing_runners() -> list[str]:
    """Return the needed packages that are not installed."""
    return [name for name, module in RUNNERS.items() if find_spec(module) is None]


def run_benchmarks(options: argparse.Namespace, threads: int, report: Path) -> int:
    """Run the benchmarks with a number of threads; return the exit code of pytest."""
    command = [sys.executable, "-m", "pytest", str(Path(__file__).parent), "-q", "--tb=short"]
    command += ["-o", "python_files=bench_*.py", "-o", "python_functions=bench_*"]
    command += ["-W", "ignore::DeprecationWarning:taichi._lib.utils"]
    command += ["-n0", "-pno:cacheprovider", "--benchmark-quiet", f"--benchmark-json={report}"]
    command += [f"--threads={threads}", f"--lanes={options.lanes}", f"--seconds={options.seconds}"]
    command += [f"--sizes={','.join(options.sizes)}", f"--arch={options.arch}"]
    if options.full_reference:
        command.append("--full-reference")
    if options.only:
        command += ["-k", f"stream or ({options.only})"]
    # More BLAS threads wait by spinning, and slow down the small systems of the reference.
    environment = os.environ | dict.fromkeys(THREAD_VARIABLES, "1")
    return subprocess.run(command, cwd=ROOT, env=environment, check=False).returncode


def fault_of(code: int) -> str:
    """Return the fault of an exit code of pytest in words; "" for 0."""
    if code == PYTEST_FAILED:
        return DISAGREEMENT_TEXT
    return f"pytest did not run the benchmarks (exit code {code}): see above" if code else ""


def run_smoke_contests() -> bool:
    """Run small contests of peers and settings, and of trust; return whether all succeeded."""
    commands = (
        ["bench.peers"],
        ["bench.ablation", "--preset", "fast", "--only", "warp"],
        ["bench.trust", "--jobs", "1"],
    )
    return all(
        subprocess.run(
            [sys.executable, "-m", *command, "--smoke"], cwd=ROOT, check=False
        ).returncode
        == 0
        for command in commands
    )


def main(arguments: list[str] | None = None) -> int:
    """Return 0, or 1 if an answer disagreed, a method failed or a bar was missed."""
    options = parse(arguments)
    missing = missing_runners()
    if missing:
        print(
            f"python -m bench needs {' and '.join(missing)}, not installed here: "
            "pip install -e '.[test]' in the folder of the sources",
            file=sys.stderr,
        )
        return 1
    RESULTS.mkdir(exist_ok=True)
    faults, reports = [], []
    for threads in options.threads:
        path = RESULTS / f"{options.output}-threads{threads}.json"
        path.unlink(missing_ok=True)
        faults.append(fault_of(run_benchmarks(options, threads, path)))
        if path.exists() and (text := path.read_text(encoding="utf-8")):
            reports.append(json.loads(text))
    memory: dict[str, float] = {}
    if options.memory or "memory" in (options.only or ""):
        memory = {preset: measure_in_process(preset) for preset in get_args(Preset)}
        path = RESULTS / f"{options.output}-memory.json"
        path.write_text(json.dumps(memory, indent=1), encoding="utf-8")

    results = collect(reports, memory)
    # Without --bars, the bars of all measured figures are shown.
    shown_bars = [bar for bar in bars(results) if options.bars or bar.value is not None]
    console = wide_console()
    show(results, console)
    for bar in shown_bars:
        console.print(str(bar), highlight=False)
    write_markdown(
        results, RESULTS / f"{options.output}.md", notes=[str(bar) for bar in shown_bars]
    )
    are_contests_complete = run_smoke_contests() if options.contests else True
    for fault in dict.fromkeys(filter(None, faults)):
        console.print(fault, highlight=False)
    return (
        0
        if not any(faults) and are_contests_complete and all(bar.is_met for bar in shown_bars)
        else 1
    )


if __name__ == "__main__":
    sys.exit(main())
