"""Times of frames that cannot serve a path: results are complete, and one note says so."""

import json
import warnings
from pathlib import Path

import numpy as np
import pytest

import tisfm
from tests.cases.inputs import room, sliding, write_film
from tests.cli.conftest import tisfm_run, work_folder  # noqa: F401
from tests.draws import nightly_except
from tisfm.exports import write_kitti_paths, write_tum_paths
from tisfm.reconstruction.path.given_poses import find_frame_poses
from tisfm.sources.frame_reader import SourceWarning
from tisfm.trajectory import Trajectory, read_tum
from tisfm.trajectory.times import are_increasing, times_note, times_or_numbers

pytest.importorskip("av")
SETTINGS = tisfm.Settings.preset("fast", motion="camera")
COUNT, FOCAL = 10, 96.0
REPEATED = [2 * (k // 2) for k in range(COUNT)]


def repeated(path, frames=None):
    """Write a film in which two frames always have one time."""
    return write_film(path, room(COUNT, 120, 160) if frames is None else frames, times=REPEATED)


def doubled(path):
    """Write two recordings one after the other into one transport stream."""
    there = room(COUNT, 120, 160)
    both = (there, there[::-1].copy())
    parts = [write_film(path.with_name(f"{k}.ts"), frames) for k, frames in enumerate(both)]
    path.write_bytes(b"".join(part.read_bytes() for part in parts))
    return path


def noted(err):
    """Return the notes that a command printed, without "note: "."""
    return [line.removeprefix("note: ") for line in err.splitlines() if line.startswith("note: ")]


@pytest.mark.parametrize(
    "film", nightly_except("repeated_times.mkv", of=["repeated_times.mkv", "doubled.ts"])
)
def test_result_is_complete(tisfm_run, tmp_path, film):  # noqa: F811
    path = (repeated if film.endswith("mkv") else doubled)(tmp_path / film)
    code, out, err = tisfm_run("reconstruct", str(path), "-o", "out", "--preset", "fast",
                               "--depth-of", "none", "--focal", str(FOCAL), "--report")  # fmt: skip
    assert (code, out) == (0, ""), err
    (note,) = noted(err)
    assert ("repeat" if film.endswith("mkv") else "go back") in note and "numbers of frames" in note
    assert err.startswith("note: "), "the note comes before the result"
    result = tisfm.Reconstruction.load("out")
    assert result.notes == (note,)
    assert (result.piece == 0).sum() >= COUNT - 1
    posed = np.flatnonzero(result.piece == result.largest_piece)
    assert read_tum("out/trajectory.txt").times.tolist() == posed.tolist()
    assert json.loads(Path("out/reconstruction.json").read_text())["notes"] == [note]
    assert "How the source was read" in Path("out/report.html").read_text()
    # Times are kept as they are; exports take numbers, and say so.
    assert not are_increasing(result.times) and None not in result.times
    assert read_tum(write_tum_paths(result, ".")[0]).times.tolist() == posed.tolist()
    stamps = write_kitti_paths(result, ".")[1].read_text().split()
    assert [float(stamp) for stamp in stamps] == posed.tolist()
    code, _, err = tisfm_run("export", "out", "-o", "exported", "--to", "tum")
    assert code == 0 and "frames have no times that rise" in err


def test_chunks_print_the_note_before_their_work(tisfm_run, tmp_path):  # noqa: F811
    path = repeated(tmp_path / "a.mkv")
    code, _, err = tisfm_run("reconstruct", str(path), "-o", "out", "--preset", "fast", "--chunk",
                             "20", "--depth-of", "none", "--focal", str(FOCAL))  # fmt: skip
    assert code == 0, err
    (note,) = noted(err)
    result = tisfm.Reconstruction.load("out")
    assert result.notes == (note,) and len(result) == COUNT
    assert (
        read_tum("out/trajectory.txt").times.tolist() == np.flatnonzero(result.piece == 0).tolist()
    )


@pytest.mark.parametrize("missing", [[4], range(COUNT)], ids=["one", "all"])
def test_frames_without_times(tmp_path, monkeypatch, missing):
    """If no frame has a time, there is no note."""
    path = write_film(tmp_path / "a.mkv", sliding(6))
    number = iter(range(10**6))

    def time(frame, stream):
        index = next(number)
        return None if index in missing else index / 25

    monkeypatch.setattr("tisfm.sources.av_video._time", time)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        result = tisfm.reconstruct(
            path, camera=tisfm.Camera(focal=40.0), settings=SETTINGS, depth_of="none"
        )
    notes = [str(one.message) for one in told if issubclass(one.category, SourceWarning)]
    assert list(result.notes) == notes
    assert len(notes) == (len(missing) == 1) and all("frame 4 has no time" in one for one in notes)


@pytest.mark.nightly
def test_stream_warns_once(tmp_path):
    path = repeated(tmp_path / "a.mkv", sliding(COUNT))
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        frames = list(
            tisfm.reconstruct_stream(path, camera=tisfm.Camera(focal=40.0), settings=SETTINGS)
        )
    assert [frame.time for frame in frames] == [time / 25 for time in REPEATED]
    (note,) = [one for one in told if issubclass(one.category, SourceWarning)]
    assert "frame a_000000 and frame a_000001 are both at 0 s" in str(note.message)


def test_run_and_a_batch_print_the_note(tisfm_run, tmp_path):  # noqa: F811
    path = repeated(tmp_path / "a.mkv", sliding(COUNT))
    options = ("--preset", "fast", "--outputs", "npz", "--stop", "4")
    code, _, err = tisfm_run("run", str(path), "-o", "out", *options)
    assert code == 0
    (note,) = noted(err)
    assert "repeat" in note
    record = Path("out/run.json").read_bytes()
    assert json.loads(record)["notes"] == [note]
    assert tisfm_run("run", str(path), "-o", "out", *options, "--resume")[0] == 0
    assert Path("out/run.json").read_bytes() == record
    jobs = f"source,output,preset,outputs,stop\n{path},batch,fast,npz,4\n"
    Path("jobs.csv").write_text(jobs)
    code, _, err = tisfm_run("batch", "jobs.csv")
    assert code == 0 and f"batch: note: {note}" in err.splitlines()


@pytest.mark.parametrize(
    ("times", "fault"),
    [
        ([], ""),
        ([3.0], ""),
        ([0.0, 0.1, 0.3], ""),
        ([1e300, 1.1e300], ""),
        ([None, None], ""),
        ([0.0, 0.0, 0.1], "frame 0 and frame 1 are both at 0 s"),
        ([0.1, 0.2, 0.0], "go back: frame 1 is at 0.2 s, frame 2 at 0 s"),
        ([0.0, None, 0.2], "frame 1 has no time"),
        ([0.0, np.nan, 0.2], "frame 1 has no time"),
        ([0.0, 1.0, np.inf], "frame 2 has no time"),
        ([1738133056.0, 1738133056.0 + 1e-9], "are both at"),  # alike as floats
    ],
    ids=str,
)  # fmt: skip
def test_usable_times(times, fault):
    assert fault in times_note(times) and bool(times_note(times)) == bool(fault)
    numbers = [float(k) for k in range(len(times))]
    expected = times if are_increasing(times) else numbers
    assert times_or_numbers(times).tolist() == list(expected)


def test_poses_with_other_times_are_refused_before_all_work(tmp_path):
    """Names of files give the times of frames at once."""
    from tests.cases.inputs import write_folder

    names = [f"{k}.500000.png" for k in range(4)]
    folder = write_folder(tmp_path / "a", sliding(4), names)
    given = Trajectory(poses=np.tile(np.eye(4), (4, 1, 1)), times=np.arange(4) + 100.0)

    def progress(stage, done, total):
        raise AssertionError("frames are read")

    with pytest.raises(ValueError, match="no pose is within"):
        tisfm.reconstruct(folder, poses=given, settings=SETTINGS, progress=progress)


def test_poses_are_assigned_by_order_if_times_do_not_increase():
    given = Trajectory(poses=np.tile(np.eye(4), (3, 1, 1)), times=[0.0, 0.1, 0.2])
    poses, missing = find_frame_poses(given, [0.0, 0.1, 0.1])
    assert len(poses) == 3 and not missing
    with pytest.raises(ValueError, match="no times that increase"):
        find_frame_poses(given, [0.0, 0.1, 0.1, 0.2])
