"""README and docs: links, snippets, options and values are those of the code."""

import contextlib
import io
import pydoc
import re
import runpy
import shlex
from dataclasses import fields
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from PIL import Image

import tisfm
from tests.draws import nightly_except
from tisfm.cli.command_line import main
from tisfm.cli.demo_animation import animation_frames
from tisfm.cli.startup import BROKEN_PIPE, INTERRUPTED, WRONG_OPTION
from tisfm.scenes import static_scene
from tisfm.settings import Preset
from tisfm.status import Status

ROOT = Path(__file__).parents[1]
README, DOCS, RESULTS = ROOT / "README.md", ROOT / "docs", ROOT / "bench" / "results"
MEASURED = RESULTS / "README.md"
CHANGES = ROOT / "CHANGELOG.md"
PAGES = [README, CHANGES, *sorted(DOCS.glob("*.md")), *sorted(DOCS.glob("guides/*.md")), MEASURED]
PRESETS = {name: tisfm.Settings.preset(name) for name in get_args(Preset)}
COMMANDS = (
    "run",
    "reconstruct",
    "eval",
    "batch",
    "export",
    "report",
    "view",
    "demo",
    "figures",
    "doctor",
)
OF_TISFM = {"--version", "--help", "--completion"}
LONGEST, LARGEST = 250, 150_000  # lines of the README, bytes of its picture
LARGEST_ANIMATION = 600_000  # bytes
FENCE = re.compile(
    r"(<!-- runnable -->\n)?```(\w*|\{[\w-]+\}.*?)\n(.*?)^```$", re.MULTILINE | re.DOTALL
)
OPTION = re.compile(r"(?<![\w-])--[a-z][a-z0-9-]*")


def name_of(path):
    return path.relative_to(ROOT).as_posix()


page = pytest.mark.parametrize("path", PAGES, ids=name_of)


def blocks(path, language):
    """Return (runnable, code) of the fenced blocks of a language."""
    found = FENCE.findall(path.read_text(encoding="utf-8"))
    return [(bool(mark), code) for mark, kind, code in found if kind == language]


def commands(path):
    """Return the words of every shell command, without its comment and variables set before it."""
    lines = [line for _, code in blocks(path, "bash") for line in code.splitlines()]
    variables = re.compile(r"^\s*(?:[A-Z_]+=(?:\$\([^)]*\)|\S+)\s+)+")
    parts = [variables.sub("", part) for line in lines for part in line.split("&&")]
    return [words for words in (shlex.split(part, comments=True) for part in parts) if words]


def prose(path):
    return FENCE.sub("", path.read_text(encoding="utf-8"))


@cache
def options_of(command):
    """Return the options that the help of a command names."""
    text = io.StringIO()
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(text):
        patch.setenv("COLUMNS", "100")
        with pytest.raises(SystemExit) as end:
            main([command, "--help"])
    assert end.value.code == 0
    return set(OPTION.findall(text.getvalue()))


def test_the_readme_is_short():
    assert len(README.read_text(encoding="utf-8").splitlines()) <= LONGEST


def test_the_changelog_has_this_version():
    stated = re.search(r'^version = "(.*)"$', (ROOT / "pyproject.toml").read_text(), re.MULTILINE)
    found = re.findall(r"^## \[(.*)\] – (not released yet|20\d\d-\d\d-\d\d)$",
                       CHANGES.read_text(encoding="utf-8"), re.MULTILINE)  # fmt: skip
    assert stated is not None and found[0][0] == stated[1]
    assert all(when != "not released yet" for _, when in found[1:])


def test_the_picture_is_small():
    picture = DOCS / "demo.png"
    assert f"]({picture.relative_to(ROOT).as_posix()})" in README.read_text(encoding="utf-8")
    assert picture.stat().st_size < LARGEST
    with Image.open(picture) as image:
        kept = np.asarray(image.convert("RGB")).astype(float)
    assert kept.shape[1] > 4 * kept.shape[0]  # four panels side by side


