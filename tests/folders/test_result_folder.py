"""Whether somebody writes to a folder: the lock tells, not its file."""

import threading
import time

import pytest

from tests.waiting import PATIENCE
from tisfm.folders import result_folder
from tisfm.folders.result_folder import LOCK, FolderInUseError, is_locked, locked_folder


def test_a_locked_folder_is_being_written(tmp_path):
    assert not is_locked(tmp_path) and not is_locked(tmp_path / "nowhere")
    assert not list(tmp_path.iterdir())  # looking leaves nothing
    with locked_folder(tmp_path):
        assert is_locked(tmp_path)
        with pytest.raises(FolderInUseError), locked_folder(tmp_path):
            pass
    assert not is_locked(tmp_path)


def test_the_lock_file_of_a_killed_run_does_not_lock(tmp_path):
    (tmp_path / LOCK).touch()
    assert not is_locked(tmp_path)
    with locked_folder(tmp_path):
        assert is_locked(tmp_path)


def test_a_reader_does_not_keep_a_run_from_its_folder(tmp_path, monkeypatch):
    monkeypatch.setattr(
        result_folder, "_LOCK_TIMEOUT", PATIENCE
    )  # a busy machine may stop the reader
    ended = threading.Event()

    def look():
        while not ended.wait(0.01):
            is_locked(tmp_path)

    looking = threading.Thread(target=look)
    looking.start()
    try:
        end = time.monotonic() + 2
        while time.monotonic() < end:
            (tmp_path / LOCK).touch()
            with locked_folder(tmp_path):
                pass
    finally:
        ended.set()
        looking.join()
