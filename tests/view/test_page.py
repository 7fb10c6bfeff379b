"""The page without a browser: what it shows, when controls change, and while a run goes on."""

import contextlib
import shutil
import socket
import threading
import time

import numpy as np
import pytest

from tests.view.pages import change, wait_for, wait_until_drawn
from tests.view.results import film, write_reconstruction, write_record_of, write_run
from tests.waiting import PATIENCE
from tisfm.folders.result_folder import locked_folder
from tisfm.point_cloud import PointCloud
from tisfm.results.opening import open_result

pytest.importorskip("viser", reason="viser is not installed: pip install 'tisfm[view]'")

from tisfm.view.colors import Ranges
from tisfm.view.frame_cloud import PointFilter
from tisfm.view.page import ViewerPage
from tisfm.view.scene import ViewerScene
from tisfm.view.server import start_server
from tisfm.view.static_page import static_page
from tisfm.view.waiting_page import WaitingPage


def test_the_server_listens_on_this_computer_alone(opened, tmp_path, capsys):
    write_run(tmp_path / "r", 1)
    page = opened(tmp_path / "r")
    assert page.url.startswith("http://127.0.0.1:")
    port = page.server.get_port()
    with socket.socket() as probe:
        assert probe.connect_ex(("127.0.0.1", port)) == 0
    with contextlib.suppress(OSError):  # a machine may not know itself by name
        other = socket.gethostbyname(socket.gethostname())
        if other != "127.0.0.1":
            with socket.socket() as probe:
                probe.settimeout(5)  # s; a firewall may answer nothing
                assert probe.connect_ex((other, port)) != 0
    assert capsys.readouterr().out == ""
    assert page.server.request_share_url() is None  # no tunnel to the outside


def test_pages_from_elsewhere_are_refused(opened, tmp_path):
    import viser
    from websockets.exceptions import InvalidStatus
    from websockets.sync.client import connect

    write_run(tmp_path / "r", 1)
    address = opened(tmp_path / "r").url.replace("http", "ws")
    options = {
        "subprotocols": [f"viser-v{viser.__version__}"],
        "open_timeout": PATIENCE,
        "proxy": None,  # whatever the environment says
    }
    for origin in ("http://127.0.0.1:8080", "http://localhost:1", "http://[::1]", None):
        with connect(address, origin=origin, max_size=None, **options) as socket:
            assert socket.recv(timeout=PATIENCE)
    for origin in ("http://example.org", "http://127.0.0.1.example.org", "http://1.2.3.4", "null"):
        with pytest.raises(InvalidStatus, match="403"):
            connect(address, origin=origin, **options)


def test_a_wrong_host_is_refused(tmp_path):
    write_run(tmp_path / "r", 1)
    with pytest.raises(OSError, match=r"cannot listen at 192\.0\.2\.1"):
        ViewerPage(open_result(tmp_path / "r"), host="192.0.2.1")
    with pytest.raises(ValueError, match="port is 70000"):
        ViewerPage(open_result(tmp_path / "r"), port=70000)


def test_frames_are_read_when_they_are_looked_at(opened, tmp_path):
    shot = write_run(tmp_path / "r", 1)
    for k in range(1, 200):
        (tmp_path / "r" / f"f{k}.npz").hardlink_to(tmp_path / "r" / "f0.npz")
    write_record_of(tmp_path / "r", film(5), range(4), "camera")
    result = open_result(tmp_path / "r")
    result.names = [f"f{k}" for k in range(200)]
    for name in ("statuses", "times"):
        setattr(result, name, getattr(result, name)[:1] * 200)
    result.poses, result.piece = np.tile(np.eye(4), (200, 1, 1)), np.arange(200)
    read = []
    result.read = lambda number, read_one=result.read: read.append(number) or read_one(number)
    page = ViewerPage(result, port=0)
    try:
        wait_until_drawn(page)
        assert len(set(read)) <= 4
        change(page, "frame", 150)
        wait_for(lambda: page.number == 150)
        assert len(set(read)) <= 5
    finally:
        page.stop()
    assert shot.frames.shape[1:] == page.frame.shape


