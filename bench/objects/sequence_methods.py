"""The methods of `python -m bench.objects.sequences`: each labels a whole clip."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise, product
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

import tisfm
from bench.objects import segmentation
from bench.objects.clips import Clip
from bench.objects.segmentation import one_label, track_parts
from bench.shared.contest import MethodFailure, measure_time
from bench.shared.peer_process import Peer
from bench.shared.sequences import FlowPair
from tisfm.errors import is_user_error
from tisfm.settings import Preset, Settings

# Parameters of the variants of the peers.
GAPS = (1, 2, 4)  # frames to the neighbours of a difference
DIFFERENCES = (4.0, 6.0, 10.0, 16.0, 25.0)  # grey levels
NEAREST = (1, 4)  # frames to the nearest neighbour of a mixture
VARIANCES = (4.0, 9.0, 16.0)  # squared deviations
RESIDUALS = (0.5, 1.0, 2.0, 3.0)  # px
COUNTS = (1, 3)  # clusters
MODELS = {
    "homography": segmentation.homography_residual,
    "epipolar lines": segmentation.epipolar_distance,
}
TRACKERS: dict[str, Callable[[Sequence[NDArray]], list[NDArray[np.uint8]]]] = {
    "one label": one_label,
    "parts tracked": track_parts,
}


@dataclass(frozen=True, kw_only=True, eq=False)
class ClipLabels:
    variant: str  # its parameters; "" for a method without variants
    labels: list[NDArray[np.uint8]]  # (H, W) for each frame
    seconds: float  # of the whole clip
    objects: tuple[Any, ...] = ()  # moving objects, from `tisfm.reconstruct`; else empty
    cameras: NDArray[np.float64] | None = None  # (N, 4, 4), camera to world
    # (H, W) for each frame: depth, and the standard deviation of inverse depth
    depth: Sequence[NDArray] | None = None
    deviation: Sequence[NDArray] | None = None


class Labeller(Protocol):
    """A method that labels clips; it may have several variants."""

    @property
    def name(self) -> str:
        """Name in the tables."""

    def run(self, clip: Clip) -> Iterator[ClipLabels]:
        """Yield the labels of each variant, or raise `MethodFailure`."""


class Differences:
    """Pixels that differ from the neighbours after a homography."""

    name = "homography + difference"

    def run(self, clip: Clip) -> Iterator[ClipLabels]:
        """Yield the labels for each gap, threshold and tracker."""
        steps, alignment_time = measure_time(segmentation.homographies, clip.grey)
        for gap, both in product(GAPS, (True, False)):
            differences, seconds = measure_time(
                segmentation.differences, clip.frames, steps, gap, both=both
            )
            for threshold in DIFFERENCES:
                masks, cleaning_time = measure_time(_threshold_masks, differences, threshold)
                neighbours = "both" if both else "either"
                choice = f"{neighbours} at {gap} frames, {threshold:g} grey levels"
                yield from _track_labels(choice, masks, alignment_time + seconds + cleaning_time)


class Mixtures:
    """OpenCV's MOG2 on neighbours that are warped to each frame by homographies."""

    name = "homography + MOG2"

    def run(self, clip: Clip) -> Iterator[ClipLabels]:
        """Yield the labels for each gap, threshold and tracker."""
        steps, alignment_time = measure_time(segmentation.homographies, clip.grey)
        for gap, threshold in product(NEAREST, VARIANCES):
            foreground, seconds = measure_time(
                segmentation.mixtures, clip.frames, steps, gap, threshold
            )
            masks, cleaning_time = measure_time(_threshold_masks, foreground, 0)
            choice = f"from {gap} frames on, varThreshold {threshold:g}"
            yield from _track_labels(choice, masks, alignment_time + seconds + cleaning_time)


class FlowClusters:
    """Clusters of the flow minus the flow of the background."""

    def __init__(self, peer: Peer) -> None:  # the method of the flow
        self._peer = peer
        self.name = f"{peer.name} + clusters"

    def run(self, clip: Clip) -> Iterator[ClipLabels]:
        """Yield the labels for each background model, threshold, count and tracker."""
        flows, flow_time = self._flows(clip)
        for name, model in MODELS.items():
            residuals, fitting_time = measure_time(
                lambda flows, fit: [fit(flow) for flow in flows], flows, model
            )
            for threshold in RESIDUALS:
                masks, cleaning_time = measure_time(
                    _threshold_masks, [length for _, length in residuals], threshold
                )
                for count in COUNTS:
                    labels, seconds = measure_time(_cluster_frames, residuals, masks, count)
                    labels.append(labels[-1])  # the last frame has no flow
                    choice = f"{name}, {threshold:g} px, {count} clusters"
                    seconds += flow_time + fitting_time + cleaning_time
                    yield from _track_labels(choice, labels, seconds, count)

    def _flows(self, clip: Clip) -> tuple[list[NDArray], float]:
        flows, seconds = [], 0.0
        for number, (frame0, frame1) in enumerate(pairwise(clip.grey)):
            call = self._peer.run(
                FlowPair(
                    name=f"{clip.name}-{number}",
                    group=clip.group,
                    frame0=frame0,
                    frame1=frame1,
                    truth=np.zeros((*frame0.shape, 2)),
                )
            )
            flows.append(call.flow)
            seconds += call.seconds
        return flows, seconds


class Reconstruct:
    """`tisfm.reconstruct` with moving objects."""

    def __init__(self, preset: Preset) -> None:
        self._preset = preset
        self.name = f"tisfm {preset}, objects"

    def run(self, clip: Clip) -> Iterator[ClipLabels]:
        """Yield the labels; the camera is given if it is known."""
        settings = Settings.preset(self._preset, motion="objects")
        try:
            result, seconds = measure_time(
                tisfm.reconstruct, clip.frames, camera=clip.camera, settings=settings
            )
        except (TypeError, ValueError, RuntimeError) as error:
            if not is_user_error(error):
                raise
            raise MethodFailure(" ".join(str(error).split())) from None
        if not hasattr(result, "labels"):
            raise MethodFailure("the result has no labels")
        numbers = range(len(clip.frames))
        yield ClipLabels(
            variant="",
            labels=[np.asarray(result.labels(k)) for k in numbers],
            depth=[np.asarray(result.depth(k), np.float32) for k in numbers],
            deviation=[np.asarray(result.inverse_depth_std(k), np.float32) for k in numbers],
            seconds=seconds,
            objects=tuple(result.objects),
            cameras=np.asarray(result.poses),
        )


def _threshold_masks(values: Sequence[NDArray], threshold: float) -> list[NDArray[np.uint8]]:
    """Return where the values of each frame are above a threshold, after opening and closing."""
    return [segmentation.clean_mask(value > threshold) for value in values]


def _cluster_frames(
    residuals: Sequence[tuple[NDArray, NDArray]], masks: Sequence[NDArray], count: int
) -> list[NDArray[np.uint8]]:
    """Return the clusters of the moving pixels of each frame."""
    return [
        segmentation.clusters(motion, mask > 0, count)
        for (motion, _), mask in zip(residuals, masks, strict=True)
    ]


def _track_labels(
    choice: str, masks: list[NDArray], seconds: float, clusters: int = 1
) -> Iterator[ClipLabels]:
    """Yield the labels of each tracker; numbers of clusters change from frame to frame."""
    for name, track in TRACKERS.items():
        if name == "one label" and clusters > 1:
            continue
        labels, tracking_time = measure_time(track, masks)
        yield ClipLabels(
            variant=f"{choice}, {name}", labels=labels, seconds=seconds + tracking_time
        )
