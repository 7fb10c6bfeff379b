"""Each control, set, changes what is shown, by its own listener."""

import numpy as np
import pytest

from tests.draws import nightly_except
from tests.view.pages import change, wait_for, wait_until_drawn
from tests.view.results import write_reconstruction, write_record_of, write_run
from tisfm.view.viewpoint import are_visible

pytest.importorskip("viser", reason="viser is not installed: pip install 'tisfm[view]'")


def count(page):
    return len(page.points)


def legend(page):
    return page.controls.legend.content


def kind_of_points(page):
    return type(page.scene._nodes["points"]).__name__


def size_of_points(page):
    return page.scene._nodes["points"].point_size


def sees_points(page):
    return page.scene._nodes["points"].visible


def nodes(page):
    return set(page.scene._nodes)


def frusta(page):
    return len(page.scene.frusta)


def pictures(page):
    return [handle.image is None for handle in page.scene.frusta.values()]


def sees_camera(page):
    return page.scene._nodes["here"].visible


def note(page):
    return page.controls.fused_note.content


def distance(page):
    return page.controls.distance.content


def status(page):
    return page.controls.status.content


RUN_CONTROLS = (  # name, value, and the output that it changes
    ("size", 3.0, size_of_points),
    ("max_thousands", 1, count),
    ("with_hidden_points", False, count),
    ("measure", True, distance),
)
RUN_CONTROLS_OF_THE_PAGE = (  # test_page.py sets these as well
    ("color", "confidence", legend),
    ("shape", "surface", kind_of_points),
    ("min_confidence", 0.5, count),
    ("max_deviation", 1.0, count),
    ("box", True, nodes),
    ("frame", 1, status),
)
RECONSTRUCTION_CONTROLS = (
    ("path", False, nodes),
    ("pictures", False, pictures),
    ("objects", False, nodes),
)
RECONSTRUCTION_CONTROLS_OF_THE_PAGE = (
    ("follow", True, sees_camera),
    ("with_frame", False, sees_points),
    ("frusta", False, frusta),
    ("fused", "points", note),
)


def assert_controls_work(page, controls):
    """Set each control, check that the page changes, and set it back."""
    wait_until_drawn(page)
    for name, value, shown in controls:
        before, old = shown(page), getattr(page.controls, name).value
        change(page, name, value)
        wait_until_drawn(page)
        assert shown(page) != before, name
        change(page, name, old)
        wait_until_drawn(page)


@pytest.mark.parametrize(
    "controls", nightly_except(RUN_CONTROLS, of=(RUN_CONTROLS, RUN_CONTROLS_OF_THE_PAGE))
)
def test_controls_of_a_run(opened, tmp_path, controls):
    write_run(tmp_path / "r", 2)
    assert_controls_work(opened(tmp_path / "r"), controls)


@pytest.mark.parametrize(
    "controls",
    nightly_except(
        RECONSTRUCTION_CONTROLS, of=(RECONSTRUCTION_CONTROLS, RECONSTRUCTION_CONTROLS_OF_THE_PAGE)
    ),
)
def test_controls_of_a_reconstruction(opened, tmp_path, controls):
    write_reconstruction(tmp_path / "r", 3, things=True)
    assert_controls_work(opened(tmp_path / "r"), controls)


def test_play_is_a_button_that_becomes_pause(opened, tmp_path):
    write_run(tmp_path / "r", 2)
    page = opened(tmp_path / "r")
    change(page, "play", True)
    assert page.controls.play.label == "Pause"
    wait_for(lambda: page.number == 1)
    change(page, "play", True)
    assert page.controls.play.label == "Play"


@pytest.mark.parametrize("k", [0, 1])
def test_the_pictures_are_chosen(opened, tmp_path, k):
    write_run(tmp_path / "r", 1)
    page = opened(tmp_path / "r")
    wait_until_drawn(page)
    before = np.array(page.controls.images[k].image)
    page.controls.kinds[k].value = "confidence"
    wait_for(lambda: (page.controls.images[k].image != before).any())
    assert page.controls.images[k].label == "blue 0, yellow 1"


@pytest.mark.parametrize("name", ["box_low", "box_high"])
def test_the_ends_of_the_box(opened, tmp_path, name):
    write_run(tmp_path / "r", 1)
    page = opened(tmp_path / "r")
    change(page, "box", True)
    wait_for(lambda: "box" in nodes(page))
    wait_until_drawn(page)
    before = count(page)
    middle = (np.array(page.controls.box_low.value) + page.controls.box_high.value) / 2
    change(page, name, tuple(middle))
    wait_for(lambda: count(page) < before)


def test_clear_removes_measurements(opened, tmp_path):
    write_run(tmp_path / "r", 1)
    page = opened(tmp_path / "r")
    page.marks.measured_points = [np.zeros(3)]
    change(page, "clear", True)
    wait_for(lambda: not page.marks.measured_points)


def test_the_speed_holds_from_now_on(opened, tmp_path):
    write_run(tmp_path / "r", 2)
    page = opened(tmp_path / "r")
    change(page, "play", True)
    since = page.playback._start
    change(page, "speed", 20)
    assert page.playback._start[0] > since[0]


def test_one_frame_cannot_be_played(opened, tmp_path):
    shot = write_run(tmp_path / "r", 2)
    write_record_of(tmp_path / "r", shot, [0], "camera")
    page = opened(tmp_path / "r")
    assert page.controls.frame.disabled and page.controls.play.disabled
    write_record_of(tmp_path / "r", shot, [0, 1], "camera")
    wait_for(lambda: not page.controls.frame.disabled and not page.controls.play.disabled)


def test_the_box_surrounds_the_points_and_has_round_steps(opened, tmp_path):
    write_reconstruction(tmp_path / "r", 2)
    page = opened(tmp_path / "r")
    low, high = (np.array(getattr(page.controls, name).value) for name in ("box_low", "box_high"))
    wait_until_drawn(page)
    inside = ((page.points.positions >= low) & (page.points.positions <= high)).all(axis=1)
    assert 0.1 < inside.mean() < 1
    seen_from, _ = page.scene.overview(page.frame, page.points)
    assert are_visible(np.array([low, high]), seen_from).all()
    # A little larger, it would have handles that are out of sight.
    larger = (low + high) / 2 + 0.55 * np.stack([low - high, high - low])
    assert not are_visible(larger, seen_from).all()
    step = page.controls.box_low.step
    assert step == page.controls.box_high.step == pytest.approx(page.scene.depth / 50, rel=0.5)
    assert float(f"{step:.0e}") == step
