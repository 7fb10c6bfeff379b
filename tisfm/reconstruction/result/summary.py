"""The summary of a reconstruction in words."""

from collections.abc import Sequence

import numpy as np

from tisfm.camera import Camera
from tisfm.grade import Grade, GradeSummary
from tisfm.reconstruction.result.calibration import Calibration, describe_focal
from tisfm.status import Status


def summarise_grades(
    grades: Sequence[Grade],
    statuses: Sequence[Status],
    errors: Sequence[float],
) -> GradeSummary:
    """Return the summary of the grades of frames.

    Frames whose depth was not requested do not count, unless there are no others.
    """
    chosen = [
        frame
        for frame, grade in enumerate(grades)
        if grade != Grade.NO_DEPTH or statuses[frame] != "converged"
    ] or range(len(grades))
    return GradeSummary.of([grades[k] for k in chosen], [errors[k] for k in chosen])


def summarise(
    piece: np.ndarray,  # (N,) int: the piece of each frame; −1 for none
    statuses: Sequence[Status],
    grades: GradeSummary,
    camera: Camera,
    calibration: Calibration,
) -> str:
    """Return one paragraph: poses, pieces, focal length, grades, and what to do."""
    count, sizes = len(piece), np.bincount(piece[piece >= 0])
    sentences = [f"{int(sizes.sum())} of {count} frames have a pose, in {describe_pieces(sizes)}."]
    focal = describe_focal(
        calibration.focal or camera.focal, calibration.focal_std, calibration.shape
    )
    sentences.append(f"The focal length is {focal}, {calibration.origin}.")
    counts = f" ({grades.counts_text})" if len(grades.counts) > 1 else ""
    sentences.append(f"Grade {grades.text}{counts}.")
    for code in dict.fromkeys(str(status) for status in statuses if status != "converged"):
        same = [status for status in statuses if status == code]
        message = f": {same[0].message}" if same[0].message else ""
        frames = f"{len(same)} frame{'s' * (len(same) != 1)}"
        sentences.append(f"{code}, {frames}{message}.")
    if not calibration.seen and calibration.message:
        sentences.append(f"{calibration.message}.")
    return " ".join(" ".join(sentences).replace("..", ".").split())


def describe_pieces(sizes: np.ndarray) -> str:
    """Return the number of pieces and their sizes, (P,) int, in words."""
    text = f"{len(sizes)} piece{'s' * (len(sizes) != 1)}"
    if len(sizes) > 1:
        text += f" ({', '.join(map(str, sizes))} frames, each with its own scale)"
    return text
