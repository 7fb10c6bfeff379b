"""``tisfm run``."""

import warnings
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import FlagCreatePairsOff, OmitArgPrefixes, Positional, UseAppendAction, arg

from tisfm.cli.console import tell, tell_device, tell_grade
from tisfm.cli.options import CameraOptions, FrameOptions, SettingsOptions
from tisfm.cli.progress import RunProgress
from tisfm.cli.report import report_run
from tisfm.errors import InputError
from tisfm.folders.run_record import RECORD
from tisfm.report import check_report
from tisfm.running.pair_files import DEFAULT_OUTPUTS, check_outputs
from tisfm.running.pair_writer import PairWriter
from tisfm.running.sequence_run import SequenceRun
from tisfm.runtime import Arch, SoftwareVulkanWarning
from tisfm.settings import FixedPixels, Preset
from tisfm.window import WindowSize

Output = Literal["depth", "depth16", "flow", "anaglyph", "figure", "ply", "pose", "npz"]


@dataclass(kw_only=True)
class Run:
    """Estimate image motion, depth and 3D motion of every pair of consecutive frames.

    SOURCE is two or more images, a folder of images, a quoted glob such as 'frames/*.png', a video,
    or webcam:0, the camera of this computer. NAME is the name of the first frame of a pair. For
    each pair, DIR receives NAME_depth.png (depth in grey levels, near is bright), NAME_depth16.png
    (depth in 16 bits; the file and run.json state its scale), NAME_anaglyph.png (red-cyan) and
    NAME_figure.png; with --motion camera or objects NAME_pose.txt; with --flo NAME_flow.flo; with
    --ply NAME.ply; and last NAME.npz, the whole result, for tisfm.Interpretation.load.
    """

    source: Annotated[
        Positional[tuple[str, ...]],
        arg(metavar="SOURCE [SOURCE ...]", help_behavior_hint="(required)"),
    ]
    """Two or more images, a folder, a quoted glob, a video, or a webcam such as webcam:0."""
    output: Annotated[Path, arg(aliases=["-o"], metavar="DIR")]
    """Folder for the results; made if it does not exist."""
    preset: Preset = "balanced"
    """Settings to start from. The defaults of the settings below are those of this preset."""
    poses: Annotated[Path | None, arg(metavar="FILE")] = None
    """File of known poses, for --motion camera; depth is then in their unit. It has a line of 12
    numbers for every frame of SOURCE, as in KITTI: the rows of (R | t), camera to world."""
    mask: Annotated[str | None, arg(metavar="MASK")] = None
    """A picture, or a folder with a picture for every frame: black pixels are ignored."""
    fixed_pixels: FixedPixels = "mask"
    """With --motion camera, pixels that stay at rest while the camera moves, such as a bonnet, a
    logo or a caption: mask ignores them; keep uses them."""
    window: WindowSize = 2
    """Frames that an interpretation uses: 2 is the pair; 3 adds the frame before it, for --motion
    field."""
    resume: bool = False
    """Continue an interrupted run: skip the pairs that it finished."""
    outputs: UseAppendAction[tuple[Output, ...]] = ()
    """The files to write for each pair: names with commas between, or the option several times. By
    default all but flow and ply, which are large."""
    figures: int = 1
    """Draw NAME_figure.png, the slowest output, for the first pair and every N-th pair after it; 0
    draws none."""
    no_figures: Annotated[bool, FlagCreatePairsOff] = False
    """Draw no NAME_figure.png: the same as --figures 0."""
    disparity: float | None = None
    """For anaglyphs: disparity between the nearest and the farthest point, from one eye to the
    other, as a share of the width. By default 0.03."""
    screen: float | None = None
    """For anaglyphs: share of the pixels, from 0 to 1, that appear behind the screen, in the first
    pair with depth; the others appear in front of it. By default the screen is twice as far away as
    the nearest point."""
    flo: bool = False
    """Write NAME_flow.flo, the image motion without rounding. NAME.npz has it rounded."""
    ply: bool = False
    """Write NAME.ply, a coloured point cloud of the pixels that are visible in both frames."""
    report: bool = False
    """Write report.html, one page for a browser: summary, statuses with advice, pictures."""
    workers: int = 1
    """Number of processes that share the pairs. Results do not depend on it."""
    cluster: Annotated[str | None, arg(metavar="ADDRESS")] = None
    """Address of the scheduler of a Dask cluster whose workers share the pairs, such as
    tcp://10.0.0.1:8786. They must find the frames and DIR under the same paths."""
    arch: Arch | None = None
    """Processor that runs the kernels. By default the environment variable TI_ARCH decides, or else
    it is the CPU."""
    threads: int | None = None
    """Maximum number of CPU threads, for each worker if there are several. By default all cores;
    several workers divide them. Results do not depend on it."""
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
            SequenceRun(
                source=self.source[0] if len(self.source) == 1 else self.source,
                folder=self.output,
                camera=self.camera.camera(),
                guess=self.camera.guess(self.settings.motion),
                settings=self.settings.settings(),
                frames=self.frames.selection(),
                poses=self.poses,
                mask=self.mask,
                fixed_pixels=self.fixed_pixels,
                window=self.window,
                resume=self.resume,
                outputs=self._outputs(),
                figures=0 if self.no_figures else self.figures,
                disparity=self.disparity,
                screen=self.screen,
                workers=self.workers,
                cluster=self.cluster,
                arch=self.arch,
                threads=self.threads,
            ),
            report=self.report,
        )

    def _outputs(self) -> tuple[str, ...]:
        """Return the outputs of a pair, or raise ValueError."""
        if self.figures < 0:
            raise InputError(f"figures is {self.figures}: expected a number of pairs, or 0")
        chosen = self.outputs or DEFAULT_OUTPUTS
        extra_outputs = ["flow"] * self.flo + ["ply"] * self.ply
        return check_outputs([*chosen, *extra_outputs])


def run(sequence: SequenceRun, *, report: bool) -> int:
    """Interpret all pairs, print a summary, write the report if requested; return the exit code."""
    if report:
        if "npz" not in sequence.outputs:
            raise InputError(
                "the report shows the contents of NAME.npz: add npz to --outputs, or leave out "
                "--report"
            )
        check_report(sequence.folder)
    tell_device(sequence.arch)
    with RunProgress() as progress, warnings.catch_warnings():
        warnings.simplefilter("ignore", SoftwareVulkanWarning)  # tell_device printed it
        skipped = sequence.interpret(progress, tell)
    if progress.writer is not None:
        _tell_result(progress.writer)
    for reason in skipped.values():
        tell(f"skipped: {reason}")
    if report:
        report_run(sequence.folder, sequence.source)
    return 0


def _tell_result(writer: PairWriter) -> None:
    """Print the number of pairs for each status, and its advice."""
    statuses = ", ".join(f"{count} {code}" for code, count in writer.statuses.items())
    seconds = sorted(writer.seconds)
    median_time = f", {seconds[len(seconds) // 2]:.2f} s each (median)" if seconds else ""
    number = sum(writer.statuses.values())
    grades = writer.grade_summary
    field_note = "" if writer.files.has_pose else ", as field only shows near and far"
    tell_grade(
        f"{number} pair{'s' * (number != 1)}: {statuses}{median_time}. "
        + (f"Grade {grades.text}{field_note}. " if grades else "")
        + f"Results in {writer.folder}, settings and scales in {writer.folder / RECORD}."
    )
    for code, advice in writer.advice.items():
        tell(f"{code}: {advice}")
    if note := writer.focal_note:
        tell(f"note: {note}")
    if note := writer.times_note:
        tell(f"note: {note}")
