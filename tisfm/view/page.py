"""The page: what the controls ask for is drawn, coarse first, then in full."""

import contextlib
import threading
import time
import traceback
from collections.abc import Callable
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from tisfm.results.frame import ViewFrame
from tisfm.results.frame_cache import MOST_BYTES, FrameCache
from tisfm.results.result import Result
from tisfm.view.browsers import Browsers
from tisfm.view.clipping_box import ClippingBox
from tisfm.view.colors import pixel_colors
from tisfm.view.controls import ANY_DEVIATION, build_controls, kind_of, take_settings
from tisfm.view.downloads import save_film, save_screenshot, save_static, tell_browser
from tisfm.view.frame_cloud import Choice, Cloud, cloud
from tisfm.view.fused_layer import WholeLayer
from tisfm.view.html_texts import legend_html, legend_of, set_html, status_html, things_in
from tisfm.view.marks import Marks
from tisfm.view.pictures import caption, picture_of
from tisfm.view.ranges import differ, ranges_of, sampled
from tisfm.view.scene import SceneView, thumbnail
from tisfm.view.server import start_server, stop_server, url_of

if TYPE_CHECKING:
    from viser import ClientHandle, ViserServer

COARSE = 15_000  # points that are drawn at once; all others follow when nothing changes
_REST = 0.25  # s without a change before the rest is drawn
_CHECK, _SETTLED = 0.05, 1.0  # s: between looks for a browser, and until one has drawn
_LOOK = 1.0  # s between looks at the folder
_GROWN = 1.2  # times as many frames, for the path to be drawn anew, and ranges to be looked at
_OTHER_RANGE = 1.25  # times as large or as small: before that, colours stay as they are
_OTHER_SIZE = 1.5  # times as large or as small: a scene that browsers look at from elsewhere
_PICTURE = 420  # px, pictures beside the scene


