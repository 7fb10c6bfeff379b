"""A moving object of a result, and known lengths of moving objects."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace
from numbers import Real
from typing import Any, Literal, get_args

import cv2
import numpy as np

from tisfm.errors import InputError, InputTypeError
from tisfm.sources.frame_reader import is_integer

ScaleFrom = Literal["size", "contact", "around", "none"]
SCALES = get_args(ScaleFrom)


@dataclass(frozen=True, kw_only=True, eq=False)
class MovingObject:
    """A moving object: the frames that show it, and its path, if known.

    Attributes
    ----------
    id : int
        Its label, from 1 on.
    frames : tuple of int
        The frames in which it is labelled.
    boxes : (n, 4) int32
        Left, top, width and height of its label in each frame, px.
    poses : (n, 4, 4) float64
        Object to world in each frame; NaN where it is unknown. The origin is the median of the
        points of the object. The axes are the camera's axes in the first frame with a pose.
    extent : (3,) float64
        Its lengths along its axes, in the unit of the poses; NaN without poses. They are the extent
        of its points, without the outermost 3 % at both ends.
    scale_from : {"size", "contact", "around", "none"}
        Source of its scale, which motion alone does not give. ``"size"``: ``object_sizes`` of
        `tisfm.reconstruct`; ``"contact"``: its contact with the static scene; ``"around"``:
        roughly, the depth around it; ``"none"``: nothing gives it. An object without poses that has
        a scale has one depth in each frame: that of the place where it stands.
    message : str
        The reason why it has no poses, or few poses, and then where its depth is from.

    Examples
    --------
    >>> import tisfm
    >>> result = tisfm.Reconstruction.load("bodies")  # of ``motion="objects"``
    >>> moving = result.objects[0]
    >>> moving.id, moving.boxes.shape[1], moving.poses.shape[1:], moving.extent.shape
    (1, 4, (4, 4), (3,))
    >>> len(moving.frames) == len(moving.boxes) == len(moving.poses)
    True
    """

    id: int
    frames: tuple[int, ...]
    boxes: np.ndarray = field(repr=False)
    poses: np.ndarray = field(repr=False)
    extent: np.ndarray
    scale_from: ScaleFrom = "none"
    message: str = ""

    def rescaled(self, factor: float, frame_mask: np.ndarray) -> "MovingObject":
        """Return the object with lengths times a factor in some frames, `frame_mask` (N,) bool."""
        is_rescaled = frame_mask[list(self.frames)]
        poses = self.poses.copy()
        poses[is_rescaled, :3, 3] *= factor
        has_pose = np.isfinite(poses).all(axis=(1, 2))
        extent = self.extent * (factor if (is_rescaled & has_pose).any() else 1.0)
        return replace(self, poses=poses, extent=extent)

    def as_json(self) -> dict[str, Any]:
        """Return the entry of the object in ``objects.json``; None stands for an unknown value."""
        return {
            "id": self.id,
            "frames": list(self.frames),
            "boxes": self.boxes.tolist(),
            "poses": [pose.tolist() if np.isfinite(pose).all() else None for pose in self.poses],
            "extent": self.extent.tolist() if np.isfinite(self.extent).all() else None,
            "scale_from": self.scale_from,
            "message": self.message,
        }

    @classmethod
    def from_json(cls, entry: dict[str, Any]) -> "MovingObject":
        """Return the object from the values of `as_json`.

        Raises
        ------
        KeyError, TypeError, ValueError
            If the entry is not of this form.
        """
        count = len(entry["frames"])
        if entry["scale_from"] not in SCALES:
            raise InputError(f"scale_from is {entry['scale_from']!r}: expected one of {SCALES}")
        no_pose = np.full((4, 4), np.nan)
        poses = [no_pose if pose is None else pose for pose in entry["poses"]]
        extent = [np.nan] * 3 if entry["extent"] is None else entry["extent"]
        return cls(
            id=int(entry["id"]),
            frames=tuple(map(int, entry["frames"])),
            boxes=np.array(entry["boxes"], np.int32).reshape(count, 4),
            poses=np.array(poses, np.float64).reshape(count, 4, 4),
            extent=np.array(extent, np.float64).reshape(3),
            scale_from=entry["scale_from"],
            message=str(entry["message"]),
        )


def labelled_objects(
    count: int,  # number of frames
    labels_of: Callable[[int], np.ndarray],  # returns the labels of a frame, (H, W)
) -> list[MovingObject]:
    """Return the objects in the labels of frames, without paths."""
    frames: dict[int, list[int]] = {}
    boxes: dict[int, list[tuple[int, ...]]] = {}
    for frame in range(count):
        labels = labels_of(frame)
        for number in np.unique(labels[labels > 0]):
            frames.setdefault(int(number), []).append(frame)
            box = cv2.boundingRect(np.uint8(labels == number))
            boxes.setdefault(int(number), []).append(tuple(box))
    return [
        MovingObject(
            id=number,
            frames=tuple(frames[number]),
            boxes=np.array(boxes[number], np.int32),
            poses=np.full((len(frames[number]), 4, 4), np.nan),
            extent=np.full(3, np.nan),
        )
        for number in sorted(frames)
    ]


def check_object_sizes(sizes: Mapping[int, float] | None) -> dict[int, float]:
    """Check the lengths of objects, and return them by object id.

    Raises TypeError, ValueError if an id is not a whole number, or a length is not positive.
    """
    if sizes is not None and not isinstance(sizes, Mapping):
        raise InputTypeError(
            f"object_sizes is {sizes!r}: expected lengths by ids, such as {{1: 4.5}}"
        )
    lengths: dict[int, float] = {}
    for number, size in (sizes or {}).items():
        if not is_integer(number):
            raise InputTypeError(f"object_sizes has the id {number!r}: expected a whole number")
        if isinstance(size, bool) or not isinstance(size, Real):
            raise InputTypeError(f"object_sizes[{number}] is {size!r}: expected a length")
        if not (np.isfinite(size) and size > 0):
            raise InputError(f"object_sizes[{number}] is {size}: expected a positive length")
        lengths[int(number)] = float(size)
    return lengths


def refuse_unknown_ids(sizes: Collection[int], object_ids: Collection[int]) -> None:
    """Raise InputError if a size belongs to an unknown object."""
    unknown_ids = sorted(set(sizes) - set(object_ids))
    if unknown_ids:
        ids = ", ".join(map(str, sorted(object_ids))) or "none"
        raise InputError(
            f"object_sizes has ids without an object: {', '.join(map(str, unknown_ids))}; the ids "
            f"of moving objects are: {ids}"
        )
