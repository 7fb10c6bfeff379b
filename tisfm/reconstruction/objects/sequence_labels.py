"""Labels of moving objects in every frame, and the camera path from the static pixels."""

from collections.abc import Iterator, Sequence

import cv2
import numpy as np

from tisfm.camera import Camera
from tisfm.reconstruction.frames.disk_cache import DiskCache
from tisfm.reconstruction.frames.image_motion import TRACKING_SETTINGS, ImageMotion
from tisfm.reconstruction.frames.prepared_frames import PreparedFrames
from tisfm.reconstruction.objects.identities import ObjectTracker
from tisfm.reconstruction.objects.label_propagation import propagate_labels
from tisfm.reconstruction.objects.motion_evidence import (
    Evidence,
    accumulate_evidence,
    frame_evidence,
)
from tisfm.reconstruction.objects.path_evidence import BelowGroundSearch, StaticDepth, path_evidence
from tisfm.reconstruction.objects.settings import OBJECTS
from tisfm.reconstruction.objects.tracked_objects import MAX_OBJECTS


class SequenceLabels:
    """The search for the moving objects of a sequence."""

    def __init__(
        self,
        camera: Camera,  # A pinhole, for the frames. A guessed focal length is enough.
    ) -> None:
        self._motion = ImageMotion(camera, TRACKING_SETTINGS)
        self._shape = (0, 0)
        self._pair_evidence = _evidence_cache()
        self._pair_focal = 0.0  # px: focal length that the evidence of frame pairs belongs to

    @classmethod
    def of_frames(cls, frames: PreparedFrames) -> "SequenceLabels":
        """Return a search with all of the frames."""
        search = cls(frames.camera)
        for number in range(frames.count):
            search.add(frames.tracker_input(number)[0])
        return search

    def add(self, grey: np.ndarray) -> None:
        """Take the next frame, (H, W) uint8."""
        self._shape = grey.shape
        self._motion.add(grey)

    def labels(
        self,
        # sequence of (4, 4) array or None: camera to world, None for a frame without a pose. With
        # poses, the evidence of many frames under this path is added.
        poses: Sequence[np.ndarray | None] | None = None,
        camera: Camera | None = None,  # the pinhole camera of the path, for the frames
    ) -> Iterator[np.ndarray]:
        """Yield the labels of every frame, (H, W) uint8: 0 for static pixels, or an object id."""
        camera = self._motion.camera(camera)
        evidence = self._find_pair_evidence(camera)
        accumulated = accumulate_evidence(self._motion, evidence)
        ground = None
        if poses is not None:
            evidence, ground = self._add_path(evidence, accumulated, poses, camera)
            accumulated = accumulate_evidence(self._motion, evidence)
        labels = ObjectTracker(self._motion, evidence, accumulated).labels()
        if ground is not None:
            labels = self._with_ground(labels, evidence, ground)
        for frame_labels in labels:
            yield enlarge_labels(frame_labels, self._motion.scale, self._shape)

    def _find_pair_evidence(self, camera: Camera) -> Sequence[Evidence]:
        """Return the evidence of frame pairs, of every frame; it is kept for a similar camera."""
        change = abs(np.log(camera.focal / self._pair_focal)) if self._pair_focal else np.inf
        if change > OBJECTS.max_focal_change:
            self._pair_evidence, self._pair_focal = _evidence_cache(), camera.focal
            for frame in range(len(self._motion)):
                self._pair_evidence.append(frame_evidence(self._motion, frame, camera))
        return self._pair_evidence

    def _add_path(
        self,
        evidence: Sequence[Evidence],  # of frame pairs, by frame
        accumulated: Sequence[Evidence],  # the same, accumulated over frames
        poses: Sequence[np.ndarray | None],
        camera: Camera,  # of the frames of the image motion
    ) -> tuple[Sequence[Evidence], BelowGroundSearch]:
        """Return the evidence with that of the camera path, and the search below the ground."""
        summed_evidence = _evidence_cache()
        depths = DiskCache(StaticDepth.to_arrays, StaticDepth.from_arrays)
        for frame, pair_evidence in enumerate(evidence):
            moving_pixels = accumulated[frame].mean() > OBJECTS.region_evidence
            path_result = path_evidence(self._motion, frame, poses, camera, moving_pixels)
            if path_result is None:
                summed_evidence.append(pair_evidence)
                depths.append(StaticDepth.empty(moving_pixels.shape))
                continue
            multi_frame, inverse_depth = path_result
            summed_evidence.append(pair_evidence.combine_with(multi_frame))
            max_total = OBJECTS.max_static_mean * multi_frame.weight
            static_pixels = ~moving_pixels & (multi_frame.weight > OBJECTS.min_static_weight)
            static_pixels &= multi_frame.total < max_total
            depths.append(StaticDepth(inverse_depth=inverse_depth, static_pixels=static_pixels))
        return summed_evidence, BelowGroundSearch(self._motion, poses, camera, depths)

    def _with_ground(
        self,
        labels: Iterator[np.ndarray],
        pair_and_path_evidence: Sequence[Evidence],  # by frame
        ground: BelowGroundSearch,
    ) -> Iterator[np.ndarray]:
        """Yield the labels of every frame, with objects below the ground added under new ids.

        The lower boundary of such an object on the ground is unknown. For this reason its region
        may extend into another moving object, which keeps its label.
        """
        cache: DiskCache[np.ndarray] = DiskCache(lambda labels: (labels,), lambda labels: labels)
        evidence = _evidence_cache()
        max_id, has_objects = 0, False
        for frame, frame_labels in enumerate(labels):
            cache.append(frame_labels)
            max_id = max(max_id, int(frame_labels.max()))
            static_evidence = pair_and_path_evidence[frame].with_static_pixels(frame_labels > 0)
            below_ground = ground.evidence(frame, frame_labels > 0)
            has_objects |= below_ground is not None
            evidence.append(
                static_evidence
                if below_ground is None
                else static_evidence.override_with(below_ground)
            )
        if not has_objects:
            yield from cache
            return
        accumulated = accumulate_evidence(self._motion, evidence)
        other_labels = ObjectTracker(self._motion, evidence, accumulated).labels()
        for frame_labels, other in zip(cache, other_labels, strict=True):
            is_new = (frame_labels == 0) & (other > 0) & (other <= MAX_OBJECTS - max_id)
            yield np.where(is_new, other + np.uint8(max_id), frame_labels)


