"""The page in a real browser: what it shows, a click, the slider, what it saves."""

import io
import re
import time
from urllib.parse import urlsplit

import numpy as np
import pytest
from PIL import Image

from tests.view.browser import tab_of
from tests.view.pages import is_drawn
from tests.view.results import write_reconstruction, write_record_of, write_run
from tests.waiting import PATIENCE

pytest.importorskip("viser", reason="viser is not installed: pip install 'tisfm[view]'")

from tisfm.view.scene import quaternion

SIZE = {"width": 1200, "height": 800}


@pytest.fixture
def look(browser, opened):
    """Open a result in a tab; return the page and the tab."""
    contexts = []

    def looked(folder, **options):
        page = opened(folder, **options)
        tab = tab_of(browser, viewport=SIZE, accept_downloads=True)
        contexts.append(tab.context)
        tab.asked = []
        tab.on("request", lambda request: tab.asked.append(request.url))
        tab.goto(page.url)
        tab.get_by_test_id("status").wait_for()
        tab.locator("canvas").first.wait_for()
        return page, tab

    yield looked
    for context in contexts:
        context.close()


def picture(tab):
    """Return what the tab shows between its panels, (h, w, 3)."""
    shot = np.asarray(Image.open(io.BytesIO(tab.screenshot())).convert("RGB"))
    return shot[200:, 320:860].astype(int)


def wait_until(tab, condition, what):
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end, what
        tab.wait_for_timeout(250)


def wait_until_still(tab):
    """Wait until two pictures, a moment apart, are the same."""
    last = []

    def is_still():
        last.append(picture(tab))
        return len(last) > 1 and (last[-1] == last[-2]).all()

    wait_until(tab, is_still, "it does not come to rest")


def status(tab):
    return tab.get_by_test_id("status").inner_text()


def field_of(tab, label):
    """Return the field beside a label, its last one if it has several."""
    return (
        tab.get_by_text(label, exact=True)
        .locator("xpath=../../..")
        .locator("input:not([type=hidden])")
        .last
    )


def set_number(tab, label, value):
    field = field_of(tab, label)
    field.fill(str(value))
    field.press("Enter")
    field.blur()


@pytest.mark.nightly  # test_foreign.py opens a page
def test_the_scene_is_shown_without_other_hosts(look, tmp_path):
    write_reconstruction(tmp_path / "r")
    _, tab = look(tmp_path / "r")
    # Points fade in on a white ground.
    wait_until(tab, lambda: (picture(tab).min(axis=2) < 225).mean() > 0.2, "there are no points")
    assert "1 of 5" in status(tab) and "converged" in status(tab)
    for label in ("Frame", "Colour", "Largest deviation, %", "Column, row", "Follow the camera"):
        assert tab.get_by_text(label, exact=True).is_visible()
    assert not tab.get_by_text("Least confidence", exact=True).is_visible()  # it has none
    assert tab.locator("img").count() >= 2
    hosts = {urlsplit(url).hostname for url in tab.asked if url.startswith(("http", "ws"))}
    assert hosts == {"127.0.0.1"}


@pytest.mark.nightly
def test_the_slider_goes_to_a_frame(look, tmp_path):
    write_reconstruction(tmp_path / "r")
    page, tab = look(tmp_path / "r")
    before = tab.locator("img").first.get_attribute("src")
    set_number(tab, "Frame", 3)
    wait_until(tab, lambda: "4 of 5" in status(tab), "the frame stays")
    assert page.number == 3
    wait_until(
        tab, lambda: tab.locator("img").first.get_attribute("src") != before, "the picture stays"
    )


@pytest.mark.nightly
def test_playing_moves_the_slider(look, tmp_path):
    write_reconstruction(tmp_path / "r")
    _, tab = look(tmp_path / "r")
    tab.get_by_role("button", name="Play").click()
    tab.get_by_role("button", name="Pause").wait_for()
    seen = set()
    wait_until(tab, lambda: seen.add(status(tab)) or len(seen) >= 3, "it does not play")
    tab.get_by_role("button", name="Pause").click()
    tab.get_by_role("button", name="Play").wait_for()


