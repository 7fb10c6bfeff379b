"""The command line: which commands there are, and how errors are told."""

import contextlib
import io
import os
import sys
import warnings
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Literal, get_args

import cv2
import tyro
from tyro.conf import Positional, arg, subcommand

from tisfm.cli.console import tell_error
from tisfm.cli.demo import Demo
from tisfm.cli.doctor import Doctor
from tisfm.cli.evaluate import Eval
from tisfm.cli.exit_codes import BROKEN_PIPE, INTERRUPTED, WRONG_OPTION
from tisfm.cli.export import Export
from tisfm.cli.figures import Figures
from tisfm.cli.known_options import SHELLS, known_options
from tisfm.cli.mistakes import explained
from tisfm.cli.options import SettingsOptions
from tisfm.cli.reconstruct import Reconstruct
from tisfm.cli.report import Report
from tisfm.cli.run import Run
from tisfm.cli.view import View
from tisfm.errors import InputError, TisfmError, is_user_error
from tisfm.machine.address_space import advice, ran_out
from tisfm.settings import Preset, Settings
from tisfm.version import __version__


@dataclass(kw_only=True)
class Batch:
    """Interpret or reconstruct many videos, each in a process of its own.

    LIST is a CSV file: its first line names the columns source, output and, as they are needed,
    options of the command, such as preset, focal or motion; then a line for each video. An empty
    cell leaves an option out, yes and no turn one on and off. Paths are relative to where the
    command runs. What fails is said, and stops no other.
    """

    jobs: Annotated[Positional[Path], arg(metavar="LIST")]
    """A CSV file with columns source and output, and one for each option, such as focal."""
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
            check=refuse_wrong,
            workers=self.workers,
            threads=self.threads,
            resume=self.resume,
        )


Command = Run | Reconstruct | Eval | Batch | Export | Report | View | Demo | Figures | Doctor


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
        if arguments and arguments[0].startswith("--completion="):
            arguments = ["--completion", arguments[0].partition("=")[2], *arguments[1:]]
        if arguments[:1] == ["--completion"]:
            return _print_completion(arguments[1:])
        command = _parse_or_explain(arguments)
        return command()
    except KeyboardInterrupt:
        print("tisfm: interrupted", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:  # what read our output, such as head, has had enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return BROKEN_PIPE
    except MemoryError as error:
        return _fail(str(error) if isinstance(error, TisfmError) else advice())
    except cv2.error as error:
        if error.code != cv2.Error.StsNoMem:
            raise
        return _fail(advice())
    except (OSError, TypeError, ValueError, IndexError, RuntimeError, ImportError) as error:
        if not is_user_error(error):
            if ran_out(error):
                return _fail(advice())
            raise
        return _fail(str(error))


def _print_completion(shells: list[str]) -> int:
    """Print what a shell completes by; return the exit code."""
    from tisfm.cli.completion import completion_script

    if len(shells) != 1:
        return _fail(f"--completion takes one shell: {', '.join(SHELLS)}", WRONG_OPTION)
    try:
        script = completion_script(shells[0], known_options(_parse))
    except ValueError as error:  # an unknown shell
        return _fail(str(error), WRONG_OPTION)
    print(script, end="")
    return 0


def _fail(text: str, code: int = 1) -> int:
    """Print an error in one line and return the exit code."""
    tell_error(text)
    return code


def _parse_or_explain(arguments: list[str]) -> Command:
    """Parse arguments; where they are wrong, say so in a line and leave with exit code 2."""
    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said):
            return _parse(arguments)
    except SystemExit as end:
        if end.code in (0, None):  # help
            raise
    raise SystemExit(_fail(explained(arguments, said.getvalue(), _parse), WRONG_OPTION))


def _parse(arguments: list[str]) -> Command:
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
        | Annotated[Export, subcommand("export", prefix_name=False)]
        | Annotated[Report, subcommand("report", prefix_name=False)]
        | Annotated[View, subcommand("view", prefix_name=False)]
        | Annotated[Demo, subcommand("demo", prefix_name=False)]
        | Annotated[Figures, subcommand("figures", prefix_name=False)]
        | Annotated[Doctor, subcommand("doctor", prefix_name=False)]
    )
    return tyro.cli(commands, prog="tisfm", args=arguments, description=__doc_cli__)


def refuse_wrong(arguments: list[str]) -> None:
    """Raise ValueError if the parser refuses arguments, with what is wrong about them."""
    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said), contextlib.redirect_stdout(said):
            _parse(arguments)
    except SystemExit:
        raise InputError(explained(arguments, said.getvalue(), _parse)) from None


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
    "Try `tisfm demo` first; `tisfm run --help` explains every setting. `tisfm doctor` says what "
    "is wrong with an installation, `tisfm --completion bash` prints what a shell completes by."
)
