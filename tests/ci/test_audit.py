"""What CI says of known vulnerabilities: a list that could not be looked up is not clean."""

import subprocess
from importlib.machinery import SourceFileLoader
from importlib.util import module_from_spec, spec_from_loader
from pathlib import Path

import pytest

FILE = Path(__file__).parents[2] / ".ci" / "audit"


@pytest.fixture
def audit():
    module = module_from_spec(spec_from_loader("audit", SourceFileLoader("audit", str(FILE))))
    module.__spec__.loader.exec_module(module)
    return module


def test_none_is_known(audit):
    found = {audit.CANARY: ["A-1"], "one==1": [], "two==2": []}
    assert audit.verdict(found) == (0, "audit: none known in 2 releases of lock.txt")


def test_what_is_known_fails(audit, monkeypatch):
    found = {audit.CANARY: ["A-1"], "one==1": ["A-2", "A-3"], "two": None}
    code, text = audit.verdict(found)
    assert code == 1
    assert text.splitlines()[:2] == ["one==1: A-2, A-3", "not looked up: two"]
    monkeypatch.setattr(audit, "ACCEPTED", {"A-2": "we do not", "A-3": "call it"})
    assert audit.verdict(found)[0] == 0


@pytest.mark.parametrize("canary", [{"django": None}, {"django==2.0": []}, {}])
def test_without_data_it_is_skipped(audit, canary):
    """pip-audit itself calls such a list free of vulnerabilities."""
    code, text = audit.verdict({"one": None, "two==2": [], **canary})
    assert code == 0 and text.startswith("audit skipped: ")


def test_no_answer_is_skipped_in_time(audit, monkeypatch, capsys):
    def run(command, *, timeout, **_):
        raise subprocess.TimeoutExpired(command, timeout)

    monkeypatch.setattr(audit, "find_spec", lambda name: True)
    monkeypatch.setattr(audit.subprocess, "run", run)
    assert audit.main() == 0
    assert capsys.readouterr().out == f"audit skipped: no answer within {audit.LIMIT} s\n"


def test_it_asks_for_all_of_the_lock_file(audit, monkeypatch, capsys):
    asked = []

    def run(command, **_):
        asked.extend(Path(command[command.index("--requirement") + 1]).read_text().split())
        return subprocess.CompletedProcess(command, 1, "", "a line\nno network\n")

    monkeypatch.setattr(audit, "find_spec", lambda name: True)
    monkeypatch.setattr(audit.subprocess, "run", run)
    assert audit.main() == 0
    assert capsys.readouterr().out == "audit skipped: no network\n"
    assert any(pin.startswith("taichi==1.7.4") for pin in asked) and asked[-1] == audit.CANARY
    names = [pin.partition("==")[0] for pin in asked]
    assert len(set(names)) == len(names)  # pip-audit takes none twice
