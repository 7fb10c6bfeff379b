"""``tisfm eval``."""

from collections import Counter
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import OmitArgPrefixes, Positional, arg

from tisfm.cli.console import print_full_width, start_kernels, tell
from tisfm.cli.options import SettingsOptions, StatedCameraOptions
from tisfm.cli.progress import TimeEstimate, progress_bar
from tisfm.datasets import LAYOUTS, Layout, LoadedPair, find_pairs
from tisfm.errors import InputError
from tisfm.evaluation.files import EVALUATION_RECORD, EvaluationWriter
from tisfm.evaluation.pair_tables import evaluation_tables
from tisfm.evaluation.pairs import PairEvaluation
from tisfm.evaluation.pairs import evaluate as evaluate_pairs
from tisfm.formats.float_maps import require_writable_flow
from tisfm.interpretation import Interpretation
from tisfm.runtime import Arch
from tisfm.settings import Preset

LayoutName = Literal[
    "middlebury", "kitti", "sintel", "yosemite", "stereo", "new_tsukuba", "sevenscenes",
    "calibrated", "tum", "kitti_odometry",
]  # fmt: skip


@dataclass(kw_only=True)
class Eval:
    """Compare results with the true flow, depth and poses of benchmarks.

    The command estimates image motion (flow), depth and 3D motion of every pair in the folders, and
    prints tables of errors. Errors of flow: end-point error (EPE), angular error (AAE), outliers as
    KITTI defines them (Fl), and the share of pixels with an error of 1 px or more (R1.0). If the
    dataset marks occluded pixels, also the EPE without them (noc), and the F1 score of the
    estimated occlusion (occ F1). Errors of depth, after scaling by the median: abs-rel, SILog, and
    the share of pixels within a factor of 1.25. Errors of the pose, with --motion camera: the angle
    between the directions of translation, and the angle between the rotations.

    Layouts for pairs: Middlebury, KITTI 2012 and 2015, Sintel, Yosemite, New Tsukuba, 7-Scenes,
    stereo pairs with a disparity, and folders of images/ with camera.txt, and poses.txt or depth/.
    Layouts for --sequence: New Tsukuba, 7-Scenes, TUM RGB-D, KITTI odometry, and such folders.

    With --sequence, the command reconstructs each sequence and compares its path (ATE, RPE, drift)
    and its depth, with one scale for all frames. DIR receives eval.json and NAME.tum, the path. If
    the path breaks, a new piece begins, with its own scale and coordinate system: NAME.tum is then
    the path of the largest piece, NAME-piece2.tum the path of the next.

    With --objects, the command compares the masks of moving objects in a reconstruction with the
    true masks of a sequence, such as those of DAVIS: intersection over union of each object, and
    the number of its label switches. If FOLDER has an objects.json like that of a reconstruction,
    and poses.txt of the camera, it also compares the paths of the objects.

    With -o, DIR receives eval.json with versions, settings and every number, and files for each
    pair NAME of DATASET. For true flow: DATASET/NAME_flow.flo, NAME_error.png (end-point error, one
    colour scale for all pairs), NAME_flow.png (estimated beside true flow). For true depth:
    NAME_depth_error.png (estimated and true depth, and the relative error).
    """

    folders: Annotated[
        Positional[tuple[str, ...]],
        arg(metavar="FOLDER [FOLDER ...]", help_behavior_hint="(required)"),
    ]
    """Folders of datasets, or folders above them."""
    output: Annotated[Path | None, arg(aliases=["-o"], metavar="DIR")] = None
    """Folder for pictures, flow and eval.json; made if it does not exist. By default nothing is
    written."""
    layout: LayoutName | None = None
    """Layout of the folders. By default every layout that is recognised."""
    step: int | None = None
    """For pairs of a sequence: the number of frames from the first to the second of a pair; by
    default 3 for 7-Scenes and 1 for others. With --sequence: use every STEP-th frame. With
    --objects: use every STEP-th true mask."""
    give_poses: bool = False
    """Use the true poses, and compare only the depth; with --motion camera or --sequence."""
    max_depth: float | None = None
    """Ignore pixels whose true depth is larger, in the unit of the dataset. By default no pixel is
    ignored."""
    sequence: bool = False
    """Reconstruct whole sequences instead of pairs, and compare their paths and depth."""
    objects: bool = False
    """Compare masks of moving objects: FOLDER, or its folder masks/, has the true masks. Needs
    --result."""
    result: Annotated[Path | None, arg(metavar="PATH")] = None
    """Compare this result, and reconstruct nothing. With --sequence: a trajectory of any program in
    the format of TUM or KITTI, or the folder of a reconstruction. With --objects: the folder of a
    reconstruction."""
    preset: Preset = "balanced"
    """Settings to start from. The defaults of the settings below are those of this preset."""
    arch: Arch | None = None
    """Processor that runs the kernels. By default the environment variable TI_ARCH decides, or else
    it is the CPU."""
    threads: int | None = None
    """Maximum number of CPU threads. By default all cores. Results do not depend on it."""
    camera: OmitArgPrefixes[StatedCameraOptions] = field(default_factory=StatedCameraOptions)
    settings: OmitArgPrefixes[SettingsOptions] = field(default_factory=SettingsOptions)

    def __call__(self) -> int:
        """Run the command and return the exit code."""
        from tisfm.cli.evaluate_sequences import evaluate_objects, evaluate_sequences

        if not self.folders:
            raise InputError(
                "FOLDER is missing: give the folder of a dataset, as in: tisfm eval FOLDER -o DIR"
            )
        if self.sequence and self.objects:
            raise InputError("--sequence and --objects are both given: give one of them")
        if self.objects:
            return evaluate_objects(self.folders, self.output, result=self.result, step=self.step)
        if self.sequence:
            if self.settings.motion == "field":
                raise InputError(
                    "--motion field works on pairs, but --sequence is given: use camera or objects"
                )
            return evaluate_sequences(self)
        if self.result is not None:
            raise InputError(
                f"--result is {self.result}, but pairs are compared: give --sequence or --objects"
            )
        return evaluate(self)


