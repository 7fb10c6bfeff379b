"""Folders from elsewhere with links in them: no command writes through one."""

import os

import pytest

from tests.cli.command_line import FRAMES
from tests.exports.made import made
from tisfm.exports.model_folder import write_pictures
from tisfm.formats import write_png

pytestmark = pytest.mark.skipif(os.name == "nt", reason="links of POSIX")


@pytest.fixture
def outside(work_folder):
    """A folder of somebody's files; check that they stay as they are."""
    folder = work_folder / "outside"
    folder.mkdir()
    (folder / "note").write_text("mine")
    yield folder
    assert {path.name: path.read_text() for path in folder.iterdir()} == {"note": "mine"}


def links_in(folder):
    return [path.name for path in folder.rglob("*") if path.is_symlink()]


def test_report(tisfm_run, work_folder, outside):
    made(work_folder / "r")
    (work_folder / "r" / "report.html").symlink_to(outside / "nothing")
    code, _, err = tisfm_run("report", "r")
    assert code == 0, err
    assert links_in(work_folder / "r") == []


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
def test_export(tisfm_run, work_folder, outside, form, is_refused):
    """All files of a first export are replaced by links before the second."""
    made(work_folder / "r", count=6)
    code, _, err = tisfm_run("export", "r", "--to", form, "-o", "o")
    assert code == 0, err
    written = sorted(path.relative_to(work_folder / "o") for path in (work_folder / "o").rglob("*"))
    (work_folder / "real").mkdir()
    (work_folder / "o2").symlink_to(work_folder / "real")  # the folder itself may be a link
    for path in written:
        if len(path.parts) == 1:
            to = outside if (work_folder / "o" / path).is_dir() else outside / "note"
            (work_folder / "real" / path).symlink_to(to)
    code, _, err = tisfm_run("export", "r", "--to", form, "-o", "o2")
    assert code == is_refused and ("has other files" in err) == is_refused, err
    if not is_refused:
        assert links_in(work_folder / "real") == []
        assert (
            sorted(p.relative_to(work_folder / "real") for p in (work_folder / "real").rglob("*"))
            == written
        )


@pytest.mark.parametrize("images", ["link", "copy"])
def test_a_picture_that_is_a_link_is_exported_as_a_file(work_folder, outside, images):
    result = made(work_folder / "r", count=2)
    picture = work_folder / "r" / "frames" / "000000.jpg"
    whole = picture.read_bytes()
    picture.rename(work_folder / "elsewhere.jpg")
    picture.symlink_to(work_folder / "elsewhere.jpg")
    write_pictures(result, [0, 1], work_folder / "o", images)
    assert (
        links_in(work_folder / "o") == []
        and (work_folder / "o" / "000000.jpg").read_bytes() == whole
    )
    assert (work_folder / "elsewhere.jpg").stat().st_nlink == 1


def test_an_export_that_is_renewed(tisfm_run, work_folder, outside):
    made(work_folder / "r", count=6)
    call = ("export", "r", "--to", "nerfstudio", "-o", "o")
    assert tisfm_run(*call)[0] == 0
    (folder,) = {path.parent for path in (work_folder / "o").rglob("transforms.json")}
    (folder / "sparse").symlink_to(outside)
    (folder / ".tisfm-new").symlink_to(outside)
    (folder / ".tisfm-earlier").symlink_to(outside)
    (folder / "transforms.json").unlink()
    (folder / "transforms.json").symlink_to(outside / "note")
    code, _, err = tisfm_run(*call)
    assert code == 0, err
    assert links_in(folder) == [] and (folder / "transforms.json").is_file()


def test_eval(tisfm_run, work_folder, outside, benchmark_folder):
    (work_folder / "out").mkdir()
    (work_folder / "out" / "flows").symlink_to(outside)
    (work_folder / "out" / "eval.json").symlink_to(outside / "nothing")
    code, _, err = tisfm_run("eval", benchmark_folder, "-o", "out", "--preset", "fast")
    assert code == 0, err
    assert links_in(work_folder / "out") == [] and list((work_folder / "out").rglob("*_flow.flo"))


def test_run(tisfm_run, work_folder, outside):
    (work_folder / "frames").mkdir()
    for k in range(2):
        write_png(work_folder / "frames" / f"f{k}.png", FRAMES[k])
    (work_folder / "real").mkdir()
    (work_folder / "out").symlink_to(work_folder / "real")
    endings = ("_depth.png", "_depth16.png", "_flow.flo", "_anaglyph.png", "_pose.txt", ".npz",
               ".ply")  # fmt: skip
    names = [*(f"f0{ending}" for ending in endings), "run.csv", "timings.csv", "report.html"]
    for name in names:
        (work_folder / "real" / name).symlink_to(outside / ("note" if "_" in name else "nothing"))
    (work_folder / "real" / ".tisfm.lock").symlink_to(outside / "note")
    call = ["run", "frames", "-o", "out", "--motion", "camera", "--preset", "fast", "--focal", "50"]
    code, _, err = tisfm_run(*call, "--flo", "--ply", "--report", "--no-figures")
    assert code == 0, err
    assert links_in(work_folder / "real") == []
    assert {path.name for path in (work_folder / "real").iterdir()} == {*names, "run.json"}


@pytest.mark.parametrize("more", [[], ["--chunk", "100"]])
def test_reconstruct_that_fails_leaves_the_earlier_result(tisfm_run, work_folder, outside, more):
    """The folder has links in place of the folders that runs make."""
    made(work_folder / "r", count=3)
    for name in ("cache", ".tisfm-chunks"):
        (work_folder / "r" / name).symlink_to(outside)
    before = {p: p.read_bytes() for p in (work_folder / "r").rglob("*") if p.is_file()}
    (work_folder / "frames").mkdir()
    for k in range(3):
        write_png(work_folder / "frames" / f"f{k}.png", FRAMES[k][: 20 + (k == 2)])  # of two sizes
    code, _, err = tisfm_run(
        "reconstruct", "frames", "-o", "r", "--preset", "fast", "--focal", "50", *more
    )
    assert code == 1 and err.startswith("tisfm: "), err
    assert {p: p.read_bytes() for p in before} == before
    assert not (work_folder / "r" / "reconstruction.begun").exists()
