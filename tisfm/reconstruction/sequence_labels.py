"""Labels of what moves on its own, for every frame of a sequence."""

from collections.abc import Iterator, Sequence

import cv2
import numpy as np

from tisfm.camera import Camera
from tisfm.reconstruction.evidence import Evidence, accumulated, evidence_of
from tisfm.reconstruction.identities import Identities
from tisfm.reconstruction.image_motion import ImageMotion
from tisfm.reconstruction.moving_parts import BOUNDARY
from tisfm.reconstruction.path import TRACKING
from tisfm.reconstruction.path_evidence import path_evidence
from tisfm.reconstruction.shelf import Shelf


class SequenceLabels:
    """Takes the frames of a sequence one after the other, and finds what moves on its own in them.

    Parameters
    ----------
    camera : Camera
        A pinhole, of the frames. A guess of its focal length serves.
    """

    def __init__(self, camera: Camera) -> None:
        self._motion = ImageMotion(camera, TRACKING)
        self._shape = (0, 0)
        self._evidence = Shelf(Evidence.arrays, Evidence.of_arrays)
        self._together: Sequence[Evidence] = ()

    def add(self, grey: np.ndarray) -> None:
        """Take the next frame, (H, W) uint8."""
        self._shape = grey.shape
        self._motion.add(grey)

    def found(
        self, poses: Sequence[np.ndarray | None] | None = None, camera: Camera | None = None
    ) -> Iterator[np.ndarray]:
        """Yield the labels of every frame, (H, W) uint8: 0 at rest, and else the thing's number.

        Parameters
        ----------
        poses : sequence of (4, 4) array or None, optional
            Camera to world, where the path is known: what many frames say under it counts as well.
            None for frames without one.
        camera : Camera, optional
            A pinhole, of the frames, that the path was found with.
        """
        if poses is not None and camera is not None:
            self._add_path(poses, camera)
        elif not len(self._evidence):
            for frame in range(len(self._motion)):
                self._evidence.append(evidence_of(self._motion, frame))
        self._together = accumulated(self._motion, self._evidence)
        for labelled in Identities(self._motion, self._together).labels():
            yield enlarged_labels(labelled, self._motion.share, self._shape)

    def _add_path(self, poses: Sequence[np.ndarray | None], camera: Camera) -> None:
        """Let the path say what it can."""
        small = camera.scaled(self._motion.share, *self._motion.grey(0).shape)
        both = Shelf(Evidence.arrays, Evidence.of_arrays)
        for frame, own in enumerate(self._evidence):
            moving = self._together[frame].mean() > BOUNDARY
            many = path_evidence(self._motion, frame, poses, small, moving)
            both.append(own if many is None else own.judged_by(many))
        self._evidence = both


def enlarged_labels(labels: np.ndarray, share: float, shape: Sequence[int]) -> np.ndarray:
    """Return labels, (h, w), of frames that are made smaller, as those of the frames, (H, W) uint8.

    Parameters
    ----------
    labels : (h, w) array
    share : float
        Px of theirs to a px of the frames.
    shape : (int, int)
        Height and width of the frames, px.
    """
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
