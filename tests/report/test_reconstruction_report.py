"""The report of a reconstruction."""

import base64
import io

import numpy as np
import pytest
from PIL import Image

from tests.draws import nightly_except
from tests.report.made import EVIL, Read, assert_self_contained, reconstruction
from tisfm.report import REPORT, is_report, write_reconstruction_report
from tisfm.status import Status


def written(result, folder, **options):
    path = write_reconstruction_report(result, folder, **options)
    assert path == folder / REPORT and is_report(path)
    page = Read(path)
    assert_self_contained(page)
    return page


def test_the_report_tells_the_status_of_frames(tmp_path):
    result = reconstruction(tmp_path / "r", pieces=[0, 0, 0, -1, 1, 1], skipped=[(6, "cut off")])
    page = written(result, tmp_path)
    for words in (
        "5 of 6",  # with a pose
        "2 (3, 2 frames)",
        "no_texture",
        "it shows too little: film on",
        "piece 0, 3 frames, from above",
        "piece 1, 2 frames, from the side",
        "unit of the path, and each piece has its own unit.",
        "cut off",
        "Settings of the preset fast",
    ):
        assert words in page.text, words
    assert len(page.all("div", _class="slide")) == 6
    slider = page.all("input", type="range")[0]
    assert (slider["min"], slider["max"]) == ("0", "5")
    # Frames without a pose have no depth; the last one of a piece has no motion to the next.
    assert page.text.count("none here") == 3 + 1 + 1
    assert {one["style"] for one in page.all("div", _class="none")} == {"aspect-ratio:44/30"}
    assert sum("hidden" in slide for slide in page.all("div", _class="slide")) == 5


def test_a_report_without_poses(tmp_path):
    page = written(reconstruction(tmp_path / "r", pieces=[-1, -1]), tmp_path)
    assert "0 of 2" in page.text and not page.all("svg")
    # Neither empty pictures nor their legends are shown.
    assert "none here" not in page.text and not page.all("p", _class="legend")
    assert len(page.all("figure")) == 2


def test_names_and_messages_are_escaped(tmp_path):
    result = reconstruction(
        tmp_path / "r",
        pieces=[0, -1],
        names=[EVIL, "b"],
        statuses=[Status("converged"), Status("no_texture", EVIL)],
        skipped=[(2, EVIL)],
    )
    page = written(result, tmp_path, source=EVIL)
    assert page.text.count("<script>alert(1)</script>") >= 4
    assert all("alert" not in script for script in page.scripts)


def test_a_second_report_is_the_same(tmp_path):
    result = reconstruction(tmp_path / "r", pieces=[0] * 5)
    first = write_reconstruction_report(result, tmp_path).read_bytes()
    assert write_reconstruction_report(result, tmp_path).read_bytes() == first


@pytest.mark.parametrize("shape", nightly_except((75, 100), of=[(75, 100), (300, 400)]))
def test_long_sequences_and_large_frames_stay_small(tmp_path, shape):
    """Noise is what takes most bytes."""
    statuses = [Status("converged")] * 90
    statuses[77] = Status("uncertain", "give it more parallax")
    result = reconstruction(tmp_path / "r", pieces=[0] * 90, shape=shape, statuses=statuses)
    path = write_reconstruction_report(result, tmp_path)
    assert path.stat().st_size < 20_000_000
    page = Read(path)
    slides = page.all("div", _class="slide")
    assert 40 < len(slides) <= 48 and f"{len(slides)} of 90 frames" in page.text
    assert "number 77 poor uncertain" in page.text  # the one that is not like the others


def test_embedded_images_stay_within_their_budget():
    from tisfm.report.pictures import Pictures

    noise = np.random.default_rng(0).integers(0, 256, (700, 900, 3), np.uint8)
    for budget in (400_000, 20_000, 4_000):
        url = Pictures(2, max_total_bytes=budget).url(noise)
        data = base64.b64decode(url.partition(",")[2])
        assert len(data) <= budget // 2
        with Image.open(io.BytesIO(data)) as image:
            assert max(image.size) <= 560 and image.format == "JPEG"


def test_files_of_others_are_not_replaced(tmp_path):
    (tmp_path / REPORT).write_text("mine")
    with pytest.raises(ValueError, match="not a report of tisfm"):
        write_reconstruction_report(reconstruction(tmp_path / "r", pieces=[0]), tmp_path)
    assert (tmp_path / REPORT).read_text() == "mine"
