"""Chunks of consecutive pairs, interpreted by the processes of a pool."""

import atexit
import os
import tempfile
import threading
from collections.abc import Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass, field, replace
from pathlib import Path
from time import perf_counter
from typing import Any

from tisfm import runtime
from tisfm.camera import Camera
from tisfm.errors import InputError, is_user_error
from tisfm.folders.result_folder import InputFiles, presence_file
from tisfm.folders.run_record import is_unchanged
from tisfm.interpretation import Interpretation
from tisfm.running.pair_files import Checksums, Ranges
from tisfm.running.pairs import PairSource, PairWork
from tisfm.running.pool import check_worker, open_pool, sendable_error
from tisfm.runtime import Arch
from tisfm.settings import FixedPixels, FocalOrigin
from tisfm.sources import FramePair, FrameSource, Listing, Source
from tisfm.sources.frame_reader import is_path
from tisfm.sources.webcam import webcam_number
from tisfm.threads import usable_cores
from tisfm.version import __version__

_OPEN_END = 2**62  # larger than the number of any pair
# Pairs of a chunk with written results: a killed process loses its chunk. Set by hand.
_MAX_PAIRS_WRITTEN = 32
# Pairs of a chunk with returned results: all these results are in memory. Set by hand.
_MAX_PAIRS_RETURNED = 4
# Smallest number of chunks, so that no process waits long for the last chunk. Set by hand.
_MIN_CHUNKS_PER_WORKER = 4


@dataclass(frozen=True, kw_only=True)
class Chunk:
    """Consecutive pairs of a source, and all data that a process needs for their interpretation."""

    source: PairSource
    work: PairWork  # if it has no files, results are returned instead of written
    first: int  # number of the first pair
    # Number of the last pair plus 1. In the last chunk this is `_OPEN_END`, since a video may have
    # more frames than its header states.
    end: int
    # arch, threads: as for `tisfm.runtime.start`
    arch: Arch | None
    threads: int | None
    listing: Listing  # the files of the source, as the parent process sees them
    ranges: Ranges | None = None  # ranges of depth and flow in images
    # record entries of the pairs that an earlier run finished, by their names
    finished_entries: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    presence: Path = Path()  # a file that exists as long as the parent process waits for the chunk
    # float32 values in a vector register of the parent's CPU; all processes need this number
    lanes: int = field(default_factory=runtime.cpu_lanes)
    version: str = __version__  # version of tisfm in the parent process

    def with_absolute_paths(self) -> "Chunk":
        """Return the chunk with paths that do not depend on the working folder."""
        source = self.source
        work = self.work
        if work.files is not None:
            files = replace(work.files, folder=work.files.folder.absolute())
            work = replace(work, files=files)
        absolute_source = replace(
            source,
            source=_absolute(source.source),
            mask=None if source.mask is None else os.path.abspath(source.mask),
            poses=None if source.poses is None else source.poses.absolute(),
        )
        return replace(self, source=absolute_source, work=work)


@dataclass(frozen=True, kw_only=True)
class FinishedPair:
    """A pair that a worker finished."""

    name: str
    # entry of the pair in the record of the run; None if an earlier run finished the pair
    entry: Mapping[str, Any] | None = None
    checksums: Checksums | None = None  # lengths and check sums of the pair's files
    result: Interpretation | None = None  # None if the result is written instead of returned
    seconds: float = 0.0  # time of the interpretation


@dataclass(frozen=True, kw_only=True)
class FinishedChunk:
    """The pairs that a worker finished: a chunk, or the part of a chunk before an error."""

    pairs: list[FinishedPair]
    # list of (int, str): numbers of all frames that the process has skipped so far, and reasons
    skipped: list[tuple[int, str]]
    error: Exception | None = None  # the error that ended the chunk early