@pytest.mark.nightly
def test_the_picture_is_up_to_date(tmp_path):
    with Image.open(DOCS / "demo.png") as image:
        kept = np.asarray(image.convert("RGB")).astype(float)
    runpy.run_path(str(DOCS / "picture.py"))["draw"](tmp_path / "new.png")
    with Image.open(tmp_path / "new.png") as image:
        drawn = np.asarray(image.convert("RGB")).astype(float)
    assert np.abs(kept - drawn).mean() < 2  # grey levels: other processors round otherwise


def test_the_animation_is_small():
    animation = DOCS / "demo.webp"
    assert f"]({animation.relative_to(ROOT).as_posix()})" in README.read_text(encoding="utf-8")
    assert animation.stat().st_size < LARGEST_ANIMATION


@pytest.mark.nightly
def test_the_animation_is_up_to_date():
    scene = static_scene("forward+rotation", 240, 320)
    settings = tisfm.Settings(motion="camera")
    result = tisfm.interpret(scene.frame0, scene.frame1, camera=scene.camera, settings=settings)
    made = animation_frames(result)
    with Image.open(DOCS / "demo.webp") as image:
        assert image.n_frames == len(made)
        for number, picture in enumerate(made):
            image.seek(number)
            kept = np.asarray(image.convert("RGB")).astype(float)
            assert np.abs(kept - picture).mean() < 6  # grey levels: WebP, and other processors


@pytest.mark.parametrize("path", sorted({*PAGES, *RESULTS.glob("*.md")}), ids=name_of)
def test_links_lead_somewhere(path):
    for target in re.findall(r"\]\(([^)\s]+)\)", prose(path)):
        if target.startswith("https://"):
            continue
        file, _, heading = target.partition("#")
        place = path.parent / file if file else path
        assert place.exists(), target
        if heading:
            headings = re.findall(r"^#+ (.*)$", place.read_text(encoding="utf-8"), re.MULTILINE)
            slugs = {re.sub(r"[^\w -]", "", text.lower()).replace(" ", "-") for text in headings}
            assert heading in slugs, target


@page
def test_python_is_valid(path):
    for number, (_, code) in enumerate(blocks(path, "python")):
        compile(code, f"{path.name}, snippet {number}", "exec")


LONG = [DOCS / "pictures.md", DOCS / "exports.md", DOCS / "guides" / "cluster.md"]
SHORT = [path for path in PAGES if path not in LONG]


@pytest.mark.parametrize("path", nightly_except(*SHORT, of=PAGES), ids=name_of)
def test_snippets_run(path, documented_here):
    snippets = blocks(path, "python")
    assert all(runs for runs, _ in snippets)
    if not snippets:
        assert path not in (README, DOCS / "python.md")
        return
    names = {"__name__": "__main__"}  # as a script
    for number, (_, code) in enumerate(snippets):
        exec(compile(code, f"{path.name}, snippet {number}", "exec"), names)


@page
def test_shell_commands_exist(path):
    for words in commands(path):
        program = Path(words[0]).name
        if program == "tisfm":
            if words[1] in OF_TISFM:
                continue
            assert words[1] in COMMANDS, words
            used = {word.partition("=")[0] for word in words if word.startswith("--")}
            assert used <= options_of(words[1]), words
        elif re.fullmatch(r"-m (bench|tests)(\.\w+)*", " ".join(words[1:3])):
            assert find_spec(words[2]) is not None, words
        elif words[1:3] == ["-m", "sphinx"]:
            assert all((ROOT / place).exists() for place in words[4:5]), words
        elif program in ("run", "lock", "audit"):
            assert (ROOT / words[0]).is_file(), words
        else:
            assert program in ("python3", "pip", "pytest", "ruff", "types"), words


@page
def test_options_in_the_text_exist(path):
    known = set().union(*map(options_of, COMMANDS)) | OF_TISFM
    bench = {"--bars", "--smoke", "--data", "--before", "--only"}  # of python -m bench
    for span in re.findall(r"`([^`\n]+)`", prose(path)):
        if not span.startswith(("python", "pip")):
            assert set(OPTION.findall(span)) <= known | bench, span


