"""``tisfm run``."""

import fnmatch
import glob
import os
import re
import shutil
from collections.abc import Collection, Iterable, Iterator
from contextlib import closing, nullcontext
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import FlagCreatePairsOff, OmitArgPrefixes, Positional, UseAppendAction, arg

from tisfm import runtime
from tisfm.camera import Camera
from tisfm.camera_file import read_camera
from tisfm.cli.console import guessed_camera, start_kernels, stated_camera, tell
from tisfm.cli.options import CameraOptions, FrameOptions, SettingsOptions
from tisfm.cli.progress import MUCH, Foretelling, RunProgress
from tisfm.cli.report import report_run
from tisfm.errors import InputError
from tisfm.folders.result_folder import InputFiles, presence_file
from tisfm.folders.run_record import RECORD
from tisfm.formats.float_maps import require_writable_flow
from tisfm.interpretation import Interpretation
from tisfm.machine.text import as_size
from tisfm.report import check_report
from tisfm.running.background import Background
from tisfm.running.pair_chunks import Chunk, FinishedChunk, chunks_of, interpret_chunk
from tisfm.running.pair_files import USUAL, checked_outputs
from tisfm.running.pair_writer import PairWriter
from tisfm.running.pairs import FrameSelection, PairSource, PairWork
from tisfm.running.pool import WorkerPool, check_workers, open_pool
from tisfm.runtime import Arch
from tisfm.settings import Preset, Settings
from tisfm.show.stereo import DISPARITY, check_disparity, check_screen
from tisfm.sources import FramePair, FrameSource, Source
from tisfm.sources.webcam import webcam_number
from tisfm.threads import usable_cores
from tisfm.window import Window, WindowSize, window_of

Output = Literal["depth", "depth16", "flow", "anaglyph", "figure", "ply", "pose", "npz"]


@dataclass(kw_only=True)
class Run:
    """Interpret every pair of consecutive frames of a sequence.

    SOURCE is two or more images, a folder of images, a quoted glob such as 'frames/*.png', a video,
    or webcam:0 for a camera, with --stop. For a pair named NAME after its first frame, DIR receives
    NAME_depth.png (grey levels, near is bright), NAME_depth16.png (16-bit depth, its scale in the
    file and in run.json), NAME_anaglyph.png (red-cyan), NAME_figure.png, for motion 'camera' or
    'objects' NAME_pose.txt, with --flo NAME_flow.flo, with --ply NAME.ply and, when all is written,
    NAME.npz for tisfm.Interpretation.load: everything, rounded a little.
    """

    source: Annotated[
        Positional[tuple[str, ...]],
        arg(metavar="SOURCE [SOURCE ...]", help_behavior_hint="(required)"),
    ]
    """Two or more images, a folder, a quoted glob, a video, or a webcam such as webcam:0."""
    output: Annotated[Path, arg(aliases=["-o"], metavar="DIR")]
    """Folder for the results; made if need be."""
    preset: Preset = "balanced"
    """Settings to start from; the settings below show its values, and change them."""
    poses: Annotated[Path | None, arg(metavar="FILE")] = None
    """Known poses, for depth in their unit: a line of 12 numbers for every frame, the rows of
    (R | t) from camera to world, as KITTI has them. For motion 'camera'."""
    mask: Annotated[str | None, arg(metavar="MASK")] = None
    """A picture, or a folder of one for every frame: black pixels are ignored everywhere."""
    window: WindowSize = 2
    """Frames that an interpretation sees: 3 adds the frame before the pair, for motion 'field'."""
    resume: bool = False
    """Continue a run that was interrupted: skip the pairs it finished."""
    outputs: UseAppendAction[tuple[Output, ...]] = ()
    """What is written of each pair: several with commas between, or the option several times. By
    default all but flow and ply, which are large."""
    figures: int = 1
    """Draw NAME_figure.png, the slowest output, of every so many pairs; 0 for none."""
    no_figures: Annotated[bool, FlagCreatePairsOff] = False
    """Draw none: the same as --figures 0."""
    disparity: float | None = None
    """Of anaglyphs: how far the nearest moves against the farthest from one eye's view to the
    other's, as a share of the width. By default 0.03."""
    screen: float | None = None
    """Of anaglyphs: the plane of the screen, as a quantile of the depth of the first pair that
    shows some, 0 for the farthest and 1 for the nearest. By default it is half as near as the
    nearest."""
    flo: bool = False
    """Write NAME_flow.flo, the image motion without the rounding that NAME.npz has."""
    ply: bool = False
    """Write NAME.ply, a coloured point cloud of the pixels that are visible in both frames."""
    report: bool = False
    """Write report.html, one page for a browser: summary, statuses with advice, pictures."""
    workers: int = 1
    """Processes that share the pairs. Results do not depend on it."""
    cluster: Annotated[str | None, arg(metavar="ADDRESS")] = None
    """The scheduler of a Dask cluster whose workers share the pairs, such as tcp://10.0.0.1:8786.
    They see the frames and DIR by the same paths."""
    arch: Arch | None = None
    """Where kernels run; by default what the variable TI_ARCH says, or else the CPU."""
    threads: int | None = None
    """Most CPU threads, of each worker if there are several; by default all cores, or its share of
    them. Results do not depend on it."""
    frames: OmitArgPrefixes[FrameOptions] = field(default_factory=FrameOptions)
    camera: OmitArgPrefixes[CameraOptions] = field(default_factory=CameraOptions)
    settings: OmitArgPrefixes[SettingsOptions] = field(default_factory=SettingsOptions)

    def __call__(self) -> int:
        """Run the command and return the exit code."""
        if not self.source:
            raise InputError(
                "SOURCE is missing: give two or more images, a folder, a quoted glob or a video, "
                "as in: tisfm run FOLDER -o DIR"
            )
        return run(
            self.source[0] if len(self.source) == 1 else self.source,
            self.output,
            camera=self.camera.camera(),
            guess=self.camera.guess(self.settings.motion),
            settings=self.settings.settings(),
            frames=self.frames.selection(),
            poses=self.poses,
            mask=self.mask,
            window=self.window,
            resume=self.resume,
            outputs=self._outputs(),
            figures=0 if self.no_figures else self.figures,
            disparity=self.disparity,
            screen=self.screen,
            report=self.report,
            workers=self.workers,
            cluster=self.cluster,
            arch=self.arch,
            threads=self.threads,
        )

    def _outputs(self) -> tuple[str, ...]:
        """Return what is written, or raise ValueError."""
        if self.figures < 0:
            raise InputError(f"figures is {self.figures}: expected a number of pairs, or 0")
        chosen = self.outputs or USUAL
        more = ["flow"] * self.flo + ["ply"] * self.ply
        return checked_outputs([*chosen, *more])


