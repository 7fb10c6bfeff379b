"""A chunk of a sequence: its frames, and its reconstruction in any process."""

import hashlib
import json
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from filelock import FileLock

from tisfm import runtime
from tisfm.camera import Camera
from tisfm.camera_file import read_camera_record
from tisfm.errors import InputError, RunError, is_user_error
from tisfm.focal_guess import GuessedFocalWarning
from tisfm.folders.result_folder import remove, remove_link
from tisfm.formats import FormatError, atomic_write
from tisfm.formats.reading import read_json
from tisfm.reconstruction.chunks.settings import CHUNKING
from tisfm.reconstruction.entry import reconstruct
from tisfm.reconstruction.result.calibration import Calibrate
from tisfm.reconstruction.result.request import files_below
from tisfm.reconstruction.stages.progress import DepthOf
from tisfm.running.pool import check_worker, sendable_error
from tisfm.runtime import Arch
from tisfm.settings import Settings
from tisfm.sources import FrameSource, Listing, Source
from tisfm.sources.frame_reader import SourceWarning, is_integer
from tisfm.version import __version__

# Default number of frames of a chunk.
DEFAULT_CHUNK = 150
# Smallest allowed number of frames of a chunk.
MIN_CHUNK = 12


@dataclass(frozen=True, kw_only=True)
class Span:
    """The frames of a chunk."""

    start: int  # number of the first frame in the source
    stop: int | None  # number of the first frame after the chunk; None for the end of the source
    count: int  # number of frames

    def slice_in(self, frames: range) -> slice:
        """Return the slice of the numbers of all selected frames that the chunk covers."""
        begin = frames.index(self.start)
        return slice(begin, begin + self.count)


def check_chunk(chunk: int) -> None:
    """Raise InputError if chunks have too few frames."""
    if not is_integer(chunk) or chunk < MIN_CHUNK:
        raise InputError(f"chunk is {chunk!r}: expected a number of frames, at least {MIN_CHUNK}")


def overlap_length(chunk: int) -> int:
    """Return the number of frames that neighbour chunks share, by the length of a chunk."""
    return min(CHUNKING.max_overlap, chunk // CHUNKING.overlap_divisor)


def chunk_spans(
    frames: range,  # numbers of all selected frames in the source
    stop: int | None,  # end of the selection, as the user gave it; the last chunk ends there
    chunk: int,  # largest number of frames of a chunk
) -> list[Span]:
    """Return the frames of each chunk; the lengths of chunks are as equal as possible."""
    count, overlap = len(frames), overlap_length(chunk)
    chunk_count = 1 if count <= chunk else -(-(count - overlap) // (chunk - overlap))
    begins = [k * (count - overlap) // chunk_count for k in range(chunk_count + 1)]
    if chunk_count == 1:
        begins = [0, count - overlap]
    return [
        Span(
            start=frames[begin],
            stop=stop if end + overlap >= count else frames[end + overlap - 1] + 1,
            count=end + overlap - begin,
        )
        for begin, end in pairwise(begins)
    ]


@dataclass(frozen=True, kw_only=True, eq=False)
class Chunk:
    """A chunk, with all data that a process needs for its reconstruction."""

    folder: Path  # output folder of the chunk, an absolute path
    source: Source  # absolute paths of the source
    span: Span  # the frames of the chunk
    # keyword arguments of `tisfm.reconstruct` for reading frames: step, size, crop, and others
    frame_arguments: Mapping[str, Any]
    camera: Camera | Path | None
    calibrate: Calibrate
    settings: Settings
    # (N, 4, 4) float64, or None: poses of the frames, if given
    poses: np.ndarray | None = field(repr=False, default=None)
    depth_of: DepthOf = "all"  # the frames that get depth
    request_digest: str  # digest of the request of the whole sequence
    listing: Listing  # the files of the frames, as the parent process sees them
    stop: int | None = None  # number of the first frame of the source after the selection
    # arch, threads: as for `tisfm.runtime.start`
    arch: Arch | None = None
    threads: int | None = None
    presence: Path = Path()  # a file that exists as long as the parent process waits for the chunk
    # float32 values in a vector register of the parent's CPU
    lanes: int = field(default_factory=runtime.cpu_lanes)
    version: str = __version__  # version of tisfm in the parent process

    @property
    def completion_file(self) -> Path:
        """The file beside the chunk's folder that marks the chunk as complete."""
        return self.folder.with_name(f"{self.folder.name}.json")

    @property
    def digest(self) -> str:
        """A digest of all data that determine the result."""
        camera = self.camera
        parts = [
            self.request_digest,
            asdict(self.span),
            read_camera_record(camera) if isinstance(camera, Path) else camera and asdict(camera),
            self.calibrate,
            self.depth_of,
        ]
        return hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:32]

    def is_complete(self) -> bool:
        """Return whether the chunk is complete: its request and its files are unchanged."""
        try:
            record = read_json(self.completion_file)
            return bool(
                record["digest"] == self.digest and record["files"] == files_below(self.folder)
            )
        except (FormatError, OSError, LookupError, TypeError):
            return False

    def with_camera(self, camera: Path) -> "Chunk":
        """Return the chunk with the camera of a file, and without calibration."""
        return replace(self, camera=camera, calibrate="nothing")


def make_chunk(chunk: Chunk) -> Exception | None:
    """Reconstruct a chunk unless it is complete; return an error that the user's input caused."""
    try:
        worker_lanes = runtime.cpu_lanes() if chunk.arch in (None, "cpu") else chunk.lanes
        check_worker(chunk.version, chunk.presence, lanes=chunk.lanes, worker_lanes=worker_lanes)
        source = FrameSource(chunk.source, stop=chunk.stop)
        chunk.listing.check(source.listing, source.title)
        with _chunk_lock(chunk):
            _reconstruct(chunk)
    except Exception as error:
        if not is_user_error(error):
            raise
        return sendable_error(error)
    return None


@contextmanager
def _chunk_lock(chunk: Chunk) -> Iterator[None]:
    """Lock the chunk: wait until other processes, such as an orphaned worker, have ended it."""
    file = chunk.folder.with_name(f"{chunk.folder.name}.lock")
    remove_link(file)
    lock = FileLock(file)
    try:
        lock.acquire()
    except NotImplementedError:  # a file system without locks
        yield
        return
    try:
        yield
    finally:
        lock.release()


def _reconstruct(chunk: Chunk) -> None:
    if chunk.is_complete():
        return
    remove(chunk.completion_file)
    remove(chunk.folder)
    runtime.start_worker(chunk.arch, threads=chunk.threads)
    with warnings.catch_warnings():
        for kind in (GuessedFocalWarning, SourceWarning):  # the parent warns once
            warnings.simplefilter("ignore", kind)
        reconstruct(
            chunk.source,
            camera=chunk.camera,
            calibrate=chunk.calibrate,
            settings=chunk.settings,
            poses=chunk.poses,
            depth_of=chunk.depth_of,
            start=chunk.span.start,
            stop=chunk.span.stop,
            folder=chunk.folder,
            progress=lambda stage, done, total: _check_parent(chunk),
            **chunk.frame_arguments,
        )
    record = {"digest": chunk.digest, "files": files_below(chunk.folder)}
    with atomic_write(chunk.completion_file, durable=True) as file:
        file.write(json.dumps(record, indent=1).encode())


def _check_parent(chunk: Chunk) -> None:
    """Stop a chunk whose parent process has ended."""
    if not chunk.presence.exists():
        raise RunError(f"the command that reconstructs {chunk.folder} has ended")
