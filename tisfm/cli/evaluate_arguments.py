"""``tisfm eval``: its arguments."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from tyro.conf import OmitArgPrefixes, Positional, arg

from tisfm.cli.shared_options import SettingsOptions, StatedCameraOptions
from tisfm.datasets import LAYOUTS, Layout, SequenceLayout
from tisfm.errors import InputError
from tisfm.runtime import Arch
from tisfm.settings import Preset


@dataclass(kw_only=True)
class Eval:
    """Compare with the true flow, depth and pose of benchmarks.

    Interprets every pair found in the folders and prints tables of errors. Of the flow: end-point
    (EPE) and angular (AAE), outliers as KITTI counts them (Fl), the share off by 1 px or more
    (R1.0), and, where the dataset says what is occluded, EPE without it (noc) and how well it is
    found (occ F1). Of the depth, after scaling by the median: abs-rel, SILog, and the share off by
    a factor below 1.25. Of the pose, with --motion camera: the angles between the directions of
    translation and between the rotations. Known layouts are those of Middlebury, KITTI 2012 and
    2015, Sintel, Yosemite, New Tsukuba, 7-Scenes, stereo pairs with a disparity, and folders of
    images/ with camera.txt, and poses.txt or depth/. With --sequence those of New Tsukuba,
    7-Scenes, TUM RGB-D, KITTI's odometry and such folders.

    With --sequence, every sequence is reconstructed as a whole, and its path (ATE, RPE, drift) and
    depth, in one scale for all frames, are compared. DIR receives NAME.tum, the path of
    the largest piece, NAME-piece2.tum of the next one, and eval.json.

    With --objects, the masks of moving things that a reconstruction saved are compared with the
    true ones of a sequence, as those of DAVIS: the intersection over union of each thing, and how
    often it got another label. Where FOLDER has an objects.json, as a reconstruction writes it, and
    poses.txt of the camera, so are the paths of things.

    With -o, DIR receives for a pair NAME of DATASET: DATASET/NAME_flow.flo; NAME_error.png
    (end-point error, on one scale for all) and NAME_flow.png (recovered beside true flow), or
    NAME_depth_error.png (recovered beside true depth, and the relative error), or both, as there
    is a truth; and eval.json with versions, settings and every number.
    """

    folders: Annotated[
        Positional[tuple[str, ...]],
        arg(metavar="FOLDER [FOLDER ...]", help_behavior_hint="(required)"),
    ]
    """Folders of datasets, or folders above them."""
    output: Annotated[Path | None, arg(aliases=["-o"], metavar="DIR")] = None
    """Folder for pictures, flow and eval.json; made if need be. By default nothing is written."""
    layout: Layout | SequenceLayout | None = None
    """Layout of the folders; by default every one that is recognised."""
    step: int | None = None
    """Frames from the first to the second of a pair, in sequences; by default 3 for 7-Scenes and 1
    for others."""
    give_poses: bool = False
    """Give every true pose, and compare only the depth; with --motion camera."""
    max_depth: float | None = None
    """True depth beyond it does not count, in the unit of the dataset. By default all counts."""
    sequence: bool = False
    """Reconstruct whole sequences instead of pairs, and compare their paths and depth."""
    objects: bool = False
    """Compare masks of moving things: FOLDER holds the true ones, by itself or in masks/. With
    --result."""
    result: Annotated[Path | None, arg(metavar="PATH")] = None
    """Compare this with one sequence instead: a trajectory in TUM's or KITTI's format, of whatever
    program, or a folder of tisfm.Reconstruction.save. With --sequence; a folder with --objects."""
    preset: Preset = "balanced"
    """Settings to start from; the settings below show its values, and change them."""
    arch: Arch | None = None
    """Where kernels run; by default what the variable TI_ARCH says, or else the CPU."""
    threads: int | None = None
    """Most CPU threads; by default all cores. Errors do not depend on it."""
    camera: OmitArgPrefixes[StatedCameraOptions] = field(default_factory=StatedCameraOptions)
    settings: OmitArgPrefixes[SettingsOptions] = field(default_factory=SettingsOptions)

    def __call__(self) -> int:
        """Run the command and return the exit code."""
        from tisfm.cli.commands import evaluate
        from tisfm.cli.moving_things import evaluate_objects
        from tisfm.cli.sequences import evaluate_sequences

        if not self.folders:
            raise InputError(
                "FOLDER is missing: give the folder of a dataset, as in: tisfm eval FOLDER -o DIR"
            )
        if self.sequence and self.objects:
            raise InputError("sequence and objects are both asked for: give one of them")
        if self.objects:
            return evaluate_objects(self.folders, self.output, result=self.result, step=self.step)
        if self.sequence:
            if self.settings.motion == "field":
                raise InputError(
                    "--motion field works on pairs, but --sequence is given: use camera or objects"
                )
            return evaluate_sequences(
                self.folders,
                self.output,
                layout=self.layout,
                camera=self.camera.camera(),
                settings=self.settings.settings(),
                step=self.step,
                give_poses=self.give_poses,
                max_depth=self.max_depth,
                result=self.result,
                arch=self.arch,
                threads=self.threads,
            )
        if self.result is not None:
            raise InputError(f"result is {self.result}, but pairs are compared: give --sequence")
        return evaluate(
            self.folders,
            self.output,
            layout=_layout_of_pairs(self.layout),
            camera=self.camera.camera(),
            settings=self.settings.settings(),
            step=self.step,
            give_poses=self.give_poses,
            max_depth=self.max_depth,
            arch=self.arch,
            threads=self.threads,
        )


def _layout_of_pairs(layout: str | None) -> Layout | None:
    if layout is None or layout in LAYOUTS:
        return layout  # type: ignore[return-value]
    raise InputError(f"layout is {layout!r}, which has sequences alone: give --sequence")
