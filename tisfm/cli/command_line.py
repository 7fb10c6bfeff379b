"""The command line: what its commands take, and how errors are told."""

import contextlib
import io
import os
import sys
import warnings
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Literal, get_args

import cv2
import tyro
from tyro.conf import FlagCreatePairsOff, OmitArgPrefixes, Positional, arg, subcommand

from tisfm.camera import Camera
from tisfm.cli.frame_options import FrameOptions
from tisfm.datasets import LAYOUTS, Layout, SequenceLayout
from tisfm.machine.address_space import advice, ran_out
from tisfm.reconstruction.calibration import Calibrate
from tisfm.reconstruction.progress import DepthOf
from tisfm.runtime import Arch
from tisfm.settings import Motion, Preset, Settings
from tisfm.stated import is_raised_here, is_stated
from tisfm.version import __version__
from tisfm.window import WindowSize

INTERRUPTED, BROKEN_PIPE = 130, 141  # exit codes of programs ended by a signal, as shells count


@dataclass(kw_only=True)
class CameraOptions:
    """The camera that took the frames."""

    file: Annotated[Path | None, arg(name="camera", metavar="FILE")] = None
    """The camera.json that tisfm reconstruct wrote of the same lens, or its folder."""
    focal: float | Literal["guess"] | None = None
    """Focal length, px. 'guess' takes the first image's EXIF data, or else its size. By default
    the paper's 600 where motion is 'field', else the guess."""
    center: tuple[float, float] | None = None
    """Principal point (cx, cy), px. By default the centre of the image."""
    distortion: Annotated[str | None, arg(metavar="K1,K2,P1,P2[,K3...]")] = None
    """OpenCV's coefficients of the lens, 4, 5, 8, 12 or 14 with commas between; removed first."""
    aspect: float = 1.0
    """fy / fx, where pixels are not square; --focal is then the smaller of both. Frames are
    resampled first."""
    readout: float | None = None
    """How long a frame is read, row after row, as a share of the time from a frame to the next; 0
    where all rows are read at once. By default reconstruct finds it for motion 'camera'; elsewhere
    it counts as 0. What it moves is undone by reconstruct, and in pairs for motion 'camera'."""

    def guess(self, motion: Motion) -> bool:
        """Tell whether the focal length is to be guessed."""
        if self.file is not None:
            return False
        return self.focal == "guess" or (self.focal is None and motion != "field")

    def camera(self) -> Camera | Path:
        """Return the camera, with a focal length of 600 px if it is not given, or its file."""
        stated = (self.focal, self.center, self.distortion, self.readout)
        if self.file is not None:
            if any(value is not None for value in stated) or self.aspect != 1:
                raise ValueError(
                    f"{self.file} states the camera: give neither --focal nor --center, "
                    "--distortion, --aspect or --readout"
                )
            return self.file
        focal = self.focal if isinstance(self.focal, float) else 600.0
        distortion = None if self.distortion is None else _numbers(self.distortion, "distortion")
        return Camera(
            focal=focal,
            center=self.center,
            distortion=distortion,
            aspect=self.aspect,
            readout=self.readout,
        )


