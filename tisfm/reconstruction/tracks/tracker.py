"""Point tracks: points follow the image motion, and are refined by their appearance."""

from dataclasses import dataclass

import cv2
import numpy as np

from tisfm.camera import Camera
from tisfm.reconstruction.frames.image_motion import find_flow, flow_scale, shrink_for_flow
from tisfm.reconstruction.tracks.settings import TRACKS
from tisfm.settings import Settings


@dataclass(frozen=True, kw_only=True)
class Observations:
    """Positions of tracks in a frame."""

    points: np.ndarray  # (N, 2) float64: (x, y), px from the upper left pixel's centre
    tracks: np.ndarray  # (N,) int64: track numbers, ascending

    @classmethod
    def from_arrays(cls, points: np.ndarray, tracks: np.ndarray) -> "Observations":
        """Return the observations with these arrays."""
        return cls(points=points, tracks=tracks)

    def to_arrays(self) -> tuple[np.ndarray, ...]:
        """Return the points and the track numbers."""
        return self.points, self.tracks

    def select(self, is_selected: np.ndarray) -> "Observations":
        """Return the observations where `is_selected`, (N,) bool, is true."""
        return Observations(points=self.points[is_selected], tracks=self.tracks[is_selected])

    def common_tracks(self, other: "Observations") -> tuple[np.ndarray, np.ndarray]:
        """Return the indices, in this frame and in another one, of the tracks that both see."""
        _, indices, other_indices = np.intersect1d(
            self.tracks, other.tracks, assume_unique=True, return_indices=True
        )
        return indices, other_indices


class Tracker:
    """Tracks points from each frame to the next."""

    def __init__(
        self,
        camera: Camera,  # pinhole camera of the frames
        settings: Settings,  # settings of the image motion
        # number of cells along the longer side: a new track begins in every cell without a track;
        # by default `TRACKS.cells`
        cells: int | None = None,
    ) -> None:
        self._camera, self._settings = camera, settings
        self._cells = TRACKS.cells if cells is None else cells
        self._grey: np.ndarray | None = None
        self._small: np.ndarray | None = None
        self._observations = Observations(points=np.empty((0, 2)), tracks=np.empty(0, np.int64))
        self._track_count = 0
        # (h, w, 2) float32: image motion of the last step, px of the shrunk frames; None before
        self.flow: np.ndarray | None = None

    def track(
        self,
        grey: np.ndarray,  # (H, W) uint8
        ignored: np.ndarray | None = None,  # (H, W) bool: pixels without tracks
        # (h, w, 2) float32: image motion from the previous frame at the size of `shrink_for_flow`,
        # px of the shrunk frame. By default it is computed.
        flow: np.ndarray | None = None,
    ) -> Observations:
        """Return the tracks in the next frame."""
        small = shrink_for_flow(grey)
        points, tracks = self._observations.points, self._observations.tracks
        if self._grey is not None and self._small is not None:
            if flow is None:
                scale = flow_scale(small, grey)
                flow = find_flow(self._small, small, scale, self._camera, self._settings)
            self.flow = flow
            points, is_tracked = track_points(self._grey, grey, points, flow)
            points, tracks = points[is_tracked], tracks[is_tracked]
            oldest_indices = keep_first_in_squares(
                points, TRACKS.min_track_distance * _cell_side(grey, self._cells)
            )
            points, tracks = points[oldest_indices], tracks[oldest_indices]
        if ignored is not None:
            x, y = np.rint(points).astype(np.intp).T
            points, tracks = points[~ignored[y, x]], tracks[~ignored[y, x]]
        new_points = choose_new_points(grey, points, ignored, self._cells)
        numbers = np.arange(self._track_count, self._track_count + len(new_points))
        self._track_count += len(new_points)
        self._grey, self._small = grey, small
        self._observations = Observations(
            points=np.vstack([points, new_points]), tracks=np.r_[tracks, numbers]
        )
        return self._observations


def track_points(
    # grey0, grey1: (H, W) uint8
    grey0: np.ndarray,
    grey1: np.ndarray,
    points: np.ndarray,  # (N, 2) float64
    flow: np.ndarray,  # (h, w, 2) float32: image motion from frame 0 to frame 1, px of this field
) -> tuple[np.ndarray, np.ndarray]:
    """Return the positions of points of frame 0 in frame 1, and the points that were found.

    The flow gives a first position. If a search by appearance succeeds near this position, the
    search's result replaces it. A point counts as found if tracking it back to frame 0 ends near
    its start, and its patches in both frames are similar. Few points pass these checks, but these
    points drift little.

    Returns the new positions, (N, 2) float64, and which points were found, (N,) bool.

    References
    ----------
    Lucas and Kanade, "An iterative image registration technique with an application to stereo
    vision", IJCAI 1981. Kalal, Mikolajczyk and Matas, "Forward-backward error", ICPR 2010,
    doi 10.1109/ICPR.2010.675.
    """
    height, width = grey0.shape
    if len(points) == 0:
        return points, np.zeros(0, bool)
    motion = _sample_flow(flow, points, grey0)
    predicted = points + motion
    refined, is_found = _search_points(grey0, grey1, points, predicted)
    is_refined = is_found & (np.hypot(*(refined - predicted).T) < TRACKS.max_search_distance)
    tracked = np.where(is_refined[:, None], refined, predicted)
    returned_points, is_tracked = _search_points(grey1, grey0, tracked, tracked - motion)
    is_tracked &= np.hypot(*(returned_points - points).T) < max(
        TRACKS.max_return_error, TRACKS.max_return_share * max(height, width)
    )
    max_position = np.array([width, height]) - 1 - TRACKS.border
    is_tracked &= ((tracked >= TRACKS.border) & (tracked <= max_position)).all(axis=1)
    difference = _sample_patches(grey0, points) - _sample_patches(grey1, tracked)
    difference -= difference.mean(axis=1, keepdims=True)
    is_tracked &= np.abs(difference).mean(axis=1) < TRACKS.max_patch_difference
    return tracked, is_tracked


