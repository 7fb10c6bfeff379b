"""The lock file of CI: every requirement that pyproject.toml states is in it, with hashes."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
LOCK = ROOT / ".ci" / "lock.txt"
PIN = re.compile(r"^([\w.-]+)==(\S+)((?: \\\n +--hash=sha256:[0-9a-f]{64})+)$", re.MULTILINE)


def canonical(name):
    return re.sub(r"[-_.]+", "-", name).lower()


def pins():
    """Return the version of each release by its name."""
    found = PIN.findall(LOCK.read_text(encoding="utf-8"))
    return {canonical(name): version for name, version, _ in found}


def stated():
    """Return all requirements of pyproject.toml: to build, to run, and of each extra."""
    tomllib = pytest.importorskip("tomllib", reason="Python 3.10 has no tomllib")
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    project = tomllib.loads(text)
    extras = project["project"]["optional-dependencies"].values()
    every = [*project["build-system"]["requires"], *project["project"]["dependencies"]]
    return [*every, *(line for lines in extras for line in lines)]


def test_it_holds_pins_with_hashes_alone():
    """No options, addresses or paths: those belong to a machine."""
    rest = PIN.sub("", LOCK.read_text(encoding="utf-8"))
    assert rest.strip() == ""
    assert len(pins()) > 50


def test_every_requirement_is_pinned_to_what_it_allows():
    requirements = pytest.importorskip("packaging.requirements")
    pinned, seen = pins(), 0
    for text in stated():
        requirement = requirements.Requirement(text)
        if requirement.name == "tisfm":
            continue
        version = pinned.get(canonical(requirement.name))
        assert version is not None, f"{text} is not in {LOCK.name}: run .ci/lock"
        assert requirement.specifier.contains(version, prereleases=True), (text, version)
        seen += 1
    assert seen > 15