@pytest.mark.nightly
def test_a_click_reads_the_pixel_that_is_there(look, tmp_path):
    write_run(tmp_path / "r", 2)
    page, tab = look(tmp_path / "r")
    tab.get_by_label("Follow the camera").check()
    (client,) = page.server.get_clients().values()
    place = page.scene.pose_of(page.number)[:3, 3]
    wait_until(
        tab, lambda: np.linalg.norm(client.camera.position - place) < 1e-3, "it does not go there"
    )
    wait_until(tab, lambda: is_drawn(page), "it is not drawn in full")
    wait_until_still(tab)
    box = tab.locator("canvas").first.bounding_box()
    x, y = box["x"] + 0.45 * box["width"], box["y"] + 0.6 * box["height"]
    tab.mouse.click(x, y)
    tab.get_by_test_id("reading").wait_for()
    text = tab.get_by_test_id("reading").inner_text()
    column, row = map(int, re.search(r"column (\d+), row (\d+)", text).groups())
    # From where the camera was, the frame just fits into the window.
    height, width = page.frame.shape
    share = max(height / box["height"], width / box["width"])
    middle = (width - 1) / 2, (height - 1) / 2
    expected = middle[0] - 0.05 * box["width"] * share, middle[1] + 0.1 * box["height"] * share
    assert (column, row) == pytest.approx(expected, abs=1.5)
    reading = page.frame.reading(row, column)
    for shown in (f"{reading.depth:.4g} ±", f"{reading.tau[0]:.4g}", f"{reading.confidence:.3f}"):
        assert shown in text
    for unit in ("1/frame", "rad/frame", "px/frame"):
        assert unit in text


def sees_whole_frame(page, client):
    """Return whether a browser looks from where the camera was, and all of the frame is in it."""
    up = np.tan(client.camera.fov / 2)
    height, width = page.frame.shape
    own = np.array((width, height)) / (2 * page.frame.camera.focal)
    share = np.array((up * client.camera.aspect, up)) / own
    place = page.scene.pose_of(page.number)[:3, 3]
    is_there = np.linalg.norm(client.camera.position - place) < 1e-3
    return is_there and share.min() == pytest.approx(1, abs=0.01)


@pytest.mark.nightly
def test_following_shows_the_whole_frame_in_any_window(look, tmp_path):
    write_reconstruction(tmp_path / "r")
    page, tab = look(tmp_path / "r")
    tab.get_by_label("Follow the camera").check()
    (client,) = page.server.get_clients().values()
    wait_until(tab, lambda: sees_whole_frame(page, client), "it does not follow")
    before = client.camera.aspect
    tab.set_viewport_size({"width": 900, "height": 900})
    wait_until(tab, lambda: client.camera.aspect < 0.6 * before, "the window stays")
    wait_until(tab, lambda: sees_whole_frame(page, client), "sides are cut off")
    late = tab.context.new_page()
    late.goto(page.url)
    wait_until(late, lambda: len(page.server.get_clients()) == 2, "nobody comes")
    newcomer = page.server.get_clients()[max(page.server.get_clients())]
    wait_until_still(late)
    wait_until(late, lambda: sees_whole_frame(page, newcomer), "it does not follow")


@pytest.mark.nightly
def test_a_pixel_that_is_typed_is_read(look, tmp_path):
    write_reconstruction(tmp_path / "r", things=True)
    _, tab = look(tmp_path / "r")
    fields = tab.get_by_text("Column, row", exact=True).locator("xpath=../../..").locator("input")
    for field, value in ((fields.first, 16), (fields.last, 14)):
        field.fill(str(value))
        field.press("Enter")
        field.blur()
    wait_until(
        tab,
        lambda: (
            tab.get_by_test_id("reading").count()
            and "column 16, row 14" in tab.get_by_test_id("reading").inner_text()
        ),
        "the pixel is not read",
    )
    assert "object 2" in tab.get_by_test_id("reading").inner_text()


@pytest.mark.nightly
def test_the_view_goes_to_the_camera(look, tmp_path):
    write_reconstruction(tmp_path / "r")
    page, tab = look(tmp_path / "r")
    set_number(tab, "Frame", 4)
    wait_until(tab, lambda: page.number == 4, "the frame stays")
    (client,) = page.server.get_clients().values()
    expected = page.scene.overview(page.frame, page.points, client.camera.aspect)[0][:3, 3]
    assert np.linalg.norm(client.camera.position - expected) > 0.1
    tab.get_by_role("button", name="Go to the camera").click()
    wait_until(
        tab,
        lambda: np.linalg.norm(client.camera.position - expected) < 0.01,
        "it does not go there",
    )
    seen = page.scene.overview(page.frame, page.points, client.camera.aspect)[0]
    assert abs(client.camera.wxyz @ quaternion(seen)) == pytest.approx(1, abs=0.01)


