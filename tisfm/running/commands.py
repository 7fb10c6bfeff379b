"""Commands of tisfm, each in its own process, several at a time."""

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from tisfm.folders.run_record import RECORD
from tisfm.reconstruction.result.folder import REQUEST
from tisfm.reconstruction.result.renewal import CHUNKS

MAX_ATTEMPTS = 3  # attempts at a command whose process was killed; set by hand
NOTE = "note: "  # beginning of a line with a note on how a source is read
_USER_SIGNALS = (-signal.SIGINT, -signal.SIGTERM)  # exit codes after a signal of the user
# Unlike with ``python -m``, a module in the working folder cannot replace a module of Python.
_PROGRAM = (
    "import sys; sys.path.remove(''); from tisfm.cli.command_line import main; sys.exit(main())"
)


@dataclass(frozen=True, kw_only=True)
class FinishedCommand:
    """How a command ended: its exit code and its last messages."""

    exit_code: int
    message: str  # the line that names the folder of results, or else the last line
    notes: list[str]  # lines with notes on the reading of the source


class CommandProcesses:
    """Runs commands in `count` processes at a time.

    After an exception in the block, its processes are terminated, and no further process begins.
    Within the block, SIGTERM raises KeyboardInterrupt, as Ctrl-C does, so that the block ends all
    processes.
    """

    def __init__(self, count: int) -> None:
        self._executor = ThreadPoolExecutor(count, thread_name_prefix="tisfm-batch")
        self._processes: set[subprocess.Popen[bytes]] = set()
        self._lock = threading.Lock()
        self._is_over = False
        self._contexts = ExitStack()

    def __enter__(self) -> "CommandProcesses":
        self._contexts.enter_context(_sigterm_as_interrupt())
        return self

    def __exit__(self, kind: type[BaseException] | None, *details: object) -> None:
        with self._contexts:
            if kind is not None:
                with self._lock:
                    self._is_over = True
                    for process in self._processes:
                        process.terminate()
            self._executor.shutdown(cancel_futures=True)

    def submit(self, arguments: Sequence[str], output: Path) -> Future[FinishedCommand]:
        """Run a command that writes to a folder; resume it if its process is killed."""
        return self._executor.submit(self._run, list(arguments), output)

    def _run(self, arguments: list[str], output: Path) -> FinishedCommand:
        result = FinishedCommand(exit_code=1, message="", notes=[])
        before = _output_state(output)
        for _ in range(MAX_ATTEMPTS):
            with self._lock:
                if self._is_over:
                    break
                process = subprocess.Popen(
                    [sys.executable, "-c", _PROGRAM, *arguments],
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.DEVNULL,
                    stderr=subprocess.PIPE,
                )
                self._processes.add(process)
            try:
                _, errors = process.communicate()
            finally:
                with self._lock:
                    self._processes.discard(process)
            result = _command_result(process.returncode, errors.decode("utf-8", "replace"))
            if result.exit_code >= 0 or result.exit_code in _USER_SIGNALS:
                break
            if "--resume" not in arguments and _output_state(output) != before:
                arguments.append("--resume")  # the process has written pairs or chunks
        return result


def _command_result(exit_code: int, errors: str) -> FinishedCommand:
    """Return the end of a command, from its lines on standard error."""
    lines = [line for line in errors.split("\n") if line.strip()]
    results = [line for line in lines if "Results in " in line]
    return FinishedCommand(
        exit_code=exit_code,
        message=(results or lines or [""])[-1].removeprefix("tisfm: "),
        notes=[line for line in lines if line.startswith(NOTE)],
    )


def _output_state(output: Path) -> list[tuple[int, int, int] | None]:
    """Return the state of the record of a run or of chunks; each writing changes the state."""
    states: list[tuple[int, int, int] | None] = []
    for path in (output / RECORD, output / CHUNKS / REQUEST):
        try:
            status = os.stat(path)
        except OSError:
            states.append(None)
        else:
            states.append((status.st_ino, status.st_mtime_ns, status.st_size))
    return states


@contextmanager
def _sigterm_as_interrupt() -> Iterator[None]:
    """Let SIGTERM raise KeyboardInterrupt; only the main thread can set this."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