def test_coarse_first_then_all(opened, tmp_path, monkeypatch):
    monkeypatch.setattr("tisfm.view.page.COARSE_POINTS", 100)
    write_reconstruction(tmp_path / "r")
    page = opened(tmp_path / "r")
    shown = []
    show = page.scene.show_points

    def noted(points, *arguments, **options):
        shown.append(len(points))
        show(points, *arguments, **options)

    monkeypatch.setattr(page.scene, "show_points", noted)
    change(page, "frame", 2)
    wait_for(lambda: page.number == 2 and len(shown) > 1 and shown[-1] > 1000)
    assert any(number < 150 for number in shown)


def test_thresholds_and_colours_change_the_points(opened, tmp_path):
    write_run(tmp_path / "r", 3)
    page = opened(tmp_path / "r")
    wait_until_drawn(page)
    everything = len(page.points)
    change(page, "min_confidence", 0.5)
    wait_for(lambda: len(page.points) < 0.6 * everything)
    change(page, "min_confidence", 0)
    change(page, "max_deviation", 1.0)
    wait_for(lambda: len(page.points) == 0)
    change(page, "max_deviation", 100.0)
    change(page, "color", "deviation")
    wait_for(lambda: "relative deviation" in page.controls.legend.content)
    before = page.points.colors
    change(page, "color", "confidence")
    wait_for(lambda: "confidence" in page.controls.legend.content)
    assert (page.points.colors[:5] != before[:5]).any()
    change(page, "shape", "surface")
    wait_for(lambda: type(page.scene._nodes["points"]).__name__ == "GlbHandle")
    low = tuple(page.points.positions.max(axis=0) + 1)
    change(page, "box_low", low)
    change(page, "box_high", tuple(np.add(low, 1)))
    change(page, "box", True)
    wait_for(lambda: len(page.points) == 0 and "box" in page.scene._nodes)


def test_playback_starts_and_stops(opened, tmp_path):
    write_reconstruction(tmp_path / "r")
    page = opened(tmp_path / "r")
    page.controls.speed.value = 30
    page._toggle_playback()
    seen = set()

    def has_seen_all():
        seen.add(page.number)
        return seen == set(range(5))

    wait_for(has_seen_all)
    assert page.controls.play.label == "Pause"
    page._toggle_playback()
    time.sleep(0.5)
    wait_until_drawn(page)
    number = page.number
    time.sleep(0.3)
    assert page.number == number and page.controls.play.label == "Play"


def test_a_growing_run_grows_in_the_page(opened, tmp_path):
    shot = write_run(tmp_path / "r", 4)
    write_record_of(tmp_path / "r", shot, [1], "camera")
    page = opened(tmp_path / "r")
    assert page.controls.status.content.count("1 of 1") == 1
    write_record_of(tmp_path / "r", shot, range(4), "camera")
    wait_for(lambda: page.controls.frame.max == 3)
    wait_for(lambda: "2 of 4" in page.controls.status.content)  # the frame that was looked at
    assert page.controls.frame.value == 1


@pytest.mark.nightly
def test_a_frame_is_not_drawn_again_when_later_frames_appear(opened, tmp_path):
    shot = write_run(tmp_path / "r", 4, with_poses=True)
    write_record_of(tmp_path / "r", shot, [0, 1], "camera", with_poses=True)
    page = opened(tmp_path / "r")
    wait_until_drawn(page)
    assert len(page.scene.frusta) == 2
    frame = page.frame
    write_record_of(tmp_path / "r", shot, range(4), "camera", with_poses=True)
    wait_for(lambda: "1 of 4" in page.controls.status.content)
    wait_for(lambda: len(page.scene.frusta) == 4)  # the path follows
    assert page.frame is frame


def drawings_of(page, monkeypatch):
    """Note how often points are sent."""
    drawn = []
    show = page.scene.show_points
    monkeypatch.setattr(page.scene, "show_points", lambda *a, **o: drawn.append(1) or show(*a, **o))
    return drawn