def split_chunk(chunk: Chunk, workers: int) -> list[Chunk]:
    """Split a chunk with all remaining pairs into chunks for the processes."""
    max_pairs = _MAX_PAIRS_RETURNED
    if chunk.work.files is not None:
        max_pairs = _MAX_PAIRS_WRITTEN
        files = replace(chunk.work.files, inputs=InputFiles())  # each process makes its own list
        chunk = replace(chunk, work=replace(chunk.work, files=files))
    count = chunk.end - chunk.first
    length = max(1, min(max_pairs, -(-count // (_MIN_CHUNKS_PER_WORKER * workers))))
    ends = [*range(chunk.first + length, chunk.end, length), _OPEN_END]
    begins = [chunk.first, *ends[:-1]]
    return [replace(chunk, first=first, end=end) for first, end in zip(begins, ends, strict=True)]


def interpret_chunk(chunk: Chunk) -> FinishedChunk:
    """Interpret the pairs of a chunk; write or return their results."""
    pairs: list[FinishedPair] = []
    reader: _PairReader | None = None
    error: Exception | None = None
    try:
        worker_lanes = runtime.cpu_lanes() if chunk.arch in (None, "cpu") else chunk.lanes
        check_worker(chunk.version, chunk.presence, lanes=chunk.lanes, worker_lanes=worker_lanes)
        runtime.start_worker(chunk.arch, threads=chunk.threads)
        reader = _reader_for(chunk)
        while (pair := reader.next_in_chunk(chunk)) is not None and chunk.presence.exists():
            pairs.append(_finish(chunk, pair, reader.inputs))
            del pair
        if not chunk.presence.exists():
            _close_reader()  # this run has no further chunks
    except Exception as exception:
        _close_reader()
        if not is_user_error(exception):
            raise
        error = sendable_error(exception)  # returned with the pairs before the error
    skipped = [] if reader is None else list(reader.skipped)
    return FinishedChunk(pairs=pairs, skipped=skipped, error=error)


def interpret_with_workers(
    source: PairSource,  # a source of files, as `check_sharable` requires
    *,
    camera: Camera,  # the camera of the frames after they are cropped and shrunk
    workers: int,  # number of processes
    first: int,  # number of the first pair
    fixed_pixels: FixedPixels = "mask",  # as for `tisfm.interpret`
    focal_origin: FocalOrigin = "stated",
) -> Iterator[Interpretation | str]:
    """Interpret pairs in several processes of this machine; yield the results in order.

    The reason for each skipped frame comes before the result that follows it.

    Raises Exception: as `tisfm.interpret_sequence`, after the results of the pairs before the
    error.
    """
    pairs, reader = source.open()
    reader.close()
    all_pairs = Chunk(
        source=source,
        work=PairWork(
            camera=camera,
            settings=source.settings,
            fixed_pixels=fixed_pixels,
            focal_origin=focal_origin,
        ),
        first=first,
        end=len(pairs),
        arch=runtime.running_arch(),  # type: ignore[arg-type]  # an arch of `runtime.start`
        threads=max(1, usable_cores() // workers),
        listing=pairs.listing,
    )
    reported_frames: set[int] = set()
    chunks_by_number: dict[int, FinishedChunk] = {}
    next_number = 0
    with (
        open_pool(workers) as pool,
        tempfile.TemporaryDirectory(prefix="tisfm-") as folder,
        presence_file(Path(folder)) as presence,
    ):
        chunks = split_chunk(replace(all_pairs, presence=presence), workers)
        with closing(pool.map_unordered(interpret_chunk, chunks)) as results:
            for number, chunk_result in results:
                chunks_by_number[number] = chunk_result
                while next_number in chunks_by_number:
                    chunk = chunks_by_number.pop(next_number)
                    next_number += 1
                    for index, reason in chunk.skipped:
                        if index not in reported_frames:
                            reported_frames.add(index)
                            yield reason
                    yield from (pair.result for pair in chunk.pairs if pair.result is not None)
                    if chunk.error is not None:
                        raise chunk.error


def check_sharable(source: Source, pairs: FrameSource) -> int:
    """Return the number of pairs of a source; raise InputError if processes cannot share them."""
    if isinstance(source, str) and webcam_number(source) is not None:
        raise InputError(
            f"{source} is not a file, so several workers cannot read it: leave them out"
        )
    if not is_path(source) and not (
        isinstance(source, (list, tuple)) and all(map(is_path, source))
    ):
        raise InputError(
            f"source is {type(source).__name__}, which several workers cannot read: give files, or "
            "leave out workers"
        )
    try:
        return len(pairs)
    except TypeError:  # the number is unknown before all frames are read
        raise InputError(
            f"{pairs.title} does not say how many frames it has: leave out workers"
        ) from None


def refuse_float_frames(pair: FramePair) -> None:
    """Raise InputError for frames with decimals: several processes would scale them differently."""
    if pair.frame0.dtype.kind == "f":
        raise InputError(
            f"frame {pair.name0} has decimals: the scale of such frames depends on all earlier "
            "frames, which several workers do not read; leave out workers"
        )


def _absolute(source: Source) -> Source:
    """Return a path or a list of paths as absolute paths."""
    if isinstance(source, (str, os.PathLike)):
        return os.path.abspath(source)
    return [os.path.abspath(path) for path in source]  # type: ignore[arg-type]


def _finish(chunk: Chunk, pair: FramePair, inputs: InputFiles) -> FinishedPair:
    """Interpret a pair, and write its files if the chunk has files."""
    work, name, number = chunk.work, pair.name0, chunk.source.number(pair)
    if work.files is None:
        return FinishedPair(name=name, result=work.interpret(pair))
    files = replace(work.files, inputs=inputs)
    finished_entries = chunk.finished_entries.get(name)
    endings = files.endings(number)
    if finished_entries is not None and is_unchanged(
        files.folder, name, finished_entries, pair.digest, endings
    ):
        return FinishedPair(name=name)
    begin = perf_counter()
    result = work.interpret(pair)
    seconds = perf_counter() - begin
    entry, checksums = files.write(
        name, result, ranges=chunk.ranges, **work.write_arguments(pair, number)
    )
    return FinishedPair(name=name, entry=entry, checksums=checksums, seconds=seconds)


class _PairReader:
    """A reader of the pairs of a source, in order. It skips the pairs of other processes."""

    def __init__(self, chunk: Chunk) -> None:
        # This check of the files comes before any use of the files.
        source = FrameSource(chunk.source.source, stop=chunk.source.frames.stop)
        chunk.listing.check(source.listing, source.title)
        self._source = chunk.source
        self._frame_source, self._pairs = chunk.source.starting_at(chunk.first).open()
        self._frame_source.allow_no_pairs()
        self._next_pair: FramePair | None = None
        self.presence = chunk.presence
        self.position = chunk.first
        poses = [] if chunk.source.poses is None else [chunk.source.poses]
        self.inputs = InputFiles([*self._frame_source.files, *poses])

    @property
    def skipped(self) -> list[tuple[int, str]]:
        """Numbers of all frames that were skipped so far, and the reasons."""
        return self._frame_source.skipped

    def next_in_chunk(self, chunk: Chunk) -> FramePair | None:
        """Return the next pair of a chunk; None after the last pair."""
        while True:
            pair, self._next_pair = self._next_pair or next(self._pairs, None), None
            if pair is None:
                return None
            number = self._source.number(pair)
            self.position = number
            if number >= chunk.end:
                self._next_pair = pair  # for a later chunk
                return None
            if number >= chunk.first:
                return pair
            del pair

    def close(self) -> None:
        """End the read-ahead thread."""
        self._pairs.close()


_thread_state = threading.local()  # .reader: reader of a thread, kept from chunk to chunk


def _reader_for(chunk: Chunk) -> _PairReader:
    """Return a reader at or before the chunk: this thread's last reader, if possible."""
    last: _PairReader | None = getattr(_thread_state, "reader", None)
    if last is not None and last.presence == chunk.presence and last.position <= chunk.first:
        return last
    _close_reader()
    atexit.register(_close_reader)  # a destructor would run after modules are unloaded
    reader = _thread_state.reader = _PairReader(chunk)
    return reader


def _close_reader() -> None:
    last: _PairReader | None = getattr(_thread_state, "reader", None)
    _thread_state.reader = None
    atexit.unregister(_close_reader)
    if last is not None:
        last.close()
