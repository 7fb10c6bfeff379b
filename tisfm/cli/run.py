"""``tisfm run``."""

import warnings
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import FlagCreatePairsOff, OmitArgPrefixes, Positional, UseAppendAction, arg

from tisfm.cli.console import tell, tell_device
from tisfm.cli.options import CameraOptions, FrameOptions, SettingsOptions
from tisfm.cli.progress import RunProgress
from tisfm.cli.report import report_run
from tisfm.errors import InputError
from tisfm.folders.run_record import RECORD
from tisfm.report import check_report
from tisfm.running.pair_files import USUAL, checked_outputs
from tisfm.running.pair_writer import PairWriter
from tisfm.running.sequence_run import SequenceRun
from tisfm.runtime import Arch, SoftwareVulkanWarning
from tisfm.settings import Preset
from tisfm.window import WindowSize

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
            SequenceRun(
                source=self.source[0] if len(self.source) == 1 else self.source,
                folder=self.output,
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
        chosen = self.outputs or USUAL
        more = ["flow"] * self.flo + ["ply"] * self.ply
        return checked_outputs([*chosen, *more])


def run(sequence: SequenceRun, *, report: bool) -> int:
    """Interpret all pairs, tell the result, write the report if wanted; return the exit code."""
    if report:
        if "npz" not in sequence.outputs:
            raise InputError(
                "the report shows what NAME.npz holds: let npz be among the outputs, or leave out "
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
    typical = f", {seconds[len(seconds) // 2]:.2f} s each (median)" if seconds else ""
    number = sum(writer.statuses.values())
    tell(
        f"{number} pair{'s' * (number != 1)}: {statuses}{typical}. Results in {writer.folder}, "
        f"settings and scales in {writer.folder / RECORD}."
    )
    for code, advice in writer.advice.items():
        tell(f"{code}: {advice}")
    if note := writer.times_note:
        tell(f"note: {note}")
