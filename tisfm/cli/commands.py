"""What the commands do."""

import fnmatch
import glob
import os
import re
import shutil
from collections import Counter
from collections.abc import Collection, Iterable, Sequence
from contextlib import closing
from dataclasses import replace
from itertools import chain, pairwise
from pathlib import Path

import numpy as np

from tisfm import runtime
from tisfm.camera import Camera
from tisfm.camera_file import read_camera
from tisfm.cli.background import Background
from tisfm.cli.console import print_whole, progress_bar, tell
from tisfm.cli.frame_options import FrameOptions
from tisfm.cli.outputs import USUAL, PairWriter
from tisfm.cli.paper_figures import write_paper_figures
from tisfm.cli.run_progress import RunProgress
from tisfm.cli.run_record import RECORD
from tisfm.cli.stated_camera import stated_camera
from tisfm.datasets import LAYOUTS, Layout, LoadedPair, find_pairs
from tisfm.datasets.trajectories import motion_between, read_poses
from tisfm.evaluation.files import EVALUATION_RECORD, EvaluationWriter
from tisfm.evaluation.pairs import PairEvaluation
from tisfm.evaluation.pairs import evaluate as evaluate_pairs
from tisfm.evaluation.tables import evaluation_tables
from tisfm.focal_guess import guess_focal
from tisfm.formats.flo import require_writable_flow
from tisfm.formats.outputs import InputFiles
from tisfm.horn_schunck import horn_schunck
from tisfm.interpretation import Interpretation
from tisfm.lens import undistort
from tisfm.rigid import check_pose
from tisfm.runtime import Arch
from tisfm.sequence import with_poses
from tisfm.settings import Settings
from tisfm.sources import FramePair, FrameSource, Source
from tisfm.window import WindowSize, window_of

_MUCH = 2e8  # bytes: a run that writes more says so beforehand


def run(
    source: Source,
    output: Path,
    *,
    camera: Camera | Path,
    guess: bool = False,
    settings: Settings,
    frames: FrameOptions,
    poses: Path | None = None,
    mask: str | None = None,
    window: WindowSize = 2,
    resume: bool = False,
    outputs: Collection[str] = USUAL,
    figures: int = 1,
    arch: Arch | None = None,
    threads: int | None = None,
) -> int:
    """Interpret every pair of a source and write the results; return the exit code.

    With `guess` the first frame decides on the focal length, whatever that of the camera. `camera`
    may be a file of one. `poses` is a file of a pose for every frame, those that are not taken
    included. `mask` is a picture, or a folder or pattern of one for every frame.
    """
    if isinstance(camera, Path):
        read_camera(camera)  # it is refused before anything else is done
    kept = window_of(window, settings)
    if kept is not None and resume and "npz" not in outputs:
        raise ValueError(
            "resume with a window of 3 goes on from the .npz of the pair before: let npz be among "
            "the outputs"
        )
    pairs = frames.open(source, mask=mask)
    _refuse_mixing(source, pairs.frame_files, output)
    if mask is not None:
        _refuse_mixing(mask, pairs.mask_files, output, kind="masks")
    motions = None if poses is None else _motions(poses, pairs, settings)
    posed = with_poses(pairs, motions, title=f"the motions of {poses}")
    first = next(posed)  # before anything is written; the others have its size
    if "flow" in outputs:
        require_writable_flow(f"frame {first.name0}", *first.frame0.shape[:2])
    full, shape = first.full, first.frame0.shape
    following = chain([first], posed)
    del first  # or it would be held to the end
    runtime.start(arch, threads=threads)
    if isinstance(camera, Path):
        camera = stated_camera(camera, full or shape[:2])
    elif guess:
        camera = _guessed(camera, pairs.first_file or full or shape)
    camera = pairs.camera_after(camera, full)
    writer = PairWriter(
        output,
        camera=camera,
        settings=settings,
        window=window,
        outputs=outputs,
        figures=figures,
        start=pairs.chosen.start,
        step=pairs.chosen.step,
        resume=resume,
        inputs=InputFiles([*pairs.files, *([] if poses is None else [poses])]),
        names=_names(pairs, output),
    )
    try:
        total: int | None = len(pairs)
    except TypeError:
        total = None
    seconds, finished, is_announced = [], None, False
    with closing(posed), writer, RunProgress(total) as progress, Background() as background:
        for number, pair in enumerate(progress.timed("decoding", following)):
            name = pair.name0
            if writer.knows(name) and writer.is_complete(name, pair.digest, number):
                finished = None if kept is None else pair
            else:
                if kept is not None and finished is not None:
                    before = Interpretation.load(writer.result_of(finished.name0))
                    finished.keep(kept, before, camera=camera)
                    del before
                finished = None
                with progress.stage("interpreting"):
                    result = pair.interpret(camera=camera, settings=settings, window=kept)
                seconds.append(progress.last)
                writer.took(name, progress.last)
                compared = settings.motion == "field" and writer.has_figure(number)
                with progress.stage("interpreting"):
                    baseline = _baseline(pair, camera, settings) if compared else None
                with progress.stage("writing"):
                    background.submit(_write, writer, number, pair, result, baseline)
                del result  # or it would be held while the next is computed
            progress.finish(name, writer.statuses)
            if not is_announced and total is not None and writer.statuses:
                is_announced = True
                _announce(writer, total)
            del pair
    statuses = ", ".join(f"{count} {code}" for code, count in writer.statuses.items())
    typical = f", {sorted(seconds)[len(seconds) // 2]:.2f} s each (median)" if seconds else ""
    number = sum(writer.statuses.values())
    tell(
        f"{number} pair{'s' * (number != 1)}: {statuses}{typical}. Results in {output}, settings "
        f"and scales in {output / RECORD}."
    )
    for code, advice in writer.advice.items():
        tell(f"{code}: {advice}")
    for _, reason in pairs.skipped:
        tell(f"skipped: {reason}")
    return 0


