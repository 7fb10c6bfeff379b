"""Statuses of frames that depend on their piece of the path."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np

from tisfm.grade import GRADES, percent
from tisfm.reconstruction.result.path_check import LIMITS, PathCheck
from tisfm.status import Status

NEW_PIECE_NOTE = (
    "no track connects it with earlier frames: a new piece begins, with a scale of its own"
)
CAUSE_NOTE = ". Probable cause: "
NO_PARALLAX = Status(
    "little_parallax",
    "no nearby frame shows enough parallax for depth, or their images do not match; its pose is "
    "known",
)
ONLY_TURNS = Status(
    "pure_rotation",
    "the camera only turns: its orientation is known; its position and depth are not. Move the "
    "camera sideways",
)
ROUGH_DEPTH = (
    "the depth of the frame is expected to be off by {error}: its deviations are large, or the "
    "focal length is uncertain; give frames with more motion between them, or the focal length"
)
_MOVING_TEXT = " of the frame moves on its own and is masked"
_MOVING_ADVICE = ': choose motion="objects" for its depth'


def add_piece_note(status: Status) -> Status:
    """Return the status of the first frame of a later piece, with a note on the new piece.

    A piece in which the camera only turns has no scale, and no note.
    """
    if status == ONLY_TURNS:
        return status
    message = f"{status.message}; {NEW_PIECE_NOTE}" if status.message else NEW_PIECE_NOTE
    return Status(str(status), message)


def remove_piece_note(status: Status) -> Status:
    """Return a status without the note of `add_piece_note`."""
    return Status(str(status), status.message.removesuffix(NEW_PIECE_NOTE).removesuffix("; "))


def contradict(reason: str, cause: str = "") -> Status:
    """Return the status of a contradicted frame; the cause, if known, hides the motion."""
    return Status("contradicted", f"{reason}{CAUSE_NOTE}{cause}" if cause else reason)


def find_cause(status: Status) -> str:
    """Return the cause in a status of `contradict`; "" without a cause."""
    return remove_piece_note(status).message.partition(CAUSE_NOTE)[2]


def add_mask_notes(
    statuses: Sequence[Status],
    pieces: Sequence[int],  # piece of each frame, −1 for none
    moving_shares: np.ndarray,  # (N,): share of the pixels of each frame that move and are masked
    has_depth: np.ndarray,  # (N,) bool: frames with depth
) -> tuple[Status, ...]:
    """Return the statuses of frames; those with a pose say how much moves and is masked.

    Depth is uncertain if much of a frame moves. `mark_contradicted` and `mark_uncertain` keep the
    note.
    """
    noted = []
    parts = zip(statuses, pieces, moving_shares.tolist(), has_depth.tolist(), strict=True)
    for status, piece, share, depth in parts:
        if piece >= 0 and share > 0:
            note = percent(share) + _MOVING_TEXT
            note += "" if status == ONLY_TURNS else _MOVING_ADVICE
            is_doubtful = depth and share > LIMITS.max_moving_share and status == "converged"
            if is_doubtful:
                note += "; so much moves that the depth of the rest is uncertain"
            code = "uncertain" if is_doubtful else str(status)
            status = Status(code, "; ".join(filter(None, [note, status.message])))
        noted.append(status)
    return tuple(noted)


def mark_contradicted(
    statuses: Sequence[Status],
    pieces: Sequence[int],  # piece of each frame, −1 for none
    checks: Sequence[PathCheck],  # of each piece
    # by piece: what hides the motion, in words, if the images show it. A piece with a doubt and a
    # cause is contradicted.
    causes: Mapping[int, str] = MappingProxyType({}),
    objection: str = "",  # what contradicts the camera of all pieces; "" if nothing does
) -> tuple[Status, ...]:
    """Return the statuses of frames: all frames of a contradicted piece are contradicted.

    Where the camera only turns, there is no depth to contradict: an objection to the camera is
    added to the message, and the status stays.
    """
    marked = []
    for status, piece in zip(statuses, pieces, strict=True):
        if piece >= 0 and status == ONLY_TURNS:
            if objection:
                status = Status(str(status), f"{status.message}; {objection}")
        elif piece >= 0:
            cause = causes.get(piece, "")
            reason = objection or checks[piece].message or (checks[piece].doubt if cause else "")
            if reason:
                status = _keep_notes(contradict(reason, cause), status)
        marked.append(status)
    return tuple(marked)


def mark_doubtful(
    statuses: Sequence[Status],
    pieces: Sequence[int],  # piece of each frame, −1 for none
    doubts: Sequence[str],  # what makes each piece doubtful; "" if nothing does
) -> tuple[Status, ...]:
    """Return the statuses of frames: frames of a doubtful piece are uncertain."""
    return tuple(
        _keep_notes(Status("uncertain", doubts[piece]), status)
        if piece >= 0 and doubts[piece] and status == "converged"
        else status
        for status, piece in zip(statuses, pieces, strict=True)
    )


def mark_uncertain(
    statuses: Sequence[Status],
    errors: np.ndarray,  # (N,): expected relative errors of depth, NaN without depth
) -> tuple[Status, ...]:
    """Return the statuses of frames: frames whose depth is expected to be rough are uncertain."""
    marked = []
    for status, error in zip(statuses, errors.tolist(), strict=True):
        if status == "converged" and error > GRADES.max_fair:
            rough = Status("uncertain", ROUGH_DEPTH.format(error=percent(error)))
            status = _keep_notes(rough, status)
        marked.append(status)
    return tuple(marked)


def _keep_notes(status: Status, earlier: Status) -> Status:
    """Return a status with the notes of an earlier one: on masked pixels, and on a new piece."""
    before, text, after = earlier.message.partition(_MOVING_TEXT)
    if text:
        advice = _MOVING_ADVICE if after.startswith(_MOVING_ADVICE) else ""
        status = Status(str(status), f"{before}{text}{advice}; {status.message}")
    return add_piece_note(status) if NEW_PIECE_NOTE in earlier.message else status
