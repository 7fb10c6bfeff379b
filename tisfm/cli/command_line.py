"""The command line: its commands, the text of errors, and exit codes."""

import ast
import contextlib
import io
import os
import re
import sys
import warnings
from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import reduce
from importlib import import_module
from operator import or_
from typing import Annotated, Any, get_args

import cv2
import tyro
from tyro.conf import subcommand

from tisfm.checks import spelling_hint
from tisfm.cli.console import tell_error
from tisfm.cli.options import SettingsOptions
from tisfm.cli.parsing import LIST_OPTIONS, WrongOptionError, parse, suggestion, wrapped_help
from tisfm.cli.startup import BROKEN_PIPE, INTERRUPTED, WRONG_OPTION
from tisfm.errors import MissingPackageError, TisfmError, is_user_error
from tisfm.machine.memory import is_out_of_memory, out_of_memory_message
from tisfm.settings import Preset, Settings
from tisfm.version import __version__

SHELLS = ("bash", "zsh", "fish", "tcsh")
# Python code that follows the data in tyro's scripts: it completes the last of several values with
# commas between, for the options of `LIST_OPTIONS`.
_COMPLETE_AFTER_COMMAS = """
_given = sys.argv[int(sys.argv[-1]) + 1 : -1][:1]
_before = _given[0].rpartition(',')[0] + ',' if _given and ',' in _given[0] else ''
for _name, _command in COMPLETION_SPEC['subcommands'].items():
    for _option in _command['options']:
        if set(_option['flags']) & set(LIST_OPTIONS.get(_name, ())):
            _option['choices'] = [_before + choice for choice in _option['choices']]
"""
# Lines that are added to tyro's scripts: they complete file names where no option or value fits.
_COMPLETE_FILES = {
    "bash": "complete -o default -F _tyro_tisfm tisfm",
    "zsh": "(( compstate[nmatches] )) || _files",
    "fish": "complete --command tisfm --force-files",
}
_SPEC_PREFIX = "COMPLETION_SPEC = "  # beginning of the line of tyro's scripts with the options
TOP_LEVEL_OPTIONS = ("--help", "--version", "--completion")
# Commands in the order of the help, with their modules and classes. A module is imported when its
# command is called.
COMMANDS = {
    "run": ("tisfm.cli.run", "Run"),
    "reconstruct": ("tisfm.cli.reconstruct", "Reconstruct"),
    "eval": ("tisfm.cli.evaluate", "Eval"),
    "batch": ("tisfm.cli.batch", "Batch"),
    "export": ("tisfm.cli.export", "Export"),
    "report": ("tisfm.cli.report", "Report"),
    "view": ("tisfm.cli.view", "View"),
    "demo": ("tisfm.cli.demo", "Demo"),
    "figures": ("tisfm.cli.figures", "Figures"),
    "doctor": ("tisfm.cli.startup", "Doctor"),
}
_DESCRIPTION = (
    "Dense structure and 3D motion from image sequences, on a CPU, without training. "
    "Try `tisfm demo` first. `tisfm run --help` explains every setting. `tisfm doctor` finds "
    "faults of an installation. `tisfm --completion bash` prints a script with which the shell "
    "completes commands and options."
)

