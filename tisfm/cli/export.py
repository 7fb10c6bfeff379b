"""``tisfm export``."""

import shutil
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from rich.progress import Progress
from tyro.conf import Positional, UseAppendAction, arg

from tisfm.checks import spelling_hint
from tisfm.cli.console import tell, tell_grade
from tisfm.cli.coverage import chosen_coverage
from tisfm.cli.progress import LARGE_OUTPUT, progress_bar
from tisfm.errors import InputError
from tisfm.folders.result_folder import make_result_folder
from tisfm.machine.text import as_duration, as_size
from tisfm.reconstruction.result.folder import DEPTH, RECORD
from tisfm.reconstruction.result.reconstruction import Reconstruction
from tisfm.show.stereo import check_disparity, check_screen

if TYPE_CHECKING:  # their import takes seconds, since it imports Taichi and SciPy
    from tisfm.exports.export_request import ExportRequest
    from tisfm.exports.formats import Format
    from tisfm.results.pair_frames import PairFrames
    from tisfm.results.sequence_frames import SequenceFrames

FormatName = Literal[
    "tum", "kitti", "ply", "glb", "mesh-ply", "mesh-glb", "gltf-camera", "chan", "colmap",
    "colmap-text", "nerfstudio", "undistortion", "undistortion-tiff", "depth-tum", "depth-kitti",
    "depth-exr", "depth-tiff", "depth-pfm", "depth-dpt", "masks", "video-depth", "video-flow",
    "video-side-by-side", "video-anaglyph", "video-wiggle",
]  # fmt: skip


@dataclass(kw_only=True)
class Export:
    """Write a result in the file formats of other programs.

    DIR is the folder that tisfm reconstruct or tisfm run wrote. Formats of the camera path: tum,
    kitti, gltf-camera, chan. Path, frames, and points measured in the frames: colmap, colmap-text,
    nerfstudio. Points and surfaces: ply, glb, mesh-ply, mesh-glb. Lens: undistortion,
    undistortion-tiff. Every frame: depth-tum, depth-kitti, depth-exr, depth-tiff, depth-pfm,
    depth-dpt, masks. Videos: video-depth, video-flow, video-side-by-side, video-anaglyph,
    video-wiggle. Paths and surfaces need a reconstruction, video-flow needs a run. Where the path
    of a sequence broke, a new piece began, with its own scale and coordinate system: each piece has
    its own file, and the largest piece comes first.
    """

    folder: Annotated[Positional[Path], arg(metavar="DIR")]
    """The folder of a reconstruction or a run."""
    to: UseAppendAction[tuple[FormatName, ...]]
    """Formats to write: names with commas between, or the option several times."""
    output: Annotated[Path, arg(aliases=["-o"], metavar="OUT")]
    """Folder for the files, other than DIR; made if it does not exist. Files of the same name are
    replaced."""
    start: int = 0
    """Number of the first frame to export, as DIR counts them, from 0."""
    stop: int | None = None
    """Stop before the frame of this number. By default all frames are exported."""
    step: int = 1
    """Export every STEP-th frame."""
    fps: float | None = None
    """Frame rate of videos and of the animated camera, and the rate from which the times of the
    path are made. By default it follows from the times of the frames. Without times it is 25, and
    the path has frame numbers as times."""
    scale: Annotated[tuple[int, int, float] | None, arg(metavar="FRAME FRAME DISTANCE")] = None
    """Two frame numbers, from 0, and the distance between the positions of the camera at these
    frames. It sets the unit."""
    disparity: float | None = None
    """For video-anaglyph, and for video-wiggle, whose camera swings from side to side: disparity
    between the nearest and the farthest point, as a share of the width. By default 0.03 between the
    eyes of the anaglyph, and 0.015 from the middle of the swing to either end."""
    screen: float | None = None
    """For video-anaglyph and video-wiggle: share of the pixels, from 0 to 1, that appear behind the
    screen; the others appear in front of it. By default the screen is twice as far away as the
    nearest point."""
    complete: bool = False
    """For points and surfaces of a reconstruction: keep uncertain depth too, and what a single
    keyframe shows."""
    strict: bool = False
    """For points and surfaces of a reconstruction: keep only what three keyframes agree on
    precisely."""
    screen_depth: float | None = None
    """For video-anaglyph and video-wiggle: depth of the screen, in the unit of the result, instead
    of --screen."""

    def __call__(self) -> int:
        """Run the command and return the exit code."""
        return export(self)


