"""A film reconstructed in chunks, compared with the same film at once."""

import multiprocessing
from concurrent.futures import ProcessPoolExecutor, as_completed

import numpy as np
import PIL.Image
import pytest

import tisfm
from tests.reconstruction.chunked.filmed import (
    CHUNK,
    COUNT,
    FAST,
    contents,
    film,
    in_turn,
    write_frames,
)
from tests.reconstruction.films import along, path_error
from tests.rendered import room_film
from tisfm import Reconstruction
from tisfm.camera_file import read_camera
from tisfm.reconstruction.chunks.entry import ChunkedRun, reconstruct_in_chunks
from tisfm.reconstruction.path.path_solver import PathSolver
from tisfm.reconstruction.result.statuses import NEW_PIECE_NOTE
from tisfm.reconstruction.stages import path as run_module


@pytest.fixture(scope="module")
def frames(tmp_path_factory):
    return write_frames(tmp_path_factory.mktemp("source") / "film", film().frames)


def in_chunks(source, folder, **options):
    options = {
        "camera": film().camera, "settings": FAST, "chunk": CHUNK,
        "map_unordered": in_turn, **options,
    }  # fmt: skip
    return reconstruct_in_chunks(source, folder, **options)


@pytest.fixture(scope="module")
def found(frames, tmp_path_factory):
    return in_chunks(frames, tmp_path_factory.mktemp("result") / "out", depth_of="keyframes")


@pytest.fixture(scope="module")
def at_once(frames):
    return tisfm.reconstruct(frames, camera=film().camera, settings=FAST)


def scales(result, frames):
    """Return for each of some frames the factor that turns its depth into true depth."""
    return np.array([np.nanmedian(film().depth[k] / result.depth(k)) for k in frames])


def test_result_is_as_of_any_reconstruction(found):
    loaded = Reconstruction.load(found.folder)
    assert len(loaded) == COUNT and loaded.names == tuple(f"f{k:02d}" for k in range(COUNT))
    assert (loaded.piece == 0).all() and loaded.unit == (1.0,)
    np.testing.assert_array_equal(loaded.poses, found.poses)
    np.testing.assert_allclose(loaded.poses[0], np.eye(4), atol=1e-12)
    assert all(status == "converged" and not status.message for status in loaded.status)
    assert np.nanmedian(loaded.depth(loaded.keyframes[0])) == pytest.approx(1, abs=2e-3)
    assert loaded.picture(COUNT - 1).shape == film().frames[0].shape
    assert sorted(path.name for path in found.folder.iterdir()) == [
        "asked.json", "camera.json", "depth", "frames", "path.npz", "reconstruction.json",
    ]  # fmt: skip


def test_path_is_nearly_as_exact_as_at_once(found, at_once):
    once, parts = (path_error(one.poses, film().poses) for one in (at_once, found))
    assert once < 0.01 and parts < 0.02
    # Deviations are in the unit of the joined path. Each chunk has its own alignment.
    ratio = found.position_deviation[:, 0] / at_once.position_deviation[:, 0]
    assert 0.1 < np.median(ratio[:CHUNK]) < 2 and 0.1 < np.median(ratio[CHUNK:]) < 2


