"""A killed run, started again: no work is done twice, and the result is the same.

Poses are given: neither kills nor damaged files depend on how a path is found.
"""

import json
import shutil
import threading
import time
from dataclasses import replace

import numpy as np
import pytest
from filelock import FileLock

import tisfm
from tests.reconstruction.chunked.filmed import (
    CHUNK,
    FAST,
    contents,
    in_turn,
    smaller_film,
    write_frames,
)
from tisfm import Reconstruction
from tisfm.reconstruction.chunks import chunk as chunk_module
from tisfm.reconstruction.chunks import entry, joining
from tisfm.reconstruction.chunks.entry import ChunkedRun, reconstruct_in_chunks
from tisfm.reconstruction.result import folder as folder_module
from tisfm.reconstruction.result.renewal import CHUNKS
from tisfm.reconstruction.stages import depth as run_module
from tisfm.sources import Listing


class Killed(BaseException):
    """The process is killed."""


@pytest.fixture(scope="module")
def frames(tmp_path_factory):
    return write_frames(tmp_path_factory.mktemp("source") / "film", smaller_film().frames)


def chunk_options():
    return {
        "camera": smaller_film().camera, "poses": smaller_film().poses, "settings": FAST,
        "chunk": CHUNK, "depth_of": "keyframes",
    }  # fmt: skip


def again(source, folder, **options):
    options = {**chunk_options(), "map_unordered": in_turn, "resume": True, **options}
    return reconstruct_in_chunks(source, folder, **options)


@pytest.fixture(scope="module")
def whole(frames, tmp_path_factory):
    """Return the files of an uninterrupted run."""
    folder = tmp_path_factory.mktemp("whole") / "out"
    again(frames, folder, resume=False)
    return contents(folder)


@pytest.fixture(scope="module")
def begun(frames, tmp_path_factory):
    """Return the folder of a run that was killed after all chunks were made."""
    folder = tmp_path_factory.mktemp("begun") / "out"
    run = ChunkedRun(frames, folder, **chunk_options())
    with pytest.MonkeyPatch.context() as patch, pytest.raises(Killed):
        patch.setattr(entry, "place_chunks", kill)
        run.result(in_turn)
    return folder


def kill(*arguments, **options):
    raise Killed


def flip_last_byte(path):
    """Change the content of a file, and not its length."""
    content = path.read_bytes()
    path.write_bytes(content[:-1] + bytes([content[-1] ^ 1]))


def at(count, original):
    """Return a function whose call number `count` kills the process."""
    calls = []

    def call(*arguments, **options):
        calls.append(arguments)
        if len(calls) == count:
            raise Killed
        return original(*arguments, **options)

    return call


STAGES = [
    # In the middle of the second chunk; before the record of the first chunk is written.
    pytest.param(run_module, "write_depth", 6, marks=pytest.mark.nightly),
    (chunk_module, "files_below", 1),
    # During the estimate of the common camera, before there is a chunk.
    pytest.param(chunk_module, "reconstruct", 1, marks=pytest.mark.nightly),
    # While chunks are joined; before the record of the result; and during the clean-up.
    (joining, "link_or_copy", 9),
    pytest.param(folder_module, "atomic_write", 20, marks=pytest.mark.nightly),
    pytest.param(joining, "write_record", 1, marks=pytest.mark.nightly),
    pytest.param(entry, "write_request", 2, marks=pytest.mark.nightly),
    pytest.param(shutil, "rmtree", 12, marks=pytest.mark.nightly),
]


@pytest.mark.parametrize(("module", "name", "count"), STAGES)
def test_same_bytes_after_a_kill(frames, whole, tmp_path, monkeypatch, module, name, count):
    with monkeypatch.context() as patch:
        patch.setattr(module, name, at(count, getattr(module, name)))
        try:
            again(frames, tmp_path / "out", resume=False)
        except Killed:
            left = contents(tmp_path / "out")
            assert any(path.startswith(CHUNKS) for path in left)
        else:
            assert name in ("atomic_write", "rmtree")  # these have fewer calls
    again(frames, tmp_path / "out")
    assert contents(tmp_path / "out") == whole


def test_complete_chunks_are_kept(frames, whole, begun, tmp_path, monkeypatch):
    shutil.copytree(begun, tmp_path / "out")
    monkeypatch.setattr(chunk_module, "reconstruct", kill)
    again(frames, tmp_path / "out")
    assert contents(tmp_path / "out") == whole