class Page:
    """A page that shows a result to all browsers that open it.

    One thread draws; the controls only say that something has changed. So a browser that is
    slower than the changes misses some of them, and none is drawn twice.

    Parameters
    ----------
    result : Result
        It has at least one frame.
    host : str
        The address that is listened at.
    port : int
        The first port that is tried, 0 for any.
    number : int
        The frame that is looked at first.
    most_points : int
        Of a frame, at first.
    most_bytes : int
        Of frames that are kept in memory.
    patience : float
        For how long, s, only the first picture is made, unless a browser comes.
    server : ViserServer, optional
        One that has shown something else so far, in place of one at `host` and `port`.

    Raises
    ------
    ImportError
        If viser is not installed.
    OSError
        If it cannot listen there.
    """

    def __init__(
        self,
        result: Result,
        *,
        host: str = "127.0.0.1",
        port: int = 8080,
        number: int = 0,
        most_points: int = 200_000,
        most_bytes: int = MOST_BYTES,
        patience: float = 0.0,
        server: "ViserServer | None" = None,
    ) -> None:
        self.result = result
        self.cache = FrameCache(result, most_bytes)
        self.number, self.fault, self._patience = -1, "", patience
        self.frame: ViewFrame | None = None
        self.points: Cloud | None = None
        self.server = start_server(host, port) if server is None else server
        self.scene = SceneView(self.server, result)
        self.browsers = Browsers(
            self.server, self.scene, is_followed=lambda: self.controls.follow.value
        )
        self._jobs: SimpleQueue[Callable[[], None]] = SimpleQueue()
        self._wake, self._stopping = threading.Event(), threading.Event()
        self._is_stale, self._is_coarse, self._changed_at = False, True, 0.0
        self._playing_since: tuple[float, int] | None = None
        self._looked_at = time.monotonic()
        self._shown_path: tuple[int, bool] | None = None
        self._path_of = self._ranges_of = 0  # frames, when they were drawn, or taken, last
        self._without_picture: list[int] = []
        if server is not None:
            server.gui.reset()
        self._build_controls(most_points)
        self._begin(number)
        self.server.scene.on_click()(lambda event: self._clicked(event))
        self.server.on_client_connect(self.browsers.welcome)
        self._draw(most=COARSE)
        self.browsers.go_all()  # they look at what was shown before
        self._thread = threading.Thread(target=self._work, name="tisfm-view", daemon=True)
        self._thread.start()

    @property
    def url(self) -> str:
        """Where a browser finds it."""
        return url_of(self.server)

    def stop(self) -> None:
        """End the page; browsers keep what they show."""
        self._stopping.set()
        self._wake.set()
        self._thread.join(timeout=10)
        stop_server(self.server)

    def choice(self, most: int | None = None) -> Choice:
        """Return which points the controls ask for, at most so many."""
        controls = self.controls
        deviation = controls.max_deviation.value
        asked = 1000 * int(controls.most.value)
        return Choice(
            min_confidence=controls.min_confidence.value,
            max_deviation=np.inf if deviation >= ANY_DEVIATION else deviation / 100,
            box=self.box.ends,
            most_points=asked if most is None else min(most, asked),
            with_hidden=controls.hidden.value,
        )

    def show(self, number: int, most: int | None = None) -> Cloud | None:
        """Show a frame, as the controls ask for it; return its points, None if it has none.

        It belongs to the thread that draws.
        """
        self._take_frame(number)
        frame, controls = self.frame, self.controls
        with self.server.atomic():
            if frame is None:
                self.points = None
                self.scene.remove("points")
            else:
                quantity = controls.color.value
                self.points = self._points_of(frame, most)
                if controls.shape.value == "surface":
                    colors = pixel_colors(frame, quantity, self.ranges)
                    self.scene.show_surface(self.points, frame, colors)
                else:
                    self.scene.show_points(self.points, frame, size=controls.size.value)
                self.scene.set_visible("points", controls.with_frame.value)
                self.scene.show_here(frame, visible=not controls.follow.value)
                spacing = self.scene.depth / frame.camera.focal
                self.whole.update(number, self.box.ends, controls.size.value * spacing)
                self.box.show()
            self._show_path(number)
        self.browsers.points = self.points
        return self.points

    def _take_frame(self, number: int) -> None:
        """Read the frame that is shown from now on."""
        self.number, self.frame = number, self._read(number)
        self.marks.frame = self.browsers.frame = self.frame

    def _points_of(self, frame: ViewFrame, most: int | None) -> Cloud:
        """Return the points of a frame that the controls ask for, at most so many."""
        pose = self.scene.pose_of(frame.number)
        return cloud(frame, self.controls.color.value, self.ranges, self.choice(most), pose)

    # What is shown first, and where the result is replaced.

    def _build_controls(self, most_points: int) -> None:
        """Make the controls that suit the result, and what goes by them."""
        with self.server.atomic():
            self.controls = build_controls(self.server, self.result, most_points=most_points)
        self.marks = Marks(self.controls, self.scene, self.result)
        self.box = ClippingBox(self.server, self.controls, self.scene)
        self.whole = WholeLayer(self.controls, self.scene, self.result, self._put_and_redraw)
        self._kind = kind_of(self.result)
        self._listen()

    def _begin(self, number: int) -> None:
        """Take sizes, ranges, and where browsers and the clipping box begin, from a frame."""
        first = self._read(number)
        self.ranges, self._ranges_of = ranges_of([first] if first else [], with_flow=False), 0
        self.scene.begin(1.0 if first is None else first.usual_depth)
        if first is not None:
            points = self._points_of(first, COARSE)
            self.scene.place_browsers(first, points)
            if not self.controls.box.value:
                self.box.begin_around(points, first)
        self.controls.frame.value = number
        self._jobs.put(self._widen_ranges)

    def _begin_anew(self, number: int) -> None:
        """Show another result in place of the one so far; what was set stays as far as it can."""
        depth = self.scene.depth
        self.cache.clear()
        self.whole.forget()
        self.marks.clear_measured()
        self.number, self._shown_path = -1, None
        if kind_of(self.result) != self._kind:
            before, pixel = self.controls, self.marks.pixel
            self.box.forget()
            with self.server.atomic():
                self.server.gui.reset()
                self._build_controls(before.most.value * 1000)
                take_settings(self.controls, before)
            self.marks.pixel = pixel
            self.controls.play.label = before.play.label
        self._set_last()
        self._begin(number)
        self.box.forget()
        self._restart_play()
        self._draw(most=COARSE)
        if abs(np.log(self.scene.depth / depth)) > np.log(_OTHER_SIZE):
            self.browsers.go_all()
        self._change(path=True)

    # What a browser asks for.

    def _listen(self) -> None:
        """Take note of what the controls and clicks ask for."""
        controls = self.controls
        for control in controls.redrawing:
            control.on_update(lambda _: self._change())
        controls.frame.on_update(self._slid)
        for control in (controls.path, controls.frusta, controls.things, controls.pictures):
            control.on_update(lambda _: self._change(path=True))
        controls.play.on_click(lambda _: self._toggle_play())
        controls.go.on_click(lambda event: self.browsers.go(event.client))
        controls.speed.on_update(lambda _: self._restart_play())
        controls.pixel.on_update(lambda event: self._mark_typed(event.client is not None))
        controls.measure.on_update(lambda _: self._measure_anew())
        controls.clear.on_click(lambda _: self._measure_anew())
        controls.screenshot.on_click(lambda event: self._do(save_screenshot, event.client))
        controls.film.on_click(lambda event: self._do(save_film, event.client))
        controls.static.on_click(lambda event: self._do(save_static, event.client))

    def _put_and_redraw(self, job: Callable[[], None]) -> None:
        """Have a job done by the thread that draws, and what is shown drawn anew after it."""
        self._jobs.put(job)
        self._change()

    def _change(self, *, path: bool = False) -> None:
        if path:
            self._shown_path = None
        self._is_stale = True
        self._wake.set()

    def _do(self, job: "Callable[[Page, ClientHandle], None]", client: "ClientHandle") -> None:
        """Have something saved for a browser."""

        def done() -> None:
            try:
                job(self, client)
            except (ImportError, OSError, RuntimeError, ValueError) as error:
                tell_browser(self, client, "It was not saved", " ".join(str(error).split()))
            set_html(self.controls.progress, Markup())

        self._jobs.put(done)
        self._wake.set()

    def _toggle_play(self) -> None:
        playing = self._playing_since is None
        self.controls.play.label = "Pause" if playing else "Play"
        self._playing_since = (
            (time.monotonic(), int(self.controls.frame.value)) if playing else None
        )
        self._wake.set()

    def _slid(self, event: Any) -> None:
        """Draw another frame, and let playing go on from where somebody moved the slider."""
        if int(self.controls.frame.value) != self.number:
            self._change()
        if event.client is not None:
            self._restart_play()

    def _restart_play(self) -> None:
        if self._playing_since is not None:
            self._playing_since = (time.monotonic(), int(self.controls.frame.value))

    def _clicked(self, event: Any) -> None:
        origin, direction = event.ray_origin, event.ray_direction
        self._jobs.put(lambda: self._pick(np.array(origin), np.array(direction)))
        self._wake.set()

    def _mark_typed(self, is_typed: bool) -> None:
        if is_typed:
            column, row = (int(part) for part in self.controls.pixel.value)
            self._jobs.put(lambda: self._mark(row, column))
            self._wake.set()

    def _measure_anew(self) -> None:
        self._jobs.put(lambda: self.marks.clear_measured())
        self._wake.set()

    # What the thread does.

    def _work(self) -> None:
        self._await_browser()
        while not self._stopping.is_set():
            self._wake.wait(self._pause())
            self._wake.clear()
            if self._stopping.is_set():
                return
            try:
                self._step()
            except Exception:  # a bug: it is told, and the page goes on
                traceback.print_exc()

    def _await_browser(self) -> None:
        """Leave the processor to a browser until it shows the first picture, or asks for more."""
        end = time.monotonic() + self._patience
        while time.monotonic() < end and not self.server.get_clients():
            if self._wake.wait(_CHECK):
                return
        if self._patience > 0:
            self._wake.wait(_SETTLED)

    def _step(self) -> None:
        """Do what is to be done now."""
        with contextlib.suppress(Empty):
            while True:
                self._jobs.get_nowait()()
        self._play()
        now = time.monotonic()
        if self._is_stale:
            self._is_stale, self._is_coarse, self._changed_at = False, True, now
            self._draw(most=COARSE)
        elif self._is_coarse and now - self._changed_at > _REST:
            self._is_coarse = False
            self._draw(most=None)
        elif self._without_picture and self._playing_since is None:
            self._give_picture(self._without_picture.pop(0))
        if now - self._looked_at > _LOOK:
            self._looked_at = now
            self._look()

    def _pause(self) -> float:
        """Return how long to wait for a change, s."""
        if self._is_stale:
            return 0.0
        if self._playing_since is not None:
            return 0.5 / self.controls.speed.value
        if self._is_coarse:
            return _REST
        return 0.02 if self._without_picture else _LOOK

    def _play(self) -> None:
        """Go on to the frame whose turn it is; those that there was no time for are left out."""
        if self._playing_since is None:
            return
        since, start = self._playing_since
        elapsed = int((time.monotonic() - since) * self.controls.speed.value)
        number = (start + elapsed) % len(self.result.names)
        if number != int(self.controls.frame.value):
            self.controls.frame.value = number
            self._is_stale = True

    def _draw(self, most: int | None) -> None:
        """Show the frame that the slider is at, and what belongs to it."""
        number = min(int(self.controls.frame.value), len(self.result.names) - 1)
        is_another = number != self.number
        if is_another and self.marks.measured and not self._shares_scale(number):
            self.marks.clear_measured()
        self.show(number, most)
        if is_another:
            self._show_status()
        if is_another or most == COARSE:
            self._show_pictures()
            self._show_legend()
            self.marks.show_reading()
        if self.controls.follow.value:
            self.browsers.follow_all()

    def _shares_scale(self, number: int) -> bool:
        """Return whether a frame has the scale of the one that is shown."""
        piece = self.result.piece
        return self.number >= 0 and piece[number] == piece[self.number] >= 0

    def _read(self, number: int) -> ViewFrame | None:
        """Return a frame, None if it cannot be read; what is wrong is said."""
        try:
            frame = self.cache[number]
        except (OSError, ValueError) as error:
            self.fault = f"it cannot be read: {' '.join(str(error).split())}"
            return None
        self.fault = ""
        return frame

    def _look(self) -> None:
        """Take over what the folder has more than before."""
        number = max(self.number, 0)
        name, pose = self.result.names[number], self.scene.pose_of(number)
        try:
            change = self.result.refresh()
        except (OSError, ValueError):  # it is replaced, or gone: what is there stays
            return
        if change is None:
            return
        names = self.result.names
        number = names.index(name) if name in names else 0
        if change == "replaced" or kind_of(self.result) != self._kind:
            self._begin_anew(number)
            return
        self._set_last()
        self._take_place(number, pose)
        if len(names) >= _GROWN * self._ranges_of:
            self._jobs.put(self._widen_ranges)

    def _set_last(self) -> None:
        """Let the slider end at the last frame; with one alone there is nothing to choose."""
        last = len(self.result.names) - 1
        self.controls.frame.max = max(1, last)
        self.controls.frame.disabled = self.controls.play.disabled = last < 1

    def _take_place(self, number: int, pose: NDArray[np.float64]) -> None:
        """Let the frame that is shown have the number that it has among more frames.

        It is drawn anew if it is at another place than its former pose; the path is, if need be.
        """
        is_moved = number != self.number
        if is_moved:
            self._take_frame(number)
            self.controls.frame.value = number
            self._restart_play()
        self._show_status()
        if not self.result.has_one_scale:
            return
        if not np.array_equal(self.scene.pose_of(number), pose):
            self._change(path=True)
        elif is_moved or len(self.result.names) >= _GROWN * self._path_of:
            self._shown_path = None
            with self.server.atomic():
                self._show_path(number)

    def _widen_ranges(self) -> None:
        """Take ranges of colours from a few frames of the whole result.

        Those that it has grown out of little are kept: colours do not change with every frame.
        """
        is_first, self._ranges_of = self._ranges_of == 0, len(self.result.names)
        ranges = ranges_of(sampled(self.cache, self._ranges_of))
        if is_first or differ(ranges, self.ranges, _OTHER_RANGE):
            self.ranges, self._is_stale = ranges, True

    def _show_path(self, number: int) -> None:
        """Show path and frusta, if they are those of another piece than before; and things."""
        self.scene.show_things(number, visible=self.controls.things.value)
        controls = self.controls
        from_inside = controls.follow.value  # where frusta are in the way
        shown = int(self.result.piece[number]), from_inside
        if self.frame is None or shown == self._shown_path:
            return
        self._shown_path, self._path_of = shown, len(self.result.names)
        self.scene.show_path(
            number,
            self.frame,
            path=controls.path.value and not from_inside,
            frusta=controls.frusta.value and not from_inside,
        )
        self._without_picture = list(self.scene.frusta) if controls.pictures.value else []

    def _give_picture(self, number: int) -> None:
        """Put the picture of a frame into its frustum."""
        handle = self.scene.frusta.get(number)
        if handle is not None:
            with contextlib.suppress(OSError, ValueError):
                handle.image = thumbnail(self.result.picture(number))

    def _show_status(self) -> None:
        status = status_html(self.result, self.frame, self.number, self.fault)
        set_html(self.controls.status, status)

    def _show_pictures(self) -> None:
        for kind, image in zip(self.controls.kinds, self.controls.images, strict=True):
            if self.frame is not None:
                image.label = caption(kind.value, self.ranges) or None
                image.image = picture_of(
                    self.frame, kind.value, self.ranges, width=_PICTURE, marked=self.marks.pixel
                )

    def _show_legend(self) -> None:
        things = things_in(self.frame) if self.frame is not None else set[int]()
        shown = legend_of(self.result, self.controls.color.value, self.ranges, things)
        set_html(self.controls.legend, legend_html(shown))

    def _pick(self, origin: NDArray[np.float64], direction: NDArray[np.float64]) -> None:
        self.marks.pick(origin, direction, self.points)
        self._show_pictures()

    def _mark(self, row: int, column: int) -> None:
        self.marks.mark(row, column)
        self._show_pictures()
