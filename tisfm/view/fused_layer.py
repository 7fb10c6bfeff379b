"""The layer of the page with the fused points or surface of several frames."""

import threading
from collections.abc import Callable

import numpy as np

from tisfm.results.fused_scene import FusedKind, FusedScene, clip_to_box
from tisfm.results.result_frames import ResultFrames
from tisfm.view.clipping_box import Box
from tisfm.view.controls import NOT_FUSED, Controls
from tisfm.view.html_texts import note_html, set_html
from tisfm.view.scene import ViewerScene

FusedKey = tuple[FusedKind, int]


class FusedLayer:
    """Shows the fused scene that the controls choose; another thread makes it meanwhile."""

    def __init__(
        self,
        controls: Controls,
        scene: ViewerScene,
        result: ResultFrames,
        schedule: Callable[[Callable[[], None]], None],  # lets the drawing thread call a function
    ) -> None:
        self._controls, self._scene, self._result, self._schedule = (
            controls,
            scene,
            result,
            schedule,
        )
        self._lock = threading.Lock()
        self._requested: FusedKey | None = None
        self._fused: FusedScene | None = None
        self._drawn_state: object = None

    def update(
        self,
        number: int,
        box: Box | None,  # ((3,), (3,)) or None: clipping box
        size: float,  # of points, in the unit of the scene
    ) -> None:
        """Show the fused scene of a frame's piece if the user has chosen it; make it if needed."""
        kind, piece = self._controls.fused.value, int(self._result.piece[number])
        if kind == NOT_FUSED:
            self.clear()
            return
        if (kind, piece) != self._requested:
            self.clear()
            self._requested = kind, piece
            self._note("The fused scene is read or made now, which may take a while.")
            arguments = kind, number, self._requested
            threading.Thread(
                target=self._make, args=arguments, name="tisfm-view-fuse", daemon=True
            ).start()
        ends = None if box is None else tuple(np.concatenate(box))
        state = self._requested, self._fused is not None, ends, size
        if state != self._drawn_state:
            self._drawn_state = state
            clipped = None if self._fused is None else clip_to_box(self._fused, box)
            self._scene.show_fused(clipped, size=size)

    def clear(self) -> None:
        """Show nothing, and make the next scene from the beginning."""
        if self._requested is not None:
            self._requested = self._fused = self._drawn_state = None
            self._scene.show_fused(None, size=1.0)
            self._note("")

    def _make(self, kind: FusedKind, number: int, key: FusedKey) -> None:
        """Make a scene, and give it to the drawing thread. Runs in a thread of its own."""
        with self._lock:
            if key != self._requested:
                return
            fused, text = None, ""
            try:
                fused = self._result.fused(kind, number)
                text = _describe(fused)
            except (ImportError, OSError, ValueError) as error:
                text = " ".join(str(error).split())
        self._schedule(lambda: self._set(key, fused, text))

    def _set(self, key: FusedKey, fused: FusedScene | None, text: str) -> None:
        """Show a scene, unless another one is requested by now."""
        if key == self._requested:
            self._fused = fused
            self._note(text)

    def _note(self, text: str) -> None:
        set_html(self._controls.fused_note, note_html(text))


def _describe(scene: FusedScene) -> str:
    """Return the source and the size of a scene, in words."""
    if scene.faces is None:
        text = f"{scene.origin}: {len(scene.positions):,} points"
    else:
        text = f"{scene.origin}: {len(scene.faces):,} triangles"
    return text + (f", thinned to {100 * scene.point_share:.0f} %" if scene.point_share < 1 else "")