def evaluate(
    folders: Sequence[str],
    output: Path | None,
    *,
    layout: Layout | None = None,
    camera: Camera | None = None,
    settings: Settings,
    step: int | None = None,
    give_poses: bool = False,
    max_depth: float | None = None,
    arch: Arch | None = None,
    threads: int | None = None,
) -> int:
    """Interpret the pairs of datasets, print their errors, write all; return the exit code."""
    pairs = dict.fromkeys(
        pair for folder in folders for pair in find_pairs(folder, layout, step=step)
    )
    if step is not None and all(LAYOUTS[pair.layout].step is None for pair in pairs):
        raise ValueError(
            f"step is {step}, but there is no sequence with poses in {', '.join(folders)}: leave "
            "it out"
        )
    runtime.start(arch, threads=threads)
    writer = (
        None
        if output is None
        else EvaluationWriter(output, camera=camera, settings=settings, pairs=pairs)
    )
    with progress_bar() as progress:
        task = progress.add_task("compiling", total=len(pairs))

        def finish_pair(
            evaluation: PairEvaluation, result: Interpretation | None, loaded: LoadedPair | None
        ) -> None:
            if writer is not None:
                writer.write(evaluation, result, loaded)
            progress.update(task, advance=1, description=evaluation.label)

        evaluation = evaluate_pairs(
            pairs,
            camera=camera,
            settings=settings,
            give_poses=give_poses,
            max_depth=max_depth,
            on_load=None if writer is None else _require_writable,
            on_pair=finish_pair,
        )
    if writer is not None:
        writer.finish(evaluation)
    for table in evaluation_tables(evaluation):
        print_whole(table)
    good = [pair for pair in evaluation.pairs if pair.fault is None]
    if good:
        counts = Counter(pair.status for pair in good)
        number = len(good)
        statuses = ", ".join(f"{count} {code}" for code, count in counts.items())
        where = (
            ""
            if output is None
            else (f" Pictures and flow in {output}, every number in {output / EVALUATION_RECORD}.")
        )
        tell(f"{number} pair{'s' * (number != 1)}: {statuses}.{where}")
    advice = {pair.status: pair.message for pair in reversed(good) if pair.status != "converged"}
    for code, message in advice.items():
        tell(f"{code}: {message}")
    for pair in evaluation.faults:
        tell(f"tisfm: {pair.label}: {pair.fault}")
    return 1 if evaluation.faults else 0