@dataclass(frozen=True, kw_only=True)
class SettingsOptions(Settings):
    """What is minimised, and how. The defaults shown are those of --preset."""

    def __post_init__(self) -> None:
        """Check nothing: the parser would report it in words of its own."""

    def settings(self) -> Settings:
        """Return the settings, or raise as `Settings` does."""
        return Settings(**asdict(self))


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
    outputs: str | None = None
    """What is written of each pair, with commas: some of depth, depth16, flow, anaglyph, figure,
    ply, pose, npz. By default all but flow and ply, which are large."""
    figures: int = 1
    """Draw NAME_figure.png, the slowest output, of every so many pairs; 0 for none."""
    no_figures: Annotated[bool, FlagCreatePairsOff] = False
    """Draw none: the same as --figures 0."""
    flo: bool = False
    """Write NAME_flow.flo, the image motion without the rounding that NAME.npz has."""
    ply: bool = False
    """Write NAME.ply, a coloured point cloud of the pixels that are visible in both frames."""
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
        from tisfm.cli.run_command import run

        if not self.source:
            raise ValueError(
                "SOURCE is missing: give two or more images, a folder, a quoted glob or a video, "
                "as in: tisfm run FOLDER -o DIR"
            )
        return run(
            self.source[0] if len(self.source) == 1 else self.source,
            self.output,
            camera=self.camera.camera(),
            guess=self.camera.guess(self.settings.motion),
            settings=self.settings.settings(),
            frames=self.frames,
            poses=self.poses,
            mask=self.mask,
            window=self.window,
            resume=self.resume,
            outputs=self._outputs(),
            figures=0 if self.no_figures else self.figures,
            workers=self.workers,
            cluster=self.cluster,
            arch=self.arch,
            threads=self.threads,
        )

    def _outputs(self) -> tuple[str, ...]:
        """Return what is written, or raise ValueError."""
        from tisfm.cli.outputs import USUAL, checked_outputs

        if self.figures < 0:
            raise ValueError(f"figures is {self.figures}: expected a number of pairs, or 0")
        chosen = USUAL if self.outputs is None else self.outputs.replace(" ", "").split(",")
        more = ["flow"] * self.flo + ["ply"] * self.ply
        return checked_outputs([*filter(None, chosen), *more])


@dataclass(kw_only=True)
class StatedCameraOptions:
    """The camera, where the dataset does not state one or another is wanted."""

    focal: float | None = None
    """Focal length of every pair, px. By default what the dataset states, or else 600."""
    center: tuple[float, float] | None = None
    """Principal point (cx, cy) that goes with --focal, px. By default the centre of the image."""

    def camera(self) -> Camera | None:
        """Return the camera of every pair, or None for those that the dataset states."""
        if self.focal is None:
            if self.center is not None:
                raise ValueError("center is given without focal: give --focal as well")
            return None
        return Camera(focal=self.focal, center=self.center)


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
            raise ValueError(
                "FOLDER is missing: give the folder of a dataset, as in: tisfm eval FOLDER -o DIR"
            )
        if self.sequence and self.objects:
            raise ValueError("sequence and objects are both asked for: give one of them")
        if self.objects:
            return evaluate_objects(self.folders, self.output, result=self.result, step=self.step)
        if self.sequence:
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
            raise ValueError(f"result is {self.result}, but pairs are compared: give --sequence")
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


