"""`tisfm batch`: many videos, several at a time; a failed video does not stop the others."""

import csv
import os
import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, arg

from tisfm.cli.command_line import parse_command
from tisfm.cli.console import tell_grade
from tisfm.cli.parsing import WrongOptionError
from tisfm.cli.progress import TimeEstimate, progress_bar
from tisfm.errors import InputError
from tisfm.folders.run_record import read_record, summarise_pairs
from tisfm.grade import Grade, GradeSummary
from tisfm.reconstruction.result.folder import RECORD as RECONSTRUCTION
from tisfm.reconstruction.result.reconstruction import Reconstruction
from tisfm.running.commands import CommandProcesses
from tisfm.threads import usable_cores

SOURCE, OUTPUT = "source", "output"
_SWITCHES = {"yes": "--", "no": "--no-"}


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
    """Maximum number of CPU threads for each video. By default the workers share all cores."""
    resume: bool = False
    """Continue interrupted runs and reconstructions."""

    def __call__(self) -> int:
        """Run the command and return the exit code."""
        return batch(self)


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
                repeated_name = max(columns, key=columns.count)
                raise InputError(f"{path} names the column {repeated_name} twice in its first line")
            reader.fieldnames = columns
            for row in reader:
                job = _parse_job(row, f"{path}, line {reader.line_num}", reader.line_num)
                real_path = os.path.realpath(job.output)
                if real_path in outputs:
                    raise InputError(
                        f"{path}, lines {outputs[real_path]} and {job.line} have the same output, "
                        f"{job.output}"
                    )
                outputs[real_path] = job.line
                jobs.append(job)
    except (csv.Error, UnicodeDecodeError) as error:
        raise InputError(f"{path} is not a CSV file: {error}") from error
    if not jobs:
        raise InputError(f"{path} has no jobs: expected a line for each video")
    return jobs


def batch(options: Batch) -> int:
    """Run a command for every line of a list; return the exit code, 1 if any of them failed.

    Each job has a process of its own. A process that is killed is started again.
    """
    path, workers, threads = options.jobs, options.workers, options.threads
    if workers < 1:
        raise InputError(f"workers is {workers}: expected a positive number")
    if threads is not None and threads < 1:
        raise InputError(f"threads is {threads}: expected a positive number")
    jobs = read_jobs(path)
    threads = threads or max(1, usable_cores() // workers)
    argument_lists = [_job_arguments(job, options, threads) for job in jobs]
    for job, arguments in zip(jobs, argument_lists, strict=True):
        try:
            _check_arguments(arguments)
        except ValueError as error:
            raise InputError(f"{path}, line {job.line}: {error}") from error
    failed_count = 0
    grades: list[Grade] = []
    with progress_bar() as progress, CommandProcesses(workers) as processes:
        task = progress.add_task(path.name, total=len(jobs))
        futures = [
            processes.submit(arguments, Path(job.output))
            for job, arguments in zip(jobs, argument_lists, strict=True)
        ]
        estimate = TimeEstimate("videos")
        for number, (job, future) in enumerate(zip(jobs, futures, strict=True), 1):
            outcome = future.result()
            estimate.update(number, len(jobs))
            failed_count += outcome.exit_code != 0
            message = outcome.message or f"exit code {outcome.exit_code}"
            for line in (message, *outcome.notes):
                tell_grade(f"{job.output}: {line}")
            if outcome.exit_code == 0 and (grade := _median_grade(Path(job.output))) is not None:
                grades.append(grade)
            progress.update(task, advance=1, description=f"{path.name}{_grades_text(grades)}")
    count = len(jobs) - failed_count
    failures = f", {failed_count} failed" if failed_count else ""
    tell_grade(f"{count} of {len(jobs)} done{failures}{_grades_text(grades)}")
    return 1 if failed_count else 0


def _median_grade(folder: Path) -> Grade | None:
    """Return the median grade of the result in a folder; None if there is none."""
    try:
        if (folder / RECONSTRUCTION).is_file():
            return Reconstruction.load(folder).median_grade
        record = read_record(folder)
        summary = summarise_pairs(record["pairs"].values()) if record is not None else None
    except (OSError, LookupError, ValueError):  # another command replaces or removes the result
        return None
    return None if summary is None else summary.median


def _grades_text(grades: Sequence[Grade]) -> str:
    """Return the median and the worst of the grades of results in words; "" without grades."""
    return f". Grade {GradeSummary.of(grades).text}" if grades else ""


def _check_arguments(arguments: list[str]) -> None:
    """Raise WrongOptionError unless the command takes these arguments."""
    if {"--help", "-h"} & set(arguments):
        raise WrongOptionError("--help is not an option of a job: remove this column")
    parse_command(arguments)


def _parse_job(row: dict[str, str], line_name: str, line: int) -> Job:
    if None in row:
        raise InputError(f"{line_name} has more cells than there are columns")
    cells = {name: (value or "").strip() for name, value in row.items()}
    for name in (SOURCE, OUTPUT):
        if not cells[name]:
            raise InputError(f"{line_name} has no {name}")
    options: list[str] = []
    try:
        for name in cells.keys() - {SOURCE, OUTPUT}:
            shlex.split(cells[name])
    except ValueError as error:
        raise InputError(f"{line_name}: {error}") from None
    for name, value in cells.items():
        if name in (SOURCE, OUTPUT) or not value:
            continue
        if value in _SWITCHES:
            options.append(f"{_SWITCHES[value]}{name}")
        else:
            options += [f"--{name}", *shlex.split(value)]
    return Job(line=line, source=cells[SOURCE], output=cells[OUTPUT], options=tuple(options))


def _job_arguments(job: Job, options: Batch, threads: int) -> list[str]:
    resume = ["--resume"] if options.resume else []
    arguments = ["-o", job.output, *resume, "--threads", str(threads), *job.options]
    return [options.command, job.source, *arguments]
