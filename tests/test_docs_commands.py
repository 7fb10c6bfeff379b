"""The commands of README and docs run, on small frames under the names that they use."""

import os
import shutil

import cv2
import numpy as np
import pytest

from tests.datasets.made import make_kitti, make_middlebury, make_sintel
from tests.draws import nightly_except
from tests.test_docs import PAGES, commands, name_of
from tisfm.cli.command_line import main
from tisfm.formats import write_png

# Parts of commands that this test does not run, with the reasons. Some page has each of them.
REASONS = {
    ("webcam:0",): "there is no camera",
    ("--cluster",): "there is no cluster; tests/cli has one of this machine",
    ("view", "walk"): "it serves until Ctrl-C; tests/view has a browser",
    ("view", "results"): "the same",
    ("demo",): "tests/cli runs it",
    ("--start",): "it takes frames of a long video",
    ("--scale",): "the same",
    ("7-Scenes/chess",): "a data set; tests/evaluation has the layout",
    ("rgbd_freiburg1_rpy",): "the same",
    ("DAVIS/camel",): "the same",
    ("--arch",): "there may be no GPU",
    ("--workers",): "tests/cli has several processes, which take long to start",
    ("doctor",): "tests/cli runs it in processes of their own, which take long to start",
    ("batch",): "the same",
    ("depth-exr,chan,undistortion",): "its lens has to distort; tests/exports has one that does",
}


def reason_not_to_run(words):
    """Return why a command does not run here, or None."""
    if "--html" in words:
        return None
    return next((why for parts, why in REASONS.items() if set(parts) <= set(words)), None)


def documented_commands():
    """Return every command of tisfm that some page has, once, with the first page that has it."""
    found = {}
    for path in PAGES:
        for words in commands(path):
            if os.path.basename(words[0]) == "tisfm" and words[1] != "--completion":
                found.setdefault(tuple(words[1:]), name_of(path))
    return found


COMMANDS = documented_commands()
RUN = [words for words in COMMANDS if reason_not_to_run(words) is None]
# At least one of each command; tests/cli has every option.
SHORT = [
    tuple(line.split())
    for line in (
        "run frames/*.jpg -o results --step 3",
        "run drive.mp4 -o results --mask bonnet.png",
        "run left.png right.png -o results --motion objects --focal 720",
        "reconstruct frames/ -o walk --preset fast --ply",
        "reconstruct drive.mp4 -o drive --mask bonnet.png",
        "eval MPI-Sintel/ --preset accurate --smoothness 30",
        "export walk --to tum,glb,depth-tiff -o exported",
        "export walk --to video-side-by-side --fps 30 -o videos",
        "export street --to masks -o masks",
        "report results",
        "view walk --html walk.html",
        "figures A.png B.png -o figures --focal 600",
    )
]


def write_video(path, frames):
    height, width = frames[0].shape[:2]
    video = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"mp4v"), 25, (width, height))
    assert video.isOpened()
    for frame in frames:
        video.write(cv2.cvtColor(frame, cv2.COLOR_GRAY2BGR))
    video.release()


def prepare(here, words):
    """Write the further files that a command reads, under the names that it uses."""
    frames = [
        cv2.imread(str(here / "frames" / f"frame{k}.png"), cv2.IMREAD_GRAYSCALE) for k in range(3)
    ]
    for name in ("left.png", "A.png"):
        write_png(here / name, frames[0])
    for name in ("right.png", "B.png"):
        write_png(here / name, frames[1])
    for k in range(8):
        cv2.imwrite(str(here / "frames" / f"{k}.jpg"), frames[k % 3])
    if "frames/*.jpg" not in words:
        for file in (here / "frames").glob("*.jpg"):
            file.unlink()
    write_video(here / "drive.mp4", frames)
    write_png(here / "bonnet.png", np.full(frames[0].shape, 255, np.uint8))
    for name, folder in (("walk.mp4", "calibrated/images"), ("street.mp4", "bodies/frames")):
        if name in words:
            images = sorted((here / folder).iterdir())[: 3 if words[0] == "run" else 6]
            write_video(here / name, [cv2.imread(str(p), cv2.IMREAD_GRAYSCALE) for p in images])
    if "--labels" in words:
        (here / "street" / "masks").mkdir(parents=True)
        for file in (here / "bodies" / "masks").iterdir():
            name = file.name.replace("frame_", "street_")  # after the frames of the video
            shutil.copy(file, here / "street" / "masks" / name)
    else:
        shutil.copytree(here / "bodies", here / "street")
    shutil.copytree(here / "results", here / "pairs")
    if words[0] == "run" and "walk/" in words:  # a folder of frames here
        shutil.rmtree(here / "walk")
        shutil.copytree(here / "calibrated" / "images", here / "walk")
    if "--poses" in words:  # of the frames that the command takes
        source = here / words[1]
        if words[1] == "frames/":
            shutil.rmtree(source)
            shutil.copytree(here / "calibrated" / "images", source)
        shutil.copy(here / "calibrated" / "poses.txt", here / "poses.txt")
    for name, make in (("middlebury/", make_middlebury), ("kitti2015/", make_kitti),
                       ("MPI-Sintel/", make_sintel)):  # fmt: skip
        if name in words:
            make(here / name)
    (here / "videos.csv").write_text("source,output,preset\ndrive.mp4,out/one,fast\n")


@pytest.mark.parametrize("words", nightly_except(*SHORT, of=RUN), ids=" ".join)
def test_documented_command_runs(words, documented_here):
    prepare(documented_here, words)
    if "-o" in words:  # results are new
        shutil.rmtree(documented_here / words[words.index("-o") + 1], ignore_errors=True)
    assert main(list(words)) == 0


def test_short_draw_has_every_command():
    assert set(SHORT) <= set(RUN)
    assert {words[0] for words in SHORT} == {words[0] for words in RUN}


def test_reasons_are_of_documented_commands():
    for parts in REASONS:
        assert any(set(parts) <= set(words) for words in COMMANDS), parts
    assert len(COMMANDS) - len(RUN) < len(RUN)
