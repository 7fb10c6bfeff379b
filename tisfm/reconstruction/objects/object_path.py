"""Path and depth of a moving object, in its own axes.

In the axes of the object, the object rests and the camera moves. For this reason path and depth
come from the same methods as in a static scene, applied to the pixels of the object alone.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from tisfm.camera import Camera
from tisfm.reconstruction.depth.segment_depth import FrameDepth, Frames, PieceDepths, depth_effort
from tisfm.reconstruction.frames.prepared_frames import PreparedFrames
from tisfm.reconstruction.mapping.solution import Piece
from tisfm.reconstruction.objects.settings import OBJECTS
from tisfm.reconstruction.path.path_solver import find_path
from tisfm.reconstruction.result.moving_object import MovingObject
from tisfm.reconstruction.tracks.settings import TRACKS
from tisfm.reconstruction.tracks.tracker import Observations
from tisfm.settings import Settings

# px: the box of an object starts at a multiple of this number, so that it has whole pixels on the
# coarsest matched level.
BOX_ALIGNMENT = 16


@dataclass(frozen=True, kw_only=True)
class ObjectPath:
    """Path and depth of an object, in the axes of the object and an arbitrary unit."""

    frames: list[int]  # frames of the sequence; `model` and `depths` use the indices of this list
    model: Piece  # poses, camera to object, and the points of the object
    depths: list[FrameDepth]

    def points(self) -> np.ndarray:
        """Return the points of the object, (N, 3)."""
        return np.array([*self.model.points.values()]).reshape(-1, 3)


class _ObjectFrames:
    """The frames that show an object; only pixels of the object are used."""

    def __init__(
        self,
        frames: PreparedFrames,
        numbers: Sequence[int],  # frames that show the object
        object_id: int,
    ) -> None:
        self.camera: Camera = frames.camera
        self.shape = frames.shape
        self._frames, self._numbers, self._object_id = frames, numbers, object_id

    def grey(self, number: int) -> np.ndarray:
        """Return a frame, (H, W) float32."""
        return self._frames.grey(self._numbers[number])

    def flow(self, number: int) -> np.ndarray | None:
        """Return the image motion from the previous frame; None if it is unknown."""
        frame = self._numbers[number]
        follows = number > 0 and self._numbers[number - 1] == frame - 1
        return self._frames.flow(frame) if follows else None

    def used_pixels(self, number: int) -> np.ndarray:
        """Return the mask of the object, (H, W) bool."""
        return self._frames.labels(self._numbers[number]) == self._object_id


def find_object_path(
    obj: MovingObject,
    frames: PreparedFrames,  # with labels
    settings: Settings,
    *,
    with_depth: bool = True,  # whether depth is computed in addition to the path
) -> ObjectPath | str:
    """Return the path and depth of an object, or the reason why it has none."""
    pixel_counts = {frame: (frames.labels(frame) == obj.id).sum() for frame in obj.frames}
    numbers = [frame for frame, count in pixel_counts.items() if count >= OBJECTS.min_object_pixels]
    if len(numbers) < OBJECTS.min_path_frames:
        return f"it is too small, or seen in fewer than {OBJECTS.min_path_frames} frames"
    object_frames = _ObjectFrames(frames, numbers, obj.id)
    object_side = float(np.median(np.sqrt(obj.boxes[:, 2] * obj.boxes[:, 3])))
    frame_side = max(frames.shape)
    cells = min(
        TRACKS.cells * frame_side / max(object_side, 1.0), frame_side / OBJECTS.min_track_distance
    )
    square = np.ones((OBJECTS.track_rim, OBJECTS.track_rim), np.uint8)

    def tracker_input(number: int) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
        grey = np.rint(object_frames.grey(number)).clip(0, 255).astype(np.uint8)
        eroded_mask = cv2.erode(np.uint8(object_frames.used_pixels(number)), square)
        return grey, eroded_mask == 0, object_frames.flow(number)

    try:
        path = find_path(
            map(tracker_input, range(len(numbers))),
            frames.camera,
            readout=0.0,
            cells=max(TRACKS.cells, round(cells)),
            is_focal_known=False,
        )
    except ValueError:  # the views do not fit together
        return "its tracks do not fit one rigid motion"
    pieces = path.pieces_with_positions
    if not pieces:
        return "its motion gives no depth: it hardly turns or changes its distance, or is not rigid"
    piece = max(pieces, key=lambda piece: len(piece.poses))
    object_path = ObjectPath(frames=numbers, model=piece, depths=[])
    if not with_depth:
        return object_path
    depths = find_object_depths(object_frames, piece, path.observations, settings)
    return replace(object_path, depths=depths)


def find_object_depths(
    frames: Frames,
    piece: Piece,
    observations: Sequence[Observations],  # tracks of every frame, on used pixels
    settings: Settings,
) -> list[FrameDepth]:
    """Return the depth of frames within the bounding box of the used pixels of all frames.

    Pixels outside the box get no depth.
    """
    crop = _CroppedFrames(frames, _bounding_box(frames, piece.poses))
    top, left = crop.corner
    tracks = [replace(item, points=item.points - (left, top)) for item in observations]
    depths = PieceDepths(
        crop, piece, tracks, settings, effort=depth_effort(settings), uncropped_shape=frames.shape
    )
    return [crop.uncrop(depth) for depth in depths]


def _bounding_box(frames: Frames, numbers: Iterable[int]) -> tuple[slice, slice]:
    """Return the rows and columns of the bounding box of used pixels, with a margin."""
    mask = np.zeros(frames.shape, bool)
    for number in numbers:
        used_pixels = frames.used_pixels(number)
        mask |= True if used_pixels is None else used_pixels
    left, top, width, height = cv2.boundingRect(np.uint8(mask))
    rows, columns = (
        slice(
            max(0, first - OBJECTS.box_margin) // BOX_ALIGNMENT * BOX_ALIGNMENT,
            min(first + length + OBJECTS.box_margin, limit),
        )
        for first, length, limit in zip((top, left), (height, width), frames.shape, strict=True)
    )
    return rows, columns


class _CroppedFrames:
    """Crops of frames, and the camera of the crops."""

    def __init__(
        self,
        frames: Frames,
        box: tuple[slice, slice],  # rows and columns of the crop in the frame, px
    ) -> None:
        self._frames, self._box = frames, box
        rows, columns = box
        self.corner = rows.start, columns.start
        self.shape = rows.stop - rows.start, columns.stop - columns.start
        cx, cy = frames.camera.center_for(*frames.shape)
        self.camera = replace(frames.camera, center=(cx - columns.start, cy - rows.start))

    def grey(self, number: int) -> np.ndarray:
        """Return the crop of a frame, (h, w) float32."""
        return np.ascontiguousarray(self._frames.grey(number)[self._box])

    def used_pixels(self, number: int) -> np.ndarray | None:
        """Return the used pixels, (h, w) bool; None for all."""
        used_pixels = self._frames.used_pixels(number)
        return None if used_pixels is None else np.ascontiguousarray(used_pixels[self._box])

    def uncrop(self, depth: FrameDepth) -> FrameDepth:
        """Return the depth of a crop in the size of the whole frame."""
        inverse_depth, deviation = (
            np.full(self._frames.shape, value, np.float32) for value in (np.nan, np.inf)
        )
        inverse_depth[self._box], deviation[self._box] = depth.inverse_depth, depth.deviation
        return FrameDepth(frame=depth.frame, inverse_depth=inverse_depth, deviation=deviation)
