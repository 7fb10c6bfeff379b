"""The pairs of a source, with their poses, and the interpretation of each pair."""

from collections.abc import Generator, Iterable, Sequence, Sized
from contextlib import closing
from dataclasses import asdict, dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from tisfm.camera import Camera
from tisfm.datasets.pose_files import motion_between, read_poses
from tisfm.errors import InputError, InputTypeError
from tisfm.horn_schunck import horn_schunck
from tisfm.interpretation import Interpretation
from tisfm.lens import undistort
from tisfm.rigid import check_pose
from tisfm.running.pair_files import PairFiles
from tisfm.settings import FixedPixels, FocalOrigin, Settings
from tisfm.sources import BadFrames, FramePair, FrameSource, Source
from tisfm.window import Window


@dataclass(frozen=True, kw_only=True)
class FrameSelection:
    """The used frames of a source, and the used part of each frame."""

    step: int = 1
    """Use every STEP-th frame, for slow motion."""
    start: int = 0
    """Number of the first frame to use; the first frame of the source is 0."""
    stop: int | None = None
    """Stop before the frame of this number. By default all frames are used."""
    size: int | None = None
    """Longer side of the frames, px: larger frames are shrunk. Give --focal and the other options
    of the camera for the frames before shrinking."""
    crop: tuple[int, int, int, int] | None = None
    """Use only this part of the frames, px. It is cut out before it is shrunk."""
    bad_frames: BadFrames = "raise"
    """A damaged frame ends the command (raise), or is left out (skip)."""

    def open(self, source: Source, *, mask: str | None = None) -> FrameSource:
        """Open a source, with its masks."""
        return FrameSource(source, mask=mask, **asdict(self))


@dataclass(frozen=True, kw_only=True)
class PairSource:
    """A source of frames, and all options that determine its pairs."""

    source: Source
    frames: FrameSelection
    settings: Settings
    mask: str | None = None  # a picture, or a folder or pattern with a picture for every frame
    poses: Path | None = None  # a file with a pose for every frame of the source, selected or not
    # sequence of (4, 4) arrays, or None: the motion of every pair, instead of `poses`
    motions: Sequence[np.ndarray] | None = None

    def open(self) -> tuple[FrameSource, Generator[FramePair, None, None]]:
        """Return the source, and its pairs with their poses."""
        pairs = self.frames.open(self.source, mask=self.mask)
        if self.poses is None:
            return pairs, attach_poses(pairs, self.motions)
        motions = _read_motions(self.poses, pairs, self.settings)
        return pairs, attach_poses(pairs, motions, title=f"the motions of {self.poses}")

    def starting_at(self, number: int) -> "PairSource":
        """Return the source without the pairs before this number."""
        start = self.frames.start + number * self.frames.step
        motions = None if self.motions is None else self.motions[number:]
        return replace(self, frames=replace(self.frames, start=start), motions=motions)

    def number(self, pair: FramePair) -> int:
        """Return the number of a pair: the number of its first frame among the selected frames."""
        return (pair.index - self.frames.start) // self.frames.step


@dataclass(frozen=True, kw_only=True)
class PairWork:
    """The interpretation of the pairs of a run."""

    camera: Camera  # camera of the frames after crop and reduction
    settings: Settings
    fixed_pixels: FixedPixels = "mask"  # as for `tisfm.interpret`
    focal_origin: FocalOrigin = "stated"
    # files of the pairs; None if results are returned instead of written
    files: PairFiles | None = field(default=None, repr=False)

    def interpret(self, pair: FramePair, window: Window | None = None) -> Interpretation:
        """Interpret a pair; `window` as for `FramePair.interpret`."""
        return pair.interpret(
            camera=self.camera,
            settings=self.settings,
            window=window,
            fixed_pixels=self.fixed_pixels,
            focal_origin=self.focal_origin,
        )

    def write_arguments(self, pair: FramePair, number: int) -> dict[str, Any]:
        """Return the arguments of `PairFiles.write` for a pair, except its interpretation."""
        has_figure = self.files is not None and self.files.has_figure(number)
        needs_baseline = self.settings.motion == "field" and has_figure
        return {
            "number": number,
            "digest": pair.digest,
            "times": pair.times,
            "pose": None if pair.pose is None else np.asarray(pair.pose),
            "baseline_flow": self._baseline_flow(pair) if needs_baseline else None,
        }

    def _baseline_flow(self, pair: FramePair) -> np.ndarray:
        """Return the flow of Horn and Schunck between the undistorted frames."""
        frames = (undistort(frame, self.camera) for frame in (pair.frame0, pair.frame1))
        return horn_schunck(*frames, settings=self.settings)


def attach_poses(
    pairs: FrameSource,
    # iterable of array_like, or None: one pose for every pair; None for no poses. The
    # interpretation of a pair checks its pose.
    poses: Iterable[npt.ArrayLike] | None,
    *,
    title: str = "poses",  # name of the poses in error messages
) -> Generator[FramePair, None, None]:
    """Give every pair of a source its pose.

    Raises TypeError, ValueError: at once, if the poses are not iterable, if their known number
    differs from the number of pairs, or if frames may be skipped; during iteration, if there are
    too few poses, or too many poses of a known number.
    """
    if poses is None:
        return iter(pairs)
    if pairs.bad_frames == "skip":
        raise InputError(
            f"{title} are given, one for every pair, and bad frames may be skipped: give poses, or "
            "let bad frames raise"
        )
    if isinstance(poses, np.ndarray) and poses.ndim != 3:
        raise InputError(
            f"{title} is {poses.shape}: expected one for every pair, (N, 4, 4) or (N, 3, 3)"
        )
    if not isinstance(poses, Iterable):
        raise InputTypeError(f"{title} is {poses!r}: expected a 4×4 or 3×3 array for every pair")
    number = len(poses) if isinstance(poses, Sized) else None
    if pairs.count is not None and number is not None:
        _check_pose_number(number, len(pairs), title)
    return _attach_poses(pairs, poses, number, title)


def _attach_poses(
    pairs: FrameSource, poses: Iterable[npt.ArrayLike], number: int | None, title: str
) -> Generator[FramePair, None, None]:
    remaining_poses = iter(poses)
    finished_count = 0
    with closing(iter(pairs)) as open_pairs:
        for pair in open_pairs:
            try:
                pose = next(remaining_poses)
            except StopIteration:
                raise InputError(
                    f"{title} ended before frames {pair.name0} and {pair.name1}, after "
                    f"{finished_count}: expected one for every pair"
                ) from None
            yield replace(pair, pose=pose)
            del pair  # free its first frame before the next pair is read
            finished_count += 1
    if number is not None:
        _check_pose_number(number, finished_count, title)


def _check_pose_number(number: int, pairs: int, title: str) -> None:
    if number != pairs:
        raise InputError(
            f"{title} are {number}, but there {'is' if pairs == 1 else 'are'} {pairs} "
            f"pair{'s' * (pairs != 1)} of frames: expected one for each"
        )


def _read_motions(path: Path, pairs: FrameSource, settings: Settings) -> list[np.ndarray]:
    """Return the motion of every pair, from a file with the pose of every frame."""
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
    motions = [motion_between(*pose_pair) for pose_pair in pairwise(poses[pairs.selection])]
    for index, motion in enumerate(motions):
        try:
            check_pose(motion)
        except ValueError as error:
            first = pairs.selection.start + index * pairs.selection.step
            second = first + pairs.selection.step
            raise InputError(f"{path}, frames {first} and {second}: {error}") from None
    return motions
