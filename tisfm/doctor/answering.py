"""The doctor's answer before anything that may be broken is loaded."""

import os
import sys
from pathlib import Path

_INTERRUPTED, _BROKEN_PIPE = 130, 141  # exit codes of programs ended by a signal
# The parser says what is wrong about others.
_OPTIONS: tuple[list[str], ...] = ([], ["--json"], ["--no-json"])


def is_asked() -> bool:
    """Return whether this process is ``tisfm doctor``."""
    return _is_tisfm() and sys.argv[1:2] == ["doctor"] and sys.argv[2:] in _OPTIONS


def _is_tisfm() -> bool:
    """Return whether this process is the command ``tisfm``, or ``python -m tisfm``."""
    name = sys.argv[0] if sys.argv else ""
    if name != "-m":  # argv[0] is -m until Python has found the module
        return Path(name).stem == "tisfm"
    module = sys.orig_argv[-len(sys.argv) :][0]  # "tisfm" of "-m tisfm", or "-mtisfm"
    return module.removeprefix("-m") == "tisfm"


def answer() -> None:
    """Answer as ``tisfm doctor`` does.

    Raises
    ------
    SystemExit
        After the answer.
    """
    from tisfm.doctor.examination import doctor

    try:
        code = doctor(json=sys.argv[2:] == ["--json"])
    except KeyboardInterrupt:
        print("tisfm: interrupted", file=sys.stderr)
        code = _INTERRUPTED
    except BrokenPipeError:  # what read our output, such as head, has had enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = _BROKEN_PIPE
    raise SystemExit(code)
