"""What whole pairs are held to as they grow: by the times and the memory of one run."""

import math
from collections.abc import Iterator
from statistics import median
from typing import Any

from bench.shared.bar import Bar

FLOAT = 4  # bytes
GIB = 2**30
MIDDLE, LARGE, LARGEST = "480x640", "1080x1920", "2160x3840"
PEER_SIZE = MIDDLE  # of the pair that OpenCV's DIS is timed on
# None: its time is as long as the bar was, so that passing would be chance; `bench.regression`
# tells whether it has grown.
MOST_OVER_PEER = {("balanced", LARGE): 57.0, ("fast", PEER_SIZE): None}
MOST_GROWTH = 1.15
MOST_GIB = 3.0


def size_of(text: str) -> tuple[int, int]:
    """Return (height, width) of a size as the command line has it."""
    height, _, width = text.partition("x")
    return int(height), int(width)


def per_pixel(entry: dict[str, Any], size: str) -> float:
    """Return the median time of a run's pair, ns per pixel."""
    return median(entry["times"][size]) / math.prod(size_of(size)) * 1e9


def over_peer(entry: dict[str, Any], size: str) -> float:
    """Return the time of a run's pair over that of the peer in the same round, the median."""
    return over(entry["times"][size], entry["peer"]["times"])


def over(times: list[float], others: list[float]) -> float:
    """Return the median of the ratios of times in the same rounds."""
    return median(time / other for time, other in zip(times, others, strict=True))


def gib(floats: float, size: str) -> float:
    """Return the GiB of so many float32 per pixel."""
    return floats * FLOAT * math.prod(size_of(size)) / GIB


def bars(found: dict[str, Any]) -> Iterator[Bar]:
    """Yield the bars of what the run has measured, on the most threads."""
    most = max(entry["threads"] for entry in found["runs"])
    for entry in found["runs"]:
        if entry["threads"] != most:
            continue
        preset = entry["preset"]
        for (held, size), bound in MOST_OVER_PEER.items():
            if held == preset and size in entry["times"] and entry["peer"]["size"] == PEER_SIZE:
                name = f"{preset}, {size}, {most} threads, time over {entry['peer']['name']}'s at "
                yield Bar(name + PEER_SIZE, over_peer(entry, size), bound)
        if {MIDDLE, LARGE} <= set(entry["times"]):
            growth = over(entry["times"][LARGE], entry["times"][MIDDLE])
            growth *= math.prod(size_of(MIDDLE)) / math.prod(size_of(LARGE))
            name = f"{preset}, {most} threads, growth of time per pixel, {MIDDLE} to {LARGE}"
            yield Bar(name, growth, MOST_GROWTH)
        if LARGEST in found["memory"].get(preset, {}):
            used = gib(found["memory"][preset][LARGEST], LARGEST)
            yield Bar(f"{preset}, {LARGEST}, peak memory, GiB", used, MOST_GIB)