def test_earlier_pairs_do_not_change_the_shown_pair(opened, tmp_path, monkeypatch):
    shot = write_run(tmp_path / "r", 4)
    write_record_of(tmp_path / "r", shot, [1, 3], "camera")
    page = opened(tmp_path / "r", number=1)
    wait_until_drawn(page)
    assert page.result.names[page.number] == "f3"
    drawn = drawings_of(page, monkeypatch)
    write_record_of(tmp_path / "r", shot, range(4), "camera")
    wait_for(lambda: "<b>f3</b>, 4 of 4" in page.controls.status.content)
    wait_for(lambda: page.controls.frame.value == 3)
    time.sleep(0.5)  # what would be drawn has had its time
    assert not drawn and page.frame.number == page.number == 3
    change(page, "frame", 1)
    wait_for(lambda: "<b>f1</b>, 2 of 4" in page.controls.status.content)
    assert drawn and page.frame.number == 1


@pytest.mark.nightly
def test_a_frame_moves_where_its_pose_changes(opened, tmp_path):
    shot = write_run(tmp_path / "r", 4, with_poses=True)
    write_record_of(tmp_path / "r", shot, [0, 2, 3], "camera", with_poses=True)
    page = opened(tmp_path / "r", number=2)
    wait_until_drawn(page)
    before = np.array(page.scene._nodes["points"].position)
    write_record_of(tmp_path / "r", shot, range(4), "camera", with_poses=True)
    wait_for(lambda: "4 of 4" in page.controls.status.content)
    expected = page.scene.pose_of(3)[:3, 3]
    wait_for(lambda: np.allclose(page.scene._nodes["points"].position, expected, atol=1e-6))
    assert np.linalg.norm(expected - before) > 0.01
    wait_for(lambda: len(page.scene.frusta) == 4)


def test_an_unreadable_frame_is_stated(opened, tmp_path):
    write_run(tmp_path / "r", 3)
    page = opened(tmp_path / "r")
    wait_until_drawn(page)  # and what it keeps of other frames is read
    (tmp_path / "r" / "f1.npz").write_bytes(b"PK damaged")
    page.cache.clear()
    change(page, "frame", 1)
    wait_for(lambda: "cannot be read" in page.controls.status.content)
    assert page.points is None
    change(page, "frame", 2)
    wait_for(lambda: "<b>f2</b>, 3 of 3" in page.controls.status.content)
    assert "cannot be read" not in page.controls.status.content and page.points is not None


def test_clicks_read_pixels(opened, tmp_path):
    write_reconstruction(tmp_path / "r", things=True)
    page = opened(tmp_path / "r")
    change(page, "frame", 1)
    wait_until_drawn(page)
    assert page.number == 1
    frame, pose = page.frame, film().poses[1]
    ray = frame.rays(np.array([15]), np.array([16]))[0]
    page.thread.put(lambda: page.pick(pose[:3, 3] - 0.001 * pose[:3, 2], pose[:3, :3] @ ray))
    # From the place of the camera the picture in the frustum is the first thing that is hit.
    wait_for(lambda: "column 16, row 15" in page.controls.reading.content)
    assert "object 2" in page.controls.reading.content
    assert page.controls.pixel.value == (16, 15)
    change(page, "follow", True)  # there is no picture in the way
    page.thread.put(
        lambda: page.pick(pose[:3, 3], pose[:3, :3] @ frame.rays(*np.array([[30], [40]]))[0])
    )
    wait_for(lambda: "column 40, row 30" in page.controls.reading.content)
    assert f"{1 / frame.inverse_depth[30, 40]:.4g} ±" in page.controls.reading.content


def test_clicks_do_not_hit_points_that_are_not_seen(opened, tmp_path):
    write_reconstruction(tmp_path / "r")
    page = opened(tmp_path / "r")
    change(page, "follow", True)
    change(page, "with_frame", False)
    wait_until_drawn(page)
    ray = page.frame.rays(np.array([15]), np.array([16]))[0]
    picked = []

    def pick():
        page.marks.pick(np.zeros(3), ray, page.points)
        picked.append(page.marks.pixel)

    page.thread.put(pick)  # only this thread may draw
    wait_for(lambda: picked == [None])
    change(page, "with_frame", True)
    page.thread.put(pick)
    wait_for(lambda: picked == [None, (15, 16)])


