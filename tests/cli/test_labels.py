"""`tisfm reconstruct --labels`: things that move, whose labels are given."""

import json
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest

import tisfm
from tests.cli.command_line import assert_one_line
from tests.rendered import bodies_film
from tisfm.formats import write_png
from tisfm.formats.label_picture import read_label_picture, write_label_png
from tisfm.scenes import bodies_path

COUNT = 6
OPTIONS = ("--preset", "fast", "--depth-of", "none", "--focal", "96", "--motion", "objects")


@cache
def film():
    return bodies_film(bodies_path(COUNT), 120, 160)


@pytest.fixture
def clip(work_folder):
    """Folders `film` of frames and `things` of their labels, for which tests run."""
    for name in ("film", "things"):
        (work_folder / name).mkdir()
    for k, (frame, labels) in enumerate(zip(film().frames, film().labels, strict=True)):
        cv2.imwrite(f"film/f{k}.png", frame)
        write_label_png(f"things/f{k}.png", labels)


def masks(folder):
    return np.stack([read_label_picture(path) for path in sorted(Path(folder, "masks").iterdir())])


@pytest.mark.parametrize("option", ["--labels", "--mask"])
def test_labels_of_every_frame(tisfm_run, clip, option):
    code, _, err = tisfm_run("reconstruct", "film", "-o", "out", *OPTIONS, option, "things")
    assert code == 0 and "object 3: labelled in 6 frames" in err
    np.testing.assert_array_equal(masks("out"), film().labels)
    assert [t["id"] for t in json.loads(Path("out/objects.json").read_text())["objects"]] == [
        1,
        2,
        3,
    ]
    assert len(tisfm.Reconstruction.load("out").objects) == 3


def test_labels_of_the_first_frame_and_of_a_result(tisfm_run, clip):
    first = ("--labels", "things/f0.png")
    assert tisfm_run("reconstruct", "film", "-o", "out", *OPTIONS, *first)[0] == 0
    found = masks("out")
    np.testing.assert_array_equal(found[0], film().labels[0])
    assert all(set(np.unique(one)) == {0, 1, 2, 3} for one in found)
    again = ("--labels", "out/masks")
    assert tisfm_run("reconstruct", "film", "-o", "again", *OPTIONS, *again)[0] == 0
    np.testing.assert_array_equal(masks("again"), found)


def test_wrong_labels_are_refused(tisfm_run, clip):
    def refused(*options, words):
        code, _, err = tisfm_run("reconstruct", "film", "-o", "out", *OPTIONS, *options)
        assert_one_line(code, err, words)

    refused("--labels", "gone", words="there is no picture or folder of labels gone")
    refused("--labels", "things", "--motion", "camera", words='expected motion="objects"')
    write_png("things/f0.png", np.dstack([film().labels[0], *film().labels[1:3]]))
    refused("--labels", "things", words="picture of mode RGB: expected labels")
    write_png("things/f0.png", film().labels[0][1:])
    refused("--labels", "things", words="(119, 160), but the size of frame f0 is (120, 160)")


@pytest.mark.nightly
def test_the_size_of_an_object_gives_its_scale(tisfm_run, work_folder):
    longer = bodies_film(bodies_path(12), 180, 240)
    for name in ("film", "things"):
        (work_folder / name).mkdir()
    for k, (frame, labels) in enumerate(zip(longer.frames, longer.labels, strict=True)):
        cv2.imwrite(f"film/f{k:02d}.png", frame)
        write_label_png(f"things/f{k:02d}.png", labels)
    focal = ("--focal", str(longer.camera.focal))
    options = (*OPTIONS, *focal, "--labels", "things", "--object-sizes", "1=0.6", "3=0.41")
    assert tisfm_run("reconstruct", "film", "-o", "out", *options)[0] == 0
    found = {thing.id: thing for thing in tisfm.Reconstruction.load("out").objects}
    assert found[1].scale_from == "size"
    assert found[2].scale_from == "none"  # neither a size nor depth is known
    # It hardly turns in so few frames: rounding decides whether it has points.
    assert found[3].scale_from in ("size", "none")


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (("1",), "--object-sizes has '1': expected ID=LENGTH, such as 3=4.5"),
        (("a=1",), "--object-sizes has 'a=1'"),
        (("1=-1",), "object_sizes[1] is -1.0: expected a positive length"),
        (("7=1",), "without an object: 7; the ids of moving objects are: 1, 2, 3"),
        (("1=1", "--scale", "0", "5", "1"), "--scale changes the unit"),
        (("1=1", "--motion", "camera"), 'expected motion="objects"'),
    ],
)
def test_wrong_object_sizes_are_refused(tisfm_run, clip, more, words):
    options = (*OPTIONS, *(() if "camera" in more else ("--labels", "things")))
    code, _, err = tisfm_run("reconstruct", "film", "-o", "out", *options, "--object-sizes", *more)
    assert_one_line(code, err, words)
