"""Give the library random small frames: ``python -m tests.fuzz.frames --seconds 600``.

Every case has a number, from which all of it follows: ``--seed 1 --case 1234`` runs one again.
"""

import argparse
import contextlib
import faulthandler
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections import Counter, defaultdict

LIMIT = 240  # s a case may take where others work beside it; the first of a process twice that
SLOW, LEAST_SLOW = 10, 1.0  # times the median of its like, and s: what is reported
SHOWN = 5  # slowest cases
PROGRAM = (sys.executable, "-m", "tests.fuzz.frames")
LIKE = 5  # cases, from which a median is told


def main(arguments=None):
    """Run it; 1 if anything was wrong, or slow."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz.frames", description=__doc__)
    parser.add_argument("--seconds", type=float, default=60, help="how long to go on")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    parser.add_argument("--case", type=int, help="one case alone, with all that is known of it")
    parser.add_argument("--entry", choices=("interpret", "sequence", "reconstruct", "stream"))
    parser.add_argument("--motion", choices=("field", "camera", "objects"))
    parser.add_argument("--limit", type=float, default=LIMIT, help="s that a case may take")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--worker", action="store_true", help=argparse.SUPPRESS)
    chosen = parser.parse_args(arguments)
    if chosen.case is not None:
        return one(chosen)
    if chosen.worker:
        return work(chosen)
    return watch(chosen)


def one(chosen):
    """Run a case and let what is wrong be raised."""
    from tests.fuzz.frame_cases import drawn, run
    from tisfm import runtime

    runtime.start(threads=chosen.threads)
    case = drawn(chosen.seed, chosen.case)
    print(case, flush=True)
    began = time.process_time()
    print(run(case), f"{time.process_time() - began:.2f} s")
    return 0


def work(chosen):
    """Run case after case, with a line of JSON before and after each."""
    from tests.fuzz.frame_cases import WAYS, drawn
    from tisfm import runtime

    runtime.start(threads=chosen.threads)
    errors = os.dup(2)  # what is said to standard error is looked at
    faulthandler.enable(errors)
    ways = [
        (entry, motion)
        for entry, motion in WAYS
        if chosen.entry in (None, entry) and chosen.motion in (None, motion)
    ]
    number, end, limit = chosen.first, time.monotonic() + chosen.seconds, 2 * chosen.limit
    while time.monotonic() < end:
        case = drawn(
            chosen.seed, number, way=None if ways == list(WAYS) else ways[number % len(ways)]
        )
        print(json.dumps({"begun": number, "like": like(case)}), flush=True)
        faulthandler.dump_traceback_later(limit, exit=True, file=errors)
        with said() as text:
            took, found = timed(case)
            if took > LEAST_SLOW and found == "result":  # kernels are compiled by now
                faulthandler.dump_traceback_later(limit, exit=True, file=errors)
                took = min(took, timed(case)[0])
        faulthandler.cancel_dump_traceback_later()
        if text and found == "result":
            found = f"wrong: it writes to standard error: {text[0][:300]}"
        print(json.dumps({"number": number, "found": found, "took": took}), flush=True)
        number, limit = number + 1, chosen.limit


def timed(case):
    """Return the time of the processor that a case takes, s, and what came of it."""
    from tests.fuzz.frame_cases import outcome

    began = time.process_time()
    found = outcome(case)
    return time.process_time() - began, found


@contextlib.contextmanager
def said():
    """Collect what is written to standard error, by libraries in C as well."""
    lines = []
    with tempfile.TemporaryFile() as file:
        kept = os.dup(2)
        os.dup2(file.fileno(), 2)
        try:
            yield lines
        finally:
            os.dup2(kept, 2)
            os.close(kept)
            file.seek(0)
            lines += file.read().decode("utf-8", "replace").strip().splitlines()


def like(case):
    """Return what cases that take about as long have in common."""
    from tests.fuzz.frame_cases import SCENES

    pixels = case.shape[0] * case.shape[1]
    size = "small" if pixels < 1000 else "middle" if pixels < 8000 else "large"
    more = " scene" * (case.kind in SCENES) + " changed" * bool(case.changes)
    return f"{case.entry} {case.motion} {case.preset} {size}{more}"


def watch(chosen):
    """Have a process run cases, another one where it ends too early, and tell what came of it."""
    counts, times, wrong = Counter(), defaultdict(list), []
    number, end = chosen.first, time.monotonic() + chosen.seconds
    while (left := end - time.monotonic()) > 0:
        command = [*PROGRAM, "--worker", "--seconds", str(left)]
        command += ["--seed", str(chosen.seed), "--first", str(number)]
        command += ["--threads", str(chosen.threads), "--limit", str(chosen.limit)]
        for name in ("entry", "motion"):
            if getattr(chosen, name):
                command += [f"--{name}", getattr(chosen, name)]
        begun = None
        with tempfile.TemporaryFile() as errors:
            process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=errors)
            for line in process.stdout:
                told = json.loads(line)
                if "begun" in told:
                    begun, kind, number = told["begun"], told["like"], told["begun"] + 1
                    continue
                begun = None
                found = told["found"].split(":")[0]
                counts[f"{' '.join(kind.split()[:3])}", found] += 1
                times[kind].append((told["took"], told["number"]))
                if found == "wrong":
                    wrong.append(told["number"])
                    print(f"case {told['number']}: {kind}: {told['found']}", flush=True)
            process.wait()
            if begun is not None:
                errors.seek(0)
                text = errors.read().decode("utf-8", "replace")
                wrong.append(begun)
                counts[f"{' '.join(kind.split()[:3])}", "ended"] += 1
                print(f"case {begun}: {kind}: ended {process.returncode}\n{text}", flush=True)
            elif process.returncode:
                return process.returncode
    return report(counts, times, wrong, number - chosen.first)


def report(counts, times, wrong, total):
    """Print counts and the slowest; 1 if anything was wrong."""
    for kind in sorted({kind for kind, _ in counts}):
        print(f"{kind:32}", *(f"{f} {n}" for (k, f), n in sorted(counts.items()) if k == kind))
    slow = []
    for kind, each in times.items():
        middle = statistics.median(took for took, _ in each)
        if len(each) >= LIKE:
            slow += [
                (took, number, kind, middle)
                for took, number in each
                if took > max(SLOW * middle, LEAST_SLOW)
            ]
    for took, number, kind, middle in sorted(slow, reverse=True):
        print(f"slow: case {number}: {kind}: {took:.1f} s, the median of such is {middle:.2f} s")
    every = sorted(((*each, kind) for kind, all_ in times.items() for each in all_), reverse=True)
    for took, number, kind in every[:SHOWN]:
        print(f"slowest: case {number}: {kind}: {took:.1f} s")
    print(f"{total} cases, {len(wrong)} wrong, {len(slow)} slow")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
