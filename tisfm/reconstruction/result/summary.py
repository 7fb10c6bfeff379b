"""The summary of a reconstruction in words."""

from collections.abc import Sequence

import numpy as np

from tisfm.camera import Camera
from tisfm.grade import GradeSummary
from tisfm.reconstruction.result.calibration import Calibration, describe_focal, describe_zoom
from tisfm.status import Status


def summarise(
    piece: np.ndarray,  # (N,) int: the piece of each frame; −1 for none
    has_position: np.ndarray,  # (N,) bool: which frames have more than an orientation
    statuses: Sequence[Status],
    grades: GradeSummary,
    camera: Camera,
    calibration: Calibration,
    zoom: np.ndarray | None,  # as `Reconstruction.zoom`
    focal_note: str = "",  # as `Reconstruction.focal_note`
    pose_deviations: str = "",  # as `Reconstruction.pose_deviation_text`
) -> str:
    """Return one paragraph: poses, pieces, focal length, grades, and what to do."""
    sentences = [f"{describe_poses(piece, has_position)}."]
    if pose_deviations:
        sentences.append(f"Median deviations: {pose_deviations}.")
    focal = calibration.focal or camera.focal
    text = describe_focal(focal, calibration.focal_std, calibration.shape)
    advice = ": pose and depth depend on it" if calibration.origin == "given" else ""
    # the message of a camera that was given says only what the sequence showed
    has_notable_message = not calibration.seen or calibration.origin == "given"
    if zoom is not None and not has_notable_message:
        advice += f"; {describe_zoom(focal, zoom)}"
    sentences.append(f"The focal length is {text}, {calibration.origin}{advice}.")
    counts = f" ({grades.counts_text})" if len(grades.counts) > 1 else ""
    sentences.append(f"Grade {grades.text}{counts}.")
    for code in dict.fromkeys(str(status) for status in statuses if status != "converged"):
        same = [status for status in statuses if status == code]
        message = f": {same[0].message}" if same[0].message else ""
        frames = f"{len(same)} frame{'s' * (len(same) != 1)}"
        sentences.append(f"{code}, {frames}{message}.")
    if calibration.message and has_notable_message:
        sentences.append(f"{calibration.message}.")
    if focal_note:
        sentences.append(f"{focal_note[0].upper()}{focal_note[1:]}.")
    return " ".join(" ".join(sentences).replace("..", ".").split())


def describe_poses(piece: np.ndarray, has_position: np.ndarray) -> str:
    """Return the number of frames with a pose, the pieces and their sizes, in words."""
    sizes = np.unique(piece[has_position], return_counts=True)[1]
    text = f"{int(sizes.sum())} of {len(piece)} frames have a pose"
    if len(sizes) or not (piece >= 0).any():
        text += f", in {len(sizes)} piece{'s' * (len(sizes) != 1)}"
    if len(sizes) > 1:
        text += f" ({', '.join(map(str, sizes))} frames, each with its own scale)"
    turning_count = int(((piece >= 0) & ~has_position).sum())
    if turning_count:
        text += f"; {turning_count} {'have' if turning_count > 1 else 'has'} an orientation only"
    return text


def describe_pose_deviations(
    # position, rotation: (F, 3) standard deviations of the frames of a piece, in the unit of the
    # poses and in degrees
    position: np.ndarray,
    rotation: np.ndarray,
) -> str:
    """Return the median deviations in words; "" if they are unknown, or the poses were given.

    The position is not a share of the path: deviations hold for a part of a long piece, whose
    length the result does not have.
    """
    sizes = [np.linalg.norm(values, axis=1) for values in (position, rotation)]
    if not all(np.isfinite(values).any() for values in sizes):
        return ""
    of_position, of_rotation = (float(np.nanmedian(values)) for values in sizes)
    if not of_rotation:
        return ""
    return f"position ±{of_position:.2g} in the unit of the poses, rotation ±{of_rotation:.2g}°"