def test_every_option_has_a_line():
    settings = {f.name.replace("_", "-") for f in fields(tisfm.Settings)}
    ours = {f"--{prefix}{name}" for name in settings for prefix in ("", "no-")}
    text = prose(DOCS / "command_line.md")
    for command in COMMANDS:
        assert options_of(command) - ours - {"--help"} <= set(OPTION.findall(text)), command


def shown(value):
    if isinstance(value, tuple):
        return ", ".join(f"{number:g}" for number in value)
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def cells(line):
    return [cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]]


@pytest.mark.parametrize("name", [field.name for field in fields(tisfm.Settings)])
def test_every_setting_has_its_unit_and_values(name):
    lines = (DOCS / "settings.md").read_text(encoding="utf-8").splitlines()
    rows = [cells(line) for line in lines if line.startswith(f"| `{name}` |")]
    values = [shown(getattr(settings, name)) for settings in PRESETS.values()]
    assert [row[3:] for row in rows] == [values]
    assert all(rows[0][1:3])  # unit and range
    assert any(line.startswith(f"- `{name}`: ") for line in lines)


@pytest.mark.parametrize("name", [field.name for field in fields(tisfm.Settings)])
def test_ranges_of_settings_are_those_that_are_accepted(name):
    lines = (DOCS / "settings.md").read_text(encoding="utf-8").splitlines()
    unit, text = next(cells(line)[1:3] for line in lines if line.startswith(f"| `{name}` |"))
    bounds = re.search(r"([\d.e-]+) to ([\d.e-]+)$", text)
    if bounds is None:
        assert name in ("relaxation", "tolerance") or not re.search(r"\d", text)
        return
    least, most = map(float, bounds.groups())
    whole = unit in ("count", "level")
    outside = (least - 1, most + 1) if whole else (least - 0.01 * (least or 1), 1.01 * most)

    def settings(value):
        value = int(value) if whole else value
        return tisfm.Settings(**{name: (value,) * 6 if name == "stiffness" else value})

    for value in (least, most):
        settings(value)
    for value in outside:
        with pytest.raises(ValueError, match=name):
            settings(value)


def test_the_presets_of_the_method_are_those_of_the_code():
    lines = (DOCS / "method.md").read_text(encoding="utf-8").splitlines()
    header = next(cells(line) for line in lines if line.startswith("| | `pyramid_factor`"))
    names = [cell.strip("`") for cell in header[1:]]
    for preset in ("fast", "balanced", "accurate"):
        row = next(cells(line) for line in lines if line.startswith(f"| `{preset}` |"))
        assert row[1:] == [shown(getattr(PRESETS[preset], name)) for name in names]
    others = {field.name for field in fields(tisfm.Settings)} - set(names)
    for name in others:  # presets but "paper" differ in effort alone
        assert len({getattr(PRESETS[p], name) for p in ("fast", "balanced", "accurate")}) == 1


def test_every_status_is_explained():
    codes = set(re.findall(r'``"(\w+)"``', Status.__doc__)) - {"camera", "objects"}
    explained = set(re.findall(r"^\| `(\w+)` \|", prose(DOCS / "trust.md"), re.MULTILINE))
    assert "converged" in codes and codes <= explained


def test_every_package_has_a_line():
    text = (DOCS / "development.md").read_text(encoding="utf-8")
    named = set(re.findall(r"^\| `([\w/]+)/` \|", text, re.MULTILINE))
    packages = {
        file.parent.relative_to(ROOT).as_posix()
        for top in ("tisfm", "kernels", "bench")
        for file in (ROOT / top).rglob("__init__.py")
    }
    assert packages <= named
    assert all((ROOT / folder).is_dir() for folder in named)


