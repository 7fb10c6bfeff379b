"""Files that appear whole or not at all."""

import os

import pytest

from tests.formats.written import (
    contents,
)
from tisfm.formats import (
    atomic_write,
)


def test_atomic_write_replaces_on_success(tmp_path):
    path = tmp_path / "file.bin"
    path.write_bytes(b"old")
    with atomic_write(path) as file:
        file.write(b"new")
        assert path.read_bytes() == b"old"
    assert path.read_bytes() == b"new"
    assert contents(tmp_path) == {"file.bin"}


@pytest.mark.parametrize("fault", [RuntimeError, KeyboardInterrupt, SystemExit, FileNotFoundError])
def test_atomic_write_leaves_nothing_after_a_failure(tmp_path, fault):
    path = tmp_path / "file.bin"
    with pytest.raises(fault, match="inside"), atomic_write(path) as file:
        file.write(b"half")
        raise fault("inside")
    assert contents(tmp_path) == set()
    path.write_bytes(b"old")
    with pytest.raises(fault, match="inside"), atomic_write(path) as file:
        file.write(b"half")
        raise fault("inside")
    assert contents(tmp_path) == {"file.bin"}
    assert path.read_bytes() == b"old"


def test_atomic_write_explains_a_missing_folder(tmp_path):
    with (
        pytest.raises(FileNotFoundError, match="missing does not exist; create it first"),
        atomic_write(tmp_path / "missing" / "file.bin"),
    ):
        pytest.fail("the block must not run")


def test_atomic_write_explains_a_path_below_a_file(tmp_path):
    (tmp_path / "plain").write_bytes(b"x")
    with (
        pytest.raises(NotADirectoryError, match="plain is not a folder"),
        atomic_write(tmp_path / "plain" / "file.bin"),
    ):
        pytest.fail("the block must not run")


def test_atomic_write_explains_missing_permission(tmp_path):
    folder = tmp_path / "locked"
    folder.mkdir()
    folder.chmod(0o500)
    if os.access(folder, os.W_OK):
        pytest.skip("this user may write everywhere")
    with (
        pytest.raises(PermissionError, match="a folder of your own"),
        atomic_write(folder / "file.bin"),
    ):
        pytest.fail("the block must not run")


def test_atomic_write_refuses_folders_and_devices(tmp_path):
    with pytest.raises(IsADirectoryError, match="is a folder"), atomic_write(tmp_path):
        pytest.fail("the block must not run")
    if os.path.exists("/dev/null"):
        with pytest.raises(OSError, match="device"), atomic_write("/dev/null"):
            pytest.fail("the block must not run")


@pytest.mark.skipif(os.name == "nt", reason="permissions and links of POSIX")
def test_atomic_write_honours_the_umask_and_follows_links(tmp_path):
    (tmp_path / "there").mkdir()
    target, link = tmp_path / "there" / "target", tmp_path / "link"
    link.symlink_to(target)
    with atomic_write(link) as file:
        file.write(b"x")
    assert link.is_symlink()
    assert target.read_bytes() == b"x"
    (tmp_path / "plain").write_bytes(b"x")
    assert target.stat().st_mode == (tmp_path / "plain").stat().st_mode


def test_atomic_write_takes_the_longest_names(tmp_path):
    path = tmp_path / ("n" * 255)
    with atomic_write(path) as file:
        file.write(b"x")
    assert path.read_bytes() == b"x"
