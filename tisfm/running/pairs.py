"""What is done with every pair of a run, whichever process does it."""

from collections.abc import Generator
from dataclasses import asdict, dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from tisfm.camera import Camera
from tisfm.datasets.pose_files import motion_between, read_poses
from tisfm.errors import InputError
from tisfm.horn_schunck import horn_schunck
from tisfm.interpretation import Interpretation
from tisfm.lens import undistort
from tisfm.rigid import check_pose
from tisfm.running.pair_files import PairFiles
from tisfm.sequence import with_poses
from tisfm.settings import Settings
from tisfm.sources import BadFrames, FramePair, FrameSource, Source
from tisfm.window import Window


@dataclass(frozen=True, kw_only=True)
class FrameSelection:
    """The frames of a source that are used, and the part of each frame."""

    step: int = 1
    """Take every STEP-th frame, for slow motion."""
    start: int = 0
    """Number of the first frame that is taken; the first of the source is 0."""
    stop: int | None = None
    """Number of the first frame that is not taken any more. By default all are."""
    size: int | None = None
    """Longer side of the frames, px: larger frames are shrunk. Give the camera and --focal for the
    frames before shrinking."""
    crop: tuple[int, int, int, int] | None = None
    """Use this part of the frames alone, px. It is cut out before the rest is shrunk."""
    bad_frames: BadFrames = "raise"
    """What becomes of damaged frames: an error, or they are left out."""

    def open(self, source: Source, *, mask: str | None = None) -> FrameSource:
        """Open a source, with its masks."""
        return FrameSource(source, mask=mask, **asdict(self))


@dataclass(frozen=True, kw_only=True)
class PairSource:
    """The pairs of a run.

    Attributes
    ----------
    source : Source
    frames : FrameSelection
    settings : Settings
    mask : str or None
        A picture, or a folder or pattern of one for every frame.
    poses : Path or None
        A file of a pose for every frame, those that are not taken included.
    """

    source: Source
    frames: FrameSelection
    settings: Settings
    mask: str | None = None
    poses: Path | None = None

    def open(self) -> tuple[FrameSource, Generator[FramePair, None, None]]:
        """Return the source, and its pairs with their poses."""
        pairs = self.frames.open(self.source, mask=self.mask)
        motions = None if self.poses is None else _motions(self.poses, pairs, self.settings)
        return pairs, with_poses(pairs, motions, title=f"the motions of {self.poses}")

    def number(self, pair: FramePair) -> int:
        """Return the number of a pair in the run, by its first frame."""
        return (pair.index - self.frames.start) // self.frames.step


@dataclass(frozen=True, kw_only=True)
class PairWork:
    """Interprets pairs.

    Attributes
    ----------
    camera : Camera
        Of the frames as they are interpreted.
    settings : Settings
    files : PairFiles
    """

    camera: Camera
    settings: Settings
    files: PairFiles = field(repr=False)

    def interpret(self, pair: FramePair, window: Window | None = None) -> Interpretation:
        """Interpret a pair; `window` as for `FramePair.interpret`."""
        return pair.interpret(camera=self.camera, settings=self.settings, window=window)

    def about(self, pair: FramePair, number: int) -> dict[str, Any]:
        """Return what `PairFiles.write` takes beside the interpretation of a pair."""
        compared = self.settings.motion == "field" and self.files.has_figure(number)
        return {
            "number": number,
            "digest": pair.digest,
            "times": pair.times,
            "pose": None if pair.pose is None else np.asarray(pair.pose),
            "baseline_flow": self._baseline(pair) if compared else None,
        }

    def _baseline(self, pair: FramePair) -> np.ndarray:
        """Return Horn and Schunck's flow of the frames without distortion."""
        frames = (undistort(frame, self.camera) for frame in (pair.frame0, pair.frame1))
        return horn_schunck(*frames, settings=self.settings)


def _motions(path: Path, pairs: FrameSource, settings: Settings) -> list[np.ndarray]:
    """Return the motion of every pair, of a file with the pose of every frame."""
    if settings.motion != "camera":
        raise InputError(
            f"the poses of {path} are given, but motion '{settings.motion}' leaves the motion "
            "free: give --motion camera"
        )
    poses = read_poses(path)
    if pairs.count is not None and len(poses) != pairs.count:
        raise InputError(
            f"{path} has {len(poses)} poses, but there are {pairs.count} frames: expected a line "
            "of twelve numbers for every frame"
        )
    motions = [motion_between(*ends) for ends in pairwise(poses[pairs.chosen])]
    for index, motion in enumerate(motions):
        try:
            check_pose(motion)
        except ValueError as error:
            first = pairs.chosen.start + index * pairs.chosen.step
            second = first + pairs.chosen.step
            raise InputError(f"{path}, frames {first} and {second}: {error}") from None
    return motions
