"""Results that grow, are replaced, or come to nothing while they are looked at."""

import shutil
import threading

import numpy as np
import pytest

from tests.view.pages import change, wait_for, wait_until_drawn
from tests.view.results import (
    DEVIATION,
    film,
    pair,
    write_reconstruction,
    write_record_of,
    write_run,
)
from tisfm.folders.result_folder import locked_folder
from tisfm.reconstruction.result.folder import write_depth

pytest.importorskip("viser", reason="viser is not installed: pip install 'tisfm[view]'")

from tisfm.view.colors import Ranges, are_different
from tisfm.view.server import start_server, stop_server
from tisfm.view.waiting_page import WaitingPage

LARGER = 100.0


def replace_by_larger(folder, *, things=False):
    """Replace a reconstruction by one whose scene is so many times as large."""
    poses = film().poses.copy()
    poses[:, :3, 3] *= LARGER
    other = folder.with_name("other")
    shot = write_reconstruction(other, changes={"poses": poses}, things=things)
    for k, depth in enumerate(shot.depth):
        inverse = (1 / (LARGER * depth)).astype(np.float32)
        write_depth(other, k, inverse, DEVIATION * inverse)
    shutil.rmtree(folder)
    other.rename(folder)


def test_a_replaced_result_has_its_own_sizes_ranges_and_choices(opened, tmp_path):
    write_reconstruction(tmp_path / "r")
    page = opened(tmp_path / "r", number=2)
    change(page, "color", "depth")
    change(page, "size", 2.5)
    wait_until_drawn(page)
    assert "object" not in page.controls.color.options
    depth, ranges = page.scene.depth, page.ranges
    high = np.array(page.controls.box_high.value)
    replace_by_larger(tmp_path / "r", things=True)
    wait_for(lambda: "object" in page.controls.color.options)
    wait_for(lambda: "3 of 5" in page.controls.status.content)
    wait_until_drawn(page)
    assert page.scene.depth == pytest.approx(LARGER * depth, rel=1e-3)
    assert page.ranges.inverse_depth == pytest.approx(ranges.inverse_depth / LARGER, rel=1e-3)
    np.testing.assert_allclose(page.controls.box_high.value, LARGER * high, rtol=0.05, atol=5)
    assert page.controls.color.value == "depth" and page.controls.size.value == 2.5
    assert f"{1 / page.ranges.inverse_depth:.3g}" in page.controls.legend.content
    start = np.array(page.server.initial_camera.position) - page.scene.pose_of(2)[:3, 3]
    assert np.linalg.norm(start) > 0.1 * page.scene.depth
    change(page, "frame", 4)  # the controls that are there now are listened to
    wait_for(lambda: "5 of 5" in page.controls.status.content)
    change(page, "color", "object")
    wait_for(lambda: "object 2" in page.controls.legend.content)


def test_a_replaced_result_of_the_same_kind_keeps_its_controls(opened, tmp_path):
    write_reconstruction(tmp_path / "r")
    page = opened(tmp_path / "r")
    change(page, "box", True)
    wait_until_drawn(page)
    controls, depth = page.controls, page.scene.depth
    change(page, "box_high", (1.0, 2.0, 3.0))
    replace_by_larger(tmp_path / "r")
    wait_for(lambda: page.scene.depth > 2 * depth)
    wait_until_drawn(page)
    assert page.controls is controls
    assert controls.box.value and controls.box_high.value == (1.0, 2.0, 3.0)  # as it was set
    assert len(page.scene.frusta) > 1 and len(page.box._handles) == 2


@pytest.mark.nightly
def test_ranges_follow_a_run_that_grows(opened, tmp_path):
    shot = write_run(tmp_path / "r", 6)
    for k in range(1, 6):  # the first pair moves little
        result = pair(shot, k, "camera")
        result.flow[:] *= 10
        result.save(tmp_path / "r" / f"f{k}.npz", compact=True)
    write_record_of(tmp_path / "r", shot, [0], "camera")
    page = opened(tmp_path / "r")
    wait_until_drawn(page)
    before = page.ranges.flow
    write_record_of(tmp_path / "r", shot, range(6), "camera")
    wait_for(lambda: page.ranges.flow > 5 * before)


def test_ranges_that_differ_little_are_kept():
    one = Ranges(inverse_depth=1.0, flow=4.0)
    assert not are_different(one, Ranges(inverse_depth=1.2, flow=3.5), 1.25)
    assert are_different(one, Ranges(inverse_depth=0.7, flow=4.0), 1.25)
    assert are_different(one, Ranges(inverse_depth=1.0, flow=40.0), 1.25)


def test_a_page_states_that_the_run_has_ended(tmp_path):
    folder = tmp_path / "r"
    folder.mkdir()
    (folder / "reconstruction.begun").touch()
    server = start_server("127.0.0.1", 0)
    waiting, raised = WaitingPage(server, folder), []

    def wait():
        try:
            waiting.wait()
        except FileNotFoundError as error:
            raised.append(str(error))

    try:
        with locked_folder(folder):
            thread = threading.Thread(target=wait, daemon=True)
            thread.start()
            wait_for(lambda: "as soon as there is one" in waiting._text.content)
        wait_for(lambda: raised)
        assert "no command writes to it" in raised[0]
        assert "no command writes to it" in waiting._text.content
        assert "as soon as there is one" not in waiting._text.content
    finally:
        stop_server(server)
