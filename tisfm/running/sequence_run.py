"""A run: one or several processes interpret every pair of a source, and write the results."""

import fnmatch
import glob
import math
import os
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, closing, nullcontext
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import Protocol, TypeVar

from tisfm import runtime
from tisfm.camera import Camera
from tisfm.camera_file import focal_doubt, read_camera
from tisfm.errors import InputError
from tisfm.focal_guess import at_size, guess_focal
from tisfm.folders.result_folder import InputFiles, presence_file
from tisfm.formats.float_maps import require_writable_flow
from tisfm.interpretation import Interpretation
from tisfm.reconstruction.result.calibration import read_calibration
from tisfm.running.background import BackgroundThread
from tisfm.running.pair_chunks import (
    Chunk,
    FinishedChunk,
    check_sharable,
    interpret_chunk,
    refuse_float_frames,
    split_chunk,
)
from tisfm.running.pair_files import DEFAULT_OUTPUTS
from tisfm.running.pair_writer import PairWriter
from tisfm.running.pairs import FrameSelection, PairSource, PairWork
from tisfm.running.pool import WorkerPool, check_workers, open_pool
from tisfm.runtime import Arch
from tisfm.settings import FixedPixels, Settings
from tisfm.show.stereo import DISPARITY, check_disparity, check_screen
from tisfm.sources import FramePair, FrameSource, Source
from tisfm.threads import usable_cores
from tisfm.window import Window, WindowSize, make_window

T = TypeVar("T")
Log = Callable[[str], None]


class RunObserver(Protocol):
    """A receiver of the progress of a run, such as `tisfm.cli.progress.RunProgress`."""

    last_seconds: float  # s: time of the last stage

    def begin(self, writer: PairWriter, pair_count: int | None) -> None:
        """Receive the writer of the run and the number of its pairs; None if unknown."""

    def stage(self, name: str) -> AbstractContextManager[None]:
        """Measure the time of a block for a stage."""

    def measure_items(self, name: str, items: Iterable[T]) -> Iterator[T]:
        """Yield items, and measure the waiting time for each item."""

    def finish(self, name: str, statuses: Mapping[str, int], *, count: int = 1) -> None:
        """Receive the last finished pair's name, and the number of finished pairs by status."""

    def estimate(self, interpreted: int) -> None:
        """Receive the number of pairs that this command has interpreted so far."""


