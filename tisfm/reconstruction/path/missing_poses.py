"""Statuses of frames without a pose: what happened, why, and what to do."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tisfm.reconstruction.causes.cause import explain_motion
from tisfm.reconstruction.causes.cause_search import CauseSearch
from tisfm.reconstruction.mapping.settings import MAPPING
from tisfm.status import Status


def split_runs(frames: Sequence[int]) -> list[list[int]]:
    """Return the runs of consecutive frames, of frames in ascending order."""
    breaks = np.flatnonzero(np.diff(frames) != 1) + 1
    runs = [run.tolist() for run in np.split(np.asarray(frames, np.int64), breaks)]
    return [run for run in runs if run]


# Causes that explain why a frame shows few points.
_EXPLAINS_FEW_POINTS = ("noise", "changing_light", "fixed_pattern")


@dataclass(frozen=True, kw_only=True, eq=False)
class MissingPoses(Mapping[int, Status]):
    """The status of each frame without a pose; found when it is asked for."""

    frames: Sequence[int]  # frames without a pose, in order
    search: CauseSearch
    has_pieces: bool  # whether other frames of the sequence have poses
    distinct_count: int  # number of frames that differ from one another
    # whether the focal length is known: then a path may begin where all points lie in one plane
    is_focal_known: bool
    # whether a rotation that explains the motion of a run becomes a piece of the path
    are_turns_found: bool = True

    def __len__(self) -> int:
        return len(self.frames)

    def __iter__(self) -> Iterator[int]:
        return iter(self.frames)

    def __getitem__(self, frame: int) -> Status:
        run = self._runs[frame]
        cause = self._causes[run[0]] if run[0] in self._causes else self._find_cause(run)
        self._causes[run[0]] = cause
        status = cause or _explain_beside_path(frame, self.search)
        count = len(self.search.observations[frame].tracks)
        if count < MAPPING.min_observations and status not in _EXPLAINS_FEW_POINTS:
            status = Status(
                "no_texture",
                f"it shows only {count} points that can be tracked: it is dark, bare or "
                "blurred. Leave the frame out, or give more light and texture",
            )
        return status

    @cached_property
    def _runs(self) -> dict[int, list[int]]:
        """The run of each frame."""
        return {frame: run for run in split_runs(self.frames) for frame in run}

    @cached_property
    def _causes(self) -> dict[int, Status | None]:
        """The causes that were found, by the first frames of the runs; None for no cause."""
        return {}

    def _find_cause(self, run: Sequence[int]) -> Status | None:
        cause = self.search.find_image_cause(run)
        if not self.has_pieces and self.distinct_count < 2 and cause != "fixed_pattern":
            cause = None  # the camera is at rest
        if cause is None and not self.has_pieces:
            cause = self._find_cause_without_path(run)
        return cause

    def _find_cause_without_path(self, run: Sequence[int]) -> Status:
        """Return the status of a run of a sequence in which no frame has a pose."""
        if self.distinct_count < 2:
            return Status("no_motion", "frames hardly differ: the camera has to move")
        if self.distinct_count < MAPPING.min_views:
            return Status(
                "little_parallax",
                f"only {self.distinct_count} frames differ, but a path needs "
                f"{MAPPING.min_views}: take more frames, or give the pair to tisfm.interpret",
            )
        return explain_motion(
            self.search.measure_tracks(run),
            is_focal_known=self.is_focal_known,
            are_turns_found=self.are_turns_found,
        )


def _explain_beside_path(frame: int, search: CauseSearch) -> Status:
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
