"""Folders of exports: whole, replaced as a whole, and nothing of others in them."""

import os
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from tests.draws import nightly_except
from tisfm import Reconstruction
from tisfm.exports import write_colmap
from tisfm.formats import FormatError

# Few points are quickly exported.
write_colmap = partial(write_colmap, spacing=40)


@pytest.fixture(scope="module")
def found(found):
    """The reconstruction with a path of six frames only."""
    return replace(found, piece=np.where(np.arange(len(found)) < 6, 0, -1).astype(np.int32))


def test_linked_images_are_the_same_files(found, tmp_path):
    write_colmap(found, tmp_path / "out", images="link")
    kept, source = tmp_path / "out" / "images" / "000002.jpg", found.folder / "frames/000002.jpg"
    assert kept.read_bytes() == source.read_bytes()
    if os.stat(tmp_path).st_dev == os.stat(found.folder).st_dev:
        assert os.path.samefile(kept, source)


def test_where_links_cannot_be_files_are_copied(found, tmp_path, monkeypatch):
    def refused(*_):
        raise OSError("another file system")

    monkeypatch.setattr(os, "link", refused)
    write_colmap(found, tmp_path / "out", images="link")
    assert len(list((tmp_path / "out" / "images").iterdir())) == 6


def test_an_earlier_export_is_replaced_as_a_whole(found, tmp_path):
    write_colmap(found, tmp_path / "out", form="both")
    first = replace(found, piece=np.where(np.arange(len(found)) < 5, 0, -1).astype(np.int32))
    write_colmap(first, tmp_path / "out")
    assert len(list((tmp_path / "out" / "images").iterdir())) == 5
    assert not (tmp_path / "out" / "sparse" / "0" / "images.txt").exists()
    assert sorted(os.listdir(tmp_path / "out")) == ["export.json", "images", "sparse"]


def files(folder):
    return {p.relative_to(folder): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def test_an_export_that_fails_leaves_the_earlier_one(found, copied, tmp_path):
    write_colmap(found, tmp_path / "out")
    before = files(tmp_path / "out")
    (copied.folder / "frames" / "000004.jpg").write_bytes(b"no picture")
    with pytest.raises(FormatError, match=r"000004\.jpg is damaged"):
        write_colmap(copied, tmp_path / "out")
    assert files(tmp_path / "out") == before
    with pytest.raises(FormatError):
        write_colmap(copied, tmp_path / "new")
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize("failing", nightly_except(2, 5, of=range(1, 6)))
def test_an_error_while_folders_are_exchanged_restores_the_earlier_export(
    found, tmp_path, monkeypatch, failing
):
    write_colmap(found, tmp_path / "out", images="link")
    before, replace_file, moved = files(tmp_path / "out"), Path.replace, []

    def broken(source, target):
        if source.suffix != ".tmp":
            moved.append(source)
        if len(moved) == failing:
            raise PermissionError("another program has it open")
        return replace_file(source, target)

    monkeypatch.setattr(Path, "replace", broken)
    with pytest.raises(PermissionError):
        write_colmap(found, tmp_path / "out", images="link", spacing=30)
    assert files(tmp_path / "out") == before
    assert sorted(os.listdir(tmp_path / "out")) == ["export.json", "images", "sparse"]


def test_a_failed_first_export_leaves_no_folder(found, tmp_path, monkeypatch):
    replace_file = Path.replace

    def broken(source, target):
        if source.name == "export.json":
            raise PermissionError("another program has it open")
        return replace_file(source, target)

    monkeypatch.setattr(Path, "replace", broken)
    with pytest.raises(PermissionError):
        write_colmap(found, tmp_path / "out", images="link")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("left", [".tisfm-new", ".tisfm-earlier"])
def test_files_left_by_a_killed_export_are_removed(found, tmp_path, left):
    """It was killed while the new one took the place of the earlier one."""
    write_colmap(found, tmp_path / "out")
    (tmp_path / "out" / "export.json").unlink()
    (tmp_path / "out" / left / "images").mkdir(parents=True)
    write_colmap(found, tmp_path / "out")
    assert sorted(os.listdir(tmp_path / "out")) == ["export.json", "images", "sparse"]


@pytest.mark.parametrize("name", ["notes.txt", "images", "sparse"])
def test_folders_of_others_are_refused(found, tmp_path, name):
    (tmp_path / name).mkdir()
    with pytest.raises(FileExistsError, match=f"has other files, such as {name}"):
        write_colmap(found, tmp_path)
    assert os.listdir(tmp_path) == [name]


def test_the_folder_of_the_reconstruction_is_refused(copied):
    with pytest.raises(FileExistsError, match="has other files"):
        write_colmap(copied, copied.folder)
    assert len(Reconstruction.load(copied.folder)) == len(copied)