@dataclass(kw_only=True)
class Reconstruct:
    """Reconstruct a sequence: one path of the camera, and depth of every frame in its scale.

    SOURCE is a video, a folder of images in order, a quoted glob, or images. DIR receives
    reconstruction.json, path.npz, depth/ and frames/ for tisfm.Reconstruction.load; the path as
    trajectory.txt (TUM: time tx ty tz qx qy qz qw) and poses.txt (KITTI: rows of (R | t), camera to
    world), of the largest piece where the sequence fell into several; with --ply points.ply, a
    coloured point cloud, and with --mesh a surface, of what its keyframes agree on; with --motion
    objects masks/, which thing each pixel belongs to, and objects.json, their paths.
    """

    source: Annotated[
        Positional[tuple[str, ...]],
        arg(metavar="SOURCE [SOURCE ...]", help_behavior_hint="(required)"),
    ]
    """A video, a folder, a quoted glob, two or more images in order, or a webcam."""
    output: Annotated[Path, arg(aliases=["-o"], metavar="DIR")]
    """Folder for the results, new or empty, or of an earlier reconstruction, which is replaced."""
    preset: Preset = "balanced"
    """How much effort: fast, balanced or accurate."""
    calibrate: Calibrate | None = None
    """Find the focal length from the frames; or with 'radial' a coefficient of the lens as well,
    whose distortion is removed. By default the focal length is found unless --focal or --camera
    states it; with --calibrate focal, --focal is a first guess."""
    poses: Annotated[Path | None, arg(metavar="FILE")] = None
    """Known poses of the frames that are taken, as TUM or KITTI have them: depth alone is found.
    Those of TUM go by their times where frames have times, else by their order."""
    mask: Annotated[str | None, arg(metavar="MASK")] = None
    """A picture, or a folder of one for every frame: black pixels are ignored everywhere. With
    --motion objects, a folder of pictures with a palette of colours is --labels instead."""
    labels: Annotated[str | None, arg(metavar="LABELS")] = None
    """With --motion objects, what moves, if that is known: a folder of pictures whose values, or
    indices of a palette, are 0 at rest, 1 to 254 for the thing of this id, and 255 where ignored;
    of every frame, or of some that they are called like, from which they are carried to others."""
    motion: Literal["camera", "objects"] = "camera"
    """What moves on its own is left out where it does not fit ('camera'); or found, labelled in
    masks/ and objects.json, and given a path and a depth of its own ('objects')."""
    object_sizes: Annotated[tuple[str, ...], arg(metavar="ID=LENGTH [ID=LENGTH ...]")] = ()
    """With --motion objects, how long things are, by their ids: the longest side of the smallest
    box around each, in the unit of --poses. It sets their scale."""
    depth_of: DepthOf = "all"
    """The frames that depth is found of: all, keyframes alone, or none, for the path alone."""
    scale: Annotated[tuple[int, int, float] | None, arg(metavar="FRAME FRAME DISTANCE")] = None
    """The distance of the camera's places at two frames, by their numbers from 0: the unit."""
    ply: bool = False
    """Write points.ply, a coloured point cloud."""
    mesh: Literal["ply", "glb"] | None = None
    """Write mesh.ply or mesh.glb, a coloured surface; it needs pip install 'tisfm[mesh]'."""
    workers: int = 1
    """Processes at a time, each with chunks of frames, which are joined. For motion 'camera'."""
    cluster: Annotated[str | None, arg(metavar="ADDRESS")] = None
    """Make chunks of frames on the workers of a Dask cluster, such as tcp://10.0.0.1:8786. They
    read SOURCE and write DIR under the same paths."""
    chunk: int | None = None
    """Frames of a chunk, at most: 150 with --workers or --cluster. It changes the result; how many
    workers there are does not."""
    resume: bool = False
    """Go on with the same command, however it was interrupted: with chunks that are complete. What
    is complete already is left as it is."""
    arch: Arch | None = None
    """Where kernels run; by default what the variable TI_ARCH says, or else the CPU."""
    threads: int | None = None
    """Most CPU threads; by default all cores. Results do not depend on it."""
    frames: OmitArgPrefixes[FrameOptions] = field(default_factory=FrameOptions)
    camera: OmitArgPrefixes[CameraOptions] = field(default_factory=CameraOptions)

    def __call__(self) -> int:
        """Run the command and return the exit code."""
        from tisfm.cli.reconstruct_command import reconstruct

        if not self.source:
            raise ValueError(
                "SOURCE is missing: give a video, a folder, a quoted glob or images, as in: "
                "tisfm reconstruct VIDEO -o DIR"
            )
        return reconstruct(
            self.source[0] if len(self.source) == 1 else self.source,
            self.output,
            camera=self._camera(),
            calibrate="nothing" if self.camera.focal == "guess" else self.calibrate,
            settings=Settings.preset(self.preset, motion=self.motion),
            frames=self.frames,
            poses=self.poses,
            mask=self.mask,
            labels=self.labels,
            object_sizes=_sizes(self.object_sizes),
            depth_of=self.depth_of,
            scale=self.scale,
            ply=self.ply,
            mesh=self.mesh,
            workers=self.workers,
            cluster=self.cluster,
            chunk=self.chunk,
            resume=self.resume,
            arch=self.arch,
            threads=self.threads,
        )

    def _camera(self) -> Camera | Path | None:
        """Return the camera, its file, or None if its focal length is to be found or guessed."""
        options = self.camera
        if not options.guess("camera"):
            return options.camera()
        stated = (options.center, options.distortion, options.readout)
        if any(value is not None for value in stated) or options.aspect != 1:
            raise ValueError(
                "--center, --distortion, --aspect and --readout are of a camera whose focal length "
                "is known: give --focal as well; with --calibrate focal, a guess will do"
            )
        if options.focal == "guess" and self.calibrate not in (None, "nothing"):
            raise ValueError("--focal guess is not found from the frames: drop it, or --calibrate")
        return None


