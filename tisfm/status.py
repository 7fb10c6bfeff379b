"""How an interpretation ended: a status, and a record of its iterations."""

import re
from dataclasses import dataclass

import numpy as np

from tisfm.errors import InputError, InputTypeError

STATUSES = (
    "converged", "iteration_limit", "no_motion", "no_texture", "diverged", "pure_rotation",
    "little_parallax", "unrelated", "pose_mismatch", "two_motions", "aperture", "behind_camera",
    "unexplained", "uncertain",
)  # fmt: skip
"""Codes of `Status`."""
UNKNOWN = "This version of tisfm does not know this status: treat it as doubtful."
"""The message for a code that is not in `STATUSES`."""
_CODE = re.compile(r"[a-z_]+")


class Status(str):
    """A short code that says how the interpretation ended, with a message on what to try.

    Codes: ``"converged"``; ``"iteration_limit"``, the iterations ran out before the result
    was exact; ``"no_motion"``, the frames do not differ, or move by no more than noise;
    ``"no_texture"``, frame 0 shows no gradient that motion could be seen by, or too few pixels are
    trusted to fit a motion to them; ``"diverged"``, the numbers are of no use: somewhere the image
    motion grew beyond half of the image's longer side, or more than half of the pixels leave the
    image (the whole side, and 80 %, where matched points, a 4×4 pose, or the images themselves
    confirm a large motion);
    ``"unrelated"``, the frames have nothing in common, or some parts are alike and at rest while
    the others differ; ``"aperture"``, they vary along one direction only, so that
    motion along their stripes cannot be seen: no depth, and it does not occur with a 4×4 pose. With
    ``motion="camera"``, or ``"objects"`` that find one motion only, also ``"pure_rotation"``, the
    camera only turned, and ``"little_parallax"``, it hardly changed its place: there is no depth;
    ``"uncertain"``, it changed its place so little that depth is rough; and ``"two_motions"``,
    frames of one plane, or far apart, leave two motions that explain them alike, and depth follows
    from one of them. With ``motion="camera"``, ``"uncertain"`` is also the status where much of the
    depth has a large deviation, and there are ``"behind_camera"``, much of the scene would lie
    behind the camera; and ``"unexplained"``, much of the texture is not alike where motion and
    depth lead: depth is wrong there. With a pose given, ``"pose_mismatch"``: it contradicts the
    images, and the depth is what follows from it all the same.

    A file of another version may hold a code that is not in this list. It is kept: treat it as
    doubtful.

    Parameters
    ----------
    code : str
        Small letters of ASCII and underscores.
    message : str
        What to try.

    Raises
    ------
    TypeError
        If the code or the message is not a string.
    ValueError
        If the code has any other character.
    """

    message: str

    def __new__(cls, code: str, message: str = "") -> "Status":
        """Make a status that compares equal to its code."""
        for name, text in (("status", code), ("message", message)):
            if not isinstance(text, str):
                raise InputTypeError(f"{name} is {text!r}: expected a text")
        if _CODE.fullmatch(code) is None:
            raise InputError(
                f"status is {code!r}: expected small letters and underscores, such as 'converged'"
            )
        status = super().__new__(cls, code)
        status.message = message
        return status


@dataclass(frozen=True, kw_only=True)
class History:
    """Record of every half-quadratic iteration, in order; arrays of one length.

    Attributes
    ----------
    level : (N,) int32
        Level of the pyramid, 0 the finest.
    warp : (N,) int32
        Linearisation within the level.
    energy : (N,) float64
        Energy (eq. 6, 20) after the iteration; within a warp it never rises.
    half_quadratic : (N,) float64
        Its half-quadratic form (eq. 8, 21) with the weights the iteration used.
    change : (N,) float64
        ‖change of ρ̂‖ / ‖ρ̂‖.
    """

    level: np.ndarray
    warp: np.ndarray
    energy: np.ndarray
    half_quadratic: np.ndarray
    change: np.ndarray