def _evidence_cache() -> DiskCache[Evidence]:
    return DiskCache(Evidence.to_arrays, Evidence.from_arrays)


def enlarge_labels(
    labels: np.ndarray,  # (h, w) array: labels of the shrunk frames
    scale: float,  # pixels of the shrunk frames per pixel of the frames
    shape: Sequence[int],  # height and width of the frames, px
) -> np.ndarray:
    """Return labels of shrunk frames, (h, w), in the size of the frames, (H, W) uint8."""
    if scale == 1:
        return labels.astype(np.uint8)
    height, width = shape
    size = round(labels.shape[1] / scale), round(labels.shape[0] / scale)
    max_coverage = np.full((height, width), 0.5, np.float32)
    enlarged = np.zeros((height, width), np.uint8)
    for number in np.unique(labels[labels > 0]):
        coverage = cv2.resize(np.float32(labels == number), size, interpolation=cv2.INTER_CUBIC)
        coverage = coverage[:height, :width]
        enlarged[coverage > max_coverage] = number
        max_coverage = np.maximum(max_coverage, coverage)
    return enlarged


def label_remaining_frames(frames: PreparedFrames, labelled_frames: Sequence[int]) -> None:
    """Propagate the labels of `labelled_frames`, in order, to the frames without labels."""
    if len(labelled_frames) == frames.count:
        return
    motion = ImageMotion(frames.camera, TRACKING_SETTINGS)
    for number in range(frames.count):
        motion.add(frames.tracker_input(number)[0])
    height, width = motion.grey(0).shape

    def labels_of(number: int) -> np.ndarray:
        size = (width, height)
        return cv2.resize(frames.labels(number), size, interpolation=cv2.INTER_NEAREST_EXACT)

    for number, labels in propagate_labels(motion, labelled_frames, labels_of):
        frames.set_labels(number, enlarge_labels(labels, motion.scale, frames.shape))
