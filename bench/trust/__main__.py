"""``python -m bench.trust``: whether results that are reported as good are right.

Sequences and pairs, right and wrong on purpose: rendered scenes with overlays, zoom, lenses, light,
noise, planes, turns, mirrors, cuts, traffic and rolling shutters, and real sequences with a right,
an unknown and a wrong focal length. Results are judged by the truth. All numbers and the tables are
written to bench/results; a case is run again only if the code has changed since, or with --again.
"""

import argparse
import hashlib
import json
import os
import queue
import sys
import tempfile
import threading
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from bench.shared.command import Parser, options_parser, progress
from bench.shared.peer_process import THREAD_VARIABLES
from bench.shared.results import RESULTS, ROOT, machine, wide_console, write_results
from bench.shared.sequences import data_folder
from bench.shared.worker import Worker, WorkerDied
from bench.trust.cases import Case, all_cases, by_film, smoke_cases
from bench.trust.report import count_table, is_false_alarm, is_missed, report

# Code that does not decide the results: folders of tisfm, and modules of this bench.
UNRELATED = ("cli", "doctor", "evaluation", "exports", "report", "running", "show", "view")
UNRELATED_MODULES = (
    "__init__.py", "__main__.py", "against_pairs.py", "cases.py", "report.py",
)  # fmt: skip
TIMEOUT = 1800.0  # s for a case on a busy machine
FORMAT = 2  # of a record; older records are dropped


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser: Parser = options_parser("trust", __doc__, "data", "smoke", "output")
    add = parser.add_argument
    add("--only", nargs="+", metavar="WORD", help="cases with a WORD in the name")
    add("--half", choices=("A", "B"), help="cases of one half of the scenes")
    add("--jobs", type=int, default=2, metavar="N", help="processes, with one thread each")
    add("--again", action="store_true", help="run cases whose results are known, too")
    add("--table", action="store_true", help="only write the tables of known results")
    return parser.parse_args(arguments)


def code_digest() -> str:
    """Return a digest of the code that decides the results."""
    digest = hashlib.sha256()
    library, bench = ROOT / "tisfm", Path(__file__).parent
    files = [
        path
        for path in library.rglob("*.py")
        if path.relative_to(library).parts[0] not in UNRELATED
    ]
    files += [path for path in bench.glob("*.py") if path.name not in UNRELATED_MODULES]
    for path in sorted(files):
        digest.update(path.relative_to(ROOT).as_posix().encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()[:12]


def choose(options: argparse.Namespace) -> list[Case]:
    """Return the cases that the options name."""
    cases = smoke_cases() if options.smoke else all_cases()
    return [
        case
        for case in cases
        if (options.half is None or case.half == options.half)
        and (options.only is None or any(word in case.name for word in options.only))
    ]


def describe(case: Case) -> dict[str, Any]:
    """Return what the tables say of a case, beside its verdict."""
    return {
        "name": case.name,
        "task": case.task,
        "kind": case.kind,
        "clean": case.is_clean,
        "flag due": case.kind == "pan",
        "half": case.half,
        "real": case.clip is not None,
    }


def read_records(path: Path) -> dict[str, Any]:
    """Return the stored records of cases that still exist, by name."""
    if not path.is_file():
        return {}
    stored = json.loads(path.read_text(encoding="utf-8"))
    verdicts = {r["name"]: r for r in stored["cases"] if r.get("format") == FORMAT}
    return {
        case.name: verdicts[case.name] | describe(case)
        for case in all_cases()
        if case.name in verdicts
    }


def run_cases(cases: Sequence[Case], options: argparse.Namespace, keep: Any) -> None:
    """Run the cases in worker processes, film by film; call ``keep(case, answer)`` for each."""
    groups: queue.SimpleQueue[list[Case]] = queue.SimpleQueue()
    for group in by_film(list(cases)):
        groups.put(group)
    environment = os.environ | dict.fromkeys(THREAD_VARIABLES, "1")
    if options.data is not None:
        environment["TISFM_DATA"] = str(options.data)

    def work(number: int, folder: Path) -> None:
        worker = Worker(
            [sys.executable, "-m", "bench.trust.worker"],
            environment=environment,
            messages=folder / f"{number}.txt",
            folder=ROOT,
            timeout=TIMEOUT,
        )
        try:
            while True:
                try:
                    group = groups.get_nowait()
                except queue.Empty:
                    return
                for case in group:
                    try:
                        answer = worker.ask({"case": case.name, "smoke": options.smoke})
                    except WorkerDied as death:
                        answer = {"failure": str(death)}
                    keep(case, answer)
        finally:
            worker.close()

    with (
        tempfile.TemporaryDirectory(prefix="tisfm-trust-") as folder,
        ThreadPoolExecutor(options.jobs) as pool,
    ):
        for done in [pool.submit(work, k, Path(folder)) for k in range(options.jobs)]:
            done.result()


def main(arguments: Sequence[str] | None = None) -> int:
    """Return 0, 1 if a case failed to run, or 2 if nothing could be run."""
    options = parse(arguments)
    path = RESULTS / (options.output or ("smoke-trust" if options.smoke else "trust"))
    cases = choose(options)
    data = None if options.smoke else data_folder(options.data)
    missing = []
    if data is None and not options.smoke:
        missing = sorted(
            {f"{c.scene}: no folder of sequences named" for c in cases if c.clip is not None}
        )
    else:
        absent = (
            {c.scene for c in cases if c.clip is not None and not (data / c.scene).is_dir()}
            if data
            else set()
        )
        missing = sorted(f"{scene}: no such folder in {data}" for scene in absent)
        cases = [case for case in cases if case.scene not in absent]
    if data is None:
        cases = [case for case in cases if case.clip is None]
    if not cases:
        print("bench.trust: no case has these words in its name", file=sys.stderr)
        return 2
    options.data = data
    digest = code_digest()
    records = {} if options.smoke else read_records(path.with_suffix(".json"))
    waiting = [
        case for case in cases if options.again or records.get(case.name, {}).get("code") != digest
    ]
    if options.table:
        waiting = []
    known = set(records)
    lock = threading.Lock()

    def page() -> str:
        stale = sum(record["code"] != digest for record in records.values())
        conditions = {
            **machine(),
            "code": digest,
            "cases": f"{len(records)}, of which {stale}, with a star, ran with earlier code",
        }
        return report(list(records.values()), conditions, missing)

    with progress(len(waiting)) as step:

        def keep(case: Case, answer: dict[str, Any]) -> None:
            with lock:
                step(case.name)
                record = {**describe(case), "format": FORMAT, "code": digest, **answer}
                records[case.name] = record
                write_results(path, page(), {"code": digest, "cases": list(records.values())})

        for is_known in (False, True):  # cases without a result come first
            run_cases([c for c in waiting if (c.name in known) == is_known], options, keep)
    write_results(path, page(), {"code": digest, "cases": list(records.values())})
    chosen = [records[case.name] for case in cases if case.name in records]
    judged = [record for record in chosen if "failure" not in record]
    console = wide_console()
    console.print(count_table(judged).rich())
    for title, is_listed in (("wrong and green", is_missed), ("right and flagged", is_false_alarm)):
        for record in filter(is_listed, judged):
            console.print(f"{title}: {record['name']}", highlight=False, markup=False)
    failed = [record for record in chosen if "failure" in record]
    for record in failed:
        console.print(f"FAILED: {record['name']}: {record['failure']}", markup=False)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
