"""Statuses of frames without a pose: what happened, why, and what to do."""

from collections.abc import Sequence

import numpy as np

from tisfm.reconstruction.causes.cause import motion_cause
from tisfm.reconstruction.causes.cause_search import CauseSearch
from tisfm.reconstruction.mapping.settings import MAPPING
from tisfm.status import Status


def runs_of(frames: Sequence[int]) -> list[list[int]]:
    """Return the runs of consecutive frames, of frames in ascending order."""
    breaks = np.flatnonzero(np.diff(frames) != 1) + 1
    runs = [run.tolist() for run in np.split(np.asarray(frames, np.int64), breaks)]
    return [run for run in runs if run]


def statuses_without_pose(
    frames: Sequence[int],  # frames without a pose, in order
    search: CauseSearch,
    *,
    has_pieces: bool,  # whether other frames of the sequence have poses
    distinct_count: int,  # number of frames that differ from one another
    # whether the focal length is known: then a path may begin where all points lie in one plane
    is_focal_known: bool,
) -> dict[int, Status]:
    """Return the status of each frame."""
    statuses: dict[int, Status] = {}
    for run in runs_of(frames):
        cause = search.find_image_cause(run)
        if not has_pieces and distinct_count < 2 and cause != "fixed_pattern":
            cause = None  # the camera is at rest
        if cause is None and not has_pieces:
            cause = _cause_without_path(run, search, distinct_count, is_focal_known)
        for frame in run:
            statuses[frame] = cause or _status_beside_path(frame, search)
            count = len(search.observations[frame].tracks)
            if count < MAPPING.min_observations and statuses[frame] not in _STRONGER:
                statuses[frame] = Status(
                    "no_texture",
                    f"it shows only {count} points that can be tracked: it is dark, bare or "
                    "blurred. Leave the frame out, or give more light and texture",
                )
    return statuses


# Causes that explain why a frame shows few points.
_STRONGER = ("noise", "changing_light", "fixed_pattern")


def _cause_without_path(
    run: Sequence[int], search: CauseSearch, distinct_count: int, is_focal_known: bool
) -> Status:
    """Return the status of a run of a sequence in which no frame has a pose."""
    if distinct_count < 2:
        return Status("no_motion", "frames hardly differ: the camera has to move")
    if distinct_count < MAPPING.min_views:
        return Status(
            "little_parallax",
            f"only {distinct_count} frames differ, but a path needs {MAPPING.min_views}: "
            "take more frames, or give the pair to tisfm.interpret",
        )
    return motion_cause(search.measure_tracks(run), is_focal_known=is_focal_known)


def _status_beside_path(frame: int, search: CauseSearch) -> Status:
    """Return the status of a frame of a sequence in which other frames have poses."""
    if search.shows_cut(frame):
        return Status(
            "unrelated",
            "hardly any point of the frame before is seen again: a cut, or a jump of the camera. "
            "Reconstruct each scene on its own, or take frames closer in time",
        )
    return Status(
        "unrelated",
        f"only few of its {len(search.observations[frame].tracks)} tracks have known points: it "
        "shows another part of the scene, or its points show no parallax; take frames closer in "
        "time",
    )
