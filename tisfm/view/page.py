"""The page of the viewer: shows the frame, the points and the pictures that its controls choose."""

import contextlib
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tisfm.results.frame import ResultFrame
from tisfm.results.result_frames import MAX_CACHE_BYTES, FrameCache, ResultFrames, as_rgb
from tisfm.view.browsers import Browsers
from tisfm.view.clipping_box import ClippingBox
from tisfm.view.colors import (
    are_different,
    caption,
    legend_of_result,
    object_labels,
    picture_of,
    pixel_colors,
    ranges_of,
    sample_frames,
)
from tisfm.view.controls import ANY_DEVIATION, build_controls, control_features, copy_settings
from tisfm.view.downloads import notify, save_film, save_screenshot, save_static
from tisfm.view.drawing_thread import DrawingThread, Playback
from tisfm.view.frame_cloud import FrameCloud, PointFilter, frame_cloud
from tisfm.view.fused_layer import FusedLayer
from tisfm.view.html_texts import NOTHING, legend_html, set_html, status_html
from tisfm.view.marks import Marks
from tisfm.view.scene import ViewerScene, thumbnail
from tisfm.view.server import start_server, stop_server, url_of

if TYPE_CHECKING:
    from viser import ClientHandle, ViserServer

# Set by hand.
COARSE_POINTS = 15_000  # points of a frame right after a change
# ratio of frame counts from which path and ranges of a growing result are computed again
_MIN_GROWTH = 1.2
_MAX_RANGE_RATIO = 1.25  # ratio of ranges up to which colours stay as they are
_MAX_SCALE_RATIO = 1.5  # ratio of scene depths from which browsers get a new viewpoint
_PICTURE_WIDTH = 420  # px, of pictures beside the scene