Command = Callable[[], int]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit code.

    An error that the user can correct is one line on standard error, with exit code 1, or 2 for a
    wrong option. Any other error is a bug, and prints its traceback.
    """
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    # FFmpeg prints nothing about damaged videos: the command itself prints one line.
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    # Warnings of libraries about glyphs in names and damaged EXIF data do not concern results.
    warnings.filterwarnings("ignore", r"Glyph \d+", UserWarning)
    warnings.filterwarnings("ignore", category=UserWarning, module=r"PIL\.")
    if isinstance(sys.stdout, io.TextIOWrapper):  # for Greek letters in other encodings
        sys.stdout.reconfigure(errors="replace")
    if arguments == ["--version"]:
        print(__version__)
        return 0
    try:
        if arguments and arguments[0].startswith("--completion="):
            arguments = ["--completion", arguments[0].partition("=")[2], *arguments[1:]]
        if arguments[:1] == ["--completion"]:
            return _print_completion(arguments[1:])
        return parse_command(arguments)()
    except WrongOptionError as error:
        return _fail(str(error), WRONG_OPTION)
    except KeyboardInterrupt:
        print("tisfm: interrupted", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:  # the reader of the output, such as head, has closed it
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return BROKEN_PIPE
    except MemoryError as error:
        return _fail(str(error) if isinstance(error, TisfmError) else out_of_memory_message())
    except cv2.error as error:
        if error.code != cv2.Error.StsNoMem:
            raise
        return _fail(out_of_memory_message())
    except (OSError, TypeError, ValueError, IndexError, RuntimeError, ImportError) as error:
        if not is_user_error(error):
            if is_out_of_memory(error):
                return _fail(out_of_memory_message())
            raise
        return _fail(str(error))


def parse_command(arguments: Sequence[str]) -> Command:
    """Return the command that the arguments call.

    Raises
    ------
    WrongOptionError
        If the command or an option does not exist, or a value is wrong or missing.
    SystemExit
        After the help text, if --help is given.
    """
    if not arguments:
        raise WrongOptionError(
            f"a command is missing: give one of {', '.join(COMMANDS)}; begin with tisfm demo"
        )
    name, *other_arguments = arguments
    if name in COMMANDS:
        command_class, default = _load_command(name, arguments)
        command: Command = parse(name, command_class, other_arguments, default)
        return command
    if name in ("--help", "-h") and not other_arguments:
        _all_commands(["--help"])
    option = name.partition("=")[0]
    if option in TOP_LEVEL_OPTIONS:
        raise WrongOptionError(f"{option} takes no command: give it alone; see tisfm --help")
    if name.startswith("-"):
        raise WrongOptionError(
            f"tisfm has no option {option}{suggestion(option, TOP_LEVEL_OPTIONS)}; see tisfm --help"
        )
    raise WrongOptionError(
        f"tisfm has no command {name}{suggestion(name, COMMANDS)}; expected {', '.join(COMMANDS)}"
    )


def _load_command(name: str, arguments: Sequence[str] = ()) -> tuple[type, Any]:
    """Return the class of a command, and an instance with the defaults of the given preset."""
    module, command_class = COMMANDS[name]
    command = getattr(import_module(module), command_class)
    if name not in ("run", "eval"):
        return command, None
    preset = _find_preset(arguments)
    settings = Settings.preset(preset)
    if "--sequence" in arguments:  # the path of a sequence needs a rigid camera motion
        settings = Settings.preset(preset, motion="camera")
    required = ("source", "output") if name == "run" else ("folders",)
    options = SettingsOptions(**asdict(settings))
    missing = dict.fromkeys(required, tyro.MISSING)
    return command, command(**missing, preset=preset, settings=options)


def _all_commands(arguments: list[str]) -> None:
    """Let tyro print the help of all commands, or a completion script for a shell."""
    commands: list[Any] = []
    for name in COMMANDS:
        command, default = _load_command(name)
        defaults = {} if default is None else {"default": default}
        summary = (command.__doc__ or "").partition("\n")[0]
        commands.append(
            Annotated[command, subcommand(name, prefix_name=False, description=summary, **defaults)]
        )
    with wrapped_help(_DESCRIPTION) as description:
        tyro.cli(reduce(or_, commands), prog="tisfm", args=arguments, description=description)


def _print_completion(shells: Sequence[str]) -> int:
    """Print the script for completion in a shell; return the exit code."""
    if len(shells) != 1:
        raise WrongOptionError(f"--completion takes one shell: {', '.join(SHELLS)}")
    shell = shells[0]
    if shell not in SHELLS:
        raise WrongOptionError(
            f"--completion is {shell!r}{spelling_hint(shell, SHELLS)}: expected {', '.join(SHELLS)}"
        )
    try:
        script = io.StringIO()
        with contextlib.suppress(SystemExit), contextlib.redirect_stdout(script):
            _all_commands(["--tyro-print-completion", shell])
    except ImportError as error:  # tyro needs shtab for tcsh
        raise MissingPackageError(
            f"completion for {shell} needs shtab, which is not installed: pip install shtab"
        ) from error
    for line in script.getvalue().splitlines():
        name, is_data, data = line.partition(_SPEC_PREFIX)
        if is_data and not name:
            # A script for fish has the data in a text, whose quotes and dollars are escaped.
            escaped = shell == "fish"
            data = re.sub(r"\\(.)", r"\1", data) if escaped else data
            spec_text = (
                f"{_complete_spec(ast.literal_eval(data))!r}\nLIST_OPTIONS = {LIST_OPTIONS!r}"
            )
            spec_text += f"\nimport sys{_COMPLETE_AFTER_COMMAS}"
            line = _SPEC_PREFIX + (
                re.sub(r'(["\\$])', r"\\\1", spec_text) if escaped else spec_text
            )
        print(line)
    print(_COMPLETE_FILES.get(shell, ""))
    return 0


def _complete_spec(spec: dict[str, Any]) -> dict[str, Any]:
    """Add options that tyro does not know to the commands and options of its script.

    The order of values is always the same.
    """
    for command in spec["subcommands"].values():
        for option in command["options"]:
            if option["flags"] == ["--focal"] and "guess" in option["description"]:
                option |= {"type": "choice", "choices": ["guess"]}
            # A shell would offer the words behind a line break of a help text as values.
            option["description"] = " ".join(option["description"].split())
            option["choices"] = sorted({*option.get("choices", ())} - {"None"})
    shell = {
        "type": "choice",
        "choices": sorted(SHELLS),
        "description": "print a script for a shell",
    }
    version = {"type": "flag", "description": "print the version"}
    spec["options"] += [
        {"flags": ["--version"], "nargs": 0, **version},
        {"flags": ["--completion"], "nargs": None, **shell},
    ]
    return spec


def _fail(text: str, code: int = 1) -> int:
    """Print an error in one line and return the exit code."""
    tell_error(text)
    return code


def _find_preset(arguments: Sequence[str]) -> Preset:
    """Return the given preset, before parsing, so that help shows its values as defaults."""
    preset: Preset = "balanced"
    for index, argument in enumerate(arguments):
        name, equals, value = argument.partition("=")
        if name == "--preset":
            given_value = value if equals else "".join(arguments[index + 1 : index + 2])
            if given_value in get_args(Preset):  # the parser refuses other values
                preset = given_value  # type: ignore[assignment]
    return preset
