"""The status of an interpretation, and the record of its iterations."""

import re
from dataclasses import dataclass

import numpy as np

from tisfm.errors import InputError, InputTypeError

STATUSES = (
    "converged", "iteration_limit", "no_motion", "no_texture", "diverged", "pure_rotation",
    "little_parallax", "unrelated", "pose_mismatch", "two_motions", "aperture", "behind_camera",
    "unexplained", "uncertain", "contradicted", "noise", "fixed_pattern", "changing_light",
    "repeated_texture", "one_plane",
)  # fmt: skip
"""Codes of `Status`."""
UNKNOWN_STATUS_ADVICE = "This version of tisfm does not know this status: treat it as doubtful."
"""The message for a code that is not in `STATUSES`."""
FOCAL_NOTE = "The result depends on the"
"""The begin of the sentence of a message about a focal length that the image motion hides."""
_CODE = re.compile(r"[a-z_]+")


class Status(str):
    """A short code for the outcome of an interpretation, with a message on what to try.

    Codes with every motion model:

    - ``"converged"``.
    - ``"iteration_limit"``: the iterations ran out before the result was exact.
    - ``"no_motion"``: the frames do not differ, or move by no more than noise.
    - ``"no_texture"``: frame 0 has no gradient that could show motion, or too few reliable pixels
      to fit a motion.
    - ``"diverged"``: the numbers are useless. Somewhere the image motion exceeds half of the longer
      side of the image, or more than half of the pixels leave the image. If matched points, a 4×4
      pose or the images confirm a large motion, the limits are the whole side and 80 %.
    - ``"unrelated"``: the frames have nothing in common, or some parts are static and the same
      while the other parts differ.
    - ``"aperture"``: the frames vary along one direction only, so motion along their stripes cannot
      be seen. No depth. Does not occur with a 4×4 pose.

    With ``motion="camera"``, or ``"objects"`` if it finds a single motion:

    - ``"pure_rotation"``: the camera only turned. No depth. A frame of a sequence has an
      orientation; its position is unknown, and 0.
    - ``"little_parallax"``: the camera hardly moved. No depth.
    - ``"uncertain"``: the camera moved so little that depth is rough; with ``motion="camera"`` also
      if half of the depth is expected to be off by more than 10 %, if much of it has a large
      deviation, if regions of the image do not move as one rigid motion lets them, if the
      direction of motion is hardly known, or if the result depends on a guessed focal length; of a
      frame of a sequence also if two motions of a plane fit its tracks equally well, or if a zoom
      fits them beside a focal length that is not known well.
    - ``"two_motions"``: two motions explain the frames equally well, because the frames show one
      plane or are far apart; depth follows from one of the motions.
    - ``"contradicted"``: the image motion contradicts the camera, because another focal length, a
      zoom, a lens, or a turn with another focal length explains it better; of a frame of a
      sequence with a pose, it contradicts the path. Pose and depth are probably wrong.

    With ``motion="camera"``:

    - ``"behind_camera"``: much of the scene would lie behind the camera.
    - ``"unexplained"``: motion and depth do not align much of the texture; depth is wrong there.
    - ``"pose_mismatch"``: the given pose contradicts the images; depth still follows from the pose.

    Of a frame of a sequence:

    - ``"noise"``, ``"fixed_pattern"``, ``"changing_light"``: the frame has no pose, because noise,
      a pattern that is fixed on the sensor, or light that changes hides the motion.
    - ``"repeated_texture"``: the frame has no pose, because its texture repeats itself.
    - ``"one_plane"``: the frame has no pose, because the scene is one plane, and the focal length
      is unknown.

    A file of another version may hold a code that is not in this list. It is kept: treat it as
    doubtful.

    Parameters
    ----------
    code : str
        Lower-case ASCII letters and underscores.
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
    """Record of all half-quadratic iterations, in order; all arrays have the same length.

    Equations are numbered as in the paper of Sekkati and Mitiche. ρ̂ are the unknowns of a pixel.
    """

    level: np.ndarray  # (N,) int32: level of the pyramid, 0 the finest
    warp: np.ndarray  # (N,) int32: linearisation within the level
    # (N,) float64: energy (eq. 6, 20) after the iteration; it never rises within a warp.
    energy: np.ndarray
    # (N,) float64: half-quadratic energy (eq. 8, 21) with the weights that the iteration used.
    half_quadratic: np.ndarray
    change: np.ndarray  # (N,) float64: ‖change of ρ̂‖ / ‖ρ̂‖, over all pixels
