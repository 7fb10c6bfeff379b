"""Feed readers with damaged and hostile files: ``python -m tests.fuzz --count 100000``."""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from importlib.util import find_spec
from pathlib import Path

from tests.fuzz.targets import TARGETS

SLOW = 50  # times fewer inputs for readers that take milliseconds
CRASHES = 20  # after which a reader gets no more


def main() -> int:
    """Run it; 1 if anything was found."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--count", type=int, default=10_000, help="inputs per reader")
    parser.add_argument("--target", action="append", choices=sorted(TARGETS), help="by default all")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    parser.add_argument(
        "--findings", type=Path, default=Path("build/fuzz"), help="where they are kept"
    )
    parser.add_argument(
        "--plain", action="store_true", help="without coverage, as where atheris is not installed"
    )
    chosen = parser.parse_args()
    way = "plain" if chosen.plain or find_spec("atheris") is None else "guided"
    chosen.findings.mkdir(parents=True, exist_ok=True)

    def of(name: str) -> tuple[str, Counter[str]]:
        count = chosen.count // SLOW if TARGETS[name].slow else chosen.count
        counts = fed(name, max(1, count), chosen.seed, chosen.findings, way)
        print(f"{name:20}", *(f"{key} {n:,}" for key, n in counts.items()), flush=True)
        return name, counts

    with ThreadPoolExecutor(chosen.jobs) as pool:
        results = dict(pool.map(of, chosen.target or TARGETS))
    total: Counter[str] = sum(results.values(), Counter())
    print(f"{'all':20}", *(f"{key} {n:,}" for key, n in total.items()), f"({way})")
    (chosen.findings / "counts.json").write_text(json.dumps({"way": way, **results}, indent=1))
    return 1 if total["findings"] else 0


def fed(name: str, count: int, seed: int, findings: Path, way: str) -> Counter[str]:
    """Return the counts of so many inputs; where a process ends too early, another goes on."""
    counts: Counter[str] = Counter()
    for attempt in range(CRASHES):
        folder = Path(tempfile.mkdtemp(prefix="fuzz"))
        left = count - counts["inputs"]
        command = [sys.executable, "-m", "tests.fuzz.worker", name, str(left)]
        command += [str(seed * CRASHES + attempt), str(folder), str(findings), way]
        process = subprocess.run(command, capture_output=True)
        lines = [line for line in process.stdout.splitlines() if line.startswith(b"{")]
        counts.update(json.loads(lines[-1]) if lines else {})
        if process.returncode == 0:
            shutil.rmtree(folder, ignore_errors=True)
            break
        counts["findings"] += 1
        place = findings / name
        place.mkdir(parents=True, exist_ok=True)
        for file in folder.glob("input*"):
            shutil.copyfile(file, place / f"crash{seed}_{attempt}{file.suffix}")
        text = process.stderr[-4000:].decode("utf-8", "replace")
        (place / f"crash{seed}_{attempt}.what").write_text(f"ended {process.returncode}\n{text}")
        shutil.rmtree(folder, ignore_errors=True)
    return counts


if __name__ == "__main__":
    sys.exit(main())
