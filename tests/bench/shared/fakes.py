"""Methods and pairs for contests, with flow and times that are made up."""

import numpy as np

from bench.shared.contest import Call, MethodFailure, run_contest
from bench.shared.sequences import FlowPair

SIZE = (48, 64)


def flow_pair(name="Grove2", group="middlebury", size=SIZE):
    frame = np.random.default_rng(0).integers(0, 256, size, dtype=np.uint8)
    truth = np.zeros((*size, 2))
    return FlowPair(name=name, group=group, frame0=frame, frame1=frame, truth=truth)


class Fake:
    """Flow off by a constant, in a time that is made up: call k takes seconds · (k + 1)."""

    def __init__(self, name, log, *, error=1.0, seconds=1e-3, fails_on=""):
        self.name, self.log, self.error, self.seconds = name, log, error, seconds
        self.fails_on, self.calls = fails_on, 0

    def run(self, pair):
        self.log.append((self.name, pair.name))
        if pair.name == self.fails_on:
            raise MethodFailure("broken")
        self.calls += 1
        seconds = self.seconds * self.calls
        flow = np.full((*pair.size, 2), [self.error, 0.0])
        return Call(flow=flow, seconds=seconds, cpu=2 * seconds)


def contest(methods, pairs, rounds=2):
    conditions = {"threads": 2}
    reference = methods[0].name
    return run_contest(
        methods, pairs, reference=reference, rounds=rounds, conditions=conditions, missing={}
    )
