"""Labels of moving objects for every frame of a sequence."""

from collections.abc import Iterator, Sequence

import cv2
import numpy as np

from tisfm.camera import Camera
from tisfm.reconstruction.frames.disk_cache import DiskCache
from tisfm.reconstruction.frames.frame_flow import TRACKING_SETTINGS
from tisfm.reconstruction.frames.image_motion import ImageMotion
from tisfm.reconstruction.objects.below_ground import BelowGround, StaticDepth
from tisfm.reconstruction.objects.identities import MAX_OBJECTS, ObjectTracker
from tisfm.reconstruction.objects.motion_evidence import (
    STATIC_EVIDENCE,
    Evidence,
    accumulate_evidence,
    evidence_of,
)
from tisfm.reconstruction.objects.moving_regions import REGION_EVIDENCE
from tisfm.reconstruction.objects.path_evidence import path_evidence

# Static depth needs evidence of more than KNOWN frames, with a mean below HALF.
KNOWN, HALF = 0.3, STATIC_EVIDENCE / 2


class SequenceLabels:
    """Finds the moving objects of a sequence, frame by frame."""

    def __init__(
        self,
        camera: Camera,  # A pinhole, for the frames. A guessed focal length is enough.
    ) -> None:
        self._motion = ImageMotion(camera, TRACKING_SETTINGS)
        self._shape = (0, 0)
        self._evidence = DiskCache(Evidence.arrays, Evidence.of_arrays)
        self._together: Sequence[Evidence] = ()

    def add(self, grey: np.ndarray) -> None:
        """Take the next frame, (H, W) uint8."""
        self._shape = grey.shape
        self._motion.add(grey)

    def found(
        self,
        # sequence of (4, 4) array or None: camera to world, if the path is known; the evidence of
        # many frames under this path is added. None for a frame without a pose.
        poses: Sequence[np.ndarray | None] | None = None,
        camera: Camera | None = None,  # the pinhole, for the frames, with which the path was found
    ) -> Iterator[np.ndarray]:
        """Yield the labels of every frame, (H, W) uint8: 0 for static pixels, or an object id."""
        ground = None
        if poses is not None and camera is not None:
            ground = self._add_path(poses, camera)
        elif not len(self._evidence):
            for frame in range(len(self._motion)):
                self._evidence.append(evidence_of(self._motion, frame))
        self._together = accumulate_evidence(self._motion, self._evidence)
        labels = ObjectTracker(self._motion, self._together).labels()
        for labelled in labels if ground is None else self._with_ground(labels, ground):
            yield enlarge_labels(labelled, self._motion.share, self._shape)

    def _add_path(self, poses: Sequence[np.ndarray | None], camera: Camera) -> BelowGround:
        """Add the evidence of the camera path, and return the search below the ground."""
        small = self._motion.camera(camera)
        both = DiskCache(Evidence.arrays, Evidence.of_arrays)
        depths = DiskCache(StaticDepth.arrays, StaticDepth.of_arrays)
        for frame, own in enumerate(self._evidence):
            moving = self._together[frame].mean() > REGION_EVIDENCE
            more = path_evidence(self._motion, frame, poses, small, moving)
            if more is None:
                both.append(own)
                depths.append(StaticDepth.unknown(moving.shape))
                continue
            many, inverse_depth = more
            both.append(own.judged_by(many))
            at_rest = ~moving & (many.weight > KNOWN) & (many.moving < HALF * many.weight)
            depths.append(StaticDepth(inverse_depth=inverse_depth, at_rest=at_rest))
        self._evidence = both
        return BelowGround(self._motion, poses, small, depths)

    def _with_ground(
        self, labels: Iterator[np.ndarray], ground: BelowGround
    ) -> Iterator[np.ndarray]:
        """Yield the labels of every frame, with objects below the ground added.

        They get ids of their own. Their lower boundary on the ground is unknown, so a region below
        the ground may run into another moving object.
        """
        known: DiskCache[np.ndarray] = DiskCache(lambda labels: (labels,), lambda labels: labels)
        evidence = DiskCache(Evidence.arrays, Evidence.of_arrays)
        count, is_any = 0, False
        for frame, labelled in enumerate(labels):
            known.append(labelled)
            count = max(count, int(labelled.max()))
            own = self._evidence[frame].at_rest_in(labelled > 0)
            below = ground.evidence(frame, labelled > 0)
            is_any |= below is not None
            evidence.append(own if below is None else own.overruled_by(below))
        if not is_any:
            yield from known
            return
        more = ObjectTracker(self._motion, accumulate_evidence(self._motion, evidence)).labels()
        for labelled, others in zip(known, more, strict=True):
            is_new = (labelled == 0) & (others > 0) & (others <= MAX_OBJECTS - count)
            yield np.where(is_new, others + np.uint8(count), labelled)


def enlarge_labels(
    labels: np.ndarray,  # (h, w) array
    share: float,  # pixels of the shrunk frames per pixel of the frames
    shape: Sequence[int],  # height and width of the frames, px
) -> np.ndarray:
    """Return labels of shrunk frames, (h, w), in the size of the frames, (H, W) uint8."""
    if share == 1:
        return labels.astype(np.uint8)
    height, width = shape
    size = round(labels.shape[1] / share), round(labels.shape[0] / share)
    best, found = np.full((height, width), 0.5, np.float32), np.zeros((height, width), np.uint8)
    for number in np.unique(labels[labels > 0]):
        mine = cv2.resize(np.float32(labels == number), size, interpolation=cv2.INTER_CUBIC)
        mine = mine[:height, :width]
        found[mine > best] = number
        best = np.maximum(best, mine)
    return found
