"""Files that appear whole or not at all."""

import os

import pytest

from tests.formats.written import contents
from tisfm.formats import atomic_write


def test_atomic_write_replaces_on_success(tmp_path):
    path = tmp_path / "file.bin"
    path.write_bytes(b"old")
    with atomic_write(path) as file:
        file.write(b"new")
        assert path.read_bytes() == b"old"
    assert path.read_bytes() == b"new"
    assert contents(tmp_path) == {"file.bin"}


@pytest.mark.parametrize("fault", [RuntimeError, KeyboardInterrupt, SystemExit, FileNotFoundError])
def test_a_failed_atomic_write_leaves_no_file(tmp_path, fault):
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
def test_atomic_write_honours_the_umask(tmp_path):
    with atomic_write(tmp_path / "written") as file:
        file.write(b"x")
    (tmp_path / "plain").write_bytes(b"x")
    assert (tmp_path / "written").stat().st_mode == (tmp_path / "plain").stat().st_mode


@pytest.mark.skipif(os.name == "nt", reason="links of POSIX")
@pytest.mark.parametrize("is_there", [True, False])
def test_atomic_write_replaces_a_link_and_not_its_target(tmp_path, is_there):
    target, link = tmp_path / "target", tmp_path / "link"
    if is_there:
        target.write_bytes(b"kept")
    link.symlink_to(target)
    with atomic_write(link) as file:
        file.write(b"x")
    assert not link.is_symlink() and link.read_bytes() == b"x"
    assert target.exists() == is_there
    assert not is_there or target.read_bytes() == b"kept"


@pytest.mark.skipif(os.name == "nt", reason="links of POSIX")
def test_atomic_write_goes_through_a_folder_that_is_a_link(tmp_path):
    (tmp_path / "there" / "inner").mkdir(parents=True)
    (tmp_path / "link").symlink_to(tmp_path / "there" / "inner")
    for name in ("link/a", "link/../b"):
        with atomic_write(tmp_path / name) as file:
            file.write(b"x")
    assert (tmp_path / "there" / "inner" / "a").read_bytes() == b"x"
    assert (tmp_path / "there" / "b").read_bytes() == b"x"


@pytest.mark.skipif(os.name == "nt", reason="links of POSIX")
def test_atomic_write_refuses_links_to_folders_and_devices(tmp_path):
    (tmp_path / "folder").mkdir()
    for name, target in (("one", tmp_path / "folder"), ("two", "/dev/null")):
        (tmp_path / name).symlink_to(target)
        with pytest.raises(OSError, match="cannot write"), atomic_write(tmp_path / name):
            pytest.fail("the block must not run")
        assert (tmp_path / name).is_symlink()


def test_atomic_write_accepts_the_longest_names(tmp_path):
    path = tmp_path / ("n" * 255)
    with atomic_write(path) as file:
        file.write(b"x")
    assert path.read_bytes() == b"x"
