"""Folders from elsewhere with links in them: no command writes through one."""

import os

import pytest

from tests.cli.command_line import FRAMES
from tests.exports.made import made
from tisfm.exports.model_folder import write_pictures
from tisfm.formats import write_png

pytestmark = pytest.mark.skipif(os.name == "nt", reason="links of POSIX")


@pytest.fixture
def outside(place):
    """A folder of somebody's files; check that they stay as they are."""
    folder = place / "outside"
    folder.mkdir()
    (folder / "note").write_text("mine")
    yield folder
    assert {path.name: path.read_text() for path in folder.iterdir()} == {"note": "mine"}


def links_in(folder):
    return [path.name for path in folder.rglob("*") if path.is_symlink()]


def test_report(tisfm_run, place, outside):
    made(place / "r")
    (place / "r" / "report.html").symlink_to(outside / "nothing")
    code, _, err = tisfm_run("report", "r")
    assert code == 0, err
    assert links_in(place / "r") == []


@pytest.mark.parametrize(
    # A form with a folder of its own refuses the other files that it finds behind the link.
    ("form", "is_refused"),
    [
        ("tum", False),
        ("depth-tiff", False),
        ("nerfstudio", True),
        ("colmap", True),
        ("chan", False),
    ],
)
def test_export(tisfm_run, place, outside, form, is_refused):
    """All files of a first export are replaced by links before the second."""
    made(place / "r", count=6)
    code, _, err = tisfm_run("export", "r", "--to", form, "-o", "o")
    assert code == 0, err
    written = sorted(path.relative_to(place / "o") for path in (place / "o").rglob("*"))
    (place / "real").mkdir()
    (place / "o2").symlink_to(place / "real")  # the folder itself may be a link
    for path in written:
        if len(path.parts) == 1:
            to = outside if (place / "o" / path).is_dir() else outside / "note"
            (place / "real" / path).symlink_to(to)
    code, _, err = tisfm_run("export", "r", "--to", form, "-o", "o2")
    assert code == is_refused and ("has other files" in err) == is_refused, err
    if not is_refused:
        assert links_in(place / "real") == []
        assert sorted(p.relative_to(place / "real") for p in (place / "real").rglob("*")) == written


@pytest.mark.parametrize("images", ["link", "copy"])
def test_a_picture_that_is_a_link_is_exported_as_a_file(place, outside, images):
    result = made(place / "r", count=2)
    picture = place / "r" / "frames" / "000000.jpg"
    whole = picture.read_bytes()
    picture.rename(place / "elsewhere.jpg")
    picture.symlink_to(place / "elsewhere.jpg")
    write_pictures(result, [0, 1], place / "o", images)
    assert links_in(place / "o") == [] and (place / "o" / "000000.jpg").read_bytes() == whole
    assert (place / "elsewhere.jpg").stat().st_nlink == 1


def test_an_export_that_is_renewed(tisfm_run, place, outside):
    made(place / "r", count=6)
    call = ("export", "r", "--to", "nerfstudio", "-o", "o")
    assert tisfm_run(*call)[0] == 0
    (folder,) = {path.parent for path in (place / "o").rglob("transforms.json")}
    (folder / "sparse").symlink_to(outside)
    (folder / ".tisfm-new").symlink_to(outside)
    (folder / ".tisfm-earlier").symlink_to(outside)
    (folder / "transforms.json").unlink()
    (folder / "transforms.json").symlink_to(outside / "note")
    code, _, err = tisfm_run(*call)
    assert code == 0, err
    assert links_in(folder) == [] and (folder / "transforms.json").is_file()


def test_eval(tisfm_run, place, outside, benchmark_folder):
    (place / "out").mkdir()
    (place / "out" / "flows").symlink_to(outside)
    (place / "out" / "eval.json").symlink_to(outside / "nothing")
    code, _, err = tisfm_run("eval", benchmark_folder, "-o", "out", "--preset", "fast")
    assert code == 0, err
    assert links_in(place / "out") == [] and list((place / "out").rglob("*_flow.flo"))


def test_run(tisfm_run, place, outside):
    (place / "frames").mkdir()
    for k in range(2):
        write_png(place / "frames" / f"f{k}.png", FRAMES[k])
    (place / "real").mkdir()
    (place / "out").symlink_to(place / "real")
    endings = ("_depth.png", "_depth16.png", "_flow.flo", "_anaglyph.png", "_pose.txt", ".npz",
               ".ply")  # fmt: skip
    names = [*(f"f0{ending}" for ending in endings), "run.csv", "timings.csv", "report.html"]
    for name in names:
        (place / "real" / name).symlink_to(outside / ("note" if "_" in name else "nothing"))
    (place / "real" / ".tisfm.lock").symlink_to(outside / "note")
    call = ["run", "frames", "-o", "out", "--motion", "camera", "--preset", "fast", "--focal", "50"]
    code, _, err = tisfm_run(*call, "--flo", "--ply", "--report", "--no-figures")
    assert code == 0, err
    assert links_in(place / "real") == []
    assert {path.name for path in (place / "real").iterdir()} == {*names, "run.json"}


@pytest.mark.parametrize("more", [[], ["--chunk", "100"]])
def test_reconstruct_that_fails_leaves_the_earlier_result(tisfm_run, place, outside, more):
    """The folder has links in place of the folders that runs make."""
    made(place / "r", count=3)
    for name in ("cache", ".tisfm-chunks"):
        (place / "r" / name).symlink_to(outside)
    before = {p: p.read_bytes() for p in (place / "r").rglob("*") if p.is_file()}
    (place / "frames").mkdir()
    for k in range(3):
        write_png(place / "frames" / f"f{k}.png", FRAMES[k][: 20 + (k == 2)])  # of two sizes
    code, _, err = tisfm_run(
        "reconstruct", "frames", "-o", "r", "--preset", "fast", "--focal", "50", *more
    )
    assert code == 1 and err.startswith("tisfm: "), err
    assert {p: p.read_bytes() for p in before} == before
    assert not (place / "r" / "reconstruction.begun").exists()
