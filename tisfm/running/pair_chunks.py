"""A part of a run that another process does: pairs that follow one another."""

import atexit
import os
import threading
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from time import perf_counter
from typing import Any

from tisfm import runtime
from tisfm.errors import is_user_error
from tisfm.folders.result_folder import InputFiles
from tisfm.folders.run_record import is_unchanged
from tisfm.running.pair_files import Ranges, Sums
from tisfm.running.pairs import PairSource, PairWork
from tisfm.running.worker import check_worker, stated
from tisfm.runtime import Arch
from tisfm.sources import FramePair, FrameSource, Listing, Source
from tisfm.version import __version__

_NO_END = 2**62
_LONGEST = 32  # pairs: what is lost when a process is killed
_EACH = 4  # parts for each process at least, so that none waits long for the last one


@dataclass(frozen=True, kw_only=True)
class Chunk:
    """Pairs of a run, and all that is needed to interpret and write them.

    Attributes
    ----------
    source : PairSource
    work : PairWork
    first, end : int
        Numbers of the first pair, and of the first that is not of this part any more. The last part
        has no end: a video may have more frames than it says.
    arch, threads
        As for `tisfm.runtime.start`.
    ranges : Ranges or None
        What pictures are drawn in.
    known : mapping
        What an earlier run says of pairs that it finished, by their names.
    listing : Listing
        Of the files of the source, as the run sees it.
    alive : Path
        A file that is there as long as the run.
    lanes : int
        Of the vectors of the run's CPU.
    version : str
        Of tisfm.
    """

    source: PairSource
    work: PairWork
    first: int
    end: int
    arch: Arch | None
    threads: int | None
    listing: Listing
    ranges: Ranges | None = None
    known: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    alive: Path = Path()
    lanes: int = field(default_factory=runtime.cpu_lanes)
    version: str = __version__

    def anywhere(self) -> "Chunk":
        """Return it with paths that do not depend on the working folder."""
        source = self.source
        files = replace(self.work.files, folder=self.work.files.folder.absolute())
        whole = replace(
            source,
            source=_absolute(source.source),
            mask=None if source.mask is None else os.path.abspath(source.mask),
            poses=None if source.poses is None else source.poses.absolute(),
        )
        return replace(self, source=whole, work=replace(self.work, files=files))


@dataclass(frozen=True, kw_only=True)
class FinishedPair:
    """What the record says of a pair, and of its files, and how long it took.

    `about` is None if an earlier run finished it.
    """

    name: str
    about: Mapping[str, Any] | None = None
    sums: Sums | None = None
    seconds: float = 0.0


@dataclass(frozen=True, kw_only=True)
class FinishedChunk:
    """What was done of a chunk.

    Attributes
    ----------
    pairs : list of FinishedPair
    skipped : list of (int, str)
        Frames that the process has skipped so far, and why.
    error : Exception or None
        What ended it early.
    """

    pairs: list[FinishedPair]
    skipped: list[tuple[int, str]]
    error: Exception | None = None


def _absolute(source: Source) -> Source:
    """Return a path, or several, from the root of the file system."""
    if isinstance(source, (str, os.PathLike)):
        return os.path.abspath(source)
    return [os.path.abspath(path) for path in source]  # type: ignore[arg-type]