def _layout_of_pairs(layout: str | None) -> Layout | None:
    if layout is None or layout in LAYOUTS:
        return layout  # type: ignore[return-value]
    raise InputError(f"--layout is {layout!r}, which has only sequences: give --sequence")


def evaluate(options: Eval) -> int:
    """Interpret the pairs of datasets, print their errors, write all; return the exit code."""
    layout, step, output = _layout_of_pairs(options.layout), options.step, options.output
    camera, settings = options.camera.camera(), options.settings.settings()
    pairs = dict.fromkeys(
        pair for folder in options.folders for pair in find_pairs(folder, layout, step=step)
    )
    if step is not None and all(LAYOUTS[pair.layout].step is None for pair in pairs):
        raise InputError(
            f"step is {step}, but there is no sequence with poses in "
            f"{', '.join(options.folders)}: leave it out"
        )
    start_kernels(options.arch, threads=options.threads)
    writer = (
        None
        if output is None
        else EvaluationWriter(output, camera=camera, settings=settings, pairs=pairs)
    )
    estimate, finished_counts = TimeEstimate("pairs"), count(1)
    with progress_bar() as progress:
        task = progress.add_task("compiling", total=len(pairs))

        def finish_pair(
            evaluation: PairEvaluation, result: Interpretation | None, loaded: LoadedPair | None
        ) -> None:
            if writer is not None:
                writer.write(evaluation, result, loaded)
            progress.update(task, advance=1, description=evaluation.label)
            estimate.update(next(finished_counts), len(pairs))

        evaluation = evaluate_pairs(
            pairs,
            camera=camera,
            settings=settings,
            give_poses=options.give_poses,
            max_depth=options.max_depth,
            on_load=None if writer is None else _require_writable_flow,
            on_pair=finish_pair,
        )
    if writer is not None:
        writer.finish(evaluation)
    for table in evaluation_tables(evaluation):
        print_full_width(table)
    valid_pairs = [pair for pair in evaluation.pairs if pair.fault is None]
    if valid_pairs:
        counts = Counter(pair.status for pair in valid_pairs)
        number = len(valid_pairs)
        statuses = ", ".join(f"{count} {code}" for code, count in counts.items())
        location = (
            ""
            if output is None
            else (f" Pictures and flow in {output}, every number in {output / EVALUATION_RECORD}.")
        )
        tell(f"{number} pair{'s' * (number != 1)}: {statuses}.{location}")
    advice = {
        pair.status: pair.message for pair in reversed(valid_pairs) if pair.status != "converged"
    }
    for code, message in advice.items():
        tell(f"{code}: {message}")
    for pair in evaluation.faults:
        tell(f"tisfm: {pair.label}: {pair.fault}")
    return 1 if evaluation.faults else 0


def _require_writable_flow(loaded: LoadedPair) -> None:
    """Raise an error for frames that are too large for the files of `tisfm eval`."""
    require_writable_flow("frame0", *loaded.frame0.shape[:2])
