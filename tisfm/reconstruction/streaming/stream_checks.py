"""Checks of the path of a stream, by pairs of its recent frames."""

from collections import deque
from collections.abc import Mapping

from tisfm.reconstruction.frames.prepared_frames import PreparedFrames
from tisfm.reconstruction.mapping.solution import Piece
from tisfm.reconstruction.path_checks.fixed_texture import spread_evenly
from tisfm.reconstruction.path_checks.pieces import (
    check_pair,
    check_with_pairs,
    choose_second_frame,
)
from tisfm.reconstruction.path_checks.settings import PATH_CHECKS
from tisfm.reconstruction.result.path_check import PairEvidence, PathCheck
from tisfm.reconstruction.result.statuses import contradict
from tisfm.reconstruction.streaming.sliding_path import SlidingPath
from tisfm.status import Status


class StreamChecks:
    """Checks the pieces of the path each time frames are yielded."""

    def __init__(self, path: SlidingPath, frames: PreparedFrames) -> None:
        self._path, self._frames = path, frames
        # evidence for and against the path of a piece, from its last pairs of frames
        self._evidence: dict[int, deque[PairEvidence]] = {}
        # pairs of recent frames that were checked, by the number of the piece
        self._checked: dict[int, set[frozenset[int]]] = {}

    def find_contradictions(
        self,
        pieces: Mapping[int, Piece],  # pieces by their numbers
        # first, last: the first and the last new frame
        first: int,
        last: int,
    ) -> dict[int, Status]:
        """Return the status of the frames of each contradicted piece, by its number.

        A message names what hides the motion, if the images of the new frames show it.
        """
        contradictions = {}
        for number, piece in pieces.items():
            check = self._check_piece(number, piece, first, last)
            if check.contradicts:
                frames = sorted(frame for frame in piece.poses if first <= frame <= last)
                cause = self._path.find_image_cause(frames)
                contradictions[number] = contradict(
                    check.message, "" if cause is None else cause.message
                )
        return contradictions

    def residual_factor(self, number: int) -> float:
        """Return `PathCheck.residual_factor` of a piece, from its last pairs of frames."""
        pairs = tuple(self._evidence.get(number, ()))
        return PathCheck(pairs=pairs, fixed_share=0.0, infinity_motion=0.0).residual_factor

    def _check_piece(self, number: int, piece: Piece, first: int, last: int) -> PathCheck:
        """Check the path of a piece by pairs that begin at new frames, and by earlier pairs.

        Each pair is checked once.
        """
        poses = self._path.select_recent(piece).poses
        new_frames = [frame for frame in poses if first <= frame <= last]
        evidence = self._evidence.setdefault(number, deque(maxlen=PATH_CHECKS.max_pairs))
        # other frames do not come back
        checked = {pair for pair in self._checked.get(number, ()) if pair <= poses.keys()}
        self._checked[number] = checked
        for frame in spread_evenly(new_frames, PATH_CHECKS.max_stream_pairs):
            other = choose_second_frame(
                frame,
                list(poses),
                self._path.observations,
                max(self._frames.grey(frame).shape),
            )
            if other is None or frozenset((frame, other)) in checked:
                continue
            checked.add(frozenset((frame, other)))
            pair = check_pair(
                frame,
                other,
                poses,
                self._frames.grey,
                self._frames.static_pixels,
                self._frames.camera,
            )
            if pair is not None:
                evidence.append(pair)
        return check_with_pairs(tuple(evidence), poses, self._frames.grey, self._frames.camera)
