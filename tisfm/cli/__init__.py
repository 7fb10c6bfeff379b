"""The command line, ``tisfm``.

Here: its arguments, the commands behind them, the files and the text that they leave, the demo
and the paper's figures.
May import: all of `tisfm`; nothing imports it.
"""

import os
import sys

from tisfm.cli.exit_codes import BROKEN_PIPE, INTERRUPTED


def main() -> int:
    """Run the command ``tisfm`` with the arguments of this process; return its exit code.

    ``tisfm doctor`` answers before any library is imported that may crash or hang, and the limit
    of the address space is checked before libraries are imported that would.
    """
    arguments = sys.argv[1:]
    # The parser explains other options of the doctor.
    if arguments[:1] == ["doctor"] and arguments[1:] in ([], ["--json"], ["--no-json"]):
        return _doctor(json=arguments[1:] == ["--json"])
    from tisfm.errors import OutOfMemoryError
    from tisfm.machine.memory import import_libraries

    try:
        import_libraries()
    except OutOfMemoryError as error:
        print(f"tisfm: {error}", file=sys.stderr)
        return 1
    from tisfm.cli.command_line import main as run

    return run()


def _doctor(*, json: bool) -> int:
    from tisfm.doctor.examination import doctor

    try:
        return doctor(json=json)
    except KeyboardInterrupt:
        print("tisfm: interrupted", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:  # the reader of the output, such as head, has closed it
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return BROKEN_PIPE
