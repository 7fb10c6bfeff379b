"""The camera's path through a sequence without end: old poses stay, new ones continue them."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tisfm.camera import Camera
from tisfm.outcome import Status
from tisfm.reconstruction.database import View
from tisfm.reconstruction.mapping import continued, models_of
from tisfm.reconstruction.path import TRACKING, why_lost, with_others
from tisfm.reconstruction.self_calibration import FocalEstimate, models_and_focal
from tisfm.reconstruction.tracks import Seen, Tracker
from tisfm.reconstruction.views import Views
from tisfm.reconstruction.way import Piece

REMEMBERED = 16  # views with poses that stay, from which the path is continued
ANCHORS = 6  # of them at least: where there are fewer, later ones stay as well


@dataclass(frozen=True, kw_only=True)
class Stretch:
    """Poses of the frames that are remembered.

    Attributes
    ----------
    pieces : dict of int to Piece
        By their numbers, which they keep.
    held : dict of int to (4, 4) float64
        Poses that stay as they are, by frame.
    lost : dict of int to Status
        Frames that have not been settled, and have no pose.
    """

    pieces: dict[int, Piece]
    held: dict[int, np.ndarray]
    lost: dict[int, Status]


class Remembered(Sequence[Seen]):
    """Tracks in every frame of a sequence, of which early ones are forgotten."""

    def __init__(self) -> None:
        self._seen: dict[int, Seen] = {}
        self._count = 0

    def append(self, seen: Seen) -> None:
        """Add the next frame."""
        self._seen[self._count] = seen
        self._count += 1

    def frames(self) -> list[int]:
        """Return the frames that are remembered."""
        return list(self._seen)

    def forget(self, frame: int) -> None:
        """Forget a frame."""
        del self._seen[frame]

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, frame: int) -> Seen:  # type: ignore[override]
        return self._seen[frame]

    def __iter__(self) -> Iterator[Seen]:
        return iter(self._seen.values())


class SlidingPath:
    """Takes the frames of a sequence one after the other, and finds where the camera was.

    Poses that have been settled stay. The path of later frames is grown from the last views whose
    poses are settled, and so in their axes and of their scale.

    Parameters
    ----------
    camera : Camera
        A pinhole, of the frames.
    focal_known : bool
        Or its focal length is a guess: it is found with the first path, and stays.

    Attributes
    ----------
    camera : Camera
    focal : FocalEstimate or None
        If it was to be found, and was.
    seen : Remembered
        Tracks in every frame.
    settled : int
        Frames up to this one have their final poses, or none for ever; −1 before there are any.
    """

    def __init__(self, camera: Camera, *, focal_known: bool = True) -> None:
        self.camera = camera
        self.focal: FocalEstimate | None = None
        self._focal_known = focal_known
        self.seen = Remembered()
        self.settled = -1
        self._tracker = Tracker(camera, TRACKING)
        self._views = Views(camera, focal_known=focal_known)
        self._last: tuple[np.ndarray, np.ndarray | None]
        self._shape = (0, 0)
        self._held: dict[int, dict[int, np.ndarray]] = {}  # poses that stay, by piece and frame
        self._pieces = 0

    def add(self, grey: np.ndarray, ignored: np.ndarray | None = None) -> None:
        """Take the next frame, (H, W) uint8, and which of its pixels to ignore, (H, W) bool."""
        seen = self._tracker.go_on(grey, ignored)
        if self._views.needs(seen, max(grey.shape)):
            self._views.add(len(self.seen), grey, seen, ignored)
        self.seen.append(seen)
        self._last = grey, ignored

    def found(self, *, at_end: bool = False) -> Stretch:
        """Return the path of the frames that are remembered; at the end, no more will come."""
        views, (grey, ignored) = self._views, self._last
        self._shape = grey.shape
        last, different = len(self.seen) - 1, len(views.chosen)
        if at_end and (not views.chosen or views.chosen[-1].frame != last):
            views.add(last, grey, self.seen[last], ignored)
        views.close_loops(self._shape)
        settled = {frame for poses in self._held.values() for frame in poses}
        left = [k for k, view in enumerate(views.chosen) if view.frame not in settled]
        pieces: dict[int, Piece] = {}
        for number in sorted(self._held, key=lambda one: -max(self._held[one])):
            held = self._held[number]
            known = [k for k, view in enumerate(views.chosen) if view.frame in held]
            model = continued(*self._among(sorted(known + left)), self.camera, self._shape, held)
            poses = dict(sorted({**model.poses, **held}.items()))
            pieces[number] = Piece(poses=poses, views=tuple(model.poses), points=model.points)
            left = [k for k in left if views.chosen[k].frame not in model.poses]
        among = self._among(left)
        if self._focal_known:
            models = models_of(*among, self.camera, self._shape)
        else:
            models, self.focal = models_and_focal(*among, self.camera, self._shape, "focal")
            if self.focal is not None:  # from now on it is known
                self.camera, self._focal_known = self.focal.taken(self.camera), True
                views.use(self.camera)
        for model in sorted(models, key=lambda one: min(one.poses)):
            number = max([*pieces, self._pieces - 1]) + 1
            pieces[number] = Piece(poses=model.poses, views=tuple(model.poses), points=model.points)
        later = [frame for frame in self.seen.frames() if frame > self.settled]
        complete, unplaced = with_others(
            list(pieces.values()), self.seen, later, self.camera, self._shape
        )
        lost = {frame: why_lost(self.seen[frame], complete, different) for frame in unplaced}
        return Stretch(
            pieces=dict(zip(pieces, complete, strict=True)),
            held={frame: pose for poses in self._held.values() for frame, pose in poses.items()},
            lost=lost,
        )

    def settle(self, last: int, pieces: Mapping[int, Piece]) -> None:
        """Let the poses of frames up to the last one stay as they are in these pieces."""
        self.settled = last
        for number, piece in pieces.items():
            if min(piece.poses) > last:
                continue
            held = {frame: pose for frame, pose in piece.poses.items() if frame <= last}
            missing = ANCHORS - sum(frame in held for frame in piece.views)
            later = [frame for frame in sorted(piece.views) if frame > last]
            held.update({frame: piece.poses[frame] for frame in later[: max(0, missing)]})
            self._held[number] = held
            self._pieces = max(self._pieces, number + 1)

    @property
    def pieces(self) -> set[int]:
        """The pieces that can be continued."""
        return set(self._held)

    def forget(self, before: int, *, kept: set[int]) -> list[int]:
        """Forget frames before this one, unless they are kept; return those that were forgotten."""
        views = self._views
        frames = [view.frame for view in views.chosen]
        settled = sum(frame <= self.settled for frame in frames)
        views.forget(max(0, settled - REMEMBERED))
        of_views = {view.frame for view in views.chosen}
        gone = [frame for frame in self.seen.frames() if frame < before and frame not in kept]
        for frame in gone:
            self.seen.forget(frame)
        there = of_views.union(self.seen.frames())
        for number, held in list(self._held.items()):
            self._held[number] = {frame: pose for frame, pose in held.items() if frame in there}
            if sum(frame in held for frame in of_views) < 2:
                del self._held[number]
        return gone

    def _among(
        self, numbers: Sequence[int]
    ) -> tuple[list[View], dict[tuple[int, int], np.ndarray]]:
        """Return some of the views, and their matches."""
        place = {number: k for k, number in enumerate(numbers)}
        matches = {
            (place[earlier], place[later]): both
            for (earlier, later), both in self._views.matches.items()
            if earlier in place and later in place
        }
        return [self._views.chosen[number] for number in numbers], matches
