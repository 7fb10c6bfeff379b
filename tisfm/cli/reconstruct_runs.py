"""How `tisfm reconstruct` makes its result: in this process, or in chunks by several."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any, Protocol

import tisfm
from tisfm.cli.console import start_kernels, tell_device
from tisfm.errors import InputError
from tisfm.folders.result_folder import locked_folder
from tisfm.reconstruction.chunks.entry import ChunkedRun
from tisfm.reconstruction.chunks.shared_camera import Finished
from tisfm.reconstruction.progress import Progress
from tisfm.reconstruction.result.reconstruction import Reconstruction
from tisfm.reconstruction.result.renewal import CHUNKS
from tisfm.reconstruction.result.request import (
    Request,
    is_done,
    make_request,
    read_request,
    refuse_differing,
    write_request,
)
from tisfm.running.pairs import FrameSelection
from tisfm.runtime import Arch
from tisfm.sources import Source
from tisfm.sources.webcam import webcam_number
from tisfm.threads import usable_cores


class ReconstructRun(Protocol):
    """Makes a result, once; knows whether it was made before."""

    def is_done(self) -> bool:
        """Return whether the folder holds the complete result; ValueError if that of another."""

    def result(self, *, resume: bool, progress: Progress) -> Reconstruction:
        """Make the result."""

    def finish(self) -> None:
        """Say that all that was asked for is there."""


class WholeRun:
    """A reconstruction at once, in this process.

    Parameters
    ----------
    source : Source
    folder : Path
    options : mapping
        Of `tisfm.reconstruct`, those that say which frames are taken apart.
    frames : FrameSelection
    others : mapping
        What else is asked for, as JSON has it.
    arch, threads
        As for `tisfm.runtime.start`.
    """

    def __init__(
        self,
        source: Source,
        folder: Path,
        options: Mapping[str, Any],
        *,
        frames: FrameSelection,
        others: Mapping[str, Any],
        arch: Arch | None,
        threads: int | None,
    ) -> None:
        self._source, self._folder = source, folder
        self._options, self._frames = options, frames
        self._arch, self._threads = arch, threads
        self._asked: Request | None = None
        if not (isinstance(source, str) and webcam_number(source) is not None):
            self._asked = self._asked_for(others)

    def _asked_for(self, others: Mapping[str, Any]) -> Request:
        plain = {k: self._options[k] for k in ("calibrate", "depth_of")}
        sizes = self._options["object_sizes"] or {}
        cut = {k: v for k, v in asdict(self._frames).items() if k not in ("start", "stop", "step")}
        return make_request(
            self._frames.open(self._source),
            camera=self._options["camera"],
            settings=self._options["settings"],
            poses=self._options["poses"],
            arch=self._arch,
            files={name: self._options[name] for name in ("mask", "labels")},
            others={
                **plain, **cut, **others, "chunk": None,
                "object_sizes": {str(number): size for number, size in sizes.items()},
            },
        )  # fmt: skip

    def is_done(self) -> bool:
        """Return whether the folder holds the complete result; ValueError if that of another."""
        if self._asked is None:
            raise InputError(
                f"resume is given, but {self._source} shows other frames now: leave it out"
            )
        chunks = read_request(self._folder / CHUNKS)
        if chunks is not None:
            refuse_differing(self._folder, chunks["asked"], self._asked)
        return is_done(self._folder, self._asked)

    def result(self, *, resume: bool, progress: Progress) -> Reconstruction:
        """Make the result, from the beginning."""
        start_kernels(self._arch, threads=self._threads)
        return tisfm.reconstruct(
            self._source,
            folder=self._folder,
            progress=progress,
            **self._options,
            **asdict(self._frames),
        )

    def finish(self) -> None:
        """Say that all that was asked for is there."""
        if self._asked is not None:
            with locked_folder(self._folder):
                write_request(self._folder, self._asked)


class ChunksRun:
    """A reconstruction in chunks, by several processes.

    Parameters
    ----------
    source, folder, options, frames, others, arch, threads
        As for `WholeRun`.
    chunk : int
        Frames of a chunk, at most.
    workers : int
        Processes at a time.
    cluster : str or None
        Address of a Dask cluster, whose processes are taken instead.
    """

    def __init__(
        self,
        source: Source,
        folder: Path,
        options: Mapping[str, Any],
        *,
        frames: FrameSelection,
        others: Mapping[str, Any],
        arch: Arch | None,
        threads: int | None,
        chunk: int,
        workers: int,
        cluster: str | None,
    ) -> None:
        taken = {k: v for k, v in options.items() if k not in ("labels", "object_sizes")}
        if workers > 1 and cluster is None:  # each has its share of the cores
            threads = threads or max(1, usable_cores() // workers)
        self._run = ChunkedRun(
            source,
            folder,
            **taken,
            **asdict(frames),
            chunk=chunk,
            arch=arch,
            threads=threads,
            others=others,
        )
        self._workers, self._cluster, self._arch = workers, cluster, arch

    def is_done(self) -> bool:
        """Return whether the folder holds the complete result; ValueError if that of another."""
        return self._run.is_done()

    def result(self, *, resume: bool, progress: Progress) -> Reconstruction:
        """Make the chunks that are not there, and of all the whole."""
        tell_device(self._arch)
        with _finished(self._workers, self._cluster) as finished:
            return self._run.result(finished, resume=resume, progress=progress)

    def finish(self) -> None:
        """Say that all that was asked for is there; chunks are removed."""
        self._run.finish()


@contextmanager
def _finished(workers: int, cluster: str | None) -> Iterator[Finished]:
    if workers == 1 and cluster is None:
        yield _one_after_the_other
        return
    from tisfm.running.pool import open_pool

    with open_pool(workers=workers, cluster=cluster) as executor:
        yield executor.map_unordered


def _one_after_the_other(
    function: Callable[[Any], Any], items: Sequence[Any]
) -> Iterator[tuple[int, Any]]:
    for number, item in enumerate(items):
        yield number, function(item)