def test_a_pixel_outside_the_frame_is_stated(opened, tmp_path):
    write_reconstruction(tmp_path / "r")
    page = opened(tmp_path / "r")
    wait_until_drawn(page)
    page.thread.put(lambda: page.mark(15, 400))
    wait_for(lambda: "column 400, row 15 is outside" in page.controls.reading.content.lower())
    assert "the frame has 45 × 61" in page.controls.reading.content
    page.thread.put(lambda: page.mark(15, 16))
    wait_for(lambda: "column 16, row 15" in page.controls.reading.content)


def test_two_clicks_measure(opened, tmp_path):
    write_reconstruction(tmp_path / "r")
    page = opened(tmp_path / "r")
    wait_until_drawn(page)
    page.controls.measure.value = True
    frame = page.frame
    ends = [np.array([20]), np.array([10])], [np.array([20]), np.array([50])]
    places = []
    for row, column in ends:
        ray = frame.rays(row, column)[0]
        places.append(ray / frame.inverse_depth[row, column])
        page.thread.put(lambda ray=ray: page.pick(np.zeros(3), ray))
    expected = float(np.linalg.norm(places[0] - places[1]))
    wait_for(lambda: f"distance {expected:.4g}" in page.controls.distance.content)
    page.thread.put(page.marks.clear_measured_points)
    wait_for(lambda: "two points" in page.controls.distance.content)
    assert not page.marks.measured_points


def test_paths_of_the_camera_and_of_objects(opened, tmp_path):
    poses, piece = film().poses.copy(), np.array([0, 0, 0, 1, 1], np.int32)
    changes = {"poses": poses, "piece": piece, "unit": (1.0, 1.0)}
    write_reconstruction(tmp_path / "r", things=True, changes=changes)
    page = opened(tmp_path / "r")
    wait_for(lambda: set(page.scene.frusta) == {0, 1, 2})
    assert len(page.scene._nodes["object2"].points) == 2  # of three frames of this piece
    wait_for(lambda: all(handle.image is not None for handle in page.scene.frusta.values()))
    change(page, "frame", 4)
    wait_for(lambda: set(page.scene.frusta) == {3, 4})
    change(page, "frusta", False)
    wait_for(lambda: not page.scene.frusta)


def test_a_static_page_holds_everything(tmp_path):
    write_reconstruction(tmp_path / "r", things=True)
    page = ViewerPage(open_result(tmp_path / "r"), port=0)
    page.stop()
    options = {"ranges": page.ranges, "points": page.point_filter(500), "frames_per_second": 5}
    text = static_page(page.result, quantity="image", max_frames=3, **options)
    assert "__VISER_EMBED_DATA__" in text.text and "</html>" in text.text
    more = static_page(page.result, quantity="image", max_frames=5, **options)
    assert len(more.text) > len(text.text)
    assert text.frames == 3 and more.frames == 5 and not more.unread
    (tmp_path / "r" / "frames" / "000000.jpg").unlink()
    left = static_page(page.result, quantity="image", max_frames=5, **options)
    assert left.frames == 4 and "f0" in left.unread[0]
    assert "4 of 5 frames. Left out, as it cannot be read: f0" in left.text
    for k in range(1, 5):
        (tmp_path / "r" / "frames" / f"{k:06d}.jpg").unlink()
    with pytest.raises(ValueError, match="no frame that can be read: f0"):
        static_page(page.result, quantity="image", max_frames=5, **options)


def test_a_static_page_has_the_path_of_every_piece(tmp_path, monkeypatch):
    piece = np.array([0, 0, 0, 1, 1], np.int32)
    write_reconstruction(tmp_path / "r", changes={"piece": piece, "unit": (1.0, 1.0)})
    result = open_result(tmp_path / "r")
    shown = []
    show = ViewerScene.show_path

    def noted(scene, number, *arguments, **options):
        show(scene, number, *arguments, **options)
        shown.append(sorted(scene.frusta))

    monkeypatch.setattr(ViewerScene, "show_path", noted)
    static_page(
        result,
        quantity="image",
        ranges=Ranges(inverse_depth=1.0, flow=1.0),
        points=PointFilter(max_points=100),
        max_frames=5,
        frames_per_second=5,
    )
    assert shown == [[0, 1, 2], [3, 4], [0, 1, 2]]  # and it begins anew


