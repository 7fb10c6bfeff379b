"""Names of files from elsewhere: for the terminal, and for spreadsheets."""

import csv
import io
import json
import os
import subprocess
import sys

import pytest
from rich.table import Table

from tests.cli.command_line import FRAMES
from tests.exports.made import made
from tests.exports.runs import run_of
from tisfm.cli.console import print_full_width, tell, tell_error
from tisfm.folders.run_record import RunRecord
from tisfm.formats import write_png
from tisfm.formats.csv_table import csv_table

ESC = "\x1b[31mred\x1b]0;title\x07\x9b2J"
MARKUP = "[red]x[/red] [/bold] :bomb:"
posix = pytest.mark.skipif(os.name == "nt", reason="Windows has no such names")


def obeyed(text):
    """Return the characters that a terminal would obey."""
    return {letter for letter in text if ord(letter) < 32 or 127 <= ord(letter) < 160} - {"\n"}


def test_lines_tables_and_errors(capsys):
    tell(f"{ESC} {MARKUP}")
    tell_error(f"{ESC} {MARKUP}")
    table = Table(title=ESC)
    table.add_column(f"{MARKUP}")
    table.add_row(f"{ESC} {MARKUP}")
    print_full_width(table)
    for text in capsys.readouterr():
        assert obeyed(text) == set() and r"\x1b[31mred" in text and MARKUP in text


@pytest.mark.skipif(os.name == "nt", reason="pseudo terminals of POSIX")
def test_progress():
    import pty

    near, far = pty.openpty()
    code = (
        "from tisfm.cli.progress import progress_bar\n"
        "with progress_bar() as bar:\n"
        f"    bar.add_task({ESC + MARKUP!r}, total=2)\n"
    )
    environment = {**os.environ, "COLUMNS": "200", "TERM": "xterm"}
    done = subprocess.run([sys.executable, "-c", code], stderr=far, env=environment, check=True)
    os.close(far)
    said = b""
    with open(near, "rb", buffering=0) as terminal:
        try:
            while part := terminal.read(4096):
                said += part
        except OSError:  # the other end is closed
            pass
    assert done.returncode == 0
    assert b"\x1b[31mred" not in said and b"\x1b]0;" not in said and b"\\x1b[31mred" in said
    assert b"[red]x[/red]" in said


@posix
@pytest.mark.parametrize("command", ["run", "reconstruct"])
def test_damaged_frames_of_evil_names(tisfm_run, work_folder, command):
    (work_folder / "frames").mkdir()
    for k in range(2):
        (work_folder / "frames" / f"{k}{ESC}[red]{k}.png").write_bytes(b"no picture")
    code, out, err = tisfm_run(command, "frames", "-o", f"out{ESC}")
    assert code == 1 and obeyed(out + err) == set()
    assert r"\x1b[31mred" in err and "[red]" in err


@posix
@pytest.mark.parametrize("command", ["view", "report", "export", "eval", "batch"])
def test_folders_of_evil_names(tisfm_run, work_folder, command):
    more = {"export": ["--to", "tum", "-o", f"o{ESC}"]}.get(command, [])
    code, out, err = tisfm_run(command, f"{ESC}[red]", *more)
    assert code != 0 and obeyed(out + err) == set() and r"\x1b[31mred" in err


def test_texts_of_a_foreign_record(tisfm_run, work_folder):
    run_of(work_folder / "r")
    path = work_folder / "r" / "run.json"
    record = json.loads(path.read_text())
    record["pairs"][f"../{ESC}"] = record["pairs"].pop("p0")
    path.write_text(json.dumps(record))
    for arguments in (["report", "r"], ["export", "r", "--to", "depth-tiff", "-o", "o"]):
        code, out, err = tisfm_run(*arguments)
        assert code == 1 and obeyed(out + err) == set(), err


@posix
def test_exported_files_of_evil_names(tisfm_run, work_folder):
    made(work_folder / "r", count=2, names=[f"a{ESC}", f"b{MARKUP.replace('/', '')}"])
    code, out, err = tisfm_run("export", "r", "--to", "depth-tiff", "-o", "o")
    assert code == 0 and obeyed(out + err) == set()
    assert r"\x1b[31mred" in err and ":bomb:" in err


@pytest.mark.parametrize("name", ["=1+1", "+1", "-1", "@SUM(A1)", "\t=1", "\r=1", "＝1", "'a"])
def test_a_name_does_not_become_a_formula(name):
    text = csv_table(("pair", "status", "x"), [(name, "converged", -1.5)])
    (row,) = csv.DictReader(io.StringIO(text, newline=""))
    assert row["pair"] == f"'{name}" and row["x"] == "-1.5"
    assert row["pair"].removeprefix("'") == name


def test_other_cells_are_unchanged():
    text = csv_table(("a", "b", "c", "d"), [("f0", None, -1e-5, "a=b, c")])
    assert text == 'a,b,c,d\nf0,,-1e-05,"a=b, c"\n'
    assert csv_table(("a",), [("f\r=1",)]) == 'a\n"f\r=1"\n'  # no row begins within it


def test_the_table_of_a_run_quotes_names_and_messages(work_folder):
    record = RunRecord(work_folder, {})
    about = {
        "number": 0,
        "status": "uncertain",
        "message": "=cmd|' /C calc'!A0",
        "twists": None,
        "grade": "poor",
        "depth_error": 0.2,
    }
    record.record_time("=1+1", 0.5)
    record.finish("=1+1", about, {})
    record.write()
    for name in ("run.csv", "timings.csv"):
        with open(work_folder / name, newline="", encoding="utf-8") as file:
            (row,) = csv.DictReader(file)
        assert row["pair"] == "'=1+1"
    assert json.loads((work_folder / "run.json").read_text())["pairs"].keys() == {"=1+1"}
    with open(work_folder / "run.csv", newline="", encoding="utf-8") as file:
        (row,) = csv.DictReader(file)
    assert row["message"].startswith("'=cmd")


def test_frames_named_like_formulas_are_resumed(tisfm_run, work_folder):
    """The record has the names of files, not the table."""
    (work_folder / "frames").mkdir()
    for k in range(3):
        write_png(work_folder / "frames" / f"={k}.png", FRAMES[k])
    call = ("run", "frames", "-o", "out", "--preset", "fast", "--outputs", "npz")
    assert tisfm_run(*call, "--stop", "2")[0] == 0
    code, _, err = tisfm_run(*call, "--resume", "--report")
    assert code == 0 and "2 pairs" in err
    assert sorted(json.loads((work_folder / "out" / "run.json").read_text())["pairs"]) == [
        "=0",
        "=1",
    ]
    assert (work_folder / "out" / "run.csv").read_text().count("\n'=") == 2
