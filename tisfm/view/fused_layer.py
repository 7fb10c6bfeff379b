"""The layer of the page with what several frames show together."""

import threading
from collections.abc import Callable

import numpy as np

from tisfm.results.fused_scene import Whole, WholeKind, clipped
from tisfm.results.result import Result
from tisfm.view.clipping_box import Box
from tisfm.view.controls import NO_WHOLE, Controls
from tisfm.view.html_texts import note_html, set_html
from tisfm.view.scene import SceneView

Key = tuple[WholeKind, int]


class WholeLayer:
    """Shows what the controls ask for, as soon as it is there; meanwhile the page goes on.

    Parameters
    ----------
    controls : Controls
    scene : SceneView
    result : Result
    do : callable
        Has a function called in the thread that draws.
    """

    def __init__(
        self,
        controls: Controls,
        scene: SceneView,
        result: Result,
        do: Callable[[Callable[[], None]], None],
    ) -> None:
        self._controls, self._scene, self._result, self._do = controls, scene, result, do
        self._one_at_a_time = threading.Lock()
        self._asked: Key | None = None
        self._found: Whole | None = None
        self._drawn: object = None

    def update(self, number: int, box: Box | None, size: float) -> None:
        """Show it for a frame, if it is on; it is made first if it is of another piece.

        Parameters
        ----------
        number : int
        box : ((3,), (3,)) or None
            That it is clipped to.
        size : float
            Of points, in the unit of the scene.
        """
        kind, piece = self._controls.whole.value, int(self._result.piece[number])
        if kind == NO_WHOLE:
            self.forget()
            return
        if (kind, piece) != self._asked:
            self.forget()
            self._asked = kind, piece
            self._note("It is read, or fused now, which may take a while.")
            arguments = kind, number, self._asked
            threading.Thread(
                target=self._make, args=arguments, name="tisfm-view-whole", daemon=True
            ).start()
        ends = None if box is None else tuple(np.concatenate(box))
        drawn = self._asked, self._found is not None, ends, size
        if drawn != self._drawn:
            self._drawn = drawn
            shown = None if self._found is None else clipped(self._found, box)
            self._scene.show_whole(shown, size=size)

    def forget(self) -> None:
        """Show nothing; what is asked for next is made anew."""
        if self._asked is not None:
            self._asked = self._found = self._drawn = None
            self._scene.show_whole(None, size=1.0)
            self._note("")

    def _make(self, kind: WholeKind, number: int, key: Key) -> None:
        """Make it, and let the thread that draws take it; it has a thread of its own."""
        with self._one_at_a_time:
            if key != self._asked:
                return
            found, text = None, ""
            try:
                found = self._result.whole(kind, number)
                text = _described(found)
            except (ImportError, OSError, ValueError) as error:
                text = " ".join(str(error).split())
        self._do(lambda: self._take(key, found, text))

    def _take(self, key: Key, found: Whole | None, text: str) -> None:
        """Take over what was made, unless something else is asked for by now."""
        if key == self._asked:
            self._found = found
            self._note(text)

    def _note(self, text: str) -> None:
        set_html(self._controls.whole_note, note_html(text))


def _described(whole: Whole) -> str:
    """Return what a layer is, in words."""
    if whole.faces is None:
        text = f"{whole.origin}: {len(whole.positions):,} points"
    else:
        text = f"{whole.origin}: {len(whole.faces):,} triangles"
    return text + (f", thinned to {100 * whole.left:.0f} %" if whole.left < 1 else "")
