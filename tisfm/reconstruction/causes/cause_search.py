"""The search for the cause of missing poses in the frames of a sequence."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tisfm.camera import Camera
from tisfm.reconstruction.causes.cause import image_cause
from tisfm.reconstruction.causes.image_measures import measure_images
from tisfm.reconstruction.causes.settings import CAUSES
from tisfm.reconstruction.causes.track_measures import TrackMeasures, measure_tracks
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

    def find_image_cause(self, frames: Sequence[int]) -> Status | None:
        """Return what the images of consecutive frames show against a path; None for nothing."""
        if self.grey is None or len(self.observations) < 2:
            return None
        last = len(self.observations) - 1
        count = min(len(frames), CAUSES.max_frames)
        chosen = [frames[k] for k in np.linspace(0, len(frames) - 1, count).astype(int)]
        numbers = [(frame, frame + 1 if frame < last else frame - 1) for frame in chosen]
        shared = []
        for first, second in numbers:
            before, after = self.observations[first], self.observations[second]
            rows, others = before.common_tracks(after)
            if len(rows) < CAUSES.min_light_survival * len(before.tracks):
                rows, others = rows[:0], others[:0]
            shared.append((before.points[rows], after.points[others]))
        images = measure_images(
            [(self.grey(first), self.grey(second)) for first, second in numbers], shared
        )
        return image_cause(images, self.measure_tracks(frames))

    def shows_cut(self, frame: int) -> bool:
        """Return whether hardly any track of the frame before goes on in a frame."""
        if frame == 0:
            return False
        before = self.observations[frame - 1]
        common, _ = before.common_tracks(self.observations[frame])
        return len(common) < CAUSES.max_cut_survival * len(before.tracks)

    def measure_tracks(self, frames: Sequence[int]) -> TrackMeasures:
        """Return the measures of the tracks of consecutive frames."""
        return measure_tracks(
            frames, self.observations, self.views, self.matches, self.camera, self.shape
        )