def test_all_chunks_have_one_scale(found, at_once):
    """Depth has the scale of the whole film on both sides of a chunk's beginning."""
    part, whole = (scales(result, found.keyframes) for result in (found, at_once))
    assert {frame // CHUNK for frame in found.keyframes} == {0, 1}
    ratio = part / whole * np.median(whole) / np.median(part)
    assert np.abs(ratio - 1).max() < 0.04


def test_focal_length_is_estimated_once(frames, tmp_path, monkeypatch):
    """Chunks know that it is a guess: from a plane alone they take no path with it."""
    stated, chunks = [], []

    def solver(**options):
        stated.append(options["is_focal_known"])
        return PathSolver(**options)

    def load_chunks(function, items):
        yield from in_turn(function, items)
        chunks.extend(Reconstruction.load(item.folder) for item in items)

    monkeypatch.setattr(run_module, "PathSolver", solver)
    with pytest.warns(tisfm.focal_guess.GuessedFocalWarning):
        found = in_chunks(
            frames,
            tmp_path / "out",
            stop=16,
            camera=None,
            depth_of="none",
            map_unordered=load_chunks,
        )
    assert found.calibration.origin in ("estimated", "guessed") and not found.calibration.seen
    assert read_camera(found.folder).focal == found.camera.focal
    assert stated == [False] * len(chunks)
    assert [one.calibration for one in chunks[-2:]] == [found.calibration] * 2
    assert [one.camera.focal for one in chunks[-2:]] == [found.camera.focal] * 2


@pytest.mark.nightly
def test_one_chunk_is_the_same_as_at_once(frames, tmp_path):
    options = {"camera": film().camera, "settings": FAST, "stop": 8, "depth_of": "keyframes"}
    at_once = tisfm.reconstruct(frames, **options)
    found = in_chunks(frames, tmp_path / "out", chunk=150, **options)
    assert contents(at_once.folder).items() <= contents(found.folder).items()


@pytest.mark.nightly
def test_given_poses_and_depth_of_keyframes(frames, tmp_path):
    poses = film().poses.copy()
    poses[9] = np.nan
    found = in_chunks(frames, tmp_path / "out", poses=poses, depth_of="keyframes")
    np.testing.assert_allclose(found.poses, poses, atol=1e-12)
    assert found.status[9] == "unrelated" and (np.delete(found.piece, 9) == 0).all()
    written = sorted(int(path.stem) for path in (found.folder / "depth").iterdir())
    assert written == list(found.keyframes)
    at_once = tisfm.reconstruct(
        frames, camera=film().camera, settings=FAST, poses=poses, depth_of="keyframes"
    )
    # For the least accurate keyframe, the errors are similar.
    once, parts = (
        max(abs(np.nanmedian(film().depth[k] / one.depth(k)) - 1) for k in one.keyframes)
        for one in (at_once, found)
    )
    assert parts < 1.5 * once


@pytest.mark.nightly
def test_camera_is_guessed_once(tmp_path):
    """The first file gives the guess, although files of later chunks state another focal length."""
    source = write_frames(tmp_path / "film", film().frames)
    for k in range(COUNT):
        exif = PIL.Image.Exif()
        exif.get_ifd(0x8769)[0xA405] = 50 if k == 0 else 90  # 35 mm equivalent, as in EXIF
        with PIL.Image.open(source / f"f{k:02d}.png") as picture:
            picture.save(source / f"f{k:02d}.jpg", exif=exif, quality=95)
        (source / f"f{k:02d}.png").unlink()
    chunks = []

    def load_chunks(function, items):
        yield from in_turn(function, items)
        chunks.extend(Reconstruction.load(item.folder) for item in items)

    with pytest.warns(tisfm.focal_guess.GuessedFocalWarning):
        found = in_chunks(
            source,
            tmp_path / "out",
            camera=None,
            map_unordered=load_chunks,
            poses=film().poses,
            depth_of="keyframes",
        )
    assert found.calibration.origin == "guessed"
    guess = tisfm.focal_guess.guess_focal(source / "f00.jpg").focal
    assert guess != tisfm.focal_guess.guess_focal(source / "f08.jpg").focal
    assert found.camera.focal == read_camera(found.folder).focal == guess
    assert [one.camera.focal for one in chunks] == [guess] * 3
    assert [one.calibration for one in chunks] == [found.calibration] * 3


def test_start_step_and_a_damaged_file(tmp_path):
    source = write_frames(tmp_path / "film", np.repeat(film().frames, 2, axis=0))
    (source / "f10.png").write_bytes(b"no picture")
    found = in_chunks(source, tmp_path / "out", start=2, stop=36, step=2, bad_frames="skip",
                      depth_of="none")  # fmt: skip
    names = [f"f{k:02d}" for k in range(2, 36, 2) if k != 10]
    assert found.names == tuple(names)
    assert [index for index, _ in found.skipped] == [10]
    assert not list((found.folder / "depth").iterdir())
    true = film().poses[[int(name[1:]) // 2 for name in names]]
    assert (found.piece == 0).all() and path_error(found.poses, true) < 0.02


def test_cut_stays_a_cut(tmp_path):
    """Two scenes of 12 frames each: two pieces, as at once (test_path.py), each in two chunks."""
    one, other = (
        room_film(along(12, np.array((side, 0, 0.02, 0, 0, 0))), 120, 160, seed=seed, samples=1)
        for side, seed in ((0.06, 0), (-0.06, 7))
    )
    both = [*one.frames, *(255 - other.frames)]
    source = write_frames(tmp_path / "film", both)
    found = in_chunks(source, tmp_path / "out", depth_of="none")
    assert found.piece.tolist() == [0] * 12 + [1] * 12
    assert [k for k, status in enumerate(found.status) if NEW_PIECE_NOTE in status.message] == [12]
    np.testing.assert_allclose(found.poses[12], np.eye(4), atol=1e-9)
    assert path_error(found.poses[:12], one.poses) < 0.03
    assert path_error(found.poses[12:], other.poses) < 0.03


def spawned(function, items):
    """Call a function with each item in its own process."""
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=context) as pool:
        tasks = {pool.submit(function, item): number for number, item in enumerate(items)}
        for task in as_completed(tasks):
            yield tasks[task], task.result()


@pytest.mark.nightly  # workers of the command are tested in tests/cli/test_workers.py
def test_other_processes_find_the_same(frames, found, tmp_path):
    there = in_chunks(frames, tmp_path / "out", map_unordered=spawned)
    assert contents(there.folder) == contents(found.folder)


@pytest.mark.parametrize(
    ("source", "options", "error", "text"),
    [
        ("film", {"chunk": 11}, ValueError, "chunk is 11: expected a number of frames, at least"),
        ("film", {"mask": np.ones((120, 160), bool)}, TypeError, "mask is ndarray"),
        ("film", {"poses": np.tile(np.eye(4), (3, 1, 1))}, ValueError, "poses are 3"),
        ("film", {"poses": np.tile(np.eye(4), (COUNT, 1, 1)), "bad_frames": "skip"}, ValueError,
         "would not fit"),
        ("film", {"poses": np.tile(np.eye(4), (COUNT, 1, 1)), "calibrate": "focal"}, ValueError,
         'calibrate="focal"'),
        ("webcam:0", {}, ValueError, "record it to a file"),
        ("arrays", {}, TypeError, "source is not a path"),
        ("gone", {}, FileNotFoundError, "gone"),
    ],
)  # fmt: skip
def test_wrong_arguments_are_refused(frames, tmp_path, source, options, error, text):
    given = {"film": frames, "arrays": iter(film().frames)}.get(source, source)
    with pytest.raises(error, match=text):
        in_chunks(given, tmp_path / "out", **options)
    assert not (tmp_path / "out" / "reconstruction.json").exists()


def test_preset_alone_means_the_motion_of_the_camera(frames, tmp_path):
    run = ChunkedRun(frames, tmp_path / "out", settings=tisfm.Settings.preset("fast"), chunk=12)
    assert run.request["settings"]["motion"] == "camera"


def test_error_of_a_chunk_is_raised(tmp_path):
    source = write_frames(tmp_path / "film", film().frames)
    (source / "f03.png").write_bytes(b"no picture")
    with pytest.raises(ValueError, match=r"f03\.png"):
        in_chunks(source, tmp_path / "out")


def test_result_is_not_written_among_frames(frames):
    with pytest.raises(ValueError, match="the output folder: give another folder"):
        in_chunks(frames, frames)
