"""The command line: ``tisfm demo``, ``tisfm run``, ``tisfm figures``."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, get_args

import tyro
from tyro.conf import OmitArgPrefixes, Positional, arg, subcommand

from tisfm.camera import Camera
from tisfm.settings import Preset, Settings

INTERRUPTED = 130  # exit code of a program ended by Ctrl-C, as shells count


@dataclass(kw_only=True)
class CameraOptions:
    """The camera that took the frames."""

    focal: float = 600.0
    """Focal length, px. The paper's value, if yours is not known."""
    center: tuple[float, float] | None = None
    """Principal point (cx, cy), px. By default the centre of the image."""

    def camera(self) -> Camera:
        """Return the camera."""
        return Camera(focal=self.focal, center=self.center)


@dataclass(kw_only=True)
class Run:
    """Interpret every pair of consecutive frames of a sequence.

    SOURCE is two or more images, a folder of images, a quoted glob such as 'frames/*.png', or a
    video. For a pair named NAME after its first frame, DIR receives NAME_depth.png (grey levels,
    near is bright), NAME_depth16.png (16-bit depth, its scale in the file and in run.json),
    NAME_flow.flo, NAME_anaglyph.png (red-cyan), NAME_figure.png and, when all is written,
    NAME.npz for tisfm.Interpretation.load.
    """

    source: Positional[tuple[str, ...]]
    """Two or more images, a folder, a quoted glob, or a video."""
    output: Annotated[Path, arg(aliases=["-o"], metavar="DIR")]
    """Folder for the results; made if need be."""
    preset: Preset = "balanced"
    """Settings to start from; the settings below show its values, and change them."""
    step: int = 1
    """Take every STEP-th frame, for slow motion."""
    resume: bool = False
    """Continue a run that was interrupted: skip the pairs it finished."""
    figures: bool = True
    """Draw NAME_figure.png, with Horn and Schunck's flow for comparison (the slowest output)."""
    threads: int | None = None
    """Most CPU threads; by default all cores. Results do not depend on it."""
    camera: OmitArgPrefixes[CameraOptions] = field(default_factory=CameraOptions)
    settings: OmitArgPrefixes[Settings] = field(default_factory=Settings)

    def __call__(self) -> int:
        """Run the command and return the exit code."""
        from tisfm.commands import run

        return run(
            self.source[0] if len(self.source) == 1 else self.source,
            self.output,
            camera=self.camera.camera(),
            settings=self.settings,
            step=self.step,
            resume=self.resume,
            figures=self.figures,
            threads=self.threads,
        )


@dataclass(kw_only=True)
class Demo:
    """Render a scene whose truth is known, interpret it, and compare.

    Two textured blocks move each on its own, in front of a background and on a floor, before a
    camera that moves sideways. Prints errors against the truth for the preset "paper", the
    default preset and Horn and Schunck, and writes every output of `tisfm run` and the paper's
    comparisons of settings.
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
        from tisfm.commands import demo

        return demo(
            self.output, height=self.height, width=self.width, seed=self.seed, threads=self.threads
        )


@dataclass(kw_only=True)
class Figures:
    """Draw the paper's comparisons of settings (its Fig. 6 and 8) for two frames of yours.

    Depth for λ = 1e8 and 1e9, with and without smoothing the frames first, and with the paper's
    contrast, which is inert, beside the default one.
    """

    frames: Positional[tuple[str, str]]
    """Two images."""
    output: Annotated[Path, arg(aliases=["-o"], metavar="DIR")]
    """Folder for the figures; made if need be."""
    threads: int | None = None
    """Most CPU threads; by default all cores."""
    camera: OmitArgPrefixes[CameraOptions] = field(default_factory=CameraOptions)

    def __call__(self) -> int:
        """Run the command and return the exit code."""
        from tisfm.commands import figures

        return figures(
            self.frames, self.output, camera=self.camera.camera(), threads=self.threads
        )


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit code.

    Errors of the user's making are one line on standard error and exit code 1 (2 for a wrong
    option); a traceback means a bug.
    """
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    try:
        command = _parse(arguments)
        return command()
    except KeyboardInterrupt:
        print("tisfm: interrupted", file=sys.stderr)
        return INTERRUPTED
    except (OSError, TypeError, ValueError, RuntimeError) as error:
        print(f"tisfm: {' '.join(str(error).split())}", file=sys.stderr)
        return 1


def _parse(arguments: list[str]) -> Run | Demo | Figures:
    default = Run(
        source=tyro.MISSING, output=tyro.MISSING, settings=Settings.preset(_preset(arguments))
    )
    commands = (
        Annotated[Run, subcommand("run", default=default, prefix_name=False)]
        | Annotated[Demo, subcommand("demo", prefix_name=False)]
        | Annotated[Figures, subcommand("figures", prefix_name=False)]
    )
    return tyro.cli(  # type: ignore[call-overload,no-any-return]
        commands, prog="tisfm", args=arguments, description=__doc_cli__
    )


def _preset(arguments: list[str]) -> Preset:
    """Find the preset before the rest is parsed, so that help shows its values as defaults."""
    for name, value in zip(arguments, [*arguments[1:], ""], strict=True):
        if name.startswith("--preset="):
            name, value = name.split("=", 1)
        if name == "--preset" and value in get_args(Preset):
            return value  # type: ignore[return-value]
    return "balanced"


__doc_cli__ = (
    "Dense structure and 3D motion from image sequences, on a CPU, without training. "
    "Try `tisfm demo` first; `tisfm run --help` explains every setting."
)