def _sizes(given: Sequence[str]) -> dict[int, float]:
    """Return lengths by ids, of words such as 3=4.5."""
    sizes = {}
    for word in given:
        number, _, length = word.partition("=")
        try:
            sizes[int(number)] = float(length)
        except ValueError:
            raise ValueError(
                f"--object-sizes has {word!r}: expected ID=LENGTH, such as 3=4.5"
            ) from None
    return sizes


@dataclass(kw_only=True)
class Demo:
    """Render scenes whose truth is known, interpret them, and compare.

    Two textured blocks move each on its own, in front of a background and on a floor, before a
    camera that moves sideways: errors against the truth of the preset "paper", the default preset
    and Horn and Schunck. Three blocks at rest, before a camera that moves forward and turns:
    errors of motion "field" and "camera". DIR receives every output of `tisfm run` for the first
    scene and the paper's comparisons of settings, DIR/camera and DIR/objects those of the
    motions "camera" and "objects".
    """

    output: Annotated[Path, arg(aliases=["-o"], metavar="DIR")] = Path("tisfm-demo")
    """Folder for the results; made if need be."""
    height: int = 240
    """Height of the rendered frames, px."""
    width: int = 320
    """Width of the rendered frames, px."""
    seed: int = 0
    """Seed of the textures."""
    threads: int | None = None
    """Most CPU threads; by default all cores."""

    def __call__(self) -> int:
        """Run the command and return the exit code."""
        from tisfm.cli.demo import demo

        return demo(
            self.output, height=self.height, width=self.width, seed=self.seed, threads=self.threads
        )


@dataclass(kw_only=True)
class Figures:
    """Draw the paper's comparisons of settings (its Fig. 6 and 8) for two frames of yours.

    Depth for λ = 1e8 and 1e9, with and without smoothing the frames first, and with the paper's
    contrast, which is inert, beside the default one.
    """

    frames: Annotated[Positional[tuple[str, str]], arg(metavar="FRAME FRAME")]
    """Two images."""
    output: Annotated[Path, arg(aliases=["-o"], metavar="DIR")]
    """Folder for the figures; made if need be."""
    threads: int | None = None
    """Most CPU threads; by default all cores."""
    camera: OmitArgPrefixes[CameraOptions] = field(default_factory=CameraOptions)

    def __call__(self) -> int:
        """Run the command and return the exit code."""
        from tisfm.cli.commands import figures

        return figures(
            self.frames,
            self.output,
            camera=self.camera.camera(),
            guess=self.camera.guess("field"),
            threads=self.threads,
        )