def tables(text):
    """Return (linked files, numbers in the rows of tables) of each part of a page with a table."""
    for part in re.split(r"^#+ ", text, flags=re.MULTILINE):
        rows = [line for line in part.splitlines() if line.startswith("| ")]
        values = [cell for row in rows for cell in cells(row)[1:] if re.search(r"\d", cell)]
        headings = re.compile(r"[a-z×]", re.IGNORECASE)
        values = [cell for cell in values if not headings.search(cell.replace(" of ", ""))]
        if values:
            links = re.findall(r"\]\(([\w/-]+\.md)\)", part)
            yield links, {number for cell in values for number in re.findall(r"\d+\.?\d*", cell)}


@pytest.mark.parametrize("path", [README, MEASURED], ids=name_of)
def test_figures_stand_in_the_files_that_are_named(path):
    found = list(tables(path.read_text(encoding="utf-8")))
    assert found
    for links, numbers in found:
        sources = [path.parent / link for link in links]
        if path == README:
            sources = [MEASURED]
        text = "\n".join(source.read_text(encoding="utf-8") for source in sources)
        known = set(re.findall(r"(?<![\d.])\d+(?:\.\d+)?(?![\d.])", text))
        assert numbers <= known, links


def test_the_code_that_the_method_names_is_there():
    names = re.findall(
        r"`((?:tisfm|bench)(?:\.\w+)+)`", (DOCS / "method.md").read_text(encoding="utf-8")
    )
    assert len(names) > 30
    for name in names:
        assert pydoc.locate(name) is not None, name


def test_the_method_names_every_equation_of_the_paper():
    text = (DOCS / "method.md").read_text(encoding="utf-8")
    named = set()
    for heading in re.findall(r"^### .*: (eq\. .*)$", text, re.MULTILINE):
        for first, last in re.findall(r"(\d+)(?:–(\d+))?", heading.replace("Table 1", "")):
            named |= set(range(int(first), int(last or first) + 1))
    assert named == set(range(1, 29))


def test_exit_codes_are_those_of_the_code():
    _, _, text = (DOCS / "command_line.md").read_text(encoding="utf-8").partition("\n## Exit codes")
    codes = [int(code) for code in re.findall(r"^\| (\d+) \|", text, re.MULTILINE)]
    assert codes == [0, 1, WRONG_OPTION, INTERRUPTED, BROKEN_PIPE]


@pytest.mark.parametrize(("words", "code"), [
    ("--version", 0),
    ("run nothing.png nothing.png -o out", 1),
    ("run frame0.png frame1.png -o out --smoothness=-1", 1),
    ("run frame0.png frame1.png -o out --motion field --poses poses.txt", 1),
    ("run frame0.png frame1.png -o out --smoothnes 1", 2),
    ("run frame0.png frame1.png -o out --smoothness much", 2),
    ("run frame0.png frame1.png -o out --preset quick", 2),
    ("--completion powershell", 2),
    ("nothing", 2),
    ("reconstruct", 2),
])  # fmt: skip
def test_exit_codes(words, code, documented_here, capsys):
    try:
        found = main(words.split())
    except SystemExit as end:
        found = end.code
    assert found == code
    assert len(capsys.readouterr().err.splitlines()) == (code > 0)


def test_the_principal_figures_stand_in_the_measurements():
    text = re.sub(r"\]\([^)]*\)", "", (DOCS / "accuracy.md").read_text(encoding="utf-8"))
    number = re.compile(r"(?<![\d.])\d+\.\d+(?![\d.])")
    found = set(number.findall(text))
    assert len(found) > 30
    assert found <= set(number.findall(MEASURED.read_text(encoding="utf-8")))


def test_the_principal_figures_are_found_again_by_the_commands_of_the_measurements():
    text = (DOCS / "accuracy.md").read_text(encoding="utf-8")
    named = re.findall(r"`(python -m bench[^`]*)`", text)
    assert len(named) > 12
    measured = {line for _, code in blocks(MEASURED, "bash") for line in code.splitlines()}
    assert [command for command in named if command not in measured] == []
