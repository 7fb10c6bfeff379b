"""Status codes in files from elsewhere, for each reader."""

import json

import pytest

from tests.interpretation_file.stored import about
from tests.view.results import write_reconstruction, write_run
from tisfm.folders.run_record import read_record
from tisfm.interpretation import Interpretation
from tisfm.reconstruction.result.reconstruction import Reconstruction
from tisfm.results.opening import open_result
from tisfm.results.pair_frames import PairFrames
from tisfm.status import Status

NO_CODES = ("<img src=x>", "Converged", "", "a b", "converged\n", "é", None, 3, ["converged"])


@pytest.mark.parametrize("code", NO_CODES)
def test_a_wrong_code_is_refused(code):
    with pytest.raises((TypeError, ValueError), match="status is"):
        Status(code)


def test_a_message_is_a_string():
    with pytest.raises(TypeError, match="message is None"):
        Status("converged", None)


def change_run(folder, code):
    record = json.loads((folder / "run.json").read_text())
    record["pairs"]["f0"]["status"] = code
    record["camera"] = {"focal": 50.0, "center": None, "distortion": None}
    (folder / "run.json").write_text(json.dumps(record))


def change_reconstruction(folder, code):
    record = json.loads((folder / "reconstruction.json").read_text())
    record["status"][0][0] = code
    (folder / "reconstruction.json").write_text(json.dumps(record))


def change_npz(folder, code):
    about(folder / "f0.npz", status=code)


def load_npz(folder):
    return Interpretation.load(folder / "f0.npz")


@pytest.mark.parametrize(
    ("change", "read"),
    [
        (change_reconstruction, Reconstruction.load),
        (change_reconstruction, open_result),
        (change_run, open_result),
        (change_run, PairFrames),
        (change_run, read_record),
        (change_npz, load_npz),
    ],
)
def test_every_reader_refuses_a_wrong_code(tmp_path, change, read):
    if change is change_reconstruction:
        write_reconstruction(tmp_path / "r", 2)
    else:
        write_run(tmp_path / "r", 1)
    for code in NO_CODES:
        change(tmp_path / "r", code)
        with pytest.raises(ValueError, match="status is"):
            read(tmp_path / "r")
    change(tmp_path / "r", "brand_new")  # of another version
    read(tmp_path / "r")


def test_a_code_of_another_version_is_kept(tmp_path):
    write_reconstruction(tmp_path / "r", 2)
    change_reconstruction(tmp_path / "r", "brand_new")
    assert Reconstruction.load(tmp_path / "r").status == ("brand_new", "converged")
    write_run(tmp_path / "p", 1)
    change_npz(tmp_path / "p", "brand_new")
    assert load_npz(tmp_path / "p").status == "brand_new"
