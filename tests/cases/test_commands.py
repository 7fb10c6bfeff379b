"""Commands: their notes on a source, and errors before their work."""

import pytest

from tests.cases.inputs import sliding, write_folder
from tests.cli.conftest import tisfm_run, work_folder  # noqa: F401

FRAMES = sliding()


def test_names_are_printed_as_they_are(tisfm_run, work_folder):  # noqa: F811
    """Rich would print an emoji for :v: and :smile:."""
    write_folder(work_folder / "a", FRAMES[:2], ["take:v:1.png", "take:v:2.png"])
    (work_folder / "a" / "clip:smile:.heic").write_bytes(b"no matter")
    code, _, err = tisfm_run("run", "a", "-o", "out", "--preset", "fast", "--outputs", "npz")
    assert code == 0
    first = err.splitlines()[0]
    assert first.startswith("note: ") and "(clip:smile:.heic)" in first


@pytest.mark.parametrize(
    ("scale", "why"), [("0 99 1", "the sequence has 6 frames"), ("0 0 1", "two frames")], ids=str
)
def test_scale_of_missing_frames_is_refused(tisfm_run, work_folder, scale, why):  # noqa: F811
    write_folder(work_folder / "a", FRAMES)
    code, out, err = tisfm_run("reconstruct", "a", "-o", "out", "--scale", *scale.split())
    assert (code, out) == (1, "") and why in err and err.count("\n") == 1
    assert not (work_folder / "out").exists()


@pytest.mark.parametrize("command", ["run", "reconstruct"])
@pytest.mark.parametrize(
    ("source", "advice"),
    [
        ("a/f%03d.png", "'a/f*.png'"),
        ("rtsp://camera/1", "ffmpeg -i rtsp"),
        ("above", "give above/rgb"),
    ],
)
def test_errors_name_the_correct_arguments(tisfm_run, work_folder, command, source, advice):  # noqa: F811
    write_folder(work_folder / "a", FRAMES)
    write_folder(work_folder / "above" / "rgb", FRAMES)
    code, out, err = tisfm_run(command, source, "-o", "out")
    assert (code, out) == (1, "") and err.count("\n") == 1
    assert advice in err
    assert not (work_folder / "out").exists()