@dataclass(frozen=True, kw_only=True)
class SequenceRun:
    """A run: its source, its settings, and the folder of its results."""

    source: Source
    folder: Path  # the folder of the results
    camera: Camera | Path  # a camera, or a camera file
    guess: bool = False  # replace the focal length of the camera by a guess from the first frame
    settings: Settings
    frames: FrameSelection
    poses: Path | None = None  # a file with a pose for every frame of the source, selected or not
    mask: str | None = None  # a picture, or a folder or pattern with a picture for every frame
    fixed_pixels: FixedPixels = "mask"  # as for `tisfm.interpret`
    window: WindowSize = 2  # {2, 3}: as for `tisfm.interpret_sequence`
    resume: bool = False  # whether to keep finished pairs of an earlier run with the same options
    # the outputs of a pair: keys of `tisfm.folders.run_record.ENDINGS`
    outputs: Collection[str] = DEFAULT_OUTPUTS
    figures: int = 1  # interval of pairs with a figure; 0 for no figures
    # disparity, screen: parameters of anaglyphs, as for `PairWriter`
    disparity: float | None = None
    screen: float | None = None
    workers: int = 1  # number of processes that share the pairs
    cluster: str | None = None  # the address of a Dask scheduler, whose workers share the pairs
    # arch, threads: as for `tisfm.runtime.start`
    arch: Arch | None = None
    threads: int | None = None

    @property
    def is_shared(self) -> bool:
        """Whether several processes share the pairs."""
        return self.workers > 1 or self.cluster is not None

    def check(self) -> Window | None:
        """Check the options that need no frame; return the window of three frames, if any.

        Raises InputError if options are impossible, alone or together.
        """
        if isinstance(self.camera, Path):
            read_camera(self.camera)
        check_disparity(DISPARITY if self.disparity is None else self.disparity)
        check_screen(self.screen, None)
        if "anaglyph" not in self.outputs and (self.disparity, self.screen) != (None, None):
            raise InputError(
                f"--{'disparity' if self.screen is None else 'screen'} is only for anaglyphs: add "
                "anaglyph to --outputs, or leave it out"
            )
        window = make_window(self.window, self.settings)
        if window is not None and self.resume and "npz" not in self.outputs:
            raise InputError(
                "with a window of 3, --resume needs the .npz of the previous pair: add npz to "
                "--outputs"
            )
        check_workers(self.workers, self.cluster)
        if self.is_shared and window is not None:
            raise InputError(
                "with a window of 3, each pair needs the result of the previous pair, so several "
                "workers cannot share the pairs: leave out one of them"
            )
        return window

    def interpret(
        self,
        observer: RunObserver,
        log: Log,  # receives each note on the source and the camera, a line of text
    ) -> dict[int, str]:  # by the numbers of skipped frames: the reasons
        """Interpret and write all pairs.

        Raises OSError, TypeError, ValueError: as `tisfm.interpret_sequence`; if the folder cannot
        be written to; if results would replace inputs; as `check`.
        """
        window = self.check()
        source = PairSource(
            source=self.source,
            frames=self.frames,
            settings=self.settings,
            mask=self.mask,
            poses=self.poses,
        )
        frames, pairs = source.open()
        refuse_among_inputs(self.source, frames.frame_files, self.folder)
        if self.mask is not None:
            refuse_among_inputs(self.mask, frames.mask_files, self.folder, kind="masks")
        for note in frames.notes:
            log(f"note: {note}")
        pair_count = check_sharable(self.source, frames) if self.is_shared else _pair_count(frames)
        first = next(pairs)  # before any file is written: all frames have its size
        if "flow" in self.outputs:
            require_writable_flow(f"frame {first.name0}", *first.frame0.shape[:2])
        if self.is_shared:
            refuse_float_frames(first)
        full_shape, shape = first.full_shape, first.frame0.shape
        first_pairs = chain([first], pairs)
        del first  # free its memory
        runtime.start(self.arch, threads=self.threads)
        camera = self.camera
        if isinstance(camera, Path):
            camera = load_camera(camera, full_shape or shape[:2], log)
        elif self.guess:
            camera = guess_camera_focal(camera, frames.first_file or full_shape or shape, log)
        writer = self._make_writer(
            frames, camera, full_shape or shape[:2], frames.camera_after(camera, full_shape)
        )
        work = PairWork(
            camera=writer.camera,
            settings=self.settings,
            fixed_pixels=self.fixed_pixels,
            focal_origin="guessed" if self.guess else "stated",
            files=writer.files,
        )
        pool = open_pool(self.workers, self.cluster) if self.is_shared else nullcontext()
        with closing(pairs), writer, pool as workers:
            observer.begin(writer, pair_count)
            interpreter = _LocalInterpreter(writer, work, source, observer, window)
            next_number = interpreter.interpret(first_pairs, stop_at_ranges=self.is_shared)
            skipped = dict(frames.skipped)
            if workers is not None and pair_count is not None and next_number < pair_count:
                pairs.close()
                remaining_chunk = self._remaining_chunk(
                    source, work, frames, next_number, pair_count
                )
                for chunk in _finished_chunks(remaining_chunk, writer, workers):
                    interpreter.interpreted += _record_chunk(chunk, writer, observer)
                    observer.estimate(interpreter.interpreted)
                    skipped.update(chunk.skipped)
            else:  # further pairs exist only if a video has more frames than its header states
                interpreter.interpret(pairs, stop_at_ranges=False)
                skipped.update(frames.skipped)
        return dict(sorted(skipped.items()))

    def _make_writer(
        self, frames: FrameSource, camera: Camera, shape: tuple[int, int], output_camera: Camera
    ) -> PairWriter:
        return PairWriter(
            self.folder,
            camera=output_camera,
            settings=self.settings,
            source=(camera, shape),
            window=self.window,
            fixed_pixels=self.fixed_pixels,
            outputs=self.outputs,
            figures=self.figures,
            disparity=DISPARITY if self.disparity is None else self.disparity,
            screen=self.screen,
            start=frames.selection.start,
            step=frames.selection.step,
            resume=self.resume,
            inputs=InputFiles([*frames.files, *([] if self.poses is None else [self.poses])]),
            names=_possible_names(frames, self.folder),
            notes=frames.notes,
            focal_deviation=self._focal_deviation(camera.focal),
        )

    def _focal_deviation(self, focal: float) -> float:
        """Return the relative standard deviation of the focal length; infinite for a guess."""
        if isinstance(self.camera, Path):
            return read_calibration(self.camera, focal).relative_focal_std
        return math.inf if self.guess else 0.0

    def _remaining_chunk(
        self, source: PairSource, work: PairWork, frames: FrameSource, first: int, end: int
    ) -> Chunk:
        """Return one chunk with all remaining pairs."""
        chunk = Chunk(
            source=source,
            work=work,
            first=first,
            end=end,
            arch=runtime.running_arch(),  # type: ignore[arg-type]  # an arch of `runtime.start`
            threads=self.threads,
            listing=frames.listing,
        )
        if self.cluster is not None:
            return chunk.with_absolute_paths()
        if self.threads is None:
            return replace(chunk, threads=max(1, usable_cores() // self.workers))
        return chunk


def load_camera(file: Path, shape: tuple[int, int] | None, log: Log) -> Camera:
    """Return the camera in a file for frames of a shape; warn if its focal length is doubtful."""
    camera = read_camera(file, shape)
    if doubt := focal_doubt(file):
        log(f"{file}: {doubt}")
    return camera


def guess_camera_focal(camera: Camera, first: Path | tuple[int, ...], log: Log) -> Camera:
    """Return a camera with a focal length guessed from the first frame, or from its shape."""
    guess = guess_focal(first)
    value = f"{guess.focal:.0f} px{at_size(guess.shape)}, {guess.reason}"
    log(f"focal length guessed: {value}; give --focal if known")
    return replace(camera, focal=guess.focal)


@dataclass
class _LocalInterpreter:
    """The interpretation of pairs in this process, with writing in a second thread."""

    writer: PairWriter
    work: PairWork
    source: PairSource
    observer: RunObserver
    window: Window | None
    interpreted: int = field(default=0, init=False)

    def interpret(self, pairs: Iterable[FramePair], *, stop_at_ranges: bool) -> int:
        """Interpret pairs; return the number of the next pair.

        With `stop_at_ranges`, interpretation stops after the first pair with depth. This pair sets
        the ranges of values in all images.
        """
        writer, window, observer = self.writer, self.window, self.observer
        # `previous` is the pair before, if an earlier run finished that pair.
        previous, number = None, -1
        with BackgroundThread() as background:
            for pair in observer.measure_items("decoding", pairs):
                name, number = pair.name0, self.source.number(pair)
                if writer.has_pair(name) and writer.is_complete(name, pair.digest, number):
                    previous = None if window is None else pair
                else:
                    if window is not None and previous is not None:
                        result = Interpretation.load(writer.result_path(previous.name0))
                        previous.store(window, result, camera=self.work.camera)
                        del result
                    previous = None
                    with observer.stage("interpreting"):
                        result = self.work.interpret(pair, window)
                    self.interpreted += 1
                    writer.record_time(name, observer.last_seconds)
                    with observer.stage("interpreting"):
                        arguments = self.work.write_arguments(pair, number)
                    with observer.stage("writing"):
                        background.submit(writer.write, name, result, **arguments)
                    del result, arguments  # free their memory before the next pair
                observer.finish(name, writer.statuses)
                observer.estimate(self.interpreted)
                del pair
                if stop_at_ranges:
                    background.wait()
                    if writer.ranges is not None:
                        break
        return number + 1


def _finished_chunks(
    remaining_chunk: Chunk, writer: PairWriter, pool: WorkerPool
) -> Iterator[FinishedChunk]:
    """Let other processes interpret the pairs of a chunk; yield finished parts of the chunk.

    After an error of a worker, the parts in work are yielded, and then the error is raised.
    """
    writer.begin()
    error: BaseException | None = None
    # This path is for the workers; it is absolute for a cluster.
    folder = (
        writer.folder if remaining_chunk.work.files is None else remaining_chunk.work.files.folder
    )
    with presence_file(folder) as presence:
        chunks = [
            replace(
                chunk,
                finished_entries=writer.entries_between(chunk.first, chunk.end),
                presence=presence,
                ranges=writer.ranges,
            )
            for chunk in split_chunk(remaining_chunk, pool.workers)
        ]
        try:
            for _, finished in pool.map_unordered(interpret_chunk, chunks):
                yield finished
                if finished.error is not None:
                    error = finished.error
                    break
        except KeyboardInterrupt as interrupt:
            error = interrupt
    if error is not None:
        yield from pool.results_of_running()
        raise error


def _record_chunk(chunk: FinishedChunk, writer: PairWriter, observer: RunObserver) -> int:
    """Record the pairs of another process; return the number of newly interpreted pairs."""
    interpreted = 0
    for pair in chunk.pairs:
        if pair.entry is not None and pair.checksums is not None:
            writer.finish(pair.name, pair.entry, pair.checksums)
            writer.record_time(pair.name, pair.seconds)
            interpreted += 1
    if chunk.pairs:
        observer.finish(chunk.pairs[-1].name, writer.statuses, count=len(chunk.pairs))
    return interpreted


def _pair_count(frames: FrameSource) -> int | None:
    """Return the number of pairs; None if it is unknown before all frames are read."""
    try:
        return len(frames)
    except TypeError:
        return None


def refuse_among_inputs(
    source: Source, files: Iterable[Path], folder: Path, *, kind: str = "frames"
) -> None:
    """Raise InputError if results would lie among the frames: the next run would read results."""
    if not isinstance(source, (str, os.PathLike)) or os.path.isfile(source):
        return
    parents = {file.parent for file in files}
    is_input_folder = folder.exists() and any(
        parent.exists() and parent.samefile(folder) for parent in parents
    )
    if is_input_folder or (
        glob.has_magic(os.fspath(source)) and _matches_pattern(folder, Path(source).parent)
    ):
        raise InputError(
            f"the results would lie among the {kind} in {folder}, and the next run would read them "
            f"as {kind}: give another folder with -o"
        )


def _matches_pattern(folder: Path, pattern: Path) -> bool:
    """Return whether a folder matches the pattern of folders, such as "d?" in "d?/*.png"."""
    folder_parts, pattern_parts = (Path(os.path.abspath(path)).parts for path in (folder, pattern))
    return len(folder_parts) == len(pattern_parts) and all(
        map(fnmatch.fnmatch, folder_parts, pattern_parts)
    )


def _possible_names(frames: FrameSource, folder: Path) -> list[str]:
    """Return the names of pairs whose results may already lie in a folder."""
    if frames.names is not None:
        return list(frames.names)
    if not folder.is_dir():
        return []
    numbered = re.compile(re.escape(frames.prefix) + r"_\d{6,}", re.IGNORECASE)
    matches = (numbered.match(name) for name in os.listdir(folder))
    return sorted({match.group() for match in matches if match})