def chunks_of(whole: Chunk, workers: int) -> list[Chunk]:
    """Return the parts that processes take in turns, of a chunk of all that is left."""
    bare = replace(whole.work.files, inputs=InputFiles())  # each process looks at them itself
    whole = replace(whole, work=replace(whole.work, files=bare))
    count = whole.end - whole.first
    length = max(1, min(_LONGEST, -(-count // (_EACH * workers))))
    ends = [*range(whole.first + length, whole.end, length), _NO_END]
    begins = [whole.first, *ends[:-1]]
    return [replace(whole, first=first, end=end) for first, end in zip(begins, ends, strict=True)]


def interpret_chunk(chunk: Chunk) -> FinishedChunk:
    """Interpret and write the pairs of a chunk."""
    done: list[FinishedPair] = []
    reading: _Reading | None = None
    error: Exception | None = None
    try:
        here = runtime.cpu_lanes() if chunk.arch in (None, "cpu") else chunk.lanes
        check_worker(chunk.version, chunk.alive, lanes=chunk.lanes, here=here)
        runtime.start_worker(chunk.arch, threads=chunk.threads)
        reading = _reading(chunk)
        while (pair := reading.next_of(chunk)) is not None and chunk.alive.exists():
            done.append(_finished(chunk, pair, reading.inputs))
            del pair
        if not chunk.alive.exists():
            _forget_reading()  # no other chunk of this run will come
    except Exception as raised:
        _forget_reading()
        if not is_user_error(raised):
            raise
        error = stated(raised)  # what is done is not lost
    skipped = [] if reading is None else list(reading.skipped)
    return FinishedChunk(pairs=done, skipped=skipped, error=error)


def _finished(chunk: Chunk, pair: FramePair, inputs: InputFiles) -> FinishedPair:
    number = chunk.source.number(pair)
    files = replace(chunk.work.files, inputs=inputs)
    known = chunk.known.get(pair.name0)
    if known is not None and is_unchanged(
        files.folder, pair.name0, known, pair.digest, files.endings(number)
    ):
        return FinishedPair(name=pair.name0)
    begin = perf_counter()
    result = chunk.work.interpret(pair)
    seconds = perf_counter() - begin
    about, sums = files.write(
        pair.name0, result, ranges=chunk.ranges, **chunk.work.about(pair, number)
    )
    return FinishedPair(name=pair.name0, about=about, sums=sums, seconds=seconds)


class _Reading:
    """The pairs of a source from one on, of which a process takes some and leaves others."""

    def __init__(self, chunk: Chunk) -> None:
        frames = chunk.source.frames
        seen = FrameSource(chunk.source.source, stop=frames.stop)  # before all that depends on it
        chunk.listing.check(seen.listing, seen.title)
        begin = frames.start + chunk.first * frames.step
        self._whole = chunk.source
        opened, self._pairs = replace(chunk.source, frames=replace(frames, start=begin)).open()
        opened.allow_no_pairs()
        self._opened = opened
        self._waiting: FramePair | None = None
        self.alive = chunk.alive
        self.position = chunk.first
        poses = [] if chunk.source.poses is None else [chunk.source.poses]
        self.inputs = InputFiles([*opened.files, *poses])

    @property
    def skipped(self) -> list[tuple[int, str]]:
        """Frames that were skipped so far."""
        return self._opened.skipped

    def next_of(self, chunk: Chunk) -> FramePair | None:
        """Return the next pair of a chunk, None if there is none any more."""
        while True:
            pair, self._waiting = self._waiting or next(self._pairs, None), None
            if pair is None:
                return None
            number = self._whole.number(pair)
            self.position = number
            if number >= chunk.end:
                self._waiting = pair  # it is of another chunk
                return None
            if number >= chunk.first:
                return pair
            del pair

    def close(self) -> None:
        """End the thread that reads ahead."""
        self._pairs.close()


_of_thread = threading.local()


def _reading(chunk: Chunk) -> _Reading:
    """Return a reading that has not passed the chunk: that of the last one, where it goes on."""
    last: _Reading | None = getattr(_of_thread, "reading", None)
    if last is not None and last.alive == chunk.alive and last.position <= chunk.first:
        return last
    _forget_reading()
    atexit.register(_forget_reading)  # or it would be closed when modules are gone
    reading = _of_thread.reading = _Reading(chunk)
    return reading


def _forget_reading() -> None:
    last: _Reading | None = getattr(_of_thread, "reading", None)
    _of_thread.reading = None
    atexit.unregister(_forget_reading)
    if last is not None:
        last.close()