_WITH_SCREEN = {"video-anaglyph", "video-wiggle"}
_FUSED = {"ply", "glb", "mesh-ply", "mesh-glb"}
_MIN_PRINTED_TIME = 20.0  # s: a shorter remaining time is not printed; set by hand
_MIN_MEASURED_TIME = 1.0  # s over which the speed of an export is measured; set by hand


def export(options: Export) -> int:
    """Write a result in other formats, and return the exit code.

    Everything that can be checked is checked before the first file is written.
    """
    from tisfm.exports.export_request import ExportRequest, check_rate
    from tisfm.exports.grade_file import GRADES, write_grades

    folder, output, scale = options.folder, options.output, options.scale
    formats = _formats(options.to)
    if options.fps is not None:
        check_rate(options.fps)
    if options.disparity is not None:
        check_disparity(options.disparity)
    check_screen(options.screen, options.screen_depth)
    for name in ("disparity", "screen", "screen_depth"):
        if getattr(options, name) is not None and not formats.keys() & _WITH_SCREEN:
            raise InputError(
                f"--{name.replace('_', '-')} is only for {' and '.join(sorted(_WITH_SCREEN))}: "
                "give one of them with --to, or leave it out"
            )
    coverage = chosen_coverage(options.complete, options.strict)
    if coverage != "normal" and not formats.keys() & _FUSED:
        raise InputError(
            f"--{coverage} is only for points and surfaces: give one of "
            f"{', '.join(sorted(_FUSED))} with --to, or leave it out"
        )
    _refuse_inside(output, folder)
    result, frames = _open_result(folder, scale)
    if coverage != "normal" and not frames.can_fuse:
        raise InputError(
            f"--{coverage} is only for reconstructions, whose keyframes are fused, but {folder} "
            "has pairs: leave it out"
        )
    if options.screen_depth is not None and not frames.has_one_scale:
        raise InputError(
            f"--screen-depth needs one unit of depth, but each pair of {folder} has its own: give "
            "--screen, a quantile"
        )
    request = ExportRequest(
        result=result,
        frames=frames,
        chosen=_select_frames(len(frames), options.start, options.stop, options.step),
        folder=output,
        frames_per_second=options.fps,
        disparity=options.disparity,
        screen=options.screen,
        screen_depth=options.screen_depth,
        coverage=coverage,
    )
    for form in formats.values():
        form.check(request)
    make_result_folder(output)
    _announce(formats, request)
    if result is not None and scale is not None and len(result.unit) > 1:
        size = int((result.piece == result.piece[scale[0]]).sum())
        tell(
            f"--scale sets the unit of the piece of these two frames, which has {size} frames; "
            "other pieces keep their units"
        )
    printed_notes: set[str] = set()
    for name, form in formats.items():
        with progress_bar() as bar:
            files = form.write(request, _progress_callback(name, bar))
        tell(f"{name}: {_describe_files(files)}")
        notes = [note for note in form.notes(request) if note not in printed_notes]
        printed_notes.update(notes)
        for note in notes:
            tell(f"{name}: {note}")
    if warning := write_grades(frames, output, request.chosen):
        tell_grade(f"warning: {warning.removesuffix('.')}. Every frame is in {output / GRADES}.")
    return 0


def _formats(names: Sequence[str]) -> "dict[str, Format]":
    """Return formats by their names, each once; ValueError for unknown names."""
    from tisfm.exports.formats import FORMATS

    unknown_names = [name for name in names if name not in FORMATS]
    if unknown_names or not names:
        spelling = spelling_hint(unknown_names[0], FORMATS) if unknown_names else ""
        reason = (
            f"{unknown_names[0]!r} is not a format{spelling}"
            if unknown_names
            else "no format is given"
        )
        choices = "" if spelling else f": expected some of {', '.join(FORMATS)}"
        raise InputError(f"--to: {reason}{choices}")
    return {name: FORMATS[name] for name in names}