class ViewerPage:
    """A page that shows a result to all browsers that open it.

    Raises ImportError if viser is not installed.

    Raises OSError if the server cannot listen at the address.
    """

    def __init__(
        self,
        result: ResultFrames,  # with at least one frame
        *,
        host: str = "127.0.0.1",  # address of the server
        port: int = 8080,  # first port that is tried, 0 for any
        number: int = 0,  # frame that is shown first
        max_points: int = 200_000,  # initial limit of the points of a frame
        max_bytes: int = MAX_CACHE_BYTES,  # limit of the frames in memory
        # s: for this time after the start, only a coarse first picture is drawn, unless a browser
        # connects
        browser_wait: float = 0.0,
        # a running server to take over, in place of one at `host` and `port`
        server: "ViserServer | None" = None,
    ) -> None:
        self.result = result
        self.cache = FrameCache(result, max_bytes)
        self.number, self.fault = -1, ""
        self.frame: ResultFrame | None = None
        self.points: FrameCloud | None = None
        self.server = start_server(host, port) if server is None else server
        self.scene = ViewerScene(self.server, result)
        self.browsers = Browsers(
            self.server, self.scene, is_following=lambda: self.controls.follow.value
        )
        self.playback = Playback()
        self.thread = DrawingThread(self, browser_wait=browser_wait)
        self._drawn_path: tuple[int, bool] | None = None  # piece, and whether browsers follow
        # numbers of frames when the path and the ranges were last computed
        self._path_frame_count = self._range_frame_count = 0
        self._missing_thumbnails: list[int] = []
        if server is not None:
            server.gui.reset()
        self._build_controls(max_points)
        self._show_first(number)
        self.server.scene.on_click()(lambda event: self._on_click(event))
        self.server.on_client_connect(self.browsers.add)
        self.draw(coarse=True)
        self.browsers.move_all_to_overview()  # browsers of a server that was taken over
        self.thread.start()

    @property
    def url(self) -> str:
        """Address for a browser."""
        return url_of(self.server)

    def stop(self) -> None:
        """Stop the server; browsers keep what they show."""
        self.thread.stop()
        stop_server(self.server)

    def point_filter(self, max_points: int | None = None) -> PointFilter:
        """Return the filter that the controls choose, with at most `max_points` points."""
        controls = self.controls
        deviation = controls.max_deviation.value
        limit = 1000 * int(controls.max_thousands.value)
        return PointFilter(
            min_confidence=controls.min_confidence.value,
            max_deviation=np.inf if deviation >= ANY_DEVIATION else deviation / 100,
            box=self.box.ends,
            max_points=limit if max_points is None else min(max_points, limit),
            with_hidden=controls.with_hidden_points.value,
        )

    def show(self, number: int, max_points: int | None = None) -> FrameCloud | None:
        """Show a frame as the controls choose; return its points, None if it cannot be read.

        Only the drawing thread may call this.
        """
        self._set_frame(number)
        frame, controls = self.frame, self.controls
        with self.server.atomic():
            if frame is None:
                self.points = None
                self.scene.remove("points")
            else:
                quantity = controls.color.value
                self.points = self._points_of(frame, max_points)
                if controls.shape.value == "surface":
                    colors = pixel_colors(frame, quantity, self.ranges)
                    self.scene.show_surface(self.points, frame, colors)
                else:
                    self.scene.show_points(self.points, frame, size=controls.size.value)
                self.scene.set_visible("points", controls.with_frame.value)
                self.scene.show_frustum(frame, visible=not controls.follow.value)
                spacing = self.scene.depth / frame.camera.focal
                self.fused.update(number, self.box.ends, controls.size.value * spacing)
                self.box.show()
            self._show_path(number)
        self.browsers.points = self.points
        return self.points

    # Called by the drawing thread.

    def pick(self, origin: NDArray[np.float64], direction: NDArray[np.float64]) -> None:
        """Mark or measure the point that a ray in the world hits."""
        self.marks.pick(origin, direction, self.points)
        self._show_pictures()

    def mark(self, row: int, column: int) -> None:
        """Mark a pixel, and show its values."""
        self.marks.mark(row, column)
        self._show_pictures()

    def draw(self, *, coarse: bool) -> None:
        """Show the frame that the slider is at, with its texts and pictures."""
        number = min(int(self.controls.frame.value), len(self.result.names) - 1)
        is_new_frame = number != self.number
        if is_new_frame and self.marks.measured_points and not self._shares_scale(number):
            self.marks.clear_measured_points()
        self.show(number, COARSE_POINTS if coarse else None)
        if is_new_frame:
            self._show_status()
        if is_new_frame or coarse:
            self._show_pictures()
            self._show_legend()
            self.marks.show_reading()
        if self.controls.follow.value:
            self.browsers.follow_all()

    def advance(self) -> bool:
        """Move the slider to the frame that is due; return whether it has moved."""
        number = self.playback.due_frame(self.controls.speed.value, len(self.result.names))
        if number is None or number == int(self.controls.frame.value):
            return False
        self.controls.frame.value = number
        return True

    def seconds_per_frame(self) -> float | None:
        """Return the time of a frame while playing, else None."""
        return 1 / self.controls.speed.value if self.playback.is_on else None

    def has_missing_thumbnails(self) -> bool:
        """Return whether a frustum has no picture yet."""
        return bool(self._missing_thumbnails)

    def add_thumbnail(self) -> None:
        """Put the next missing picture into its frustum."""
        number = self._missing_thumbnails.pop(0)
        handle = self.scene.frusta.get(number)
        if handle is not None:
            with contextlib.suppress(OSError, ValueError):
                handle.image = thumbnail(as_rgb(self.result.picture(number)))

    def has_browser(self) -> bool:
        """Return whether a browser shows the page."""
        return bool(self.server.get_clients())

    def watch_folder(self) -> None:
        """Take over new frames of the result, or another result in its folder."""
        number = max(self.number, 0)
        name, pose = self.result.names[number], self.scene.pose_of(number)
        try:
            change = self.result.refresh()
        except (OSError, ValueError):  # the result is being replaced, or gone: the page stays
            return
        if change is None:
            return
        names = self.result.names
        number = names.index(name) if name in names else 0
        if change == "replaced" or control_features(self.result) != self._control_features:
            self._replace_result(number)
            return
        self._set_last_frame()
        self._renumber(number, pose)
        if len(names) >= _MIN_GROWTH * self._range_frame_count:
            self.thread.put(self._renew_ranges)

    # The result: at the beginning, and when it grows or is replaced.

    def _build_controls(self, max_points: int) -> None:
        """Build the controls for the result, and the parts of the page that depend on them."""
        with self.server.atomic():
            self.controls = build_controls(self.server, self.result, max_points=max_points)
        self.marks = Marks(self.controls, self.scene, self.result)
        self.box = ClippingBox(self.server, self.controls, self.scene)
        self.fused = FusedLayer(
            self.controls, self.scene, self.result, lambda job: self.thread.put(job, redraw=True)
        )
        self._control_features = control_features(self.result)
        self._connect_controls()

    def _show_first(self, number: int) -> None:
        """Set sizes, ranges, the viewpoint of browsers and the clipping box from a frame."""
        first_frame = self._read(number)
        self.ranges = ranges_of([first_frame] if first_frame else [], with_flow=False)
        self._range_frame_count = 0
        self.scene.set_depth(1.0 if first_frame is None else first_frame.median_depth)
        if first_frame is not None:
            points = self._points_of(first_frame, COARSE_POINTS)
            self.scene.set_first_viewpoint(first_frame, points)
            if not self.controls.box.value:
                self.box.fit(points, first_frame)
        self.controls.frame.value = number
        self.thread.put(self._renew_ranges)

    def _replace_result(self, number: int) -> None:
        """Show another result; controls that the new page also has keep their settings."""
        depth = self.scene.depth
        self.cache.clear()
        self.fused.clear()
        self.marks.clear_measured_points()
        self.number, self._drawn_path = -1, None
        if control_features(self.result) != self._control_features:
            earlier, pixel = self.controls, self.marks.pixel
            self.box.remove_handles()
            with self.server.atomic():
                self.server.gui.reset()
                self._build_controls(earlier.max_thousands.value * 1000)
                copy_settings(earlier, self.controls)
            self.marks.pixel = pixel
            self.controls.play.label = earlier.play.label
        self._set_last_frame()
        self._show_first(number)
        self.box.remove_handles()
        self._restart_playback()
        self.draw(coarse=True)
        if abs(np.log(self.scene.depth / depth)) > np.log(_MAX_SCALE_RATIO):
            self.browsers.move_all_to_overview()
        self._redraw(path=True)

    def _set_last_frame(self) -> None:
        """Let the slider end at the last frame; a single frame disables it."""
        last = len(self.result.names) - 1
        self.controls.frame.max = max(1, last)
        self.controls.frame.disabled = self.controls.play.disabled = last < 1

    def _renumber(self, number: int, pose: NDArray[np.float64]) -> None:
        """Give the frame that is shown its number in the larger result.

        It is drawn again if its pose has changed; the path is drawn again if it has grown enough.
        """
        has_changed = number != self.number
        if has_changed:
            self._set_frame(number)
            self.controls.frame.value = number
            self._restart_playback()
        self._show_status()
        if not self.result.has_one_scale:
            return
        if not np.array_equal(self.scene.pose_of(number), pose):
            self._redraw(path=True)
        elif has_changed or len(self.result.names) >= _MIN_GROWTH * self._path_frame_count:
            self._drawn_path = None
            with self.server.atomic():
                self._show_path(number)

    def _renew_ranges(self) -> None:
        """Set ranges of colours from a few frames of the whole result.

        Ranges that differ little stay, so that colours do not change with every new frame.
        """
        is_first, self._range_frame_count = self._range_frame_count == 0, len(self.result.names)
        ranges = ranges_of(sample_frames(self.cache, self._range_frame_count))
        if is_first or are_different(ranges, self.ranges, _MAX_RANGE_RATIO):
            self.ranges = ranges
            self.thread.redraw()

    def _read(self, number: int) -> ResultFrame | None:
        """Read a frame; None if it cannot be read, with the reason in `fault`."""
        try:
            frame = self.cache[number]
        except (OSError, ValueError) as error:
            self.fault = f"it cannot be read: {' '.join(str(error).split())}"
            return None
        self.fault = ""
        return frame

    def _set_frame(self, number: int) -> None:
        """Read the frame that is shown from now on."""
        self.number, self.frame = number, self._read(number)
        self.marks.frame = self.browsers.frame = self.frame

    def _points_of(self, frame: ResultFrame, max_points: int | None) -> FrameCloud:
        """Return the points of a frame that the controls choose, at most `max_points`."""
        pose = self.scene.pose_of(frame.number)
        quantity = self.controls.color.value
        return frame_cloud(frame, quantity, self.ranges, self.point_filter(max_points), pose)

    def _shares_scale(self, number: int) -> bool:
        """Return whether a frame has the scale of the frame that is shown."""
        piece = self.result.piece
        return self.number >= 0 and piece[number] == piece[self.number] >= 0

    # Controls and clicks: they only give work to the drawing thread.

    def _connect_controls(self) -> None:
        controls = self.controls
        for control in controls.redraw_controls:
            control.on_update(lambda _: self._redraw())
        controls.frame.on_update(self._on_slider_change)
        for control in (controls.path, controls.frusta, controls.objects, controls.pictures):
            control.on_update(lambda _: self._redraw(path=True))
        controls.play.on_click(lambda _: self._toggle_playback())
        controls.go.on_click(lambda event: self.browsers.move_to_overview(event.client))
        controls.speed.on_update(lambda _: self._restart_playback())
        controls.pixel.on_update(lambda event: self._on_pixel_change(event.client is not None))
        for control in (controls.measure.on_update, controls.clear.on_click):
            control(lambda _: self.thread.put(lambda: self.marks.clear_measured_points()))
        controls.screenshot.on_click(lambda event: self._save(save_screenshot, event.client))
        controls.film.on_click(lambda event: self._save(save_film, event.client))
        controls.static.on_click(lambda event: self._save(save_static, event.client))

    def _redraw(self, *, path: bool = False) -> None:
        if path:
            self._drawn_path = None
        self.thread.redraw()

    def _save(
        self, save: "Callable[[ViewerPage, ClientHandle], None]", client: "ClientHandle"
    ) -> None:
        """Let the drawing thread save a file for a browser; the browser shows a failure."""

        def job() -> None:
            try:
                save(self, client)
            except (ImportError, OSError, RuntimeError, ValueError) as error:
                notify(self, client, "It was not saved", " ".join(str(error).split()))
            set_html(self.controls.progress, NOTHING)

        self.thread.put(job)

    def _toggle_playback(self) -> None:
        self.playback.toggle(int(self.controls.frame.value))
        self.controls.play.label = "Pause" if self.playback.is_on else "Play"
        self.thread.wake()

    def _restart_playback(self) -> None:
        self.playback.restart(int(self.controls.frame.value))

    def _on_slider_change(self, event: Any) -> None:
        """Draw another frame; if a user moved the slider, playing goes on from there."""
        if int(self.controls.frame.value) != self.number:
            self._redraw()
        if event.client is not None:
            self._restart_playback()

    def _on_click(self, event: Any) -> None:
        origin, direction = np.array(event.ray_origin), np.array(event.ray_direction)
        self.thread.put(lambda: self.pick(origin, direction))

    def _on_pixel_change(self, by_user: bool) -> None:
        if by_user:
            column, row = (int(part) for part in self.controls.pixel.value)
            self.thread.put(lambda: self.mark(row, column))

    # Path, texts and pictures around the points.

    def _show_path(self, number: int) -> None:
        """Show moving objects, and path and frusta if they differ from the last drawing."""
        controls = self.controls
        self.scene.show_objects(number, visible=controls.objects.value)
        is_following = controls.follow.value  # path and frusta would hide the points
        path_state = int(self.result.piece[number]), is_following
        if self.frame is None or path_state == self._drawn_path:
            return
        self._drawn_path, self._path_frame_count = path_state, len(self.result.names)
        self.scene.show_path(
            number,
            self.frame,
            path=controls.path.value and not is_following,
            frusta=controls.frusta.value and not is_following,
        )
        self._missing_thumbnails = list(self.scene.frusta) if controls.pictures.value else []

    def _show_status(self) -> None:
        status = status_html(self.result, self.frame, self.number, self.fault)
        set_html(self.controls.status, status)

    def _show_pictures(self) -> None:
        for kind, image in zip(self.controls.kinds, self.controls.images, strict=True):
            if self.frame is not None:
                image.label = caption(kind.value, self.ranges) or None
                image.image = picture_of(
                    self.frame,
                    kind.value,
                    self.ranges,
                    width=_PICTURE_WIDTH,
                    marked_pixel=self.marks.pixel,
                )

    def _show_legend(self) -> None:
        labels = object_labels(self.frame) if self.frame is not None else set[int]()
        legend = legend_of_result(self.result, self.controls.color.value, self.ranges, labels)
        set_html(self.controls.legend, legend_html(legend))
