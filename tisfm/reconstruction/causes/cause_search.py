"""The search for the cause of missing poses in the frames of a sequence."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from tisfm.camera import Camera
from tisfm.reconstruction.causes.cause import explain_images
from tisfm.reconstruction.causes.image_measures import ImageMeasures
from tisfm.reconstruction.causes.settings import CAUSES
from tisfm.reconstruction.causes.track_measures import TrackMeasures
from tisfm.reconstruction.frames.image_motion import flow_scale, shrink_for_flow
from tisfm.reconstruction.tracks.tracker import Observations
from tisfm.reconstruction.tracks.views import View
from tisfm.status import Status


@dataclass(frozen=True, kw_only=True)
class CauseSearch:
    """Finds why frames have no pose."""

    observations: Sequence[Observations]  # tracks in every frame
    views: Sequence[View]
    matches: Mapping[tuple[int, int], np.ndarray]  # by pair of view indices: (N, 2) indices
    camera: Camera  # pinhole camera
    shape: tuple[int, int]
    # frame → (H, W) uint8; None if images are no longer known
    grey: Callable[[int], np.ndarray] | None

    @classmethod
    def of_images(
        cls,
        observations: Sequence[Observations],
        camera: Camera,
        shape: tuple[int, int],
        grey: Callable[[int], np.ndarray] | None,
    ) -> "CauseSearch":
        """Return a search for what the images show, without the matches of views."""
        return cls(
            observations=observations,
            views=(),
            matches={},
            camera=camera.pinhole(),
            shape=shape,
            grey=grey,
        )

    def find_image_cause(self, frames: Sequence[int]) -> Status | None:
        """Return what the images of consecutive frames show against a path; None for nothing."""
        if self.grey is None or len(self.observations) < 2:
            return None
        count = min(len(frames), CAUSES.max_frames)
        chosen = [frames[k] for k in np.linspace(0, len(frames) - 1, count).astype(int)]
        numbers = [(frame, self._choose_neighbour(frame)) for frame in chosen]
        grey = {frame: self.grey(frame) for frame in {*chosen, *(pair[1] for pair in numbers)}}
        small = {frame: shrink_for_flow(image) for frame, image in grey.items()}
        pairs = [(small[first], small[second]) for first, second in numbers]
        scale = flow_scale(small[chosen[0]], grey[chosen[0]])
        survival = [self._measure_survival(first, second) for first, second in numbers]
        is_cut = np.array(survival) < CAUSES.max_cut_survival
        if is_cut.sum() >= max(CAUSES.min_broken_pairs, CAUSES.min_broken_share * len(numbers)):
            is_cut[:] = False  # tracks end everywhere: light may be the reason
        points: list[tuple[np.ndarray, np.ndarray] | None] = []
        for (first, second), share, at_cut in zip(numbers, survival, is_cut, strict=True):
            if at_cut:
                points.append(None)
            elif share < CAUSES.min_light_survival:
                points.append((np.zeros((0, 2)), np.zeros((0, 2))))
            else:
                points.append(self._find_shared_points(first, second, scale))
        return explain_images(
            ImageMeasures(pairs=pairs, points=points), self.measure_tracks(frames)
        )

    def _choose_neighbour(self, frame: int) -> int:
        """Return the next frame; at a cut or at the end, the frame before, if tracks go on."""
        last = len(self.observations) - 1
        if frame == last:
            return frame - 1
        if frame and self._measure_survival(frame, frame + 1) < CAUSES.max_cut_survival:
            return max(frame + 1, frame - 1, key=partial(self._measure_survival, frame))
        return frame + 1

    def _measure_survival(self, first: int, second: int) -> float:
        """Return the share of the tracks of a frame that another frame shows."""
        tracks = self.observations[first]
        common, _ = tracks.common_tracks(self.observations[second])
        return len(common) / max(1, len(tracks.tracks))

    def _find_shared_points(
        self, first: int, second: int, scale: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the points of tracks that two frames share, px of shrunk frames."""
        before, after = self.observations[first], self.observations[second]
        rows, others = before.common_tracks(after)
        return (before.points[rows] + 0.5) * scale - 0.5, (after.points[others] + 0.5) * scale - 0.5

    def shows_cut(self, frame: int) -> bool:
        """Return whether hardly any track of the frame before goes on in a frame."""
        if frame == 0:
            return False
        before = self.observations[frame - 1]
        common, _ = before.common_tracks(self.observations[frame])
        return len(common) < CAUSES.max_cut_survival * len(before.tracks)

    def measure_tracks(self, frames: Sequence[int]) -> TrackMeasures:
        """Return the measures of the tracks of consecutive frames."""
        return TrackMeasures(
            frames=frames,
            observations=self.observations,
            views=self.views,
            matches=self.matches,
            camera=self.camera,
            shape=self.shape,
        )