def _open_result(
    folder: Path, scale: tuple[int, int, float] | None
) -> "tuple[Reconstruction | None, SequenceFrames | PairFrames]":
    """Return the reconstruction in a folder, None for a run, and its frames."""
    from tisfm.folders.run_record import RECORD as RUN
    from tisfm.results.pair_frames import PairFrames
    from tisfm.results.sequence_frames import SequenceFrames

    if not folder.is_dir():
        raise FileNotFoundError(
            f"there is no folder {folder}: give one that tisfm reconstruct or tisfm run wrote"
        )
    if (folder / RECORD).is_file() or (folder / DEPTH).is_dir():
        result = Reconstruction.load(folder)
        if scale is not None:
            result = result.rescaled(*scale)
        return result, SequenceFrames(result)
    if not (folder / RUN).is_file():
        raise FileNotFoundError(
            f"{folder} has neither {RECORD} nor {RUN}: give a folder that tisfm reconstruct or "
            "tisfm run wrote"
        )
    if scale is not None:
        raise InputError(
            f"--scale needs the path of a reconstruction, but {folder} is a run: leave it out"
        )
    return None, PairFrames(folder)


def _select_frames(count: int, start: int, stop: int | None, step: int) -> range:
    """Return the numbers of the selected frames; ValueError if there are none."""
    if start < 0 or step < 1 or (stop is not None and stop < 0):
        raise InputError(
            f"--start {start}, --stop {stop}, --step {step}: expected 0 or more, and a step of 1 "
            "or more"
        )
    chosen = range(start, count if stop is None else min(stop, count), step)
    if not chosen:
        raise InputError(f"--start and --stop leave no frame of {count}")
    return chosen


def _refuse_inside(output: Path, folder: Path) -> None:
    """Raise InputError if the output lies in the folder of the result."""
    path, result = output.resolve(), folder.resolve()
    if result in (path, *path.parents):
        raise InputError(f"{output} lies in {folder}, the input: give another folder with -o")


def _announce(formats: "dict[str, Format]", request: "ExportRequest") -> None:
    """Print the expected size of a large export, and whether the disk has space for it."""
    height, width = request.frames.shape
    pixels = len(request.chosen) * height * width
    expected = sum(form.bytes_per_pixel for form in formats.values()) * pixels
    free = shutil.disk_usage(request.folder).free
    about = f"up to {as_size(expected)} for {len(request.chosen)} frames of {width}×{height} px"
    if expected > free:
        tell(f"{about}, but {as_size(free)} are free: choose frames with --start, --stop, --step")
    elif expected > LARGE_OUTPUT:
        tell(f"{about} in {request.folder}")


def _progress_callback(name: str, bar: Progress) -> Callable[[int, int], None]:
    """Return a callback for the progress of a format; it prints a long remaining time."""
    task, is_printed = bar.add_task(name, total=None), False
    measured_since, measured_count = 0.0, 0

    def tell_progress(done: int, total: int) -> None:
        nonlocal measured_since, measured_count, is_printed
        bar.update(task, completed=done, total=total)
        now = time.monotonic()
        if not measured_count or done <= measured_count:  # the first call gives no speed
            measured_since, measured_count = now, done
        elif not is_printed and now - measured_since > _MIN_MEASURED_TIME:
            is_printed = True
            remaining_time = (now - measured_since) / (done - measured_count) * (total - done)
            if remaining_time > _MIN_PRINTED_TIME:
                tell(f"{name}: about {as_duration(remaining_time)} for {total - done} more frames")

    return tell_progress


def _describe_files(files: Sequence[Path]) -> str:
    """Return the paths of files, or their number in each folder if there are more than four."""
    folders = Counter(file.parent for file in files)
    if len(files) <= 4:
        return ", ".join(map(str, files))
    return ", ".join(f"{count} files in {folder}" for folder, count in folders.items())
