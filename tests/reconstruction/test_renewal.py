"""A folder with an earlier reconstruction, if the next one fails or is killed."""

import contextlib
import os
import shutil
from pathlib import Path

import numpy as np
import pytest

import tisfm
from tisfm.folders.result_folder import FolderInUseError, locked_folder
from tisfm.reconstruction.result import renewal
from tisfm.reconstruction.result.renewal import EARLIER, renewed_folder

FAST = tisfm.Settings.preset("fast", motion="camera")


def contents(folder):
    """Return the files below a folder by name."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


@pytest.fixture
def earlier(tmp_path):
    """Return a folder like that of a finished reconstruction."""
    folder = tmp_path / "result"
    with renewed_folder(folder) as path:
        for name in ("reconstruction.json", "path.npz", "points.ply", "depth/000000.npz"):
            (path / name).write_text(name)
        (path / "reconstruction.begun").unlink()
    return folder


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt, MemoryError])
def test_earlier_result_comes_back(earlier, error):
    before = contents(earlier)
    with pytest.raises(error), renewed_folder(earlier) as path:
        assert not (path / "reconstruction.json").exists()
        assert list((path / "depth").iterdir()) == []
        (path / "path.npz").write_text("half")
        (path / "trajectory.txt").write_text("half")
        raise error
    assert contents(earlier) == before
    assert not (earlier / EARLIER).exists()


@pytest.mark.skipif(os.name == "nt", reason="links of POSIX")
@pytest.mark.parametrize(
    "name",
    ["cache", ".tisfm-chunks", ".tisfm-leaving", ".tisfm-restoring", ".tisfm-earlier",
     ".tisfm.lock", "reconstruction.begun", "poses.txt", "camera.json", "masks"],
)  # fmt: skip
@pytest.mark.parametrize("fails", [True, False])
def test_links_are_not_followed_and_the_earlier_result_comes_back(earlier, tmp_path, name, fails):
    shutil.rmtree(earlier / "cache")
    before = contents(earlier)
    outside = tmp_path / "outside"
    outside.mkdir()
    (outside / "note.txt").write_text("mine")
    # Instead of files: a link to a missing file.
    is_folder = name in ("cache", "masks") or name.startswith(".tisfm-")
    (earlier / name).symlink_to(outside if is_folder else outside / "nothing")
    ends = pytest.raises(ValueError, match="again") if fails else contextlib.nullcontext()
    with ends, renewed_folder(earlier) as path:
        for part in ("cache/x", "masks/x", "poses.txt", "camera.json"):
            (path / part).parent.mkdir(exist_ok=True)
            (path / part).write_text("new")
        if fails:
            raise ValueError("again")
    assert contents(outside) == {"note.txt": b"mine"}
    if fails:
        assert contents(earlier) == before
    else:
        assert (earlier / "poses.txt").read_text() == "new"
        assert not [path for path in earlier.rglob("*") if path.is_symlink()]


def test_new_result_replaces_it(earlier):
    with renewed_folder(earlier) as path:
        (path / "path.npz").write_text("new")
    assert not (earlier / EARLIER).exists() and not (earlier / "points.ply").exists()
    assert (earlier / "path.npz").read_text() == "new"


def test_result_moved_aside_by_a_killed_run_comes_back(earlier):
    before = contents(earlier)
    (earlier / EARLIER).mkdir()
    for name in ("reconstruction.json", "path.npz", "points.ply", "depth"):
        (earlier / name).rename(earlier / EARLIER / name)
    (earlier / "reconstruction.begun").touch()
    (earlier / "path.npz").write_text("half")
    (earlier / ".tisfm-01.tmp").write_text("half")
    with pytest.raises(ValueError, match="again"), renewed_folder(earlier):
        raise ValueError("again")
    after = contents(earlier)
    assert {name: after[name] for name in before} == before
    assert not [name for name in after if name.startswith(".")]


class Killed(BaseException):
    """The process ends: no code runs after it."""


@pytest.mark.parametrize("phase", ["aside", "back"])
@pytest.mark.parametrize("step", range(1, 7))
def test_no_file_is_lost_at_any_kill(earlier, monkeypatch, phase, step):
    """The n-th move of a file kills the run, and the next run fails."""
    before, moved = contents(earlier), []

    def counted(original):
        def move(*arguments):
            moved.append(arguments)
            if len(moved) == step:
                raise Killed
            return original(*arguments)

        return move

    def start():
        with renewed_folder(earlier) as path:
            (path / "path.npz").write_text("half")
            if phase == "back":
                patch()
                raise ValueError("the run fails")

    def patch():
        for name in ("replace", "rename"):
            monkeypatch.setattr(Path, name, counted(getattr(Path, name)))

    with pytest.MonkeyPatch.context() as inner:
        monkeypatch = inner
        if phase == "aside":
            patch()
            # A killed process does not put files back.
            inner.setattr(renewal, "_restore", lambda path: None)
        with contextlib.suppress(Killed, ValueError):
            start()
    assert len(moved) == step
    with pytest.raises(ValueError, match="again"), renewed_folder(earlier):
        raise ValueError("again")
    assert contents(earlier) == before


@pytest.mark.parametrize("step", range(1, 6))
def test_interrupt_before_the_run_begins_leaves_the_earlier_result(earlier, monkeypatch, step):
    before, moved = contents(earlier), []
    original = Path.replace

    def replace(*arguments):
        moved.append(arguments)
        if len(moved) == step:
            raise KeyboardInterrupt
        return original(*arguments)

    monkeypatch.setattr(Path, "replace", replace)
    with contextlib.suppress(KeyboardInterrupt), renewed_folder(earlier):
        raise KeyboardInterrupt
    assert contents(earlier) == before


def test_one_at_a_time(earlier):
    before = contents(earlier)
    with (
        locked_folder(earlier),
        pytest.raises(FolderInUseError, match="another run"),
        renewed_folder(earlier),
    ):
        pass
    assert contents(earlier) == before


def test_other_files_stay(tmp_path):
    (tmp_path / "note.txt").write_text("mine")
    with pytest.raises(FileExistsError, match=r"note\.txt"), renewed_folder(tmp_path):
        pass
    assert os.listdir(tmp_path) == ["note.txt"]


def test_bad_input_leaves_the_earlier_result(tmp_path):
    frames = [np.uint8(np.random.default_rng(k).integers(0, 255, (60, 80))) for k in range(4)]
    folder = tmp_path / "out"
    camera = tisfm.Camera(focal=80.0)
    tisfm.reconstruct(frames, camera=camera, settings=FAST, folder=folder, depth_of="none")
    before = contents(folder)
    with pytest.raises(ValueError, match=r"\(10, 10\)|size|shape"):
        tisfm.reconstruct(
            [*frames, frames[0][:10, :10]], camera=camera, settings=FAST, folder=folder
        )
    assert contents(folder) == before


def test_foreign_page_is_kept(earlier):
    (earlier / "report.html").write_text("mine")
    before = contents(earlier)
    refused = pytest.raises(FileExistsError, match=r"has other files, such as report\.html")
    with refused, renewed_folder(earlier):
        raise AssertionError("it is not to begin")
    assert contents(earlier) == before