def _search_points(
    grey0: np.ndarray, grey1: np.ndarray, points: np.ndarray, start: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Search for points of frame 0 near positions in frame 1; return positions and successes."""
    positions, status, _ = cv2.calcOpticalFlowPyrLK(
        grey0,
        grey1,
        points.astype(np.float32),
        start.astype(np.float32),
        winSize=(TRACKS.search_window, TRACKS.search_window),
        maxLevel=0,
        criteria=(
            cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS,
            TRACKS.search_rounds,
            TRACKS.search_tolerance,
        ),
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
        minEigThreshold=TRACKS.min_search_structure,
    )
    return positions.astype(np.float64), status[:, 0] > 0


def choose_new_points(
    grey: np.ndarray,  # (H, W) uint8
    points: np.ndarray,  # (M, 2) float64: existing points
    ignored: np.ndarray | None,  # (H, W) bool, or None
    cells: int,  # number of cells along the longer side
) -> np.ndarray:
    """Return the strongest corner of each cell without a point, (N, 2) float64.

    References
    ----------
    Shi and Tomasi, "Good features to track", CVPR 1994, doi 10.1109/CVPR.1994.323794.
    """
    height, width = grey.shape
    side = _cell_side(grey, cells)
    rows, columns = height // side, width // side
    if not rows * columns:
        return np.empty((0, 2))
    strength = cv2.cornerMinEigenVal(grey, TRACKS.structure_window)
    min_strength = max(
        float(np.quantile(strength[::2, ::2], TRACKS.structure_quantile)),
        TRACKS.min_corner_strength,
    )
    is_inside = np.zeros((height, width), bool)
    is_inside[TRACKS.border : -TRACKS.border, TRACKS.border : -TRACKS.border] = True
    if ignored is not None:
        is_inside &= ~ignored
    strength[~is_inside] = 0
    is_occupied = np.zeros((rows + 1, columns + 1), bool)
    column, row = (points / side).astype(np.intp).T
    is_occupied[row.clip(0, rows), column.clip(0, columns)] = True
    blocks = strength[: rows * side, : columns * side].reshape(rows, side, columns, side)
    blocks = blocks.transpose(0, 2, 1, 3).reshape(rows, columns, side * side)
    strongest = blocks.argmax(axis=-1)
    row, column = np.nonzero((blocks.max(axis=-1) > min_strength) & ~is_occupied[:rows, :columns])
    y, x = np.divmod(strongest[row, column], side)
    return np.stack([column * side + x, row * side + y], axis=1).astype(np.float64)


def _cell_side(grey: np.ndarray, cells: int) -> int:
    """Return the side of the cells in which new points begin, px."""
    return max(TRACKS.border, round(max(grey.shape) / cells))


def keep_first_in_squares(points: np.ndarray, side: float) -> np.ndarray:
    """Return the indices of the first point in each square of this side, ascending."""
    _, first = np.unique(points // side, axis=0, return_index=True)
    return np.sort(first)


def _sample_flow(flow: np.ndarray, points: np.ndarray, grey: np.ndarray) -> np.ndarray:
    """Return the flow at points of the frame, px of the frame."""
    scale = flow_scale(flow, grey)
    return _sample(flow, (points + 0.5) * scale - 0.5) / scale


def _sample(image: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Sample an image, (H, W) or (H, W, 2), at points, bilinearly; return (N,) or (N, 2)."""
    x, y = np.ascontiguousarray(points.T, np.float32)
    values = cv2.remap(
        image, x[:, None], y[:, None], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    return values[:, 0].astype(np.float64)


def _sample_patches(grey: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return the patches around points, (N, TRACKS.patch_side²) float32."""
    offsets = np.arange(TRACKS.patch_side, dtype=np.float32) - TRACKS.patch_side // 2
    dx, dy = (grid.ravel() for grid in np.meshgrid(offsets, offsets))
    x, y = (
        points[:, axis, None].astype(np.float32) + offset for axis, offset in enumerate((dx, dy))
    )
    patches = cv2.remap(grey, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return patches.reshape(len(points), -1).astype(np.float32)