def test_a_page_shows_the_progress_of_a_reconstruction(opened, tmp_path):
    folder = tmp_path / "r"
    shot = write_reconstruction(tmp_path / "made")
    for part in ("frames", "depth"):
        (folder / part).mkdir(parents=True)
    (folder / "reconstruction.begun").touch()
    server = start_server("127.0.0.1", 0)
    waiting = WaitingPage(server, folder)
    found = []
    with locked_folder(folder):
        thread = threading.Thread(target=lambda: found.append(waiting.wait()), daemon=True)
        thread.start()
        wait_for(lambda: "no complete reconstruction yet" in waiting._text.content)
        for k in range(5):
            shutil.copy(tmp_path / "made" / "frames" / f"{k:06d}.jpg", folder / "frames")
            shutil.copy(tmp_path / "made" / "depth" / f"{k:06d}.npz", folder / "depth")
        wait_for(lambda: "5 frames are read, 5 of them have depth" in waiting._text.content)
        wait_for(lambda: waiting._image is not None)
        for name in ("path.npz", "reconstruction.json"):
            shutil.copy(tmp_path / "made" / name, folder)
        wait_for(lambda: found)
    page = ViewerPage(found[0], server=server)
    try:
        assert page.server is server and "1 of 5" in page.controls.status.content
        assert page.frame.shape == shot.frames.shape[1:3]
    finally:
        page.stop()


def test_the_whole_scene_is_a_layer(opened, tmp_path):
    write_reconstruction(tmp_path / "r")
    positions = np.random.default_rng(0).uniform(-1, 1, (40, 3)).astype(np.float32)
    colors, confidence = np.full((40, 3), 99, np.uint8), np.ones(40, np.float32)
    points = PointCloud(positions=positions, colors=colors, confidence=confidence)
    points.save(tmp_path / "r" / "points.ply")
    page = opened(tmp_path / "r")
    assert "fused" not in page.scene._nodes
    change(page, "fused", "points")
    wait_for(lambda: "points.ply: 40 points" in page.controls.fused_note.content)
    wait_for(lambda: "fused" in page.scene._nodes)
    np.testing.assert_array_equal(page.scene._nodes["fused"].points, positions)
    change(page, "with_frame", False)
    wait_for(lambda: not page.scene._nodes["points"].visible)
    page.controls.box_low.value, page.controls.box_high.value = (0, 0, 0), (1, 1, 1)
    change(page, "box", True)
    wait_for(lambda: len(page.scene._nodes["fused"].points) == (positions > 0).all(axis=1).sum())
    change(page, "fused", "nothing")
    wait_for(lambda: "fused" not in page.scene._nodes)
    assert page.controls.fused_note.content == ""


def test_a_scene_that_cannot_be_fused_is_stated(opened, tmp_path):
    write_reconstruction(tmp_path / "r", changes={"keyframes": ()})
    page = opened(tmp_path / "r")
    change(page, "fused", "surface")
    wait_for(lambda: "no keyframes" in page.controls.fused_note.content)
    change(page, "frame", 2)
    wait_for(lambda: page.number == 2)  # the page goes on


def test_handles_of_the_box_drag_its_corners(opened, tmp_path):
    write_reconstruction(tmp_path / "r")
    page = opened(tmp_path / "r")
    change(page, "box", True)
    wait_for(lambda: len(page.box._handles) == 2)
    change(page, "color", "depth")  # drawn anew, the handles stay
    wait_until_drawn(page)
    for handle, corner in zip(page.box._handles, page.box._corners, strict=True):
        np.testing.assert_allclose(handle.position, corner.value, atol=1e-6)
    page.box._drag(1, np.array((0.25, 0.5, 2.125)))
    wait_for(lambda: page.box.ends[1][1] == 0.5)
    assert page.controls.box_high.value == (0.25, 0.5, 2.125)
    change(page, "box_low", (-0.5, -0.5, 0))
    wait_for(lambda: np.allclose(page.box._handles[0].position, (-0.5, -0.5, 0)))
    change(page, "box", False)
    wait_for(lambda: not page.box._handles and "box" not in page.scene._nodes)