@dataclass(kw_only=True)
class Batch:
    """Interpret or reconstruct many videos, each in a process of its own.

    LIST is a CSV file: its first line names the columns source, output and, as they are needed,
    options of the command, such as preset, focal or motion; then a line for each video. An empty
    cell leaves an option out, yes and no turn one on and off. Paths are relative to where the
    command runs. What fails is said, and stops no other.
    """

    jobs: Annotated[Positional[Path], arg(metavar="LIST")]
    """A CSV file with columns source, output, and options."""
    command: Literal["run", "reconstruct"] = "run"
    """What is done with each."""
    workers: int = 1
    """Videos at a time."""
    threads: int | None = None
    """Most CPU threads of each; by default its share of all cores."""
    resume: bool = False
    """Continue runs and reconstructions that were interrupted."""

    def __call__(self) -> int:
        """Run the command and return the exit code."""
        from tisfm.cli.batch import batch

        return batch(
            self.jobs,
            self.command,
            check=_refuse_wrong,
            workers=self.workers,
            threads=self.threads,
            resume=self.resume,
        )


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit code.

    Errors that were foreseen are one line on standard error and exit code 1 (2 for a wrong
    option). Any other is a bug, and leaves its traceback.
    """
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    # FFmpeg prints complaints of its own about a damaged video; ours is the one line below.
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    # What libraries find odd about names and damaged EXIF data changes no result.
    warnings.filterwarnings("ignore", r"Glyph \d+", UserWarning)
    warnings.filterwarnings("ignore", category=UserWarning, module=r"PIL\.")
    if isinstance(sys.stdout, io.TextIOWrapper):  # Greek letters, where the encoding has none
        sys.stdout.reconfigure(errors="replace")
    if arguments == ["--version"]:
        print(__version__)
        return 0
    try:
        command = _parse(arguments)
        return command()
    except KeyboardInterrupt:
        print("tisfm: interrupted", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:  # what read our output, such as head, has had enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return BROKEN_PIPE
    except MemoryError as error:
        return _fail(str(error) if is_raised_here(error) else advice())
    except cv2.error as error:
        if error.code != cv2.Error.StsNoMem:
            raise
        return _fail(advice())
    except (OSError, TypeError, ValueError, IndexError, RuntimeError, ImportError) as error:
        if not is_stated(error):
            if ran_out(error):
                return _fail(advice())
            raise
        return _fail(str(error))


def _fail(text: str) -> int:
    """Print an error in one line and return the exit code."""
    shown = " ".join(text.split()).encode("utf-8", "replace").decode("utf-8")
    print(f"tisfm: {shown}", file=sys.stderr)
    return 1


def _layout_of_pairs(layout: str | None) -> Layout | None:
    if layout is None or layout in LAYOUTS:
        return layout  # type: ignore[return-value]
    raise ValueError(f"layout is {layout!r}, which has sequences alone: give --sequence")


def _numbers(text: str, name: str) -> tuple[float, ...]:
    """Read numbers with commas or spaces between."""
    try:
        return tuple(map(float, text.replace(",", " ").split()))
    except ValueError:
        raise ValueError(f"{name} is {text!r}: expected numbers with commas between") from None


def _parse(arguments: list[str]) -> Run | Reconstruct | Eval | Batch | Demo | Figures:
    preset = _preset(arguments)
    settings = SettingsOptions(**asdict(Settings.preset(preset)))
    run = Run(source=tyro.MISSING, output=tyro.MISSING, preset=preset, settings=settings)
    of_path = settings  # a sequence has one motion, that of the camera
    if "--sequence" in arguments:
        of_path = SettingsOptions(**asdict(Settings.preset(preset, motion="camera")))
    evaluation = Eval(folders=tyro.MISSING, preset=preset, settings=of_path)
    commands = (
        Annotated[Run, subcommand("run", default=run, prefix_name=False)]
        | Annotated[Reconstruct, subcommand("reconstruct", prefix_name=False)]
        | Annotated[Eval, subcommand("eval", default=evaluation, prefix_name=False)]
        | Annotated[Batch, subcommand("batch", prefix_name=False)]
        | Annotated[Demo, subcommand("demo", prefix_name=False)]
        | Annotated[Figures, subcommand("figures", prefix_name=False)]
    )
    return tyro.cli(commands, prog="tisfm", args=arguments, description=__doc_cli__)


def _refuse_wrong(arguments: list[str]) -> None:
    """Raise ValueError if the parser refuses arguments, with what it says of them."""
    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said), contextlib.redirect_stdout(said):
            _parse(arguments)
    except SystemExit:
        lines = (line.strip(" │|╭╰─╮╯-") for line in said.getvalue().splitlines())
        words = [line for line in lines if line]
        raise ValueError(" ".join(words[:3]) or "these options are wrong") from None


def _preset(arguments: list[str]) -> Preset:
    """Find the preset before the rest is parsed, so that help shows its values as defaults."""
    preset: Preset = "balanced"
    for index, argument in enumerate(arguments):
        name, equals, value = argument.partition("=")
        if name == "--preset":
            given = value if equals else "".join(arguments[index + 1 : index + 2])
            if given in get_args(Preset):  # else the parser refuses it
                preset = given  # type: ignore[assignment]
    return preset


__doc_cli__ = (
    "Dense structure and 3D motion from image sequences, on a CPU, without training. "
    "Try `tisfm demo` first; `tisfm run --help` explains every setting."
)
