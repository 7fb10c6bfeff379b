"""A short run of every reader: `python -m tests.fuzz` runs longer ones."""

import random
from pathlib import Path

import pytest

from tests.fuzz import watching
from tests.fuzz.mutation import mutated, repaired
from tests.fuzz.targets import TARGETS, Target
from tests.fuzz.watching import READ, REFUSED, Watch
from tisfm.formats import FormatError

SLOW_SHARE = 50  # of a slow reader's inputs, one in so many is tried


@pytest.mark.parametrize("inputs", [100, pytest.param(4000, marks=pytest.mark.nightly)])
@pytest.mark.parametrize("name", TARGETS)
def test_data_or_a_clear_error(name, inputs, tmp_path):
    if name == "av_video":
        pytest.importorskip("av")
    target, watch, rng = TARGETS[name], Watch(), random.Random(3)
    path, seeds = tmp_path / f"input{target.suffix}", TARGETS[name].seeds()
    for data in seeds:
        path.write_bytes(data)
        assert watch.outcome(target, path) == READ
    for number in range(inputs // SLOW_SHARE if target.slow else inputs):
        path.write_bytes(data := mutated(rng.choice(seeds), seeds, rng))
        found = watch.outcome(target, path)
        assert found in (READ, REFUSED), (number, data)


def raises(error):
    def read(path):
        raise error(f"{path} is bad")

    return read


def long(path):
    sum(range(10**7))


def large(path):
    """Hold 256 MiB more than the process has ever held."""
    held, enough = [], watching.peak() + 2**28
    while watching.peak() < enough:
        held.append(b"\1" * 2**24)


@pytest.mark.parametrize(
    ("read", "word"),
    [
        (len, "raised TypeError"),
        (lambda path: None, READ),
        (raises(FormatError), REFUSED),
        (raises(ZeroDivisionError), "raised ZeroDivisionError"),
        (lambda path: raises(FormatError)("a"), "unclear"),
        (long, "slow"),
        (large, "memory"),
    ],
)
def test_broken_promises_are_found(read, word, tmp_path):
    if read is large and watching.resource is None:
        pytest.skip("memory is not watched on this system")
    target = Target(read=read, seeds=list, seconds=0.05 if read is long else 10)
    path: Path = tmp_path / "input"
    assert Watch().outcome(target, path).startswith(word)


@pytest.mark.parametrize("name", ["depth_png", "depth_of_frame"])
def test_mutations_repair_check_sums(name, tmp_path):
    target = TARGETS[name]
    (whole,) = target.seeds()
    assert repaired(whole) == whole
    changed = whole.replace(b"tisfm:depth", b"tisfm:DEPTH").replace(b"\0\x3c", b"\0\x3d")
    assert changed != whole
    found = []
    for data in (changed, repaired(changed)):
        path = tmp_path / "input"
        path.write_bytes(data)
        try:
            target.read(path)
            found.append("")
        except FormatError as error:
            found.append(str(error))
    assert found[0] != found[1] and "CRC" not in found[1]
