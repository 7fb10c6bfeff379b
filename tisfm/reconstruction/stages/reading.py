"""The first stage: frames are read, prepared and tracked."""

from collections.abc import Iterable
from contextlib import closing
from dataclasses import dataclass

import numpy as np

from tisfm.camera import Camera
from tisfm.errors import InputError
from tisfm.reconstruction.calibration.source_camera import SourceCamera
from tisfm.reconstruction.frames.prepared_frames import PreparedFrames
from tisfm.reconstruction.objects.sequence_labels import SequenceLabels
from tisfm.reconstruction.result.calibration import Calibrate
from tisfm.reconstruction.result.folder import CACHE, PICTURES
from tisfm.reconstruction.stages.job import Job
from tisfm.reconstruction.stages.progress import StopReading
from tisfm.reconstruction.tracks.sequence_tracks import SequenceTracker, SequenceTracks
from tisfm.shutter import frame_instants
from tisfm.sources import FrameSource
from tisfm.sources.frame_reader import warn_notes
from tisfm.trajectory.times import times_note


@dataclass(frozen=True, kw_only=True)
class ReadingResult:
    """The frames of a sequence after the reading stage."""

    names: tuple[str, ...]
    times: tuple[float | None, ...]  # times of the frames, s
    # (N,) array: times of the frames, in intervals between frames of the source
    instants: np.ndarray
    camera: SourceCamera
    # later stages correct these frames for the estimated lens and readout, and label them
    frames: PreparedFrames
    # None with moving objects: static points are tracked later, when labels are known
    tracks: SequenceTracks | None
    # the search for moving objects; None without moving objects, or with given labels
    labels: SequenceLabels | None
    labelled_frames: tuple[int, ...]  # frames with given labels
    notes: tuple[str, ...]


def read_frames(job: Job) -> ReadingResult:
    """Read and prepare all frames once; track each frame while the next frame is read."""
    names: list[str] = []
    times: list[float | None] = []
    indices: list[int] = []
    labelled_frames: list[int] = []
    tracker: SequenceTracker | None = None
    labels: SequenceLabels | None = None
    source, total = job.source, _frame_count(job.source)
    with closing(source.frames()) as source_frames:
        for frame in source_frames:
            if not names:
                camera = SourceCamera.from_first_frame(source, job.camera, frame)
                frames = PreparedFrames(
                    camera.used_camera,
                    job.folder / CACHE,
                    job.folder / PICTURES,
                    are_labels_prepared=job.are_labels_prepared,
                )
                if not job.has_objects:
                    tracker = make_tracker(job, frames.camera, job.calibrate)
                elif not source.has_labels:
                    labels = SequenceLabels(frames.camera)
            grey, ignored = frames.add(frame)
            if labels is not None:
                labels.add(grey)
            elif tracker is not None:
                tracker.add(grey, ignored)
                if tracker.flow is not None:
                    frames.keep_flow(len(names), tracker.flow)
            if frame.labels is not None:
                labelled_frames.append(len(names))
            names.append(frame.name)
            times.append(frame.time)
            indices.append(frame.index)
            try:
                job.progress("reading", len(names), total)
            except StopReading:
                break
    if len(names) < 2:
        raise InputError(
            f"{source.title} has {len(names)} frame{'s' * (len(names) != 1)} that can "
            "be read: expected at least 2"
        )
    job.progress("path", 0, len(names))
    notes = list(source.notes)
    if note := times_note(times):
        notes.append(note)
        warn_notes([note], stacklevel=4)
    return ReadingResult(
        names=_distinct_names(names),
        times=tuple(times),
        instants=frame_instants(indices, times),
        camera=camera,
        frames=frames,
        tracks=None if tracker is None else tracker.finish(),
        labels=labels,
        labelled_frames=tuple(labelled_frames),
        notes=tuple(notes),
    )


def make_tracker(job: Job, camera: Camera, calibrate: Calibrate) -> SequenceTracker:
    """Return the tracker of the frames of a job."""
    return SequenceTracker(
        camera, is_focal_known=calibrate == "nothing", selects_views=job.poses is None
    )


def _frame_count(source: FrameSource) -> int | None:
    try:
        return len(source) + 1
    except TypeError:
        return None


def _distinct_names(names: Iterable[str]) -> tuple[str, ...]:
    """Return the names of frames, with a number before each name if two names are equal."""
    all_names = list(names)
    if len(set(all_names)) == len(all_names):
        return tuple(all_names)
    return tuple(f"{k:06d}_{name}" for k, name in enumerate(all_names))
