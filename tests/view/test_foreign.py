"""Folders from elsewhere: no page runs their texts as script."""

import json
from dataclasses import replace
from urllib.parse import urlsplit

import pytest

from tests.draws import nightly_except
from tests.view.browser import tab_of
from tests.view.results import thing, write_reconstruction
from tests.waiting import wait_for
from tisfm.formats import FormatError
from tisfm.reconstruction.result.calibration import GIVEN
from tisfm.reconstruction.result.reconstruction import Reconstruction
from tisfm.report import write_reconstruction_report
from tisfm.status import Status

pytest.importorskip("viser", reason="viser is not installed: pip install 'tisfm[view]'")

from tisfm.results.opening import open_result
from tisfm.view.colors import ranges_of, sample_frames
from tisfm.view.frame_cloud import PointFilter
from tisfm.view.static_page import static_page

# Each sets a mark if a browser runs it.
EVIL = (
    '"\'></title></style></script><img src=x onerror="window.hacked=1">'
    "<svg onload=window.hacked=2><script>window.hacked=3</script>"
    "[a](javascript:window.hacked=4) ${window.hacked=5} \ud800"
)


def evil_folder(folder):
    """Write a reconstruction with an attack in every text; the third of four frames is missing."""
    count = 4
    one = replace(thing(count), message=EVIL)
    status = (Status("brand_new", EVIL), *(Status("converged", EVIL),) * (count - 1))
    changes = {
        "status": status,
        "names": tuple(f"{EVIL}{k}" for k in range(count)),
        "skipped": ((1, EVIL),),
        "version": EVIL,
        "objects": (one,),
        "notes": (EVIL,),
        "calibration": replace(GIVEN, origin="guessed", seen=False, message=EVIL),
    }
    write_reconstruction(folder, count, things=True, changes=changes)
    (folder / "frames" / "000002.jpg").unlink()
    return folder


@pytest.fixture
def tab(browser):
    """Return a tab that fails the test if a page opens a dialog."""
    tab = tab_of(browser, viewport={"width": 400, "height": 300})  # software draws few pixels fast
    tab.on("dialog", lambda dialog: pytest.fail(f"a script said {dialog.message}"))
    yield tab
    tab.context.close()


def hacked(tab):
    tab.wait_for_timeout(100)  # time to look for a picture that does not exist
    return tab.evaluate("window.hacked")


def test_a_status_with_markup_is_refused(opened, tmp_path):
    write_reconstruction(tmp_path / "r")
    path = tmp_path / "r" / "reconstruction.json"
    about = json.loads(path.read_text())
    about["status"][0][0] = "<img src=x onerror=window.hacked=1>"
    path.write_text(json.dumps(about))
    with pytest.raises(FormatError, match=r"status is '<img.*small letters"):
        opened(tmp_path / "r")


def test_the_page_runs_no_script_of_a_folder(opened, tab, tmp_path):
    page = opened(evil_folder(tmp_path / "<img src=x onerror=window.hacked=6>"))
    shown, asked = tab.get_by_test_id("status"), []
    tab.on("request", lambda request: asked.append(request.url))
    tab.goto(page.url)
    shown.wait_for()
    text = shown.inner_text()
    assert "<img src=x" in text and "brand_new" in text and "treat it as doubtful" in text
    page.controls.frame.value = 2
    wait_for(lambda: "is not complete" in page.controls.status.content)
    tab.wait_for_function("document.body.innerText.includes('is not complete')")
    assert "3 of 4" in shown.inner_text()
    assert hacked(tab) is None
    hosts = {urlsplit(url).hostname for url in asked if url.startswith(("http", "ws"))}
    assert hosts == {"127.0.0.1"}


@pytest.mark.parametrize("kind", nightly_except("report", of=("static", "report")))
def test_no_exported_page_runs_script_of_a_folder(tab, tmp_path, kind):
    folder = evil_folder(tmp_path / "<img src=x onerror=window.hacked=6>")
    if kind == "static":
        result = open_result(folder)
        from tisfm.results.result_frames import FrameCache

        made = static_page(
            result,
            quantity="image",
            ranges=ranges_of(sample_frames(FrameCache(result), 1)),
            points=PointFilter(max_points=50),
            max_frames=4,
            frames_per_second=8,
        )
        path = tmp_path / "view.html"
        path.write_text(made.text, encoding="utf-8")
    else:
        write_reconstruction(tmp_path / "whole", 4)  # its pictures are all there
        whole = Reconstruction.load(folder)
        result = replace(whole, folder=tmp_path / "whole", objects=())
        path = write_reconstruction_report(result, tmp_path, source=EVIL)
    tab.goto(path.as_uri())
    assert "<img src=x" in tab.inner_text("body")
    assert hacked(tab) is None