@pytest.mark.nightly
@pytest.mark.parametrize("size", [(1700, 700), (760, 480), (400, 701)])
def test_the_scene_fits_any_window_until_the_view_is_moved(look, tmp_path, size):
    write_reconstruction(tmp_path / "r")
    page, tab = look(tmp_path / "r")
    wait_until(tab, lambda: page.server.get_clients(), "nobody is there")
    (client,) = page.server.get_clients().values()

    def is_fitted():
        expected, _ = page.scene.overview(page.frame, page.points, client.camera.aspect)
        return np.linalg.norm(client.camera.position - expected[:3, 3]) < 0.15 * page.scene.depth

    wait_until(tab, is_fitted, "it does not begin there")
    before = client.camera.aspect
    tab.set_viewport_size(dict(zip(("width", "height"), size, strict=True)))
    wait_until(tab, lambda: abs(client.camera.aspect - before) > 0.05, "the window stays")
    wait_until(tab, is_fitted, "it is not seen from farther")
    fitted = np.array(client.camera.position)
    box = tab.locator("canvas").first.bounding_box()
    x, y = box["x"] + 0.15 * box["width"], box["y"] + 0.6 * box["height"]
    tab.mouse.move(x, y)
    tab.mouse.down()
    tab.mouse.move(x + 30, y + 20, steps=5)
    tab.mouse.up()
    wait_until(
        tab, lambda: np.linalg.norm(client.camera.position - fitted) > 0.05, "it is not dragged"
    )
    wait_until_still(tab)
    dragged, aspect = np.array(client.camera.position), client.camera.aspect
    tab.set_viewport_size({"width": size[0], "height": size[1] - 100})
    wait_until(tab, lambda: abs(client.camera.aspect - aspect) > 0.01, "the window stays")
    assert client.camera.position == pytest.approx(dragged, abs=0.02)


@pytest.mark.nightly
def test_thresholds_and_colours(look, tmp_path):
    write_run(tmp_path / "r", 1)
    page, tab = look(tmp_path / "r")
    wait_until(tab, lambda: (picture(tab).min(axis=2) < 225).mean() > 0.2, "there are no points")
    set_number(tab, "Least confidence", 0.9)
    wait_until(tab, lambda: len(page.points) < 400, "all points are left")
    set_number(tab, "Least confidence", 0)
    field_of(tab, "Colour").click()
    tab.get_by_role("option", name="confidence").click()
    tab.get_by_text("0.5", exact=True).first.wait_for()  # of the legend
    assert page.controls.color.value == "confidence"
    # Blue at the left and yellow at the right, as confidence grows.
    wait_until(
        tab, lambda: np.ptp(picture(tab)[..., 0] - picture(tab)[..., 2]) > 150, "it is not coloured"
    )


@pytest.mark.nightly
def test_a_growing_run_is_shown(look, tmp_path):
    shot = write_run(tmp_path / "r", 3)
    write_record_of(tmp_path / "r", shot, [0], "camera")
    _, tab = look(tmp_path / "r")
    assert "1 of 1" in status(tab)
    write_record_of(tmp_path / "r", shot, [0, 1, 2], "camera")
    wait_until(tab, lambda: "1 of 3" in status(tab), "it stays as it was")


@pytest.mark.nightly
def test_pictures_videos_and_pages_are_saved(look, browser, tmp_path, monkeypatch):
    monkeypatch.setattr("tisfm.view.downloads.FILM_SIZE", (120, 160))
    write_reconstruction(tmp_path / "r", 3)
    _, tab = look(tmp_path / "r")
    tab.get_by_text("Save", exact=True).click()

    def saved(name):
        with tab.expect_download(timeout=1000 * PATIENCE) as download:
            tab.get_by_role("button", name=name).click()
        path = tmp_path / download.value.suggested_filename
        download.value.save_as(path)
        return path

    with Image.open(saved("Screenshot (PNG)")) as shot:
        assert shot.format == "PNG" and shot.height >= 700
        assert (np.asarray(shot.convert("L")) < 140).mean() > 0.1
    av = pytest.importorskip("av", reason="PyAV is not installed: pip install 'tisfm[video]'")
    with av.open(str(saved("Fly-through (MP4)"))) as film:
        pictures = [frame.to_ndarray(format="gray") for frame in film.decode(video=0)]
    assert len(pictures) == 3 and pictures[0].shape == (120, 160)
    assert all(np.ptp(picture) > 60 for picture in pictures)
    plays_by_itself(browser, saved("Page that plays by itself (HTML)"))


def plays_by_itself(browser, path):
    """Open a page without a network, and see that it moves."""
    context = browser.new_context(viewport=SIZE, offline=True)
    try:
        tab = context.new_page()
        asked = []
        tab.on("request", lambda request: asked.append(request.url))
        tab.goto(path.as_uri())
        wait_until(tab, lambda: (picture(tab).min(axis=2) < 225).mean() > 0.1, "it is empty")
        first = picture(tab)
        wait_until(tab, lambda: (picture(tab) != first).mean() > 0.01, "it does not play")
        assert {urlsplit(url).scheme for url in asked} <= {"file", "blob", "data"}
    finally:
        context.close()
