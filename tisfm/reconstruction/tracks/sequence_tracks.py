"""Tracking of a whole sequence: tracks in every frame, and the views for the camera path.

Views are the frames from which the path is built.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tisfm.camera import Camera
from tisfm.errors import InputError
from tisfm.reconstruction.frames.disk_cache import DiskCache
from tisfm.reconstruction.frames.image_motion import TRACKING_SETTINGS
from tisfm.reconstruction.tracks.settings import TRACKS
from tisfm.reconstruction.tracks.tracker import Observations, Tracker
from tisfm.reconstruction.tracks.views import View, ViewSelection


@dataclass(frozen=True, kw_only=True)
class SequenceTracks:
    """Tracks and views of a sequence."""

    observations: Sequence[Observations]  # tracks in every frame
    # the frames from which a path is built, in order; for given poses, only of photographs
    views: Sequence[View]
    # by pair of view indices: (N, 2) int array, the indices of the detected points that match
    matches: Mapping[tuple[int, int], np.ndarray]
    distinct_count: int  # number of frames that differ from one another
    shape: tuple[int, int]  # height and width of the frames, px


class SequenceTracker:
    """Tracks points through the frames of a sequence, and selects views."""

    def __init__(
        self,
        camera: Camera,  # pinhole camera of the frames
        *,
        # Whether matches of views have to fit the focal length of the camera. Otherwise any focal
        # length may fit.
        is_focal_known: bool = True,
        # Whether views are selected. If poses are given, only tracks are needed.
        selects_views: bool = True,
        # number of cells along the longer side, in which new tracks begin; by default
        # `TRACKS.cells`
        cells: int | None = None,
    ) -> None:
        self._tracker = Tracker(camera, TRACKING_SETTINGS, cells)
        self._observations = DiskCache(Observations.to_arrays, Observations.from_arrays)
        self._selects_views = selects_views
        self._views = ViewSelection(camera, is_focal_known=is_focal_known, on_disk=True)
        # Views with less motion between them: they are used if `_views` has few views.
        self._close_views: ViewSelection | None = ViewSelection(
            camera, is_focal_known=is_focal_known, on_disk=True
        )
        self._last_frame: tuple[np.ndarray, np.ndarray | None] | None = None

    def add(
        self,
        grey: np.ndarray,  # (H, W) uint8
        ignored: np.ndarray | None = None,  # (H, W) bool: pixels without tracks
        # (h, w, 2) float32: image motion from the previous frame, px of the shrunk frame
        flow: np.ndarray | None = None,
    ) -> None:
        """Track points into the next frame."""
        frame = len(self._observations)
        observations = self._tracker.track(grey, ignored, flow)
        if self._selects_views:
            longer_side = max(grey.shape)
            if self._views.needs_view(observations, longer_side):
                self._views.add(frame, grey, observations, ignored)
            if len(self._views.views) >= TRACKS.min_views:
                self._close_views = None
            elif self._close_views is not None and self._close_views.needs_view(
                observations, longer_side, TRACKS.min_close_motion
            ):
                self._close_views.add(frame, grey, observations, ignored)
        self._observations.append(observations)
        self._last_frame = grey, ignored

    @property
    def flow(self) -> np.ndarray | None:
        """Image motion from the last frame but one to the last frame, as for `add`."""
        return self._tracker.flow

    def finish(self) -> SequenceTracks:
        """Return the tracks and views of all frames.

        Raises InputError if frames are out of order.
        """
        if self._last_frame is None:
            return SequenceTracks(
                observations=(), views=(), matches={}, distinct_count=0, shape=(0, 0)
            )
        grey, ignored = self._last_frame
        selection = self._views if self._close_views is None else self._close_views
        distinct_count = len(selection.views)
        if self._selects_views:
            last = len(self._observations) - 1
            if not selection.views or selection.views[-1].frame != last:
                selection.add(last, grey, self._observations[last], ignored)
            selection.close_loops(grey.shape)
            if selection.is_out_of_order():
                raise InputError(
                    "frames are out of order: most do not match the frame before them, but match "
                    "other frames; sort them, or give a video"
                )
        return SequenceTracks(
            observations=self._observations,
            views=selection.views,
            matches=selection.matches,
            distinct_count=distinct_count,
            shape=grey.shape,
        )