def figures(
    frames: Sequence[str],
    output: Path,
    *,
    camera: Camera | Path,
    guess: bool = False,
    threads: int | None,
) -> int:
    """Draw the paper's comparisons of settings for two image files; `guess` as for `run`."""
    pairs = FrameSource(tuple(frames))
    inputs = InputFiles(pairs.files)
    runtime.start(threads=threads)
    for pair in pairs:
        if isinstance(camera, Path):
            camera = stated_camera(camera, pair.frame0.shape[:2])
        elif guess:
            camera = _guessed(camera, pairs.files[0])
        written = write_paper_figures(
            output, pair.frame0, pair.frame1, camera=camera, inputs=inputs
        )
        tell("wrote " + ", ".join(map(str, written)))
    return 0


def _write(
    writer: PairWriter,
    number: int,
    pair: FramePair,
    result: Interpretation,
    baseline: np.ndarray | None,
) -> None:
    writer.write(
        pair.name0,
        result,
        number=number,
        digest=pair.digest,
        times=pair.times,
        pose=None if pair.pose is None else np.asarray(pair.pose),
        baseline_flow=baseline,
    )


def _announce(writer: PairWriter, total: int) -> None:
    """Say how much a long run will write, and whether the disk has room for it."""
    total -= sum(writer.statuses.values()) - 1  # those are written
    expected, free = writer.expected_bytes(total), shutil.disk_usage(writer.folder).free
    if expected > free:
        tell(
            f"about {_size(expected)} for {total} pairs, but {_size(free)} are free: see --outputs"
        )
    elif expected > _MUCH:
        tell(f"about {_size(expected)} for {total} pairs in {writer.folder}; --outputs chooses")


def _size(count: float) -> str:
    """Return a number of bytes as it is read."""
    return f"{count / 1e9:.1f} GB" if count >= 1e9 else f"{count / 1e6:.0f} MB"


def _require_writable(loaded: LoadedPair) -> None:
    """Refuse frames that are too large for the files of `tisfm eval`."""
    require_writable_flow("frame0", *loaded.frame0.shape[:2])


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
        raise ValueError(
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


def _motions(path: Path, pairs: FrameSource, settings: Settings) -> list[np.ndarray]:
    """Return the motion of every pair, of a file with the pose of every frame."""
    if settings.motion != "camera":
        raise ValueError(
            f"the poses of {path} are given, but motion '{settings.motion}' leaves the motion "
            "free: give --motion camera"
        )
    poses = read_poses(path)
    if pairs.count is not None and len(poses) != pairs.count:
        raise ValueError(
            f"{path} has {len(poses)} poses, but there are {pairs.count} frames: expected a line "
            "of twelve numbers for every frame"
        )
    motions = [motion_between(*ends) for ends in pairwise(poses[pairs.chosen])]
    for index, motion in enumerate(motions):
        try:
            check_pose(motion)
        except ValueError as error:
            first = pairs.chosen.start + index * pairs.chosen.step
            second = first + pairs.chosen.step
            raise ValueError(f"{path}, frames {first} and {second}: {error}") from None
    return motions


def _guessed(camera: Camera, first: Path | tuple[int, ...]) -> Camera:
    """Return the camera with a focal length guessed by the first frame, or its shape; say so."""
    guess = guess_focal(first)
    tell(f"focal length guessed: {guess.focal:.0f} px, {guess.reason}; give --focal if known")
    return replace(camera, focal=guess.focal)


def _baseline(pair: FramePair, camera: Camera, settings: Settings) -> np.ndarray:
    """Return Horn and Schunck's flow of the frames without distortion."""
    frames = (undistort(frame, camera) for frame in (pair.frame0, pair.frame1))
    return horn_schunck(*frames, settings=settings)
