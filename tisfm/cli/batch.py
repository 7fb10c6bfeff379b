"""`tisfm batch`: many videos, several at a time; a failed video does not stop the others."""

import csv
import os
import shlex
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, arg

from tisfm.cli.command_line import parse_command
from tisfm.cli.console import tell
from tisfm.cli.parsing import WrongOptionError
from tisfm.cli.progress import TimeEstimate, progress_bar
from tisfm.errors import InputError
from tisfm.folders.run_record import RECORD
from tisfm.reconstruction.result.folder import REQUEST
from tisfm.reconstruction.result.renewal import CHUNKS
from tisfm.threads import usable_cores

Command = Literal["run", "reconstruct"]

SOURCE, OUTPUT = "source", "output"
NOTE = "note: "
TRIES = 3  # for a job whose process was killed
_WANTED = (-signal.SIGINT, -signal.SIGTERM)  # signals by which a user ends a process
_CALL = "import sys; sys.path.remove(''); from tisfm.cli.command_line import main; sys.exit(main())"
_FLAGS = {"yes": "--", "no": "--no-"}


@dataclass(kw_only=True)
class Batch:
    """Interpret or reconstruct many videos, each in a process of its own.

    LIST is a CSV file. Its first line names the columns: source, output, and options of the
    command, such as preset, focal or motion. Each further line is a video. An empty cell leaves the
    option out; yes and no switch an option on and off. Paths are relative to the current folder. A
    failure is printed, and does not stop the other videos.
    """

    jobs: Annotated[Positional[Path], arg(metavar="LIST")]
    """A CSV file with columns source and output, and one for each option, such as focal."""
    command: Literal["run", "reconstruct"] = "run"
    """Command for each video."""
    workers: int = 1
    """Number of videos at a time."""
    threads: int | None = None
    """Maximum number of CPU threads for each video. By default its share of all cores."""
    resume: bool = False
    """Continue interrupted runs and reconstructions."""

    def __call__(self) -> int:
        """Run the command and return the exit code."""
        return batch(
            self.jobs,
            self.command,
            workers=self.workers,
            threads=self.threads,
            resume=self.resume,
        )


@dataclass(frozen=True, kw_only=True)
class Job:
    """A line of the list.

    Attributes
    ----------
    line : int
        Number of the line in the file, from 1.
    source, output : str
    options : tuple of str
        Options of the command, as on the command line.
    """

    line: int
    source: str
    output: str
    options: tuple[str, ...]


def read_jobs(path: Path) -> list[Job]:
    """Read a list of jobs, CSV with a line of names first.

    Raises
    ------
    OSError
        If the file cannot be read.
    ValueError
        If it has no columns ``source`` and ``output``, a line lacks one of them or has too many
        cells, two lines have the same output, or there are no lines.
    """
    jobs: list[Job] = []
    outputs: dict[str, int] = {}
    try:
        with open(path, newline="", encoding="utf-8-sig") as file:
            reader = csv.DictReader(file, strict=True)
            columns = [name.strip() for name in reader.fieldnames or ()]
            if not {SOURCE, OUTPUT} <= set(columns):
                raise InputError(f"{path} has no columns source and output in its first line")
            if len(set(columns)) < len(columns):
                raise InputError(f"{path} names a column twice in its first line")
            reader.fieldnames = columns
            for row in reader:
                job = _job(row, f"{path}, line {reader.line_num}", reader.line_num)
                place = os.path.realpath(job.output)
                if place in outputs:
                    raise InputError(
                        f"{path}, lines {outputs[place]} and {job.line} have the same output, "
                        f"{job.output}"
                    )
                outputs[place] = job.line
                jobs.append(job)
    except (csv.Error, UnicodeDecodeError) as error:
        raise InputError(f"{path} is no CSV: {error}") from error
    if not jobs:
        raise InputError(f"{path} lists nothing: expected a line for each video")
    return jobs


