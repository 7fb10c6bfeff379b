"""A process that feeds one reader: ``python -m tests.fuzz.worker``, which ``tests.fuzz`` starts.

It writes a line of JSON with its counts now and then, so that a crash loses few of them. The input
that it is at lies in its folder.
"""

import json
import os
import random
import resource
import signal
import sys
from collections import Counter
from hashlib import sha256
from pathlib import Path

GIB = 2**30
SPACE = 6 * GIB  # of addresses: a header that lies about more ends in a MemoryError
HANG = 60  # s
FINE = ("read", "refused")
EVERY = 500  # inputs from one line to the next


class Feeding:
    """Feeds a reader, counts what came of it, and keeps what is wrong, one of each kind."""

    def __init__(self, name, target, folder, findings, count):
        from tests.fuzz.watching import Watch  # imports tisfm, after atheris has prepared for it

        self._target, self._count, self._watch = target, count, Watch()
        self._findings = findings / name
        self.path = folder / f"input{target.suffix}"
        self.counts = Counter()

    def feed(self, data):
        """Have one input read; True once there were enough."""
        self.path.write_bytes(data)
        found = self._watch.outcome(self._target, self.path)
        self.counts["inputs"] += 1
        self.counts[found if found in FINE else "findings"] += 1
        if found not in FINE:
            self.keep(data, found)
        done = self.counts["inputs"] >= self._count
        if done or self.counts["inputs"] % EVERY == 0:
            print(json.dumps(self.counts), flush=True)
        return done

    def keep(self, data, found):
        kind = "".join(c for c in found[:60] if not c.isdigit())
        mark = sha256(kind.encode()).hexdigest()[:8]
        self._findings.mkdir(parents=True, exist_ok=True)
        file = self._findings / f"{mark}{self._target.suffix or '.bin'}"
        if not file.exists():
            file.write_bytes(data)
            file.with_name(f"{mark}.what").write_text(found)


def plain(feeding, seeds, seed):
    """Feed changed seeds."""
    from tests.fuzz.mutation import mutated

    rng = random.Random(seed)
    done = any([feeding.feed(data) for data in seeds])
    while not done:
        done = feeding.feed(mutated(rng.choice(seeds), seeds, rng))


def guided(feeding, seeds, seed, folder):
    """Feed what atheris makes of them: inputs that reach new code are changed again."""
    import atheris

    from tests.fuzz.mutation import mutated

    corpus = folder / "corpus"
    corpus.mkdir(exist_ok=True)
    for number, data in enumerate(seeds):
        (corpus / f"seed{number}").write_bytes(data)

    def one(data):
        if feeding.feed(data):
            sys.stdout.flush()
            os._exit(0)  # atheris has no other end

    def change(data, longest, seed):
        rng = random.Random(seed)
        if rng.random() < 0.3:
            data = atheris.Mutate(data, longest)
        # Changes of changes are refused at the beginning of a file: some start from a whole one.
        if not data or rng.random() < 0.3:
            data = rng.choice(seeds)
        return mutated(data, seeds, rng)[:longest]

    options = ["-max_len=65536", f"-timeout={HANG}", "-rss_limit_mb=0", f"-seed={seed}"]
    atheris.Setup(["fuzz", *options, str(corpus)], one, custom_mutator=change)
    atheris.Fuzz()


def main():
    name, count, seed, folder, findings, way = sys.argv[1:]
    resource.setrlimit(resource.RLIMIT_AS, (SPACE, SPACE))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    if way == "guided":
        import atheris

        with atheris.instrument_imports(include=["tisfm", "zipfile", "PIL", "numpy.lib"]):
            from tests.fuzz.targets import TARGETS
    else:
        from tests.fuzz.targets import TARGETS
    target, place = TARGETS[name], Path(folder)
    feeding = Feeding(name, target, place, Path(findings), int(count))
    seeds = target.seeds()
    if way == "guided":
        guided(feeding, seeds, int(seed), place)
        return
    signal.signal(signal.SIGALRM, signal.SIG_DFL)  # ends the process, wherever it hangs
    feed = feeding.feed

    def timed(data):
        signal.alarm(HANG)
        return feed(data)

    feeding.feed = timed
    plain(feeding, seeds, int(seed))


if __name__ == "__main__":
    main()
