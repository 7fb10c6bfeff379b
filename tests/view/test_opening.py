"""Folders that are opened: runs that go on, results that are damaged, paths of the camera."""

import json

import numpy as np
import pytest

from tests.view.results import film, write_reconstruction, write_record_of, write_run
from tisfm.folders.result_folder import LOCK, locked_folder
from tisfm.formats import FormatError
from tisfm.results.opening import NotReadyError, describe_progress, open_result


def test_finished_pairs_of_a_running_run_are_shown(tmp_path):
    shot = write_run(tmp_path, 4)
    write_record_of(tmp_path, shot, [0], "camera")
    result = open_result(tmp_path)
    assert result.names == ["f0"] and not result.refresh()
    write_record_of(tmp_path, shot, [0, 1, 2, 3], "camera")
    assert result.refresh() == "grown" and result.names == ["f0", "f1", "f2", "f3"]
    assert len(result.statuses) == len(result.times) == len(result.poses) == 4
    assert result.times == pytest.approx([0, 0.1, 0.2, 0.3])
    assert result.refresh() is None
    write_record_of(tmp_path, shot, [0, 2], "camera")
    assert result.refresh() == "replaced"
    write_record_of(tmp_path, shot, [0, 1, 2], "camera")  # workers finish out of order
    assert result.refresh() == "grown" and result.names == ["f0", "f1", "f2"]
    write_record_of(tmp_path, shot, [1, 2, 3], "camera")  # a run from another frame on
    assert result.refresh() == "replaced"


def test_pairs_are_in_the_order_of_their_numbers(tmp_path):
    shot = write_run(tmp_path, 4)
    write_record_of(tmp_path, shot, [3, 0, 2], "camera")
    assert open_result(tmp_path).names == ["f0", "f2", "f3"]


def test_a_record_damaged_later_keeps_the_earlier_result(tmp_path):
    write_run(tmp_path, 2)
    result = open_result(tmp_path)
    (tmp_path / "run.json").write_text('{"pairs": {"f0": 1}}')
    with pytest.raises(FormatError, match="damaged"):
        result.refresh()
    assert result.names == ["f0", "f1"] and result.read(1).number == 1


def test_given_poses_make_a_path(tmp_path):
    shot = write_run(tmp_path, 4, with_poses=True)
    result = open_result(tmp_path)
    expected = np.linalg.inv(shot.poses[0]) @ shot.poses[:4]
    assert result.has_one_scale and (result.piece == 0).all()
    np.testing.assert_allclose(result.poses, expected, atol=1e-9)
    write_record_of(tmp_path, shot, [0, 1, 3], "camera", with_poses=True)
    result.refresh()
    assert result.piece.tolist() == [0, 0, 2]  # a pair is missing: its way is not known
    np.testing.assert_allclose(result.poses[2], np.eye(4))
    assert result.read(2).scale == 1


def test_without_poses_each_pair_has_its_own_scale(tmp_path):
    write_run(tmp_path, 3)
    result = open_result(tmp_path)
    assert not result.has_one_scale and result.piece.tolist() == [0, 1, 2]
    np.testing.assert_allclose(result.poses, np.tile(np.eye(4), (3, 1, 1)))
    for number in range(3):
        frame = result.read(number)
        assert np.nanmean(frame.inverse_depth / frame.scale) == pytest.approx(1, rel=1e-3)


def test_the_path_of_a_reconstruction_is_its_own(tmp_path):
    write_reconstruction(tmp_path / "r")
    result = open_result(tmp_path / "r")
    np.testing.assert_allclose(result.poses, film().poses)
    assert result.read(3).inverse_depth == pytest.approx(1 / film().depth[3], rel=1e-3)
    assert result.read(3).picture.shape == (45, 61, 3)


def test_a_reconstruction_is_readable_while_it_is_replaced(tmp_path):
    write_reconstruction(tmp_path / "r")
    result = open_result(tmp_path / "r")
    record = (tmp_path / "r" / "reconstruction.json").read_text()
    (tmp_path / "r" / "reconstruction.json").unlink()
    assert not result.refresh() and len(result.names) == 5
    about = json.loads(record)
    about["names"][0] = "another"
    (tmp_path / "r" / "reconstruction.json").write_text(json.dumps(about))
    assert result.refresh() == "replaced" and result.names[0] == "another"


RECORD = json.dumps({"format": 4, "version": "1", "settings": {"motion": "field"}, "pairs": {}})


@pytest.mark.parametrize(
    ("name", "text", "yet", "ended"),
    [
        ("reconstruction.begun", "", "no complete reconstruction yet", "no command writes to it"),
        ("run.json", RECORD, "no finished pair yet", "no command writes to it"),
        (None, "", "no finished pair yet", "neither run.json nor reconstruction.json"),
    ],
)
def test_running_results_are_awaited_and_killed_ones_are_not(tmp_path, name, text, yet, ended):
    if name is not None:
        (tmp_path / name).write_text(text)
    with locked_folder(tmp_path), pytest.raises(NotReadyError, match=yet):
        open_result(tmp_path)
    (tmp_path / LOCK).touch()  # a killed run leaves the file, and nobody holds it
    with pytest.raises(FileNotFoundError, match=ended):
        open_result(tmp_path)


def test_how_far_a_reconstruction_is(tmp_path):
    assert describe_progress(tmp_path) == ""
    (tmp_path / "reconstruction.begun").touch()
    assert "read" in describe_progress(tmp_path)
    for part, count, ending in (("frames", 5, "jpg"), ("depth", 2, "npz")):
        (tmp_path / part).mkdir()
        for k in range(count):
            (tmp_path / part / f"{k:06d}.{ending}").touch()
    assert describe_progress(tmp_path) == "5 frames are read, 2 of them have depth"


def test_other_folders_are_refused(tmp_path):
    with pytest.raises(FileNotFoundError, match="there is no folder"):
        open_result(tmp_path / "nowhere")
    with pytest.raises(FileNotFoundError, match=r"neither run\.json nor reconstruction\.json"):
        open_result(tmp_path)
    (tmp_path / "file").touch()
    with pytest.raises(NotADirectoryError, match="is not a folder"):
        open_result(tmp_path / "file")


def test_a_run_without_npz_files_is_refused(tmp_path):
    shot = write_run(tmp_path, 1)
    write_record_of(tmp_path, shot, [0], "camera", files=("_depth.png",))
    with pytest.raises(FormatError, match="run again with npz among --outputs"):
        open_result(tmp_path)


@pytest.mark.parametrize(
    "text", ["", "[]", "{}", '{"pairs": []}', '{"pairs": {"../x": {"number": 1}}}']
)
def test_a_damaged_record_is_refused(tmp_path, text):
    (tmp_path / "run.json").write_text(text)
    with pytest.raises(FormatError, match=r"run\.json"):
        open_result(tmp_path)


def test_names_lead_to_no_other_folder(tmp_path):
    shot = write_run(tmp_path, 1)
    write_record_of(tmp_path, shot, [0], "camera")
    text = (tmp_path / "run.json").read_text().replace('"f0"', '"../f0"')
    (tmp_path / "run.json").write_text(text)
    with pytest.raises(FormatError, match="not the name of a pair"):
        open_result(tmp_path)