@pytest.mark.parametrize(
    "damage",
    [
        lambda chunk: flip_last_byte(chunk / "path.npz"),
        lambda chunk: (chunk / "frames" / "000003.jpg").unlink(),
        lambda chunk: chunk.with_name("001.json").write_text("{"),
        pytest.param(
            lambda chunk: (chunk / "depth" / "000099.npz").write_bytes(b"one too many"),
            marks=pytest.mark.nightly,
        ),
        pytest.param(
            lambda chunk: chunk.with_name("001.json").write_text('{"digest": "", "files": {}}'),
            marks=pytest.mark.nightly,
        ),
        pytest.param(lambda chunk: shutil.rmtree(chunk), marks=pytest.mark.nightly),
    ],
)
def test_damaged_chunk_is_made_again(frames, whole, begun, tmp_path, monkeypatch, damage):
    shutil.copytree(begun, tmp_path / "out")
    damage(tmp_path / "out" / CHUNKS / "001")
    made, original = [], chunk_module.reconstruct

    def counted(*arguments, **options):
        made.append(options["folder"].name)
        return original(*arguments, **options)

    monkeypatch.setattr(chunk_module, "reconstruct", counted)
    again(frames, tmp_path / "out")
    assert made == ["001"]
    assert contents(tmp_path / "out") == whole


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"chunk": 13}, "chunk was 12, now 13"),
        ({"camera": tisfm.Camera(focal=100.0)}, "camera.focal was 48.0, now 100.0"),
        ({"depth_of": "all"}, 'depth_of was "keyframes", now "all"'),
        ({"settings": tisfm.Settings.preset("balanced", motion="camera")}, "settings"),
        ({"start": 1, "poses": smaller_film().poses[1:]}, "start was 0, now 1"),
        ({"size": 200}, "size was null, now 200"),
        ({"poses": None}, "poses was .*, now null"),
        ({"others": {"ply": True}}, "ply was null, now true"),
    ],
)
def test_other_options_are_refused(frames, begun, options, text):
    before = contents(begun)
    with pytest.raises(ValueError, match=text):
        again(frames, begun, **options)
    assert contents(begun) == before


def test_other_frames_and_versions_are_refused(frames, begun, tmp_path, monkeypatch):
    other = write_frames(tmp_path / "film", smaller_film().frames)
    (other / "f07.png").write_bytes((other / "f08.png").read_bytes())
    with pytest.raises(ValueError, match="frames was"):
        again(other, begun)
    shutil.copytree(begun, tmp_path / "out")
    path = tmp_path / "out" / CHUNKS / "asked.json"
    about = json.loads(path.read_text())
    about["asked"]["version"] = "0.0.1"
    path.write_text(json.dumps(about))
    with pytest.raises(ValueError, match=r'version was "0\.0\.1", now'):
        again(frames, tmp_path / "out")


def test_complete_result_is_kept(frames, whole, tmp_path, monkeypatch):
    folder = tmp_path / "out"
    result = again(frames, folder)  # nothing to resume
    np.testing.assert_allclose(result.poses, smaller_film().poses, atol=1e-12)
    assert contents(folder) == whole
    monkeypatch.setattr(chunk_module, "reconstruct", kill)
    assert len(again(frames, folder)) == len(smaller_film().frames)
    assert contents(folder) == whole
    with pytest.raises(ValueError, match="size was null, now 200"):
        again(frames, folder, size=200)
    with pytest.raises(Killed):  # without `resume` all work is done again
        again(frames, folder, resume=False)
    assert len(Reconstruction.load(folder)) == len(smaller_film().frames)


def test_earlier_result_stays_until_the_next_is_complete(frames, begun, tmp_path, monkeypatch):
    """It can be opened while chunks are made, and it comes back if joining them fails."""
    folder = tmp_path / "out"
    camera = smaller_film().camera
    tisfm.reconstruct(frames, stop=6, camera=camera, settings=FAST, depth_of="none", folder=folder)
    before = contents(folder)
    shutil.copytree(begun / CHUNKS, folder / CHUNKS)
    with monkeypatch.context() as patch:
        patch.setattr(joining, "link_or_copy", at(5, joining.link_or_copy))
        with pytest.raises(Killed):
            again(frames, folder)
    after = contents(folder)
    assert {name: after[name] for name in before} == before
    assert len(Reconstruction.load(folder)) == 6
    assert len(again(frames, folder)) == len(smaller_film().frames)


def test_run_at_once_removes_the_chunks(frames, begun, tmp_path):
    shutil.copytree(begun, tmp_path / "out")
    tisfm.reconstruct(
        frames,
        stop=4,
        camera=smaller_film().camera,
        settings=FAST,
        depth_of="none",
        folder=tmp_path / "out",
    )
    assert not (tmp_path / "out" / CHUNKS).exists()


def test_chunk_of_another_process_is_awaited(frames, whole, begun, tmp_path, monkeypatch):
    """A worker may outlive the process that started it; its chunk is not made again."""
    shutil.copytree(begun, tmp_path / "out")
    account = tmp_path / "out" / CHUNKS / "001.json"
    account.rename(tmp_path / "kept.json")
    held, resumed = threading.Event(), threading.Event()

    def finish():
        with FileLock(account.with_suffix(".lock")):
            held.set()
            resumed.wait()
            time.sleep(0.3)
            (tmp_path / "kept.json").rename(account)

    def in_other_process(function, items):
        resumed.set()
        yield from in_turn(function, items)

    monkeypatch.setattr(chunk_module, "reconstruct", kill)
    thread = threading.Thread(target=finish)
    thread.start()
    held.wait()
    again(frames, tmp_path / "out", map_unordered=in_other_process)
    thread.join()
    assert contents(tmp_path / "out") == whole


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"version": "0.0.7"}, "the command has 0.0.7"),
        ({"lanes": 4}, "processor of the command 4"),
        ({"listing": Listing(3, "")}, "sees other files in"),
    ],
    ids=["version", "processor", "files"],
)
def test_worker_with_another_setup_is_refused(frames, tmp_path, change, words):
    def there(function, items):
        return in_turn(function, [replace(item, **change) for item in items])

    with pytest.raises(RuntimeError, match=words):
        again(frames, tmp_path / "out", map_unordered=there, resume=False)
    assert not (tmp_path / "out" / CHUNKS / "000").exists()
