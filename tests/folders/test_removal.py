"""Removing and making entries of a folder for results: links are not followed."""

import os

import pytest

from tisfm.folders.result_folder import (
    locked_folder,
    make_subfolder,
    remove,
    remove_link,
    try_to_remove,
)

pytestmark = pytest.mark.skipif(os.name == "nt", reason="links of POSIX")


@pytest.fixture
def outside(tmp_path):
    (tmp_path / "outside").mkdir()
    (tmp_path / "outside" / "note").write_text("mine")
    yield tmp_path / "outside"
    assert (tmp_path / "outside" / "note").read_text() == "mine"


@pytest.mark.parametrize("function", [remove, try_to_remove])
def test_remove(tmp_path, outside, function):
    (tmp_path / "folder" / "inner").mkdir(parents=True)
    (tmp_path / "folder" / "link").symlink_to(outside)
    (tmp_path / "file").write_text("x")
    (tmp_path / "link").symlink_to(outside)
    (tmp_path / "nothing").symlink_to(tmp_path / "nowhere")
    for name in ("folder", "file", "link", "nothing", "never"):
        function(tmp_path / name)
        assert not os.path.lexists(tmp_path / name)


def test_an_inner_folder_replaces_a_link(tmp_path, outside):
    (tmp_path / "link").symlink_to(outside)
    for _ in range(2):
        made = make_subfolder(tmp_path / "link")
        assert made.is_dir() and not made.is_symlink()
        (made / "note").write_text("ours")


def test_only_links_are_removed(tmp_path, outside):
    (tmp_path / "link").symlink_to(outside)
    for name in ("link", "outside", "never"):
        remove_link(tmp_path / name)
    assert not os.path.lexists(tmp_path / "link")


def test_a_lock_and_temporaries_that_are_links(tmp_path, outside):
    folder = tmp_path / "out"
    (folder / ".tisfm-2.tmp").mkdir(parents=True)  # of a process that was killed
    (folder / ".tisfm-2.tmp" / "half").write_text("x")
    (folder / ".tisfm-1.tmp").symlink_to(outside)
    (folder / ".tisfm.lock").symlink_to(outside / "note")
    with locked_folder(folder):
        assert [path.name for path in folder.iterdir()] == [".tisfm.lock"]
    assert not list(folder.iterdir())