def batch(
    path: Path,
    command: Command,
    *,
    workers: int = 1,
    threads: int | None = None,
    resume: bool = False,
) -> int:
    """Run a command for every line of a list; return the exit code, 1 if any of them failed.

    Each job has a process of its own with `threads` threads, by default its share of the cores. A
    process that is killed is started again.
    """
    if workers < 1:
        raise InputError(f"workers is {workers}: expected a positive number")
    if threads is not None and threads < 1:
        raise InputError(f"threads is {threads}: expected a positive number")
    jobs = read_jobs(path)
    each = threads or max(1, usable_cores() // workers)
    calls = [_arguments(job, command, each, resume=resume) for job in jobs]
    for job, call in zip(jobs, calls, strict=True):
        try:
            _check(call)
        except ValueError as error:
            raise InputError(f"{path}, line {job.line}: {error}") from error
    failed = 0
    with (
        _ending_by_signal(),
        progress_bar() as progress,
        _workers(workers) as executor,
        _Processes() as processes,
    ):
        task = progress.add_task(path.name, total=len(jobs))
        ends = [
            executor.submit(processes.finished, call, Path(job.output))
            for job, call in zip(jobs, calls, strict=True)
        ]
        estimate = TimeEstimate("videos")
        for number, (job, end) in enumerate(zip(jobs, ends, strict=True), 1):
            code, last, notes = end.result()
            estimate.update(number, len(jobs))
            failed += code != 0
            tell(f"{job.output}: {last}" if last else f"{job.output}: exit code {code}")
            for note in notes:
                tell(f"{job.output}: {note}")
            progress.advance(task)
    done = len(jobs) - failed
    tell(f"{done} of {len(jobs)} done" + (f", {failed} failed" if failed else ""))
    return 1 if failed else 0


def _check(call: list[str]) -> None:
    """Raise WrongOptionError if a command does not take these arguments."""
    if {"--help", "-h"} & set(call):
        raise WrongOptionError("help is no option of a job: remove this column")
    parse_command(call)


def _job(row: dict[str, str], where: str, line: int) -> Job:
    if None in row:
        raise InputError(f"{where} has more cells than there are columns")
    cells = {name: (value or "").strip() for name, value in row.items()}
    for name in (SOURCE, OUTPUT):
        if not cells[name]:
            raise InputError(f"{where} has no {name}")
    options: list[str] = []
    try:
        for name in cells.keys() - {SOURCE, OUTPUT}:
            shlex.split(cells[name])
    except ValueError as error:
        raise InputError(f"{where}: {error}") from None
    for name, value in cells.items():
        if name in (SOURCE, OUTPUT) or not value:
            continue
        if value in _FLAGS:
            options.append(f"{_FLAGS[value]}{name}")
        else:
            options += [f"--{name}", *shlex.split(value)]
    return Job(line=line, source=cells[SOURCE], output=cells[OUTPUT], options=tuple(options))


def _arguments(job: Job, command: Command, threads: int, *, resume: bool) -> list[str]:
    again = ["--resume"] if resume else []
    options = ["-o", job.output, *again, "--threads", str(threads), *job.options]
    return [command, job.source, *options]


class _Processes:
    """The processes of jobs. They are terminated if an exception leaves the block."""

    def __init__(self) -> None:
        self._running: set[subprocess.Popen[bytes]] = set()
        self._lock = threading.Lock()
        self._is_over = False

    def __enter__(self) -> "_Processes":
        return self

    def __exit__(self, kind: type[BaseException] | None, *about: object) -> None:
        if kind is None:
            return
        with self._lock:
            self._is_over = True
            for process in self._running:
                process.terminate()

    def finished(self, arguments: Sequence[str], output: Path) -> tuple[int, str, list[str]]:
        """Run a command in a process of its own.

        Return its exit code, its last message, and its notes.
        """
        code, said, call = 1, "", list(arguments)
        notes: list[str] = []
        before = _state(output)
        for _ in range(TRIES):
            with self._lock:
                if self._is_over:
                    break
                # Unlike -m, this does not import modules from the working folder instead of
                # Python's.
                process = subprocess.Popen(
                    [sys.executable, "-c", _CALL, *call],
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.DEVNULL,
                    stderr=subprocess.PIPE,
                )
                self._running.add(process)
            try:
                _, errors = process.communicate()
            finally:
                with self._lock:
                    self._running.discard(process)
            text = errors.decode("utf-8", "replace")
            code, said, notes = process.returncode, _said(text), _notes(text)
            if code >= 0 or code in _WANTED:
                break
            if "--resume" not in call and _state(output) != before:
                call.append("--resume")  # first pairs or chunks are written
        return code, said, notes


def _said(errors: str) -> str:
    """Return the line that names the results, or else the last line."""
    lines = [line for line in errors.split("\n") if line.strip()]
    results = [line for line in lines if "Results in " in line]
    return (results or lines or [""])[-1].removeprefix("tisfm: ")


def _notes(errors: str) -> list[str]:
    """Return the lines that are notes on how a source was read."""
    return [line for line in errors.split("\n") if line.startswith(NOTE)]


def _state(output: Path) -> object:
    """Return a state that changes when a run's record, or a request of chunks, is written."""
    return [_about(path) for path in (output / RECORD, output / CHUNKS / REQUEST)]


def _about(path: Path) -> tuple[int, int, int] | None:
    try:
        about = os.stat(path)
    except OSError:
        return None
    return about.st_ino, about.st_mtime_ns, about.st_size


@contextmanager
def _ending_by_signal() -> Iterator[None]:
    """Let SIGTERM leave the block as Ctrl-C does, so that no process stays behind."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


@contextmanager
def _workers(count: int) -> Iterator[ThreadPoolExecutor]:
    """Run `count` jobs at a time; leaving the block cancels the jobs that have not begun."""
    executor = ThreadPoolExecutor(count, thread_name_prefix="tisfm-batch")
    try:
        yield executor
    finally:
        executor.shutdown(cancel_futures=True)