def run(
    source: Source,
    output: Path,
    *,
    camera: Camera | Path,
    guess: bool = False,
    settings: Settings,
    frames: FrameSelection,
    poses: Path | None = None,
    mask: str | None = None,
    window: WindowSize = 2,
    resume: bool = False,
    outputs: Collection[str] = USUAL,
    figures: int = 1,
    disparity: float | None = None,
    screen: float | None = None,
    report: bool = False,
    workers: int = 1,
    cluster: str | None = None,
    arch: Arch | None = None,
    threads: int | None = None,
) -> int:
    """Interpret every pair of a source and write the results; return the exit code.

    With `guess` the first frame decides on the focal length, whatever that of the camera. `camera`
    may be a file of one. `poses` is a file of a pose for every frame, those that are not taken
    included. `mask` is a picture, or a folder or pattern of one for every frame. With several
    `workers`, processes, or a `cluster`, the address of a scheduler of Dask, these share the pairs;
    results are the same. `disparity` and `screen` are of anaglyphs. With `report`, ``report.html``
    is written at the end, or made again.
    """
    if isinstance(camera, Path):
        read_camera(camera)  # it is refused before anything else is done
    check_disparity(DISPARITY if disparity is None else disparity)
    check_screen(screen, None)
    if "anaglyph" not in outputs and (disparity, screen) != (None, None):
        raise InputError(
            f"--{'disparity' if screen is None else 'screen'} is of anaglyphs: let anaglyph be "
            "among the outputs, or leave it out"
        )
    kept = window_of(window, settings)
    if kept is not None and resume and "npz" not in outputs:
        raise InputError(
            "resume with a window of 3 goes on from the .npz of the pair before: let npz be among "
            "the outputs"
        )
    if report:
        if "npz" not in outputs:
            raise InputError(
                "the report shows what NAME.npz holds: let npz be among the outputs, or leave out "
                "--report"
            )
        check_report(output)
    check_workers(workers, cluster)
    is_shared = workers > 1 or cluster is not None
    if is_shared:
        _refuse_sharing(source, kept)
    opened = PairSource(source=source, frames=frames, settings=settings, mask=mask, poses=poses)
    pairs, posed = opened.open()
    _refuse_mixing(source, pairs.frame_files, output)
    if mask is not None:
        _refuse_mixing(mask, pairs.mask_files, output, kind="masks")
    for note in pairs.notes:
        tell(f"note: {note}")
    total = _total(pairs)
    if is_shared and total is None:
        raise InputError(f"{pairs.title} does not say how many frames it has: leave out workers")
    first = next(posed)  # before anything is written; the others have its size
    if "flow" in outputs:
        require_writable_flow(f"frame {first.name0}", *first.frame0.shape[:2])
    if is_shared and first.frame0.dtype.kind == "f":
        raise InputError(
            f"frame {first.name0} has decimals: which scale such frames are on is told by all that "
            "came before, which several workers do not see; leave them out"
        )
    full, shape = first.full, first.frame0.shape
    following = chain([first], posed)
    del first  # or it would be held to the end
    start_kernels(arch, threads=threads)
    if isinstance(camera, Path):
        camera = stated_camera(camera, full or shape[:2])
    elif guess:
        camera = guessed_camera(camera, pairs.first_file or full or shape)
    of_source = camera, full or shape[:2]
    camera = pairs.camera_after(camera, full)
    writer = PairWriter(
        output,
        camera=camera,
        settings=settings,
        source=of_source,
        window=window,
        outputs=outputs,
        figures=figures,
        disparity=DISPARITY if disparity is None else disparity,
        screen=screen,
        start=pairs.chosen.start,
        step=pairs.chosen.step,
        resume=resume,
        inputs=InputFiles([*pairs.files, *([] if poses is None else [poses])]),
        names=_names(pairs, output),
        notes=pairs.notes,
    )
    work = PairWork(camera=camera, settings=settings, files=writer.files)
    skipped: dict[int, str] = {}
    others = open_pool(workers, cluster) if is_shared else nullcontext()
    with closing(posed), writer, others as many, RunProgress(total) as progress:
        here = _Here(writer, work, opened, progress, kept, total)
        done = here.interpret(following, until_ranges=is_shared)
        skipped.update(pairs.skipped)
        if many is not None and total is not None and done < total:
            posed.close()
            whole = Chunk(
                source=opened,
                work=work,
                first=done,
                end=total,
                arch=runtime.running_arch(),  # type: ignore[arg-type]  # it is one that it takes
                threads=threads,
                listing=pairs.listing,
            )
            if cluster is not None:
                whole = whole.anywhere()
            elif threads is None:
                whole = replace(whole, threads=max(1, usable_cores() // workers))
            for chunk in _shared(whole, writer, many):
                here.seconds += _take(chunk, writer, progress)
                here.foretell()
                skipped.update(chunk.skipped)
        else:  # nothing is left to share, unless a video has more frames than it says
            here.interpret(posed, until_ranges=False)
            skipped.update(pairs.skipped)
    _tell(writer, here.seconds)
    for _, reason in sorted(skipped.items()):
        tell(f"skipped: {reason}")
    if report:
        report_run(output, source)
    return 0


@dataclass
class _Here:
    """The pairs that this process interprets."""

    writer: PairWriter
    work: PairWork
    source: PairSource
    progress: RunProgress
    kept: Window | None
    total: int | None
    foretelling: Foretelling = field(default_factory=lambda: Foretelling("pairs"))
    seconds: list[float] = field(default_factory=list)
    _is_announced: bool = False

    def interpret(self, pairs: Iterable[FramePair], *, until_ranges: bool) -> int:
        """Interpret pairs, all or until the ranges are known; return the number of the next."""
        writer, kept, progress = self.writer, self.kept, self.progress
        finished, number = None, -1
        with Background() as background:
            for pair in progress.timed("decoding", pairs):
                name, number = pair.name0, self.source.number(pair)
                if writer.knows(name) and writer.is_complete(name, pair.digest, number):
                    finished = None if kept is None else pair
                else:
                    if kept is not None and finished is not None:
                        before = Interpretation.load(writer.result_of(finished.name0))
                        finished.keep(kept, before, camera=self.work.camera)
                        del before
                    finished = None
                    with progress.stage("interpreting"):
                        result = self.work.interpret(pair, kept)
                    self.seconds.append(progress.last)
                    writer.took(name, progress.last)
                    with progress.stage("interpreting"):
                        about = self.work.about(pair, number)
                    with progress.stage("writing"):
                        background.submit(writer.write, name, result, **about)
                    del result, about  # or they would be held while the next is computed
                progress.finish(name, writer.statuses)
                self._announce()
                self.foretell()
                del pair
                if until_ranges:
                    background.wait()
                    if writer.ranges is not None:
                        break
        return number + 1

    def foretell(self) -> None:
        """Say how long it takes, by the pairs that were not complete before."""
        if self.total is not None:
            made = len(self.seconds)
            done = sum(self.writer.statuses.values())
            self.foretelling.done(made, made + self.total - done)

    def _announce(self) -> None:
        if not self._is_announced and self.total is not None and self.writer.statuses:
            self._is_announced = True
            _announce(self.writer, self.total)


def _shared(whole: Chunk, writer: PairWriter, many: WorkerPool) -> Iterator[FinishedChunk]:
    """Let other processes do what is left, and yield what they have done, in any order.

    An error of one of them is raised when what is under way is done and yielded.
    """
    writer.begin()
    error: BaseException | None = None
    with presence_file(whole.work.files.folder) as alive:
        parts = [
            replace(
                part, known=writer.known(part.first, part.end), alive=alive, ranges=writer.ranges
            )
            for part in chunks_of(whole, many.workers)
        ]
        try:
            for _, done in many.finished(interpret_chunk, parts):
                yield done
                if done.error is not None:
                    error = done.error
                    break
        except KeyboardInterrupt as interrupt:
            error = interrupt
    if error is not None:
        yield from many.under_way()
        raise error


def _take(chunk: FinishedChunk, writer: PairWriter, progress: RunProgress) -> list[float]:
    """Take down what another process did; return how long its pairs took."""
    seconds = []
    for pair in chunk.pairs:
        if pair.about is not None and pair.sums is not None:
            writer.finish(pair.name, pair.about, pair.sums)
            writer.took(pair.name, pair.seconds)
            seconds.append(pair.seconds)
    if chunk.pairs:
        progress.finish(chunk.pairs[-1].name, writer.statuses, count=len(chunk.pairs))
    return seconds


def _refuse_sharing(source: Source, kept: Window | None) -> None:
    """Refuse what several processes cannot share."""
    if kept is not None:
        raise InputError(
            "a window of 3 goes on from pair to pair, which several workers cannot: leave out "
            "one of them"
        )
    if isinstance(source, str) and webcam_number(source) is not None:
        raise InputError(f"{source} is no file, which several workers could read: leave them out")


def _total(pairs: FrameSource) -> int | None:
    """Return the number of pairs, None where only reading tells."""
    try:
        return len(pairs)
    except TypeError:
        return None


def _tell(writer: PairWriter, seconds: list[float]) -> None:
    """Say what was done, and what to try where something is wrong."""
    statuses = ", ".join(f"{count} {code}" for code, count in writer.statuses.items())
    typical = f", {sorted(seconds)[len(seconds) // 2]:.2f} s each (median)" if seconds else ""
    number = sum(writer.statuses.values())
    tell(
        f"{number} pair{'s' * (number != 1)}: {statuses}{typical}. Results in {writer.folder}, "
        f"settings and scales in {writer.folder / RECORD}."
    )
    for code, advice in writer.advice.items():
        tell(f"{code}: {advice}")
    if note := writer.times_note:
        tell(f"note: {note}")


def _announce(writer: PairWriter, total: int) -> None:
    """Say how much a long run will write, and whether the disk has room for it."""
    total -= sum(writer.statuses.values()) - 1  # those are written
    expected, free = writer.expected_bytes(total), shutil.disk_usage(writer.folder).free
    if expected > free:
        tell(
            f"about {as_size(expected)} for {total} pairs, but {as_size(free)} are free: see "
            "--outputs"
        )
    elif expected > MUCH:
        tell(f"about {as_size(expected)} for {total} pairs in {writer.folder}; --outputs chooses")


def _refuse_mixing(
    source: Source, files: Iterable[Path], output: Path, *, kind: str = "frames"
) -> None:
    """Refuse to write among the frames, where results would count as frames the next time."""
    if not isinstance(source, (str, os.PathLike)) or os.path.isfile(source):
        return
    folders = {file.parent for file in files}
    among = any(
        folder.exists() and folder.samefile(output) for folder in folders if output.exists()
    )
    if among or (glob.has_magic(os.fspath(source)) and _matches(output, Path(source).parent)):
        raise InputError(
            f"the results would lie among the {kind} in {output}, and count as {kind} the "
            "next time: give another folder with -o"
        )


def _matches(folder: Path, pattern: Path) -> bool:
    """Return whether the folders of a glob pattern, such as "d?" in "d?/*.png", include one."""
    parts, patterns = (Path(os.path.abspath(path)).parts for path in (folder, pattern))
    return len(parts) == len(patterns) and all(map(fnmatch.fnmatch, parts, patterns))


def _names(pairs: FrameSource, output: Path) -> list[str]:
    """Return names of pairs whose results may lie in a folder already."""
    if pairs.names is not None:
        return list(pairs.names)
    if not output.is_dir():
        return []
    numbered = re.compile(re.escape(pairs.prefix) + r"_\d{6,}", re.IGNORECASE)
    found = (numbered.match(name) for name in os.listdir(output))
    return sorted({match.group() for match in found if match})
