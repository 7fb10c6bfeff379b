"""The command line, ``tisfm``.

Here: the arguments, the commands, their text output, the demo and the paper's figures.
May import: all of `tisfm`; nothing imports it.
"""

import os
import sys

from tisfm.cli.startup import BROKEN_PIPE, INTERRUPTED, Doctor


def main() -> int:
    """Run the command ``tisfm`` with the arguments of this process; return the exit code.

    ``tisfm doctor`` runs before the import of any library that may crash or hang. For other
    commands, the limit of the address space is checked before libraries are imported that would
    crash below it.
    """
    arguments = sys.argv[1:]
    # The parser handles all other arguments of the doctor, such as --help.
    if arguments[:1] == ["doctor"] and arguments[1:] in ([], ["--json"], ["--no-json"]):
        return _run_doctor(Doctor(json=arguments[1:] == ["--json"]))
    from tisfm.errors import OutOfMemoryError
    from tisfm.machine.memory import import_libraries

    try:
        import_libraries()
    except OutOfMemoryError as error:
        print(f"tisfm: {error}", file=sys.stderr)
        return 1
    from tisfm.cli.command_line import main as run

    return run()


def _run_doctor(doctor: Doctor) -> int:
    try:
        return doctor()
    except KeyboardInterrupt:
        print("tisfm: interrupted", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:  # the reader of the output, such as head, has closed it
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return BROKEN_PIPE
