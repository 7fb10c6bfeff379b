"""What is saved, for a browser that only says what it would draw."""

import io
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

from tests.view.pages import wait_until_drawn
from tests.view.results import write_reconstruction, write_run
from tisfm.results.opening import open_result

pytest.importorskip("viser", reason="viser is not installed: pip install 'tisfm[view]'")

from tisfm.view.colors import Ranges
from tisfm.view.downloads import notify, save_film, save_screenshot
from tisfm.view.frame_cloud import PointFilter
from tisfm.view.static_page import static_page


class Browser:
    """Draws noise, and notes what it is given."""

    client_id = 7

    def __init__(self):
        self.camera = SimpleNamespace(image_height=20, image_width=30)
        self.files, self.notes, self.formats = {}, [], []

    def get_render(self, height, width, *, transport_format, **_):
        self.formats.append(transport_format)
        picture = np.random.default_rng(0).integers(0, 255, (height, width, 4), np.uint8)
        picture[..., 3] = 255
        picture[0, 0] = 0
        return picture if transport_format == "png" else picture[..., :3]

    def send_file_download(self, name, content, **_):
        self.files[name] = content

    def add_notification(self, title, text):
        self.notes.append((title, text))


@pytest.fixture
def browser(monkeypatch):
    monkeypatch.setattr("viser.ViserServer.get_clients", lambda _: {7: None})
    return Browser()


@pytest.fixture
def page(opened, tmp_path):
    write_reconstruction(tmp_path / "r")
    found = opened(tmp_path / "r")
    wait_until_drawn(found)
    found.stop()  # this thread draws now
    return found


def test_a_screenshot_is_exact(page, browser):
    save_screenshot(page, browser)
    with Image.open(io.BytesIO(browser.files["f0.png"])) as shot:
        assert shot.format == "PNG" and shot.mode == "RGB"
        saved = np.asarray(shot)
    expected = browser.get_render(20, 30, transport_format="png")[..., :3]
    expected[0, 0] = 255  # nothing is there
    np.testing.assert_array_equal(saved, expected)


def test_a_video_leaves_out_unreadable_frames_and_states_them(page, browser, tmp_path, monkeypatch):
    av = pytest.importorskip("av", reason="PyAV is not installed: pip install 'tisfm[video]'")
    monkeypatch.setattr("tisfm.view.downloads.FILM_SIZE", (64, 96))
    (tmp_path / "r" / "frames" / "000002.jpg").unlink()
    page.cache.clear()
    save_film(page, browser)
    with av.open(io.BytesIO(browser.files["fly-through.mp4"])) as film:
        assert len(list(film.decode(video=0))) == 4
    ((title, text),) = browser.notes
    assert title == "The film is not complete" and "1 frame cannot be read: f2:" in text
    for path in (tmp_path / "r" / "frames").iterdir():
        path.unlink()
    page.cache.clear()
    with pytest.raises(ValueError, match="no frame can be read: f0:"):
        save_film(page, browser)


def test_a_closed_browser_gets_no_message(page, browser, monkeypatch):
    notify(page, browser, "a", "b")
    assert browser.notes == [("a", "b")]
    monkeypatch.setattr("viser.ViserServer.get_clients", lambda _: {})
    notify(page, browser, "c", "d")
    assert browser.notes == [("a", "b")]


@pytest.mark.parametrize(
    ("quantity", "words"),
    [("depth", "depth Z, harmonic mean"), ("confidence", "confidence</div>"), ("image", "")],
)
def test_a_static_page_has_a_legend(tmp_path, quantity, words):
    write_run(tmp_path / "r", 1)
    made = static_page(
        open_result(tmp_path / "r"),
        quantity=quantity,
        ranges=Ranges(inverse_depth=1.0, flow=1.0),
        points=PointFilter(max_points=100),
        max_frames=1,
        frames_per_second=5,
    )
    assert ("linear-gradient(to right,#" in made.text) == (quantity != "image")
    assert words in made.text
