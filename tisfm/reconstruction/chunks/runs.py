"""Reconstructions that can be resumed: all frames in one process, or chunks in several."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any, Protocol

from tisfm import runtime
from tisfm.errors import InputError
from tisfm.folders.result_folder import locked_folder
from tisfm.reconstruction.chunks.entry import ChunkedRun
from tisfm.reconstruction.chunks.shared_camera import UnorderedMap
from tisfm.reconstruction.entry import reconstruct
from tisfm.reconstruction.result.reconstruction import Reconstruction
from tisfm.reconstruction.result.renewal import CHUNKS
from tisfm.reconstruction.result.request import (
    Request,
    is_done,
    make_request,
    read_request,
    refuse_differing_request,
    write_request,
)
from tisfm.reconstruction.stages.progress import Progress, ReportDepth
from tisfm.running.pairs import FrameSelection
from tisfm.runtime import Arch
from tisfm.sources import Source
from tisfm.sources.webcam import webcam_number
from tisfm.threads import usable_cores


class ReconstructRun(Protocol):
    """A reconstruction into a folder, unless the folder is complete."""

    def is_done(self) -> bool:
        """Return whether the folder is complete; InputError if it has another reconstruction."""

    def result(
        self, *, resume: bool, progress: Progress, report_depth: ReportDepth
    ) -> Reconstruction:
        """Compute the result."""

    def finish(self) -> None:
        """Record that the folder is complete."""


class WholeRun:
    """A reconstruction of the whole sequence in this process."""

    def __init__(
        self,
        source: Source,
        folder: Path,
        options: Mapping[str, Any],  # arguments of `tisfm.reconstruct`, except those in `frames`
        *,
        frames: FrameSelection,
        others: Mapping[str, Any],  # further options of the command, as JSON values
        # arch, threads: as for `tisfm.runtime.start`
        arch: Arch | None,
        threads: int | None,
    ) -> None:
        self._source, self._folder = source, folder
        self._options, self._frames = options, frames
        self._arch, self._threads = arch, threads
        self._request: Request | None = None
        if not (isinstance(source, str) and webcam_number(source) is not None):
            self._request = self._request_of(others)

    def _request_of(self, others: Mapping[str, Any]) -> Request:
        json_options = {k: self._options[k] for k in ("calibrate", "depth_of")}
        sizes = self._options["object_sizes"] or {}
        selection = {
            k: v for k, v in asdict(self._frames).items() if k not in ("start", "stop", "step")
        }
        return make_request(
            self._frames.open(self._source),
            camera=self._options["camera"],
            settings=self._options["settings"],
            poses=self._options["poses"],
            arch=self._arch,
            files={name: self._options[name] for name in ("mask", "labels")},
            others={
                **json_options, **selection, **others, "chunk": None,
                "object_sizes": {str(number): size for number, size in sizes.items()},
            },
        )  # fmt: skip

    def is_done(self) -> bool:
        """Return whether the folder is complete; InputError if it has another reconstruction."""
        if self._request is None:
            raise InputError(
                f"resume is given, but {self._source} shows other frames now: leave it out"
            )
        chunks = read_request(self._folder / CHUNKS)
        if chunks is not None:
            refuse_differing_request(self._folder, chunks["asked"], self._request)
        return is_done(self._folder, self._request)

    def result(
        self, *, resume: bool, progress: Progress, report_depth: ReportDepth
    ) -> Reconstruction:
        """Compute the result from the beginning."""
        runtime.start(self._arch, threads=self._threads)
        return reconstruct(
            self._source,
            folder=self._folder,
            progress=progress,
            report_depth=report_depth,
            **self._options,
            **asdict(self._frames),
        )

    def finish(self) -> None:
        """Record that the folder is complete."""
        if self._request is not None:
            with locked_folder(self._folder):
                write_request(self._folder, self._request)


class ChunksRun:
    """A reconstruction in chunks, by several processes."""

    def __init__(
        self,
        # source, folder, options, frames, others, arch, threads: as for `WholeRun`
        source: Source,
        folder: Path,
        options: Mapping[str, Any],
        *,
        frames: FrameSelection,
        others: Mapping[str, Any],
        arch: Arch | None,
        threads: int | None,
        chunk: int,  # largest number of frames of a chunk
        workers: int,  # number of processes
        cluster: str | None,  # address of a Dask scheduler, whose workers replace these processes
    ) -> None:
        chunk_options = {k: v for k, v in options.items() if k not in ("labels", "object_sizes")}
        if workers > 1 and cluster is None:  # each process gets its share of the cores
            threads = threads or max(1, usable_cores() // workers)
        self._run = ChunkedRun(
            source,
            folder,
            **chunk_options,
            **asdict(frames),
            chunk=chunk,
            arch=arch,
            threads=threads,
            others=others,
        )
        self._workers, self._cluster = workers, cluster

    def is_done(self) -> bool:
        """Return whether the folder is complete; InputError if it has another reconstruction."""
        return self._run.is_done()

    def result(
        self, *, resume: bool, progress: Progress, report_depth: ReportDepth
    ) -> Reconstruction:
        """Compute the missing chunks, and join all chunks."""
        with _open_map(self._workers, self._cluster) as map_unordered:
            return self._run.result(
                map_unordered, resume=resume, progress=progress, report_depth=report_depth
            )

    def finish(self) -> None:
        """Record that the folder is complete, and remove the chunks."""
        self._run.finish()


@contextmanager
def _open_map(workers: int, cluster: str | None) -> Iterator[UnorderedMap]:
    """Yield a map: it calls a function with every item, in this process or in other processes."""
    if workers == 1 and cluster is None:
        yield _map_here
        return
    from tisfm.running.pool import open_pool

    with open_pool(workers=workers, cluster=cluster) as pool:
        yield pool.map_unordered


def _map_here(function: Callable[[Any], Any], items: Sequence[Any]) -> Iterator[tuple[int, Any]]:
    for number, item in enumerate(items):
        yield number, function(item)
