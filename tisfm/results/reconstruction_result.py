"""The folder of `tisfm reconstruct`."""

import os
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tisfm.reconstruction.result.folder import RECORD
from tisfm.reconstruction.result.moving_object import MovingObject
from tisfm.reconstruction.result.reconstruction import Reconstruction
from tisfm.results.frame import ViewFrame
from tisfm.results.fused_scene import Whole, WholeKind, fused_whole, stored_whole, thinned
from tisfm.results.result import Change, as_rgb
from tisfm.rigid import rigid_twist


class ReconstructionResult:
    """A reconstruction; see `tisfm.results.result.Result`.

    Raises
    ------
    FileNotFoundError
        If the folder is not complete.
    tisfm.formats.FormatError
        If a file is damaged.
    """

    unit = "the unit of the path"
    has_one_scale = has_whole = True

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._seen: tuple[int, int] | None = None
        self.refresh()

    def refresh(self) -> Change | None:
        """Open it anew if it was replaced; while that goes on it stays as it was."""
        try:
            about = os.stat(self.folder / RECORD)
        except FileNotFoundError:
            if self._seen is not None:  # another is being made
                return None
            raise FileNotFoundError(
                f"the folder {self.folder} is not complete: it has no {RECORD}"
            ) from None
        seen = about.st_mtime_ns, about.st_size
        if seen == self._seen:
            return None
        self._take(Reconstruction.load(self.folder))
        self._seen = seen
        return "replaced"

    def read(self, number: int) -> ViewFrame:
        """Read picture, depth and labels of a frame."""
        result = self._result
        has_labels = result.settings.motion == "objects"
        return ViewFrame(
            number=number,
            picture=self.picture(number),
            camera=result.camera,
            inverse_depth=result.inverse_depth(number),
            inverse_depth_std=result.inverse_depth_std(number),
            status=result.status[number],
            labels=result.labels(number) if has_labels else None,
            motions=self._motions(number),
        )

    def picture(self, number: int) -> NDArray[np.uint8]:
        """Read the picture of a frame."""
        return as_rgb(self._result.picture(number))

    def whole(self, kind: WholeKind, number: int) -> Whole:
        """Return what was written of the largest piece, or else fuse the keyframes around a frame.

        Its points are thinned.
        """
        result, found = self._result, None
        if self.piece[number] == result.largest_piece:
            found = stored_whole(self.folder, kind)
        return thinned(fused_whole(result, kind, number) if found is None else found)

    def _take(self, result: Reconstruction) -> None:
        """Take over what a reconstruction says."""
        self._result = result
        self.names, self.statuses = list(result.names), list(result.status)
        self.times, self.objects = list(result.times), result.objects
        self.poses, self.piece = result.poses, result.piece
        self.quantities: tuple[str, ...] = ("deviation",)
        self.quantities += ("object",) if result.settings.motion == "objects" else ()

    def _motions(self, number: int) -> dict[int, tuple[NDArray[np.float64], NDArray[np.float64]]]:
        """Return the motion before the camera to the next frame, of what is at rest and of things.

        Nothing where the two frames are not of one piece.
        """
        following = number + 1
        if following >= len(self.names) or not 0 <= self.piece[number] == self.piece[following]:
            return {}
        to_next = np.linalg.inv(self.poses[following])
        moves = {0: to_next @ self.poses[number]}
        for thing in self.objects:
            moved = _moved(thing, number)
            if moved is not None:
                moves[thing.id] = to_next @ moved @ self.poses[number]
        return {label: (rigid_twist(m[:3, :3], m[:3, 3]), m) for label, m in moves.items()}


def _moved(thing: MovingObject, number: int) -> NDArray[np.float64] | None:
    """Return how a thing moves in the world from a frame to the next, (4, 4), if it is known."""
    if number not in thing.frames or number + 1 not in thing.frames:
        return None
    here, there = (thing.poses[thing.frames.index(k)] for k in (number, number + 1))
    if not (np.isfinite(here).all() and np.isfinite(there).all()):
        return None
    moved: NDArray[np.float64] = there @ np.linalg.inv(here)
    return moved
